"""A study that adopts values of earlier ones: these are read, and calibrated where they are not yet, in their order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from calib.analyses import staged
from calib.analyses.provenance.isolation import isolated
from calib.errors.errors import InputError
from calib.study.several import AnyStudy, load
from calib.study.study import LoadedStudy


def loaded_after(path: Path, calibrated: Callable[[LoadedStudy, Path], staged.Found | None]) -> AnyStudy:
    """A study with the values that it adopts; a user's function runs in a child process.

    Parameters
    ----------
    path : Path
    calibrated : callable
        Returns what an earlier study has found, given that study and its file.

    Raises
    ------
    InputError
        For anything wrong in one of the studies, and where an earlier one has several tests.
    """
    *earlier, last = staged.earliest_first(path)
    taken: staged.Found = staged.Found({}, {})
    before: LoadedStudy | None = None
    for file in earlier:
        study = _taking_over(file, taken, before)
        if study.settings.several:
            raise InputError(
                "values can be adopted from a study with one test only, and this one has several", place=file,
                remedy="fit all tests together in one study",
            )  # fmt: skip
        (before,) = study.studies
        taken = calibrated(before, file) or staged.Found({}, {})
    return _taking_over(last, taken, before)


def _taking_over(file: Path, taken: staged.Found, before: LoadedStudy | None) -> AnyStudy:
    study = load(file, *taken)
    if before is not None:
        for one in study.studies:
            staged.require_same_units(one, before)
    return study.each(isolated)
