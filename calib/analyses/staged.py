"""Stored calibrations, and staged ones: a study that adopts values found by an earlier one."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from calib.analyses.provenance.places import QUICK
from calib.analyses.provenance.stale import stale_answers
from calib.errors.errors import InputError
from calib.problem.space import ParameterSpace
from calib.results.json_file import read_json
from calib.results.results import Results
from calib.results.table import read_table
from calib.results.written import require_unchanged
from calib.study.several import AnyStudy, JointStudy
from calib.study.study import LoadedStudy
from calib.study.study_file import shell_argument, study_file
from calib.study.study_text import read_settings

_ROUNDING = 1e-9
"""Relative tolerance at a limit, since tables keep ten digits."""


def earliest_first(path: Path) -> tuple[Path, ...]:
    """Files of a study and of all earlier ones whose values it adopts, the earliest first."""
    files = [study_file(path)]
    while (earlier := _earlier(files[0])) is not None:
        if earlier.resolve() in [f.resolve() for f in files]:
            raise InputError(
                "it adopts values from itself, directly or by way of other studies", place=files[0],
                remedy="name another study under [adopted]",
            )  # fmt: skip
        files.insert(0, earlier)
    return tuple(files)


def _earlier(file: Path) -> Path | None:
    adopted = read_settings(file).adopted
    if adopted is None:
        return None
    earlier = study_file(file.resolve().parent / adopted.study)
    if not earlier.is_file():
        raise InputError(
            f"there is no study {adopted.study!r} to adopt values from", place=file,
            remedy="[adopted] study is a folder, relative to this study's",
        )  # fmt: skip
    return earlier


class Found(NamedTuple):
    """Result of a calibration: all values, and the standard deviations of the fitted ones."""

    values: dict[str, float]
    std: dict[str, float]


def values_found(study: LoadedStudy, root: Path, quick: bool = False) -> Found | None:
    """The best case of a calibration; None when there is none for the present state of the study.

    ``root`` is the root folder of all results; a quick run also accepts a quick calibration.
    """
    home = Results(root / study.name)
    found = stored_calibration(study, home)
    return stored_calibration(study, Results(home.path / QUICK)) if found is None and quick else found


def require_same_units(study: LoadedStudy, earlier: LoadedStudy) -> None:
    """InputError where an adopted parameter has another unit than in the earlier study."""
    adopted = study.settings.adopted
    for name in () if adopted is None else adopted.parameters:
        here, there = study.model.space, earlier.model.space
        if name in here and name in there and here[name].unit != there[name].unit:
            raise InputError(
                f"{name} is in {here[name].unit} here and in {there[name].unit} in {earlier.name}, from which it is "
                "adopted",
                place=study.file,
                remedy="give both models the parameter in one unit",
            )


def stored_calibration(study: AnyStudy, folder: Results) -> Found | None:
    """The calibration in a folder; None where it is missing or of another state, InputError where it is damaged.

    A selection by the sensitivity analysis is read from the same folder.
    """
    from calib.analyses.sensitivity import selecting

    if _missing(study, folder):
        return None
    remedy = f"run 'calib calibrate {shell_argument(study.file)}' again"
    for name in ("summary.json", "parameters.csv"):
        require_unchanged(folder.path / name, remedy)
    summary = read_json(folder.path / "summary.json", {"best_case": str}, remedy=remedy)
    if "calibrate" in stale_answers(study, folder).sentences:
        return None
    space = study.search_space if isinstance(study, JointStudy) else selecting(study, folder).search_space
    return _of_best_case(folder.path / "parameters.csv", str(summary.get("best_case")), space, remedy)


def required_calibration(study: AnyStudy, folder: Results) -> Found:
    """The same; InputError, with what to run, also where it is missing or of another state."""
    found = stored_calibration(study, folder)
    if found is None:
        why = stale_answers(study, folder).sentences.get("calibrate", "").partition(", so ")[0]
        remedy = f"run it first: calib calibrate {shell_argument(study.file)}"
        raise InputError(why or "the study was not calibrated yet", place=study.file, remedy=remedy)
    return found


def _missing(study: AnyStudy, folder: Results) -> bool:
    """Whether a folder lacks a calibration, or the valid selection that it needs."""
    if not (folder.has("summary.json") and folder.has("parameters.csv")):
        return True
    if isinstance(study, JointStudy) or not study.settings.selected_by_sensitivity:
        return False
    from calib.analyses.sensitivity import outdated_selection

    return not folder.has("selection.csv") or bool(outdated_selection(study, folder))


def _of_best_case(path: Path, case: str, space: ParameterSpace, remedy: str) -> Found:
    """Values and standard deviations of one case, every free parameter once and within its limits."""
    table = read_table(
        path, ["case", "parameter"], ["value", "std"], complete=["value"], blank=["unit"], unique=("case", "parameter")
    )
    best = table[table["case"] == case]
    found = dict(zip(best["parameter"], best["value"], strict=True))
    if differing := sorted(set(found) ^ set(space.free_names)):
        there = "has no row" if differing[0] in space.free_names else "is none of the study's"
        raise InputError(f"parameter {differing[0]!r} of case {case!r} {there}", place=path, remedy=remedy)
    units = dict(zip(best["parameter"], best["unit"], strict=True))
    for name, value in found.items():
        parameter = space[name]
        if units[name] != parameter.unit:
            raise InputError(
                f"{name} is in {units[name] or 'no unit'}, and the model's is in {parameter.unit}", place=path,
                remedy=remedy,
            )  # fmt: skip
        slack = _ROUNDING * max(abs(parameter.lower), abs(parameter.upper))
        if not parameter.lower - slack <= value <= parameter.upper + slack:
            raise InputError(
                f"{name} = {value:g} is outside its limits [{parameter.lower:g}, {parameter.upper:g}]",
                place=path, remedy=remedy,
            )  # fmt: skip
        if parameter.integer and value != round(value):
            raise InputError(f"{name} = {value:g} is no integer", place=path, remedy=remedy)
        found[name] = min(max(value, parameter.lower), parameter.upper)
    known = best[best["std"].notna()]
    if (known["std"] < 0).any():
        raise InputError("a standard deviation is negative", place=path, remedy=remedy)
    return Found(space.complete(found), dict(zip(known["parameter"], known["std"], strict=True)))
