"""Frequency response functions to universal files (UFF, UNV): datasets 58."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import VALUE_LIMIT
from calib.measurement.files.uff_sets import SI_UNITS, header, nodes, points_of_nodes, write_sets
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS

Form = Literal["double", "single", "binary"]
_NUMERATOR: Mapping[str, int] = {"receptance": 8, "mobility": 11, "accelerance": 12}
_FORCE, _FREQUENCY, _FRF = 13, 18, 4
_BINARY_HEAD = re.compile(rb"(?m)^( {4}58b[ \d]{6}[ \d]{6} {10}11)[ \d]{12}(?=[ \d]{36}$)")
"""The first line of a binary function, up to its number of bytes."""


def write_uff_frfs(path: Path, frfs: MeasuredFRFs, title: str = "FRFs", form: Form = "double") -> None:
    """Write one repeat: datasets 151, 164 (SI), 15 where all places are known, and a 58 for each measured function.

    Standard deviations have no place in the format. The file is written whole or not at all, and the same functions
    give the same bytes.

    Parameters
    ----------
    path : Path
    frfs : MeasuredFRFs
        A function that is NaN on every line was not measured and is left out.
    title : str
        Model name in dataset 151 and second ID line of each function. The first one names quantity, response and
        reference, after ``SYNTHETIC`` where no structure was measured.
    form : {"double", "single", "binary"}
        Values as text of 12 or 6 digits, or as bytes without loss. Frequencies are exact where they are evenly spaced
        with a start and a step of 6 digits, and in binary; else they are text of 6 digits.

    Raises
    ------
    InputError
        For what the format cannot hold or no reader would take, or a path that cannot be written.
    """
    _check_writable(path, frfs)
    even = _evenly_spaced(frfs.freq)
    if not even and form != "binary" and np.any(np.diff(_six_digits(frfs.freq)) <= 0):
        raise InputError("two lines are the same in six digits", place=path, remedy="write it binary")
    label = "SYNTHETIC " if frfs.synthetic else ""
    name = " ".join(title.split())
    points = points_of_nodes(path, frfs.sensors)
    sets: list[Mapping[str, Any]] = [header(f"{label}{name}", "frequency response functions"), SI_UNITS]
    if all(sensor.point is not None for sensor in frfs.sensors):
        sets.append(nodes(points))
    for number, function in enumerate(frfs.functions, start=1):
        response, reference = function.response, function.reference
        sets.append({
            "type": 58, "func_type": _FRF, "func_id": number, "binary": int(form == "binary"),
            "id1": f"{label}{frfs.quantity} {function.name}", "id2": name[:80],
            "rsp_node": response.node, "rsp_dir": DIRECTIONS.index(response.direction) + 1,
            "ref_node": reference.node, "ref_dir": DIRECTIONS.index(reference.direction) + 1,
            "x": frfs.freq, "data": frfs.values[:, function.i, function.j],
            "ord_data_type": 5 if form == "single" else 6,
            "abscissa_spacing": int(even), "abscissa_spec_data_type": _FREQUENCY, "abscissa_axis_units_lab": "Hz",
            "ordinate_spec_data_type": _NUMERATOR[frfs.quantity], "orddenom_spec_data_type": _FORCE,
        })  # fmt: skip
    count = len(frfs.freq) * (16 if even else 24)
    write_sets(path, sets, form != "single", partial(_count_bytes, count) if form == "binary" else None)


def _check_writable(path: Path, frfs: MeasuredFRFs) -> None:
    """InputError for values that the format cannot hold, and where nothing was measured."""
    if not frfs.functions:
        raise InputError("no function was measured", place=path, remedy="give at least one")
    for function in frfs.functions:
        values = frfs.values[:, function.i, function.j]
        if not np.all(np.abs(values) <= VALUE_LIMIT):  # NaN fails the comparison too
            raise InputError(
                f"the function {function.name} holds a value that is not a finite number, for which the format has no "
                "mark",
                place=path, remedy="give it on every line, or leave out the line or the function",
            )  # fmt: skip
        if not values.any():
            raise InputError(
                f"the function {function.name} is zero on every line: a dead channel", place=path, remedy="leave it out"
            )


def _evenly_spaced(freq: np.ndarray) -> bool:
    """Whether a start and a step of six digits, all that the format has for them, give these frequencies."""
    start, step = _six_digits(np.array([freq[0], freq[1] - freq[0]]))
    return bool(np.allclose(start + step * np.arange(len(freq)), freq, rtol=1e-12, atol=0))


def _six_digits(values: np.ndarray) -> np.ndarray:
    return np.array([float(f"{value:.5e}") for value in values])


def _count_bytes(count: int, draft: Path) -> None:
    """State the number of bytes of each binary function; pyuff counts those of the real parts alone."""
    draft.write_bytes(_BINARY_HEAD.sub(rb"\g<1>%12d" % count, draft.read_bytes()))
