"""Measured modes from universal files (UFF, UNV): datasets 55 or 2414, with nodes and units; see `uff_nodes`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import FREQ_LIMIT, VALUE_LIMIT, is_rigid
from calib.measurement.files.uff_2414 import as_dataset_55
from calib.measurement.files.uff_blocks import MODAL, Dataset, extract_sets, halves_of_six, read_blocks
from calib.measurement.files.uff_nodes import Nodes, length_factor, nodes_of
from calib.measurement.files.uff_write import write_uff
from calib.measurement.modal import DIRECTIONS
from calib.measurement.places import Doubt, Point
from calib.measurement.repeats import Repeat, ShapeSet
from calib.measurement.rules import RULES

__all__ = ["UniversalFile", "drop_unmeasured", "read_uff", "write_uff"]

_DAMAGED = -1
_ANALYSES = {1: "static", 4: "transient", 5: "frequency responses", 6: "buckling"}
"""Analysis types that are no modes."""
_NAME_LINE = re.compile(r"mode\s+(\S+)", re.IGNORECASE)


@dataclass(frozen=True)
class UniversalFile:
    """Contents of one universal file: its modes in the axes of its nodes, and these nodes (none without a dataset)."""

    repeat: Repeat
    nodes: Nodes

    @property
    def points(self) -> Mapping[int, Point]:
        """Places of the nodes, m."""
        return self.nodes.points


def read_uff(path: Path, length_unit: float | None = None) -> UniversalFile:
    """Read one repeat from a universal file.

    Modes are the datasets 55 of analysis type 2 (natural frequency in Hz and viscous damping ratio, 0 for unknown), 3
    and 7 (eigenvalue in rad/s), in the order of the file, or the datasets 2414 of these types where the file has no
    such 55; of a conjugate pair the one with positive imaginary part is kept. Datasets 55 and 2414 that are not modes,
    such as frequency responses (type 5), are skipped and noted. A mode is named by the first ID line that reads
    ``mode NAME`` (one word) provided every mode has such a line, the names differ, and they are not just the numbers
    from 1 in order; otherwise modes are numbered from 1. Nodes without a record in a mode count as not measured in it.
    Zeros are kept here, see `drop_unmeasured`, and so are local axes, see `in_global_axes`. Lengths, and with them
    translations, are converted to SI. A rigid-body mode at 0 Hz and an overdamped one are left out and noted.

    Parameters
    ----------
    path : Path
    length_unit : float, optional
        Metres per unit of length, where the file does not state it.

    Raises
    ------
    InputError
        For a file that cannot be read, is damaged or truncated, or holds no modes.
    """
    notes: list[str] = []
    blocks = read_blocks(path, notes)
    used = _with_modes(path, [block for block in blocks if block.kind in (55, 2414)], notes)
    parts = [part for block in used for part in halves_of_six(path, block)]
    if not any(block.kind == 55 for block in parts):
        raise _without_modes(path, blocks)
    sets = extract_sets(path, parts)
    per_metre = length_factor(path, blocks, notes, length_unit)
    nodes = nodes_of(path, blocks, per_metre, notes)
    with np.errstate(all="ignore"):  # what overflows is refused as not finite
        repeat = _modes(path, parts, sets, per_metre, notes)
    return UniversalFile(replace(repeat, notes=tuple(notes)), nodes)


def _without_modes(path: Path, blocks: Sequence[Dataset]) -> InputError:
    """What a file without modes holds instead."""
    held = {(block.kind, _analysis_type(block)) for block in blocks if block.kind in (55, 2414)}
    if held:
        what = " and ".join(f"{kind} of {_analysis(analysis)}" for kind, analysis in sorted(held))
        words, remedy = f"it holds no modes, only datasets {what}", "export motions at nodes of modes (2, 3 or 7)"
    else:
        found = ", ".join(str(kind) for kind in sorted({block.kind for block in blocks}))
        words = f"it holds no modes (dataset 55 or 2414), only datasets {found}"
        remedy = "export the identified modes as dataset 55"
    return InputError(words, place=path, remedy=remedy)


def _analysis(code: int) -> str:
    """An analysis type in words; the modal ones are those without motions at nodes."""
    words = f"analysis type {code}"
    if code in MODAL:
        return f"{words} without motions at nodes"
    return f"{words} ({_ANALYSES[code]})" if code in _ANALYSES else words


def in_global_axes(repeat: Repeat, nodes: Nodes) -> Repeat:
    """The repeat with its shapes turned into global axes; see `calib.measurement.files.uff_nodes.Nodes.turned`."""
    given = repeat.shape_set
    if given is None or not nodes.axes:
        return repeat
    turned = nodes.turned(dict(zip(given.sensors, given.shapes, strict=True)), repeat.source)
    shapes = np.array(list(turned.values()))
    return replace(repeat, shape_set=ShapeSet(given.source, tuple(turned), shapes, np.full(shapes.shape, np.nan)))


def _with_modes(path: Path, blocks: Sequence[Dataset], notes: list[str]) -> list[Dataset]:
    """Blocks with the modes as datasets 55; analysis data that are not modes are dropped and noted."""
    modes = [block for block in blocks if block.kind == 55 and _analysis_type(block) in MODAL]
    others: dict[tuple[int, int], int] = {}
    out = []
    for block in blocks:
        kept: Dataset | None = block
        if block.kind == 55:
            kept = block if _analysis_type(block) in (*MODAL, _DAMAGED) else None
        elif block.kind == 2414:
            kept = None if modes else as_dataset_55(path, block)
        if kept is None:
            key = block.kind, _analysis_type(block)
            others[key] = others.get(key, 0) + 1
        else:
            out.append(kept)
    for (kind, analysis), count in others.items():
        what = f"{count} dataset{'s' * (count > 1)} {kind} of {_analysis(analysis)}"
        why = "the modes are those of its datasets 55" if kind == 2414 and modes else "they hold no mode shapes"
        notes.append(f"{path}: {what} skipped: {why}")
    return out


def _analysis_type(block: Dataset) -> int:
    """Analysis type of a dataset 55 or 2414; `_DAMAGED` where it cannot be read."""
    at = 5 if block.kind == 55 else 8
    text = block.lines[at][10:20].strip() if len(block.lines) > at else ""
    return int(text) if text.isdecimal() and text.isascii() else _DAMAGED


@dataclass(frozen=True)
class _Mode:
    name: str | None
    freq: float
    damping: float
    eigenvalue: complex | None
    values: dict[tuple[int, str], complex]


def _modes(
    path: Path, blocks: Sequence[Dataset], sets: Sequence[Mapping[str, Any]], per_metre: float, notes: list[str]
) -> Repeat:
    modes: list[_Mode] = []
    if in_hertz := _eigenvalues_in_hertz(sets):
        words = "its eigenvalues are in Hz by their modal A and B, not in rad/s as the format asks"
        notes.append(Doubt(f"{path}: {words}: multiplied by 2 pi"))
        roots = {k: {"eig": 2 * math.pi * complex(sets[k]["eig"])} for k in in_hertz}
        sets = [{**one, **roots.get(k, {})} for k, one in enumerate(sets)]
    highest = max(_size(data) for data in sets)
    count, kept = 0, True
    for block, data in zip(blocks, sets, strict=True):
        if block.kind == 55:
            count, motion = count + 1, _no_vibration(data, highest)
            kept = motion is None
            if motion is not None:
                notes.append(Doubt(f"{path}, line {block.line}: mode {count} of the file is {motion}: left out"))
        if not kept:
            continue
        values = _values(path, block, data, per_metre)
        if block.kind == -55:
            modes[-1].values.update(values)
            continue
        freq, damping, eigenvalue = _frequency(path, block, data, notes)
        matches = (_NAME_LINE.fullmatch(str(data[f"id{k}"]).strip()) for k in range(1, 6))
        name = next((match.group(1) for match in matches if match), None)
        modes.append(_Mode(name, freq, damping, eigenvalue, values))
    modes = _upper_half(modes)
    if not modes:
        raise InputError("all of its modes are rigid-body modes or overdamped", place=path, remedy="export vibrations")
    given = [mode.name for mode in modes]
    counted = [str(k + 1) for k in range(len(given))]
    named = None not in given and len(set(given)) == len(given) and given != counted
    names = tuple(str(name) for name in given) if named else tuple(str(k + 1) for k in range(len(modes)))
    present = {key for mode in modes for key in mode.values}
    nodes = dict.fromkeys(node for mode in modes for node, _ in mode.values)
    sensors = [(node, direction) for node in nodes for direction in DIRECTIONS if (node, direction) in present]
    where = {key: k for k, key in enumerate(sensors)}
    shapes = np.full((len(sensors), len(modes)), complex(np.nan, np.nan))
    for m, mode in enumerate(modes):
        for key, value in mode.values.items():
            shapes[where[key], m] = value
    if any(len(mode.values) != len(sensors) for mode in modes):
        notes.append(f"{path}: nodes without a record in a mode count as not measured in it")
    return Repeat(
        str(path),
        names,
        named,
        np.array([mode.freq for mode in modes]),
        np.full(len(modes), np.nan),
        np.array([mode.damping for mode in modes]),
        np.full(len(modes), np.nan),
        ShapeSet(str(path), tuple(sensors), shapes, np.full(shapes.shape, np.nan)),
    )


def _values(path: Path, block: Dataset, data: Mapping[str, Any], per_metre: float) -> dict[tuple[int, str], complex]:
    """Shape values of one dataset 55 by node and direction, translations in SI."""
    width = int(data["n_data_per_node"])
    if width not in (3, 6):
        words = f"the dataset 55 that starts here has {width} values a node"
        raise block.error(path, words, "export 3 or 6 components")
    nodes = [int(node) for node in data["node_nums"]]
    columns = [np.asarray(data[f"r{k}"], dtype=complex) for k in range(1, width + 1)]
    if any(len(column) != len(nodes) for column in columns):
        words = f"the dataset 55 that starts here has not {width} values a node"
        raise block.error(path, words, "export it again")
    if len(set(nodes)) != len(nodes):
        raise block.error(path, "the dataset 55 that starts here gives a node twice", "remove one")
    values: dict[tuple[int, str], complex] = {}
    for k, column in enumerate(columns):
        code = k + (3 if block.kind == -55 else 0)
        scaled = column / per_metre if code < 3 else column
        for node, value in zip(nodes, scaled.tolist(), strict=True):
            # NaN fails the comparison too
            if not max(abs(value.real), abs(value.imag)) <= VALUE_LIMIT or math.isnan(value.imag):
                words = f"node {node}{DIRECTIONS[code]} in the dataset 55 that starts here has no finite value"
                raise block.error(path, words, "export it again")
            values[node, DIRECTIONS[code]] = value
    return values


def _eigenvalues_in_hertz(sets: Sequence[Mapping[str, Any]]) -> set[int]:
    """Complex modes, as indices of the sets, if all that can tell have eigenvalues in Hz.

    Modal B is -lambda times modal A, with lambda in rad/s; without B modal A is 2 i omega where the modal mass is 1.
    """
    modes = [k for k, one in enumerate(sets) if one["analysis_type"] in (3, 7) and abs(complex(one["eig"])) > 0]
    votes = []
    for k in modes:
        root, a, b = (complex(sets[k][key]) for key in ("eig", "modal_a", "modal_b"))
        ratio = abs(b) / abs(a * root) if a and b else abs(a) / (2 * abs(root.imag)) if a and root.imag else math.nan
        if math.isfinite(ratio) and (b or abs(ratio / (2 * math.pi) - 1) < RULES.in_hertz):
            votes.append(abs(ratio / (2 * math.pi) - 1) < RULES.in_hertz)
    return set(modes) if votes and all(votes) else set()


def _size(data: Mapping[str, Any]) -> float:
    """Modulus of the frequency that a dataset 55 states, Hz."""
    stated = float(data["freq"]) if data["analysis_type"] == 2 else abs(complex(data["eig"])) / (2 * math.pi)
    return abs(stated) if math.isfinite(stated) else 0.0


def _no_vibration(data: Mapping[str, Any], highest: float) -> str | None:
    """What a mode is that does not vibrate, where the highest frequency of the file is given in Hz; None for others."""
    normal = data["analysis_type"] == 2
    if is_rigid(float(data["freq"]) if normal else _size(data), highest):
        return f"a rigid-body motion ({_size(data):g} Hz)"
    if not normal and complex(data["eig"]).imag == 0 and math.isfinite(complex(data["eig"]).real):
        return f"overdamped (real eigenvalue {complex(data['eig']).real:g} 1/s)"
    return None


def _frequency(
    path: Path, block: Dataset, data: Mapping[str, Any], notes: list[str]
) -> tuple[float, float, complex | None]:
    """Natural frequency in Hz, damping ratio and eigenvalue (None for a normal mode)."""
    eigenvalue: complex | None = None
    if data["analysis_type"] == 2:
        freq, damping = float(data["freq"]), float(data["modal_damp_vis"])
        if damping == 0:
            damping = math.nan  # exporters write 0 for unknown damping
            if float(data["modal_damp_his"]) != 0:
                notes.append(f"{path}, line {block.line}: only hysteretic damping is given, which is not used")
    else:
        re_part, im_part = complex(data["eig"]).real, complex(data["eig"]).imag
        size = math.hypot(re_part, im_part)
        freq = size / (2 * math.pi)
        damping = -re_part / size if size > 0 else 0.0
        eigenvalue = complex(re_part, im_part)
    if not 0 < freq < FREQ_LIMIT:
        raise block.error(
            path,
            f"the frequency in the dataset 55 that starts here is {freq:g} Hz, outside (0, {FREQ_LIMIT:g})",
            "correct it",
        )
    unreadable = data["analysis_type"] == 2 and math.isnan(data["modal_damp_vis"])
    if unreadable or not (math.isnan(damping) or 0 <= damping < 1):
        raise block.error(
            path,
            f"the damping ratio in the dataset 55 that starts here is {damping:g}, outside [0, 1)",
            "give a ratio (0.01 for one percent), and a decaying mode an eigenvalue with negative real part",
        )
    return freq, abs(damping), eigenvalue


def _upper_half(modes: Sequence[_Mode]) -> list[_Mode]:
    """Modes with eigenvalues in the upper half plane; one below is conjugated, or dropped if its conjugate is there."""
    out = []
    for mode in modes:
        eigenvalue = mode.eigenvalue
        if eigenvalue is None or eigenvalue.imag > 0:
            out.append(mode)
            continue
        partner = eigenvalue.conjugate()
        if not any(m.eigenvalue is not None and abs(m.eigenvalue - partner) < 1e-4 * abs(partner) for m in modes):
            out.append(
                replace(mode, eigenvalue=partner, values={key: value.conjugate() for key, value in mode.values.items()})
            )
    return out


def drop_unmeasured(repeats: Sequence[Repeat]) -> list[Repeat]:
    """Repeats without the directions that were never measured.

    Dataset 55 holds zeros for components without a sensor. A direction that is exactly zero in every mode of every
    repeat is therefore dropped; one that is zero in every mode of some repeats becomes NaN in those only, and a mode
    that is zero everywhere has no shape (NaN).
    """
    alive: dict[tuple[int, str], None] = {}
    for repeat in repeats:
        if repeat.shape_set is not None:
            moving = np.any(np.nan_to_num(repeat.shape_set.shapes) != 0, axis=1)
            alive.update((s, None) for s, moves in zip(repeat.shape_set.sensors, moving, strict=True) if moves)
    out = []
    for repeat in repeats:
        given = repeat.shape_set
        if given is None or not alive:
            note = () if given is None else (f"{repeat.source}: no shape values, frequencies only",)
            out.append(replace(repeat, shape_set=None, notes=(*repeat.notes, *note)))
            continue
        kept = [k for k, sensor in enumerate(given.sensors) if sensor in alive]
        shapes = given.shapes[kept].copy()
        zero = ~(np.nan_to_num(shapes) != 0)
        dead = zero.all(axis=1)
        notes = [
            f"{repeat.source}: sensor {node}{direction} is zero in every mode, taken as not measured"
            for (node, direction), is_dead in zip((given.sensors[k] for k in kept), dead, strict=True)
            if is_dead
        ]
        shapes[dead] = complex(np.nan, np.nan)
        shapes[:, zero.all(axis=0)] = complex(np.nan, np.nan)
        new = ShapeSet(given.source, tuple(given.sensors[k] for k in kept), shapes, given.std[kept])
        out.append(replace(repeat, shape_set=new, notes=(*repeat.notes, *notes)))
    return out
