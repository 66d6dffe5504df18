"""Frequency response functions from universal files: datasets 58, ASCII or binary, with the units of 164."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import VALUE_LIMIT
from calib.measurement.files.uff import length_factor, points_of
from calib.measurement.files.uff_blocks import Dataset, extract_sets, read_blocks
from calib.measurement.files.uff_sets import pyuff_faults
from calib.measurement.frf import NO_PHASE, Quantity
from calib.measurement.frf_repeats import FRFRepeat, Key, off_axis, repeat_of
from calib.measurement.frf_units import GRAVITY, FRFUnits, parse_unit
from calib.measurement.modal import DIRECTIONS

_FRF, _COHERENCE = 4, 6
_MOTIONS: Mapping[int, Quantity] = {8: "receptance", 11: "mobility", 12: "accelerance"}
"""Quantity by the data type of the numerator."""
_FORCE = (0, 13)
"""Data types of the denominator: unknown, excitation force."""
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
    stated = None if unit is None else parse_unit(unit, path)
    if stated is not None:
        if quantity not in (None, stated[0]):
            raise InputError(f"{unit} is no unit of {quantity}", place=path, remedy="correct one of them")
        quantity = stated[0]
    units = _units(path, blocks)
    notes = [] if units or stated else [f"{path}: no units (dataset 164): metres and newtons assumed"]
    frfs, coherences = _datasets(path, notes)
    found = {_quantity(one, quantity) for one in frfs.values()}
    if len(found) > 1:
        raise InputError(f"it holds {' and '.join(sorted(found))}", place=path, remedy="export one quantity")
    (own,) = found
    functions = {key: _values(one, own, units, stated) for key, one in frfs.items()}
    coherence = {key: np.asarray(np.real(one.data["data"]), dtype=float) for key, one in coherences.items()}
    points = points_of(path, blocks, 1.0 if units is None else 1 / units.length, notes)
    return repeat_of(str(path), next(iter(frfs.values())).freq, own, functions, coherence, notes, points)


@dataclass(frozen=True, eq=False)
class _Dataset:
    """A dataset 58 with its ends: ``sign`` is that of the product of their directions, ``freq`` (n_freq,) in Hz."""

    where: str
    key: Key
    sign: float
    freq: np.ndarray
    data: Mapping[str, Any]


def _datasets(path: Path, notes: list[str]) -> tuple[dict[Key, _Dataset], dict[Key, _Dataset]]:
    """FRFs and coherences on common lines; what is neither is noted."""
    frfs: dict[Key, _Dataset] = {}
    coherences: dict[Key, _Dataset] = {}
    every = _sets(path)
    used = [_checked(path, data) for data in every if data["func_type"] in (_FRF, _COHERENCE)]
    for one in used:
        if off_axis(one.freq, used[0].freq).any():
            raise InputError(
                "its lines are not those of the first function", place=one.where,
                remedy="export all on common frequencies",
            )  # fmt: skip
        kind, into = ("function", frfs) if one.data["func_type"] == _FRF else ("coherence", coherences)
        if one.key in into:
            remedy = "export each once, one file a repeat"
            raise InputError(f"this {kind} is there twice", place=one.where, remedy=remedy)
        into[one.key] = one
    if not frfs:
        raise InputError(
            "it holds no frequency response function (dataset 58 of function type 4)", place=path,
            remedy="export the FRFs as complex dataset 58",
        )  # fmt: skip
    if skipped := len(every) - len(used):
        what = "1 function that is neither an FRF" if skipped == 1 else f"{skipped} functions that are neither FRFs"
        notes.append(f"{path}: {what} nor {'a coherence' if skipped == 1 else 'coherences'} skipped")
    return frfs, coherences


def _sets(path: Path) -> list[dict[str, Any]]:
    remedy = "export it again"
    with pyuff_faults(lambda words: InputError(f"its functions cannot be read ({words})", place=path, remedy=remedy)):
        reader = pyuff.UFF(str(path))
        return [dict(reader.read_sets(k)) for k, kind in enumerate(reader.get_set_types()) if int(kind) == 58]


def _units(path: Path, blocks: Sequence[Dataset]) -> FRFUnits | None:
    """Units by dataset 164 of the file; None without one."""
    own = [block for block in blocks if block.kind == 164]
    if not own:
        return None
    sets = extract_sets(path, own)
    length, forces = 1 / length_factor(path, own, sets, []), {float(data["force"]) for data in sets}
    if len(forces) > 1:
        raise InputError("two datasets 164 state different units", place=path, remedy="keep one of them")
    (force,) = forces
    if not 0 < force < np.inf:
        raise own[0].error(path, f"the force factor of dataset 164 is {force:g}", "correct it")
    return FRFUnits(length, length, 1 / force)


def _checked(path: Path, data: Mapping[str, Any]) -> _Dataset:
    """A dataset 58 over frequency with as many values as it announces."""
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
    return _Dataset(where, key, sign, freq, data)


def _values(
    one: _Dataset, quantity: Quantity, units: FRFUnits | None, stated: tuple[Quantity, FRFUnits] | None
) -> np.ndarray:
    """Values of an FRF in SI, (n_freq,), complex, of a sensor along its axis."""
    if int(one.data["ord_data_type"]) not in _COMPLEX:
        raise InputError("its values are real", place=one.where, remedy=NO_PHASE)
    values = np.asarray(one.data["data"], dtype=complex)
    if not np.all(np.abs(values) <= VALUE_LIMIT):  # NaN fails the comparison too
        raise InputError("it holds values that are not finite", place=one.where, remedy="export it again")
    if not values.any():
        raise InputError("it is zero on every line: a dead channel", place=one.where, remedy="leave it out")
    in_g = quantity == "accelerance" and _in_g(one.data)
    return one.sign * values * _in_file(one.where, in_g, units, stated).factor(one.key)


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


def _quantity(one: _Dataset, stated: Quantity | None) -> Quantity:
    moved, under = (int(one.data[f"{axis}_spec_data_type"]) for axis in ("ordinate", "orddenom"))
    own = _MOTIONS.get(moved)
    if under not in _FORCE:
        raise InputError(
            f"its denominator is of data type {under}, no force (13)", place=one.where,
            remedy="export motion over force",
        )  # fmt: skip
    if own is None and stated is None:
        raise InputError(
            f"its ordinate is of data type {moved}, which is neither displacement (8), velocity (11) nor acceleration "
            "(12)",
            place=one.where, remedy="state the quantity",
        )  # fmt: skip
    if own is not None and stated not in (None, own):
        raise InputError(f"it says that it is {own}, not {stated}", place=one.where, remedy="correct one of them")
    return own or stated or "receptance"


def _in_g(data: Mapping[str, Any]) -> bool:
    """Whether the label of the ordinate says that it is in g."""
    return str(data.get("ordinate_axis_units_lab", "")).strip().lower().split("/")[0] in ("g", "gn")


def _in_file(where: str, in_g: bool, own: FRFUnits | None, stated: tuple[Quantity, FRFUnits] | None) -> FRFUnits:
    """Units of one function: of the file, or else as stated, with accelerations in g or not."""
    given = own or (FRFUnits() if stated is None else stated[1])
    units = replace(given, motion=GRAVITY) if in_g else given
    if stated is not None and not units.agrees(stated[1]):
        raise InputError("its unit is not the stated one", place=where, remedy="correct one of them")
    return units
