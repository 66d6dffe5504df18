"""Frequency response functions from universal files: datasets 58, ASCII or binary, with the units of 164."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from calib.errors import InputError
from calib.measurement.csv_format import VALUE_LIMIT
from calib.measurement.frf import AXIS, NO_PHASE, FRFRepeat, Key, Quantity, repeat_of
from calib.measurement.frf_units import GRAVITY, FRFUnits, parse_unit
from calib.measurement.modal import DIRECTIONS
from calib.measurement.uff import points_of
from calib.measurement.uff_blocks import read_blocks
from calib.measurement.uff_sets import pyuff_faults

_FRF, _COHERENCE = 4, 6
_MOTIONS: Mapping[int, Quantity] = {8: "receptance", 11: "mobility", 12: "accelerance"}
"""Quantity by the data type of the numerator."""
_FORCES = (13,)
_COMPLEX = (5, 6)
_FREQUENCY = (0, 18)
"""Data types of the abscissa: unknown, frequency."""


def read_uff_frfs(path: Path, quantity: Quantity | None = None, unit: str | None = None) -> FRFRepeat:
    """Read one repeat from a universal file.

    Every dataset 58 with a frequency response function counts; coherences are kept beside them, other functions are
    noted. A sensor mounted against its axis (negative direction) reverses the sign. Lengths and forces are those of
    dataset 164, accelerations in g are converted; a line at 0 Hz is dropped where the motion is no displacement. Places
    are those of datasets 15 or 2411.

    Parameters
    ----------
    path : Path
    quantity : {"receptance", "mobility", "accelerance"}, optional
        Where the file does not say; a contradiction is refused.
    unit : str, optional
        Likewise, where it has no dataset 164; see `calib.measurement.frf_units.parse_unit`.

    Raises
    ------
    InputError
        For a file that cannot be read, without such functions, with amplitudes alone, a function twice, or lines that
        differ between functions.
    """
    blocks = read_blocks(path)  # a truncated file would lose its last functions without a word
    sets = _sets(path)
    stated = None if unit is None else parse_unit(unit, path)
    if stated is not None:
        if quantity not in (None, stated[0]):
            raise InputError(f"{unit} is no unit of {quantity}", place=path, remedy="correct one of them")
        quantity = stated[0]
    own_units, notes = _units(path, sets, stated is not None)
    functions: dict[Key, np.ndarray] = {}
    coherence: dict[Key, np.ndarray] = {}
    axis: np.ndarray | None = None
    found: Quantity | None = None
    others = 0
    for data in sets:
        if data["type"] != 58:
            continue
        if data["func_type"] not in (_FRF, _COHERENCE):
            others += 1
            continue
        where = f"{path}, response {data['rsp_node']}, direction {data['rsp_dir']}"
        key, sign = _key(where, data)
        if int(data["abscissa_spec_data_type"]) not in _FREQUENCY:
            raise InputError("its abscissa is no frequency", place=where, remedy="export it over frequency in Hz")
        freq = np.asarray(data["x"], dtype=float)
        # pyuff reads what is there, however many values the header announces
        if not len(freq) == np.size(data["data"]) == int(data["num_pts"]):
            raise InputError(
                f"it has {np.size(data['data'])} values, but announces {int(data['num_pts'])}", place=where,
                remedy="export it again",
            )  # fmt: skip
        if axis is None:
            axis = freq
        if freq.shape != axis.shape or not np.allclose(freq, axis, rtol=AXIS, atol=AXIS * float(np.abs(axis).max())):
            raise InputError(
                "its lines are not those of the first function", place=where, remedy="export all on common frequencies"
            )
        if data["func_type"] == _COHERENCE:
            if key in coherence:
                raise InputError("this coherence is there twice", place=where, remedy="export each once")
            coherence[key] = np.asarray(np.real(data["data"]), dtype=float)
            continue
        if int(data["ord_data_type"]) not in _COMPLEX:
            raise InputError("its values are real", place=where, remedy=NO_PHASE)
        own = _quantity(where, data, quantity)
        if found not in (None, own):
            raise InputError(f"it is {own}, others are {found}", place=where, remedy="export one quantity")
        found = own
        if key in functions:
            raise InputError("this function is there twice", place=where, remedy="export each once, one file a repeat")
        values = np.asarray(data["data"], dtype=complex)
        if not np.all(np.abs(values) <= VALUE_LIMIT):  # NaN fails the comparison too
            raise InputError("it holds values that are not finite", place=where, remedy="export it again")
        if not values.any():
            raise InputError("it is zero on every line: a dead channel", place=where, remedy="leave it out")
        in_g = own == "accelerance" and _in_g(data)
        functions[key] = sign * values * _in_file(where, in_g, own_units, stated).factor(key)
    if axis is None or found is None or not functions:
        raise InputError(
            "it holds no frequency response function (dataset 58 of function type 4)", place=path,
            remedy="export the FRFs as complex dataset 58",
        )  # fmt: skip
    if others:
        what = (
            "1 function that is neither an FRF nor a"
            if others == 1
            else f"{others} functions that are neither FRFs nor"
        )
        notes.append(f"{path}: {what} coherence{'s' * (others > 1)} skipped")
    points = points_of(path, blocks, notes)
    return repeat_of(str(path), axis, found, functions, coherence, notes, points)


def _sets(path: Path) -> list[dict[str, Any]]:
    remedy = "export it again"
    with pyuff_faults(lambda words: InputError(f"its functions cannot be read ({words})", place=path, remedy=remedy)):
        reader = pyuff.UFF(str(path))
        return [dict(reader.read_sets(k)) for k, kind in enumerate(reader.get_set_types()) if int(kind) in (58, 164)]


def _units(path: Path, sets: list[dict[str, Any]], stated: bool) -> tuple[FRFUnits | None, list[str]]:
    """Units by dataset 164 of the file, None without one, and a note where nothing states them."""
    given = {(float(data["length"]), float(data["force"])) for data in sets if data["type"] == 164}
    if len(given) > 1:
        raise InputError("two datasets 164 state different units", place=path, remedy="keep one of them")
    if not given:
        return None, [] if stated else [f"{path}: no units (dataset 164): metres and newtons assumed"]
    ((length, force),) = given
    if not (0 < length < np.inf and 0 < force < np.inf):
        raise InputError(f"its units are {length:g} and {force:g}", place=path, remedy="correct dataset 164")
    return FRFUnits(1 / length, 1 / length, 1 / force), []


def _key(where: str, data: Mapping[str, Any]) -> tuple[Key, float]:
    """Response and reference, and the sign of their directions."""
    sign, ends = 1.0, []
    for side, what in (("rsp", "response"), ("ref", "reference")):
        code = int(data[f"{side}_dir"])
        if not 1 <= abs(code) <= 6:
            raise InputError(
                f"the direction of its {what} is {code}", place=where, remedy="give 1 to 6, negative against the axis"
            )
        sign *= np.sign(code)
        ends.append((int(data[f"{side}_node"]), DIRECTIONS[abs(code) - 1]))
    return (ends[0], ends[1]), float(sign)


def _quantity(where: str, data: Mapping[str, Any], stated: Quantity | None) -> Quantity:
    own = _MOTIONS.get(int(data["ordinate_spec_data_type"]))
    under = int(data["orddenom_spec_data_type"])
    if under not in (0, *_FORCES):
        raise InputError(
            f"its denominator is of data type {under}, no force (13)", place=where, remedy="export motion over force"
        )
    if own is None and stated is None:
        raise InputError(
            f"its ordinate is of data type {int(data['ordinate_spec_data_type'])}, which is neither displacement (8), "
            "velocity (11) nor acceleration (12)",
            place=where, remedy="state the quantity",
        )  # fmt: skip
    if own is not None and stated not in (None, own):
        raise InputError(f"it says that it is {own}, not {stated}", place=where, remedy="correct one of them")
    return own or stated or "receptance"


def _in_g(data: Mapping[str, Any]) -> bool:
    """Whether the label of the ordinate says that it is in g."""
    return str(data.get("ordinate_axis_units_lab", "")).strip().lower().split("/")[0] in ("g", "gn")


def _in_file(where: str, in_g: bool, own: FRFUnits | None, stated: tuple[Quantity, FRFUnits] | None) -> FRFUnits:
    """Units of one function: of the file, or else as stated, with accelerations in g or not."""
    if own is None:
        units = FRFUnits() if stated is None else stated[1]
        if stated is None or not in_g or units.motion == GRAVITY:
            return replace(units, motion=GRAVITY) if in_g else units
    else:
        units = replace(own, motion=GRAVITY) if in_g else own
        if stated is None or units.agrees(stated[1]):
            return units
    raise InputError("its unit is not the stated one", place=where, remedy="correct one of them")
