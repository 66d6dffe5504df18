"""Phases: a study that takes over what an earlier one has found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from calib.errors import InputError
from calib.questions.calibrate import fingerprint
from calib.questions.places import QUICK
from calib.questions.sensitivity import selected_by_measures
from calib.results import Results
from calib.settings import read_settings
from calib.study import Study, study_file


def in_order(path: Path) -> tuple[Path, ...]:
    """Files of a study and of those before it whose values it takes over, the first one first."""
    files = [study_file(path)]
    while (earlier := _earlier(files[0])) is not None:
        if earlier.resolve() in [f.resolve() for f in files]:
            raise InputError(
                "it takes values over from itself, by way of other studies or directly", place=files[0],
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
            f"there is no study {adopted.study!r} to take values over from", place=file,
            remedy="[adopted] study is a folder, relative to this study's",
        )  # fmt: skip
    return earlier


class Found(NamedTuple):
    """What a calibration has found: all values, and the standard deviations of those that it fitted."""

    values: dict[str, float]
    std: dict[str, float]


def values_found(study: Study, root: Path, quick: bool = False) -> Found | None:
    """The best case of a calibration; None when there is none of the study as it is now.

    ``root`` is where the folders with results are; a quick look is content with a quick answer.
    """
    home = Results(root / study.name)
    found = _values(study, home, home)
    return _values(study, Results(home.path / QUICK), home) if found is None and quick else found


def _values(study: Study, folder: Results, home: Results) -> Found | None:
    try:
        summary = json.loads((folder.path / "summary.json").read_text("utf-8"))
        table = pd.read_csv(folder.path / "parameters.csv")
        if summary["fingerprint"] != fingerprint(selected_by_measures(study, home)):
            return None
        best = table[table["case"] == summary["best_case"]].set_index("parameter")[["value", "std"]].astype(float)
        known = best["std"][np.isfinite(best["std"])]
        return Found(study.search_space.complete(best["value"].to_dict()), known.to_dict())
    except (InputError, OSError, ValueError, KeyError):
        return None
