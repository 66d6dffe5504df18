"""Frequency response functions from universal files: datasets 58, ASCII or binary, with the units of 164."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import VALUE_LIMIT
from calib.measurement.files.frf_columns import channel_of
from calib.measurement.files.uff_blocks import Dataset, extract_sets, read_blocks
from calib.measurement.files.uff_labels import MOTIONS, Axis, force_axis, hertz_each, motion_axis
from calib.measurement.files.uff_nodes import Nodes, length_factor, nodes_of
from calib.measurement.files.uff_sets import pyuff_faults
from calib.measurement.frf import NO_PHASE, Quantity
from calib.measurement.frf_repeats import FRFRepeat, Key, function_name, off_axis, repeat_of
from calib.measurement.frf_units import GRAVITY, FRFUnits, parse_unit
from calib.measurement.modal import DIRECTIONS
from calib.measurement.places import Doubt
from calib.measurement.record import QUANTITY_OF
from calib.measurement.rules import RULES

_FRF, _COHERENCE = 4, 6
_COMPLEX = (5, 6)
_FREQUENCY = (0, 18)
"""Data types of the abscissa: unknown, frequency."""


def read_uff_frfs(
    path: Path,
    quantity: Quantity | None = None,
    unit: str | None = None,
    length_unit: float | None = None,
    channels: Sequence[str] = (),
) -> FRFRepeat:
    """Read one repeat from a universal file.

    Every dataset 58 with a frequency response function of a motion over a force counts; coherences are kept beside
    them, other functions, pressures and strains among them, are noted. A sensor mounted against its axis (negative
    direction) reverses the sign. Units are those on the labels of the axes, else those of dataset 164; a line at 0 Hz
    is dropped where the motion is no displacement, and a value that is not finite was not measured. A function that is
    there several times, as the driving point of several runs is, is their mean. Places and axes of
    the nodes are those of `calib.measurement.files.uff_nodes`.

    Parameters
    ----------
    path : Path
    quantity : {"receptance", "mobility", "accelerance"}, optional
        Where the file does not say, or contradicts itself; a contradiction to the file is refused.
    unit : str, optional
        Likewise, where neither labels nor dataset 164 say; see `calib.measurement.frf_units.parse_unit`.
    length_unit : float, optional
        Metres per unit of length, where it has no dataset 164.
    channels : sequence of str, optional
        Response and reference of each FRF, such as ``12z/3z``, in the order of the file, whose nodes and directions
        then do not count.

    Raises
    ------
    InputError
        For a file that cannot be read, without such functions, with amplitudes alone, a function twice whose two
        versions differ in scale or sign, a label that contradicts the type of its axis, or lines that differ between
        functions.
    """
    notes: list[str] = []
    blocks = read_blocks(path, notes)  # a truncated file would lose its last functions without a word
    stated = None if unit is None else parse_unit(unit, path)
    if stated is not None:
        if quantity not in (None, stated[0]):
            raise InputError(f"{unit} is no unit of {quantity}", place=path, remedy="correct one of them")
        quantity = stated[0]
    units = file_units(path, blocks)
    frfs, again, coherences = _datasets(path, quantity, notes, channels)
    found = {one.quantity for one in (*frfs.values(), *again)}
    if len(found) > 1:
        raise InputError(f"it holds {' and '.join(sorted(found))}", place=path, remedy="export one quantity")
    (own,) = found
    functions = {key: _values(one, units, stated, notes) for key, one in frfs.items()}
    for key in dict.fromkeys(one.key for one in again):
        every = [functions[key], *(_values(one, units, stated, notes) for one in again if one.key == key)]
        functions[key] = _mean_of_same(path, key, every, notes)
    coherence = {key: np.asarray(np.real(one.data["data"]), dtype=float) for key, one in coherences.items()}
    assumed: list[str] = []
    per_metre = length_factor(path, blocks, assumed, length_unit)
    nodes = nodes_of(path, blocks, per_metre, notes)
    notes += assumed
    functions, coherence = _in_global_axes(path, nodes, functions, coherence)
    freq = next(iter(frfs.values())).freq
    return repeat_of(str(path), freq, own, functions, coherence, list(dict.fromkeys(notes)), nodes.points)


def _in_global_axes(
    path: Path, nodes: Nodes, functions: Mapping[Key, np.ndarray], coherence: Mapping[Key, np.ndarray]
) -> tuple[dict[Key, np.ndarray], dict[Key, np.ndarray]]:
    """Functions with responses and references in global axes; a coherence is not that of a function turned."""
    if not any(node in nodes.axes for key in functions for node, _ in key):
        return dict(functions), dict(coherence)
    half: dict[Key, np.ndarray] = {}
    for reference in dict.fromkeys(reference for _, reference in functions):
        own = {response: values for (response, one), values in functions.items() if one == reference}
        half.update({(response, reference): values for response, values in nodes.turned(own, str(path)).items()})
    out: dict[Key, np.ndarray] = {}
    for response in dict.fromkeys(response for response, _ in half):
        own = {reference: values for (one, reference), values in half.items() if one == response}
        out.update({(response, reference): values for reference, values in nodes.turned(own, str(path)).items()})
    order = [key for key in functions if key in out] + [key for key in out if key not in functions]
    kept = {key: own for key, own in coherence.items() if not any(node in nodes.axes for node, _ in key)}
    return {key: out[key] for key in order}, kept


@dataclass(frozen=True, eq=False)
class _Dataset:
    """A dataset 58 with its ends: ``sign`` is that of the product of their directions, ``freq`` (n_freq,) in Hz."""

    where: str
    key: Key
    sign: float
    freq: np.ndarray
    data: Mapping[str, Any]
    quantity: Quantity = "receptance"


def _datasets(
    path: Path, stated: Quantity | None, notes: list[str], channels: Sequence[str]
) -> tuple[dict[Key, _Dataset], list[_Dataset], dict[Key, _Dataset]]:
    """FRFs, those that are there again, and coherences, on common lines; what is none of them is noted."""
    frfs: dict[Key, _Dataset] = {}
    again: list[_Dataset] = []
    coherences: dict[Key, _Dataset] = {}
    every = _with_channels(path, _sets(path), channels) if channels else _sets(path)
    foreign: Counter[str] = Counter()
    for data in every:
        if data["func_type"] == _FRF and (what := _foreign(data)) is not None:
            foreign[what] += 1
        elif data["func_type"] == _FRF:
            one = _checked(path, data, stated, notes)
            _require_axis(one, frfs)
            if frfs.setdefault(one.key, one) is not one:
                again.append(one)
    repeated, seen = {one.key for one in again}, list[_Dataset]()
    for data in every:
        # a coherence of what is skipped may have no direction
        if data["func_type"] == _COHERENCE and all(1 <= abs(int(data[f"{end}_dir"])) <= 6 for end in ("rsp", "ref")):
            one = _checked(path, data, None, [])
            if one.key in frfs:
                _require_axis(one, frfs)
                seen.append(one)
                if one.key in repeated:
                    continue  # that of one of them is not that of their mean
                if coherences.setdefault(one.key, one) is not one:
                    words = "this coherence is there twice, its function once"
                    raise InputError(words, place=one.where, remedy="export each once, one file a repeat")
    if not frfs:
        what = f"{' and '.join(sorted(foreign))}, no motion over force" if foreign else "no frequency response function"
        raise InputError(
            f"it holds {what} (dataset 58 of function type 4)", place=path,
            remedy="export the FRFs of motions over forces as complex dataset 58",
        )  # fmt: skip
    for what, count in foreign.items():
        notes.append(f"{path}: {_functions(count)} of {what} skipped: no motion over force")
    if skipped := len(every) - len(frfs) - len(again) - len(seen) - foreign.total():
        what = "1 function that is neither an FRF" if skipped == 1 else f"{skipped} functions that are neither FRFs"
        notes.append(f"{path}: {what} nor {'a coherence' if skipped == 1 else 'coherences'} of one skipped")
    return frfs, again, coherences


def _with_channels(path: Path, every: Sequence[dict[str, Any]], channels: Sequence[str]) -> list[dict[str, Any]]:
    """Datasets whose FRFs, and coherences where there are as many, have the ends that the user names."""
    out = list(every)
    of = {code: [k for k, data in enumerate(every) if data["func_type"] == code] for code in (_FRF, _COHERENCE)}
    of[_FRF] = [k for k in of[_FRF] if _foreign(every[k]) is None]
    if len(of[_FRF]) != len(channels):
        words = f"{len(channels)} channels are named, but it holds {len(of[_FRF])} FRFs of a motion over a force"
        raise InputError(words, place=path, remedy="name every one, in the order of the file")
    for own in of.values():
        for k, channel in zip(own, channels, strict=False):
            ((response, moved), (reference, driven)), sign = channel_of(channel, path)
            ends = {"rsp_node": response, "rsp_dir": sign * (DIRECTIONS.index(moved) + 1)}
            if len(own) == len(channels):
                out[k] = {**every[k], **ends, "ref_node": reference, "ref_dir": DIRECTIONS.index(driven) + 1}
    return out


def _functions(count: int) -> str:
    return "1 function" if count == 1 else f"{count} functions"


def _mean_of_same(path: Path, key: Key, every: Sequence[np.ndarray], notes: list[str]) -> np.ndarray:
    """Mean of the versions of one function; InputError where one differs in scale, as between set-ups, or in sign."""
    first, known = every[0], np.all(np.isfinite(every), axis=0)
    farthest = 0.0
    most = 1 + RULES.setup_scale
    for other in every[1:]:
        sizes = [float(np.linalg.norm(one[known])) for one in (first, other)]
        ratio, same = sizes[1] / max(sizes[0], 1e-300), float(np.real(np.vdot(first[known], other[known]))) > 0
        if not same or not 1 / most <= ratio <= most:
            words = f"{function_name(key)} is there {len(every)} times, and one of them is {ratio:.3g} times as large"
            remedy = "leave the wrong one out of the export; check sensitivities and directions"
            raise InputError(f"{words} or has the opposite sign", place=path, remedy=remedy)
        farthest = max(farthest, float(np.linalg.norm((other - first)[known])) / sizes[0])
    words = f"{function_name(key)} is there {len(every)} times, {100 * farthest:.2g} % apart: their mean is used"
    notes.append(Doubt(f"{path}: {words}"))
    return np.asarray(np.mean(every, axis=0))


def _require_axis(one: _Dataset, frfs: Mapping[Key, _Dataset]) -> None:
    """InputError unless a dataset is on the lines of the first function."""
    first = next(iter(frfs.values()), one)
    if off_axis(one.freq, first.freq).any():
        raise InputError(
            "its lines are not those of the first function", place=one.where, remedy="export all on common frequencies"
        )


def _foreign(data: Mapping[str, Any]) -> str | None:
    """What a function is that is no motion over a force, such as ``pressure over force``; None where it may be one."""
    moved, driven = motion_axis(data)[0].kind, force_axis(data).kind
    if moved in (None, *MOTIONS.values()) and driven in (None, "force"):
        return None
    return f"{moved or 'an unknown quantity'} over {driven or 'an unknown one'}"


def _sets(path: Path) -> list[dict[str, Any]]:
    remedy = "export it again"
    with pyuff_faults(lambda words: InputError(f"its functions cannot be read ({words})", place=path, remedy=remedy)):
        reader = pyuff.UFF(str(path))
        return [dict(reader.read_sets(k)) for k, kind in enumerate(reader.get_set_types()) if int(kind) == 58]


def file_units(path: Path, blocks: Sequence[Dataset]) -> FRFUnits | None:
    """Units by dataset 164 of the file; None without one."""
    own = [block for block in blocks if block.kind == 164]
    if not own:
        return None
    length, forces = 1 / length_factor(path, own, []), {float(data["force"]) for data in extract_sets(path, own)}
    if len(forces) > 1:
        raise InputError("two datasets 164 state different units", place=path, remedy="keep one of them")
    (force,) = forces
    if not 0 < force < np.inf:
        raise own[0].error(path, f"the force factor of dataset 164 is {force:g}", "correct it")
    return FRFUnits(length, length, 1 / force)


def _checked(path: Path, data: Mapping[str, Any], stated: Quantity | None, notes: list[str]) -> _Dataset:
    """A dataset 58 over frequency with as many values as it announces."""
    where = f"{path}, response {data['rsp_node']}, direction {data['rsp_dir']}"
    key, sign = _key(where, data)
    if int(data["abscissa_spec_data_type"]) not in _FREQUENCY:
        raise InputError("its abscissa is no frequency", place=where, remedy="export it over frequency in Hz")
    if "x" not in data:  # neither evenly nor unevenly spaced by its header
        raise InputError("it has no frequencies", place=where, remedy="export it again")
    freq, count = np.asarray(data["x"], dtype=float), int(data["num_pts"])
    # pyuff reads what is there, however many values the header announces
    if not len(freq) == np.size(data["data"]) == count:
        held = f"{np.size(data['data'])} values" if np.size(data["data"]) != count else f"{len(freq)} frequencies"
        raise InputError(f"it has {held}, but announces {count}", place=where, remedy="export it again")
    quantity = _quantity(where, data, stated, notes) if data["func_type"] == _FRF else "receptance"
    return _Dataset(where, key, sign, freq * hertz_each(data), data, quantity)


def _values(
    one: _Dataset, units: FRFUnits | None, stated: tuple[Quantity, FRFUnits] | None, notes: list[str]
) -> np.ndarray:
    """Values of an FRF in SI, (n_freq,), complex, of a sensor along its axis; NaN where they are not finite."""
    if int(one.data["ord_data_type"]) not in _COMPLEX:
        raise InputError("its values are real", place=one.where, remedy=NO_PHASE)
    values = np.array(one.data["data"], dtype=complex)
    known = np.abs(values) <= VALUE_LIMIT  # NaN fails the comparison too
    if not known.any():
        raise InputError("its values are not finite on any line", place=one.where, remedy="leave it out of the export")
    if not values[known].any():
        raise InputError("it is zero on every line: a dead channel", place=one.where, remedy="leave it out")
    values[~known] = complex(np.nan, np.nan)
    return one.sign * values * _in_file(one, units, stated, notes).factor(one.key)


def _key(where: str, data: Mapping[str, Any]) -> tuple[Key, float]:
    """Response and reference, and the sign of their directions."""
    sign, ends = 1.0, []
    for side, what in (("rsp", "response"), ("ref", "reference")):
        code = int(data[f"{side}_dir"])
        if not 1 <= abs(code) <= 6:
            raise InputError(
                f"the direction of its {what} is {code}", place=where,
                remedy="give 1 to 6, negative against the axis, or name every channel: channels = ['12z/3z', ...]",
            )  # fmt: skip
        sign *= np.sign(code)
        ends.append((int(data[f"{side}_node"]), DIRECTIONS[abs(code) - 1]))
    return (ends[0], ends[1]), float(sign)


def _quantity(where: str, data: Mapping[str, Any], stated: Quantity | None, notes: list[str]) -> Quantity:
    """What a function is by its type, its label, or as stated where the file says nothing or contradicts itself."""
    axis, _ = motion_axis(data)
    _require_force(where, force_axis(data))
    said = [QUANTITY_OF[kind] for kind in (axis.typed, axis.labelled) if kind is not None and kind in QUANTITY_OF]
    if axis.contradicts:
        words = f"its ordinate is of the type {axis.typed}, but its label says {axis.text!r:.60}"
        if stated is None or stated not in said:
            raise InputError(words, place=where, remedy="correct one of them, or state quantity and unit")
        path = where.partition(", response")[0]
        notes.append(Doubt(f"{path}: {words.replace('its', 'an', 1)}: taken as {stated}, as stated"))
        return stated
    if not said and stated is None:
        raise InputError(
            "neither the type of its ordinate nor its label says what was measured: it is neither displacement (8), "
            "velocity (11) nor acceleration (12)",
            place=where, remedy="state the quantity",
        )  # fmt: skip
    if said and stated not in (None, said[0]):
        raise InputError(f"it says that it is {said[0]}, not {stated}", place=where, remedy="correct one of them")
    return said[0] if said else stated or "receptance"


def _require_force(where: str, axis: Axis) -> None:
    if axis.contradicts:
        words = f"its denominator is of the type {axis.typed}, but its label says {axis.text!r:.60}"
        raise InputError(words, place=where, remedy="correct one of them")


def _in_file(
    one: _Dataset, own: FRFUnits | None, stated: tuple[Quantity, FRFUnits] | None, notes: list[str]
) -> FRFUnits:
    """Units of one function: on its labels, of the file, or else as stated."""
    axis, under = motion_axis(one.data)
    driven = force_axis(one.data)
    agrees = axis.labelled is None or QUANTITY_OF.get(axis.labelled) == one.quantity
    (_, moved), (_, load) = one.key
    motion = axis.unit if agrees and not moved.startswith("r") else None
    force = driven.unit or (under if agrees else None)
    base = own or (FRFUnits() if stated is None else stated[1])
    # the label of a moment states force times length
    length = 1.0 if force is not None and load.startswith("r") else base.length
    units = FRFUnits(motion or base.motion, length, force or base.force)
    if stated is not None and not units.agrees(stated[1]):
        raise InputError("its unit is not the stated one", place=one.where, remedy="correct one of them")
    path = one.where.partition(", response")[0]
    if own is None and stated is None and (motion is None or force is None):
        notes.insert(0, f"{path}: no units (dataset 164): metres and newtons assumed where labels state none")
    elif own is not None and not replace(units, motion=own.motion if motion == GRAVITY else units.motion).agrees(own):
        words = f"its labels say {axis.text!r} over {driven.text!r}, dataset 164 other units"
        notes.append(Doubt(f"{path}: {words}: those of the labels are used"))
    return units
