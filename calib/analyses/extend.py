"""Extended studies: a new study whose model has further effects, beside its parent or among the results."""

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

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.problem.effect import Effect
from calib.results.answer import in_prose
from calib.results.written import DRAFT, free_name, is_own_folder, note_folder
from calib.study.loading import pick
from calib.study.search_settings import CalibrationSettings
from calib.study.several import AnyStudy, load
from calib.study.study_file import StudyFile

NAME = "study.toml"
EXTENDED, EARLIER = "_extended", "_earlier"
"""Name of a study's file; ends of the names of a study written among results, and of one that was there before."""
STARTS = 4
"""Starts of least squares of a study that begins at a known fit."""


@dataclass(frozen=True)
class Extension:
    """An extended study that was written.

    Attributes
    ----------
    file : Path
        The new study file.
    effects : tuple of Effect
        The added effects.
    selected : tuple of str
        Their parameters that were added to the selection; empty when the sensitivity analysis selects.
    aside : Path or None
        New location of a changed study that was in this place; its results are not moved with it.
    """

    file: Path
    effects: tuple[Effect, ...]
    selected: tuple[str, ...]
    aside: Path | None = None


def write_extension(
    study: AnyStudy, names: Sequence[str], folder: Path, begin_at: Mapping[str, float] = MappingProxyType({})
) -> Extension:
    """Write a study that builds on another and adds effects of its library; it is written whole or not at all.

    Parameters
    ----------
    study : Study
    names : sequence of str
        Of the effects.
    folder : Path
        A folder that does not exist yet, in one that does.
    begin_at : mapping from str to float
        Fitted values of the extended model, such as those of an explanation. The new study then calibrates by least
        squares from there, from the nominal values and from sampled points, instead of a search from scratch.

    Raises
    ------
    InputError
        When the study has no such effect or has it already, the folder cannot be written, or the new study is invalid.
    """
    effects = _candidates(study, names)
    new = _free_place(study.file.resolve().parent, folder)
    with _written(study, effects, folder, new, _beside, begin_at) as (draft, extension):
        _put(draft, new, folder)
    return extension


def extend_among(
    study: AnyStudy, names: Sequence[str], results: Path, begin_at: Mapping[str, float] = MappingProxyType({})
) -> Extension:
    """Write the same into a folder of results, replacing what an earlier run wrote there.

    ``begin_at`` as in `write_extension`.

    The new study names its parent by a relative and an absolute path, so that it can be moved alone or together with
    it. An identical study stays as it is. Another one is replaced if it is unchanged since it was written here;
    otherwise it is kept beside the new one under a name that ends with `EARLIER`.
    """
    folder = _place_among(study, results)
    new = folder.parent.resolve() / folder.name
    with _written(study, _candidates(study, names), folder, new, anywhere, begin_at) as (draft, extension):
        aside = put_among(draft, new, folder)
    return extension if aside is None else replace(extension, aside=aside)


def put_among(draft: Path, new: Path, folder: Path) -> Path | None:
    """Move a draft among results; an identical study stays, and a changed one is kept at the returned place."""
    if new.is_dir() and _content(new) == _content(draft):
        return None
    with draft_of(new, folder) as old:
        own, there = is_own_folder(new), os.path.lexists(new)
        aside = old / new.name if own else free_name(new, EARLIER)
        try:
            note_folder(draft, new.name)
        except OSError as fault:
            raise unwritable(fault, folder) from None
        if there:
            _put(new, aside, folder)
        _put(draft, new, folder)
    return folder.with_name(aside.name) if there and not own else None


def set_aside(folder: Path) -> Path | None:
    """Move a study that was written among results out of its place, to the returned one; None where there is none."""
    new = folder.parent.resolve() / folder.name
    if not os.path.lexists(new):
        return None
    aside = free_name(new, EARLIER)
    _put(new, aside, folder)
    return folder.with_name(aside.name)


def found_among(study: StudyFile, results: Path) -> Path | None:
    """The study file that `extend_among` wrote into a folder of results; None without one."""
    file = _place_among(study, results) / NAME
    return file if file.is_file() else None


def _place_among(study: StudyFile, results: Path) -> Path:
    return results / f"{study.name}{EXTENDED}"


def _candidates(study: AnyStudy, names: Sequence[str]) -> tuple[Effect, ...]:
    if not study.library and not study.settings.effects:
        raise InputError(
            "the study names no list of possible causes",
            place=study.file,
            remedy='add a line such as effects = "effects.py:library" or effects = "generic"',
        )
    effects = tuple(pick(study.library, name, Place(str(study.file))) for name in dict.fromkeys(names))
    for effect in effects:
        if effect in study.included:
            raise InputError(
                f"the effect {effect.name!r} is in the model already",
                place=study.file,
                remedy=f"the effects it lacks are {', '.join(e.name for e in study.candidates) or 'none'}",
            )
    return effects


def beginning_at(calibration: CalibrationSettings, values: Mapping[str, float]) -> dict[str, Any]:
    """Keys of a calibration that begins at fitted values of its model, where that would search from scratch."""
    begin_at = {**calibration.begin_values, **values}
    if not calibration.refine or calibration.method not in ("auto", "genetic"):
        return {"begin_at": begin_at}
    return {"method": "gauss-newton", "starts": STARTS, "begin_at": begin_at}


# -- writing -----------------------------------------------------------------------------------------------------------

Leading = Callable[[Path, Path], str | list[str]]
"""Path or paths by which a new folder names its parent."""


def _beside(goal: Path, new: Path) -> str:
    return Path(os.path.relpath(goal, new)).as_posix()


def anywhere(goal: Path, new: Path) -> list[str]:
    """A relative and an absolute path, of which the first that exists holds."""
    return [_beside(goal, new), goal.as_posix()]


@contextlib.contextmanager
def _written(
    study: AnyStudy,
    effects: tuple[Effect, ...],
    folder: Path,
    new: Path,
    leading: Leading,
    begin_at: Mapping[str, float],
) -> Iterator[tuple[Path, Extension]]:
    """The new study as a checked draft beside its place; deleted afterwards unless it was moved there."""
    free = tuple(p.name for effect in effects for p in effect.parameters if p.distribution != "fixed")
    listed = study.settings.listed is not None
    selected = () if study.settings.selected_by_sensitivity else free
    text = _text(study, effects, selected if listed else (), new, leading, begin_at)
    with draft_of(new, folder) as draft:
        target = draft / NAME
        try:
            draft.chmod(0o755)
            target.write_text(text, encoding="utf-8", newline="")
        except OSError as fault:
            raise unwritable(fault, folder) from None
        require_valid(study, target, folder)
        for cache in draft.rglob("__pycache__"):  # made by the check
            shutil.rmtree(cache, ignore_errors=True)
        yield draft, Extension(folder / target.name, effects, selected)


def _put(draft: Path, new: Path, folder: Path) -> None:
    try:
        draft.rename(new)
    except OSError as fault:
        raise unwritable(fault, folder) from None


def _content(folder: Path) -> dict[Path, bytes]:
    """Every file of a study with its content, without hidden files, caches and results."""
    files = ((p.relative_to(folder), p) for p in folder.rglob("*") if p.is_file())
    return {name: p.read_bytes() for name, p in files if not any(_is_ignored(part) for part in name.parts)}


def _is_ignored(part: str) -> bool:
    return part.startswith(".") or part in ("results", "__pycache__")


# -- places ------------------------------------------------------------------------------------------------------------


def _free_place(old: Path, folder: Path) -> Path:
    """Resolved path of the new folder; InputError when it cannot be written there."""
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


@contextlib.contextmanager
def draft_of(new: Path, folder: Path) -> Iterator[Path]:
    """A folder beside the new one, deleted afterwards unless it was renamed."""
    try:
        draft = Path(tempfile.mkdtemp(prefix=".calib-extend-", suffix=DRAFT, dir=new.parent))
    except OSError as fault:
        raise unwritable(fault, folder) from None
    try:
        yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def unwritable(fault: OSError, folder: Path) -> InputError:
    """The error for a folder that cannot be written."""
    words = fault.strerror
    if isinstance(fault, shutil.Error) and fault.args and fault.args[0]:
        source, _, why = fault.args[0][0]
        words = f"{source}: {why}"
    return InputError(f"it cannot be written ({words or fault})", place=folder, remedy="free it or name another place")


def require_valid(study: AnyStudy, target: Path, folder: Path) -> None:
    """Load the draft of the new study; InputError when it is invalid."""
    try:
        load(target, study.adopted)
    except InputError as fault:
        said = str(fault).replace(str(target.parent), str(folder))
        at = None if fault.at is None else replace(fault.at, file=str(Path(fault.at.file).resolve()))
        if at is not None and Path(at.file).is_relative_to(target.parent.resolve()):  # a file that does not stay
            at = None
        words = f"the new study would be invalid and was not written: {said}"
        raise InputError(words, remedy="extend by hand, or correct the study", at=at) from None


def _text(
    study: AnyStudy,
    effects: Sequence[Effect],
    selected: Sequence[str],
    new: Path,
    leading: Leading,
    begin_at: Mapping[str, float],
) -> str:
    """Text of the new study file: its parent and its additions."""
    source, given = study.file.resolve(), study.settings
    names = [effect.name for effect in effects]
    document = tomlkit.document()
    document["title"] = " + ".join([given.title, *map(in_prose, names)])
    document["base"] = leading(source.parent if source.name == "study.toml" else source, new)
    document["with_effects"] = [*given.with_effects, *names]
    if selected:
        document["selection"] = [*(given.listed or ()), *selected]
    calibration = beginning_at(given.calibration, begin_at) if begin_at else {}
    if given.selected_by_sensitivity:  # which may not select all of these
        calibration.pop("begin_at", None)
    elif begin_at:
        known = tomlkit.inline_table()
        known.update(begin_at)
        calibration["begin_at"] = known
    if calibration:
        document["calibration"] = calibration
    return tomlkit.dumps(document)
