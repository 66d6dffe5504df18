"""A new study whose model has effects more, written beside the one it comes from or among its results."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from calib.effect import Effect
from calib.errors import InputError
from calib.loading import pick
from calib.settings import line_of
from calib.study import Study, StudyFile
from calib.written import DRAFT, free_name, is_own_folder, note_folder

LEFT_BEHIND = ("results", "__pycache__")
"""Folders that are no part of a study; hidden files and folders are none either."""
TOLD_OF_THE_OLD = "README.md"
"""File that says what a study is; it would not be true of the new one."""
EXTENDED, EARLIER = "_extended", "_earlier"
"""Ends of the names of a study written among results, and of one that was there before."""


@dataclass(frozen=True)
class Extension:
    """A study that was written with more effects.

    Attributes
    ----------
    file : Path
        The new study file.
    effects : tuple of Effect
        What its model has more than the old one's.
    selected : tuple of str
        Their parameters that were added to the selection; none when the study leaves that to the sensitivity analysis.
    moved : tuple of (str, str)
        Paths that lead out of the study, as they were and as they lead to the same place from the new folder.
    aside : Path or None
        Where a study is now that was in the new one's place and had been changed; its answers are not moved with it.
    """

    file: Path
    effects: tuple[Effect, ...]
    selected: tuple[str, ...]
    moved: tuple[tuple[str, str], ...]
    aside: Path | None = None


def extend(study: Study, names: Sequence[str], folder: Path) -> Extension:
    """Write a copy of a study with more effects of its library; the folder appears whole or not at all.

    Parameters
    ----------
    study : Study
    names : sequence of str
        Of the effects.
    folder : Path
        A folder that does not exist yet, in one that does.

    Raises
    ------
    InputError
        When the study has no such effect or has it already, the folder cannot be there, or the new study is not sound.
    """
    effects = _candidates(study, names)
    new = _free_place(study.file.resolve().parent, folder)
    with _written(study, effects, folder, new, _beside, {}) as (draft, extension):
        _put(draft, new, folder)
    return extension


def extend_among(
    study: Study, names: Sequence[str], results: Path, begin_at: Mapping[str, float] = MappingProxyType({})
) -> Extension:
    """Write the same into a folder of results, whatever an earlier run has written there.

    Its least squares begin at given values too, such as those of an explanation, which has fitted the same model; not
    where the selection is left to a sensitivity analysis, which may not select them.

    Paths that lead out of the study become absolute, so that the folder may be moved. One that is there and says the
    same stays as it is; another is replaced as long as it is what was written here, and kept beside it under a name
    with `EARLIER` at its end when anything in it was changed or added.
    """
    folder = _place_among(study, results)
    new = folder.parent.resolve() / folder.name
    with _written(study, _candidates(study, names), folder, new, _anywhere, begin_at) as (draft, extension):
        if not new.is_dir() or _content(new) != _content(draft):
            with _draft_of(new, folder) as old:
                own = is_own_folder(new)
                aside = old / new.name if own else free_name(new, EARLIER)
                try:
                    note_folder(draft, new.name)
                except OSError as fault:
                    raise _unwritable(fault, folder) from None
                if os.path.lexists(new):
                    _put(new, aside, folder)
                    extension = extension if own else replace(extension, aside=folder.with_name(aside.name))
                _put(draft, new, folder)
    return extension


def found_among(study: StudyFile, results: Path) -> Path | None:
    """The study file that `extend_among` has written into a folder of results; None without one."""
    file = _place_among(study, results) / study.file.name
    return file if file.is_file() else None


def _place_among(study: StudyFile, results: Path) -> Path:
    return results / f"{study.name}{EXTENDED}"


def _candidates(study: Study, names: Sequence[str]) -> tuple[Effect, ...]:
    if study.settings.effects is None:
        raise InputError(
            "the study names no library of effects",
            place=study.file,
            remedy='add a line such as effects = "effects.py:library"',
        )
    effects = tuple(pick(study.library, name, str(study.file)) for name in dict.fromkeys(names))
    for effect in effects:
        if effect in study.included:
            raise InputError(
                f"the effect {effect.name!r} is in the model already",
                place=study.file,
                remedy=f"the effects it lacks are {', '.join(e.name for e in study.candidates) or 'none'}",
            )
    return effects


# -- writing -----------------------------------------------------------------------------------------------------------

Leading = Callable[[Path, Path], str]
"""How a path is written that leads from the new folder to a place outside."""


def _beside(goal: Path, new: Path) -> str:
    return Path(os.path.relpath(goal, new)).as_posix()


def _anywhere(goal: Path, new: Path) -> str:
    return goal.as_posix()


@contextlib.contextmanager
def _written(
    study: Study,
    effects: tuple[Effect, ...],
    folder: Path,
    new: Path,
    leading: Leading,
    begin_at: Mapping[str, float],
) -> Iterator[tuple[Path, Extension]]:
    """The new study as a draft beside its place, checked; gone afterwards unless it was put there."""
    source = study.file.resolve()
    old = source.parent
    free = tuple(p.name for effect in effects for p in effect.parameters if p.distribution != "fixed")
    selected = () if isinstance(study.settings.selection, str) else free
    text, moved = _extended_text(study, effects, selected, source, new, leading, begin_at)
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
        yield draft, Extension(folder / source.name, effects, selected, moved)


def _put(draft: Path, new: Path, folder: Path) -> None:
    try:
        draft.rename(new)
    except OSError as fault:
        raise _unwritable(fault, folder) from None


def _content(folder: Path) -> dict[Path, bytes]:
    """Every file of a study with its content."""
    files = (p for p in folder.rglob("*") if p.is_file())
    within = ((p, [q for q in (p, *p.parents) if q != folder and q.is_relative_to(folder)]) for p in files)
    return {p.relative_to(folder): p.read_bytes() for p, parts in within if not any(map(_is_left_behind, parts))}


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
        left |= {name for name in names if draft.is_relative_to(Path(folder, name))}  # results beside the study's files
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
        draft = Path(tempfile.mkdtemp(prefix=".calib-extend-", suffix=DRAFT, dir=new.parent))
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
    study: Study,
    effects: Sequence[Effect],
    selected: Sequence[str],
    source: Path,
    new: Path,
    leading: Leading,
    begin_at: Mapping[str, float],
) -> tuple[str, tuple[tuple[str, str], ...]]:
    """The new study file, its comments and order kept, and the paths that had to change."""
    try:
        document: Any = tomlkit.parse(source.read_bytes().decode("utf-8"))
    except TOMLKitError as fault:
        raise InputError(f"it cannot be rewritten ({fault})", place=study.file, remedy="extend by hand") from None
    names = [effect.name for effect in effects]
    document["title"] = " + ".join([study.settings.title, *names])
    for name in selected:
        document["selection"].append(name)
    if selected and begin_at:
        known = tomlkit.inline_table()
        known.update(begin_at)
        document["calibration"]["begin_at"] = known
    moved = tuple(_move_paths(document, source.parent, new, leading))
    fresh: dict[str, Any] = {}
    if "with_effects" in document:
        document["with_effects"].extend(names)
    else:
        fresh["with_effects"] = names
    came_from = leading(source.parent if source.name == "study.toml" else source, new)
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


def _move_paths(document: Any, old: Path, new: Path, leading: Leading) -> Iterator[tuple[str, str]]:
    """Rewrite every path of the study file that leads to what is not copied; yields what it was and what it is."""

    def moved(path: str) -> str:
        if Path(path).is_absolute():
            return path
        goal = Path(os.path.normpath(old / path))
        parts = [p for p in (goal, *goal.parents) if p != old and p.is_relative_to(old)]
        if parts and not any(_is_left_behind(p) for p in parts):
            return path
        return leading(goal, new)

    for key in ("model", "effects"):
        where, _, function = str(document[key]).rpartition(":")
        if where.endswith(".py") and moved(where) != where:
            document[key] = f"{moved(where)}:{function}"
            yield where, moved(where)
    for k, path in enumerate(str(p) for p in document.get("depends_on", ())):
        if moved(path) != path:
            document["depends_on"][k] = moved(path)
            yield path, moved(path)
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
