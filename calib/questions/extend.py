"""A new study whose model has one more effect, written beside the one it comes from."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from calib.effect import Effect
from calib.errors import InputError
from calib.loading import pick
from calib.settings import line_of
from calib.study import Study

LEFT_BEHIND = ("results", "__pycache__")
"""Folders that are no part of a study; hidden files and folders are none either."""
TOLD_OF_THE_OLD = "README.md"
"""File that says what a study is; it would not be true of the new one."""


@dataclass(frozen=True)
class Extension:
    """A study that was written with one more effect.

    Attributes
    ----------
    file : Path
        The new study file.
    effect : Effect
        What its model has more than the old one's.
    selected : tuple of str
        The effect's parameters that were added to the selection; none when the study leaves that to the sensitivity
        analysis.
    moved : tuple of (str, str)
        Paths that lead out of the study, as they were and as they lead to the same place from the new folder.
    """

    file: Path
    effect: Effect
    selected: tuple[str, ...]
    moved: tuple[tuple[str, str], ...]


def extend(study: Study, name: str, folder: Path) -> Extension:
    """Write a copy of a study with one more effect of its library; the folder appears whole or not at all.

    Parameters
    ----------
    study : Study
    name : str
        Of the effect.
    folder : Path
        A folder that does not exist yet, in one that does.

    Raises
    ------
    InputError
        When the study has no such effect or has it already, the folder cannot be there, or the new study is not sound.
    """
    effect = _candidate(study, name)
    source = study.file.resolve()
    old = source.parent
    new = _free_place(old, folder)
    free = tuple(p.name for p in effect.parameters if p.distribution != "fixed")
    selected = () if isinstance(study.settings.selection, str) else free
    text, moved = _extended_text(study, effect, selected, source, new)
    with _draft_of(new, folder) as draft:
        try:
            shutil.copytree(old, draft, ignore=_left_behind(old, draft), dirs_exist_ok=True)
            draft.chmod(old.stat().st_mode & 0o7777 | 0o700)
            target = draft / source.name
            target.unlink(missing_ok=True)  # a copy keeps the mode of its original, which may be read-only
            target.write_text(text, encoding="utf-8", newline="")
        except (OSError, shutil.Error) as fault:
            raise _unwritable(fault, folder) from None
        _check(target, folder, study.adopted)
        for cache in draft.rglob("__pycache__"):  # made by the check
            shutil.rmtree(cache, ignore_errors=True)
        try:
            draft.rename(new)
        except OSError as fault:
            raise _unwritable(fault, folder) from None
    return Extension(folder / source.name, effect, selected, moved)


def _candidate(study: Study, name: str) -> Effect:
    if study.settings.effects is None:
        raise InputError(
            "the study names no library of effects",
            place=study.file,
            remedy='add a line such as effects = "effects.py:library"',
        )
    effect = pick(study.library, name, str(study.file))
    if effect in study.included:
        raise InputError(
            f"the effect {name!r} is in the model already",
            place=study.file,
            remedy=f"the effects it lacks are {', '.join(e.name for e in study.candidates) or 'none'}",
        )
    return effect


# -- places ------------------------------------------------------------------------------------------------------------


def _free_place(old: Path, folder: Path) -> Path:
    """Where the new folder will be, without links; InputError when it cannot be there."""
    if os.path.lexists(folder):
        raise InputError("it exists already", place=folder, remedy="name a new folder")
    if not folder.parent.is_dir():
        raise InputError(
            f"there is no folder {str(folder.parent)!r} to put it in", place=folder, remedy="make that one first"
        )
    new = folder.parent.resolve() / folder.name
    if new.is_relative_to(old):
        raise InputError("it would lie inside the study it is copied from", place=folder, remedy="put it beside it")
    if new.suffix == ".toml":
        raise InputError("it would be taken for a study file", place=folder, remedy="name it without .toml")
    return new


def _is_left_behind(path: Path) -> bool:
    return path.name.startswith(".") or (path.name in LEFT_BEHIND and path.is_dir())


def _left_behind(old: Path, draft: Path) -> Callable[[str, list[str]], set[str]]:
    """Which names of a folder are not copied; linked files and folders are copied as what they lead to."""

    def ignored(folder: str, names: list[str]) -> set[str]:
        left = {name for name in names if _is_left_behind(Path(folder, name))}
        left |= {TOLD_OF_THE_OLD} & set(names) if Path(folder) == old else set()
        for linked in (Path(folder, name) for name in names if name not in left):
            if linked.is_symlink() and linked.is_dir():
                goal = linked.resolve()
                if old.is_relative_to(goal) or draft.is_relative_to(goal):
                    raise InputError(
                        "it leads to a folder around the study and cannot be copied",
                        place=linked,
                        remedy="remove that link",
                    )
        return left

    return ignored


@contextlib.contextmanager
def _draft_of(new: Path, folder: Path) -> Iterator[Path]:
    """A folder beside the new one that is gone afterwards, unless it was renamed."""
    try:
        draft = Path(tempfile.mkdtemp(prefix=".calib-extend-", dir=new.parent))
    except OSError as fault:
        raise _unwritable(fault, folder) from None
    try:
        yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _unwritable(fault: OSError, folder: Path) -> InputError:
    words = fault.strerror
    if isinstance(fault, shutil.Error) and fault.args and fault.args[0]:
        source, _, why = fault.args[0][0]
        words = f"{source}: {why}"
    return InputError(f"it cannot be written ({words or fault})", place=folder, remedy="free it or name another place")


def _check(target: Path, folder: Path, adopted: Mapping[str, float]) -> None:
    """Load the draft of the new study, complaining as if it were in its place."""
    try:
        Study.load(target, adopted)
    except InputError as fault:
        said = str(fault).replace(str(target.parent), str(folder))
        raise InputError(
            f"the new study would not be sound and was not written: {said}", remedy="extend by hand, or mend the study"
        ) from None


# -- the study file ----------------------------------------------------------------------------------------------------


def _extended_text(
    study: Study, effect: Effect, selected: Sequence[str], source: Path, new: Path
) -> tuple[str, tuple[tuple[str, str], ...]]:
    """The new study file, its comments and order kept, and the paths that had to change."""
    try:
        document: Any = tomlkit.parse(source.read_bytes().decode("utf-8"))
    except TOMLKitError as fault:
        raise InputError(f"it cannot be rewritten ({fault})", place=study.file, remedy="extend by hand") from None
    document["title"] = f"{study.settings.title} + {effect.name}"
    for name in selected:
        document["selection"].append(name)
    moved = tuple(_move_paths(document, source.parent, new))
    fresh: dict[str, Any] = {}
    if "with_effects" in document:
        document["with_effects"].append(effect.name)
    else:
        fresh["with_effects"] = [effect.name]
    came_from = Path(os.path.relpath(source.parent if source.name == "study.toml" else source, new)).as_posix()
    if "extended_from" in document:
        document["extended_from"] = came_from
    else:
        fresh["extended_from"] = came_from
    return _with_lines(document.as_string(), "effects", fresh), moved


def _with_lines(text: str, after: str, fresh: dict[str, Any]) -> str:
    """The text with keys on lines of their own after that of another key, where they stand best."""
    lines = text.splitlines(keepends=True)
    number = line_of(text, (after,)) or 0
    end = "\r\n" if number and lines[number - 1].endswith("\r\n") else "\n"
    if number and not lines[number - 1].endswith("\n"):
        lines[number - 1] += end
    lines[number:number] = [f"{key} = {tomlkit.item(value).as_string()}{end}" for key, value in fresh.items()]
    return "".join(lines)


def _move_paths(document: Any, old: Path, new: Path) -> Iterator[tuple[str, str]]:
    """Rewrite every path of the study file that leads to what is not copied; yields what it was and what it is."""

    def moved(path: str) -> str:
        if Path(path).is_absolute():
            return path
        goal = Path(os.path.normpath(old / path))
        parts = [p for p in (goal, *goal.parents) if p != old and p.is_relative_to(old)]
        if parts and not any(_is_left_behind(p) for p in parts):
            return path
        return Path(os.path.relpath(goal, new)).as_posix()

    for key in ("model", "effects"):
        where, _, function = str(document[key]).rpartition(":")
        if where.endswith(".py") and moved(where) != where:
            document[key] = f"{moved(where)}:{function}"
            yield where, moved(where)
    if "adopted" in document and moved(path := str(document["adopted"]["study"])) != path:
        document["adopted"]["study"] = moved(path)
        yield path, moved(path)
    measurement = document["measurement"]
    for key in ("sensors", "responses"):
        if key in measurement and moved(path := str(measurement[key])) != path:
            measurement[key] = moved(path)
            yield path, moved(path)
    for key in ("files", "shapes"):
        for k, path in enumerate(str(p) for p in measurement.get(key, ())):
            if moved(path) != path:
                measurement[key][k] = moved(path)
                yield path, moved(path)
