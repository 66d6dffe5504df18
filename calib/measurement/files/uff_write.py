"""Measured modes to universal files (UFF, UNV)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import FREQ_LIMIT, VALUE_LIMIT
from calib.measurement.files.uff_blocks import read_blocks
from calib.measurement.files.uff_sets import SI_UNITS, header, nodes, points_of_nodes, write_sets
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.places import Point


def write_uff(
    path: Path,
    *,
    names: Sequence[str],
    natural_freq: np.ndarray,
    damping_ratio: np.ndarray,
    sensors: Sequence[Sensor],
    shapes: np.ndarray,
    title: str = "modes",
) -> None:
    """Write one repeat as datasets 151, 164 (SI), 15 and 55 (complex modes with their eigenvalue).

    A node without a measured direction in a mode gets no record there. Values carry six digits. The file is written
    whole or not at all.

    Parameters
    ----------
    path : Path
    names : sequence of str, length n_modes
        One word each, written as ID line ``mode NAME``.
    natural_freq, damping_ratio : ndarray (n_modes,)
        Hz and ratio.
    sensors : sequence of Sensor, length n_sensors
        All with a place in metres.
    shapes : ndarray (n_sensors, n_modes)
        Real or complex; NaN where not measured.
    title : str
        Model name in dataset 151.

    Raises
    ------
    InputError
        For what the format cannot hold, or a path that cannot be written.
    """
    values = np.asarray(shapes, dtype=complex)
    freq, damping = np.asarray(natural_freq, dtype=float), np.asarray(damping_ratio, dtype=float)
    points = _check_writable(path, names, freq, damping, sensors, values)
    order = list(points)
    position = {node: k for k, node in enumerate(order)}
    six = any(sensor.direction.startswith("r") for sensor in sensors)
    omega = 2 * np.pi * freq
    eigenvalues = omega * (-damping + 1j * np.sqrt(1 - damping**2))
    datasets: list[Mapping[str, Any]] = [header(title, "measured modes"), SI_UNITS, nodes(points)]
    for m, name in enumerate(names):
        table = np.full((len(order), 6), complex(np.nan, np.nan))
        for k, sensor in enumerate(sensors):
            table[position[sensor.node], DIRECTIONS.index(sensor.direction)] = values[k, m]
        present = np.flatnonzero(np.isfinite(table).any(axis=1))
        table = np.nan_to_num(table[present])
        common = {"type": 55, "id1": f"mode {name}", "model_type": 1, "analysis_type": 3, "data_ch": 2}
        common |= {"spec_data_type": 8, "load_case": 1, "mode_n": m + 1, "eig": complex(eigenvalues[m])}
        common["node_nums"] = [order[k] for k in present]
        for first in (0, 3) if six else (0,):
            datasets.append(common | {f"r{k + 1}": table[:, first + k] for k in range(3)})
    write_sets(path, datasets, mend=_with_complex_rotations if six else None)


def _with_complex_rotations(draft: Path) -> None:
    """Join every pair of datasets 55 (translations, rotations) into one of six components, which pyuff cannot write."""
    blocks, lines = read_blocks(draft), draft.read_text(encoding="utf-8").splitlines()
    modes = [block for block in blocks if block.kind == 55]
    out = list(lines[: modes[0].line - 1])
    for one, two in zip(modes[::2], modes[1::2], strict=True):
        head = list(one.lines[:8])
        head[5] = head[5][:20] + f"{3:10d}" + head[5][30:50] + f"{6:10d}"
        out += [f"{-1:6d}", f"{55:6d}", *head]
        for k in range(8, len(one.lines), 2):
            out += [one.lines[k], one.lines[k + 1], two.lines[k + 1]]
        out.append(f"{-1:6d}")
    draft.write_text("\n".join(out) + "\n", encoding="utf-8", newline="\n")


def _check_writable(
    path: Path,
    names: Sequence[str],
    freq: np.ndarray,
    damping: np.ndarray,
    sensors: Sequence[Sensor],
    values: np.ndarray,
) -> dict[int, Point]:
    """Check that the format can hold the modes; returns the places of the nodes."""
    n = len(names)
    if freq.shape != (n,) or damping.shape != (n,) or values.shape != (len(sensors), n) or n == 0 or not len(sensors):
        raise InputError("names, frequencies, damping, sensors and shapes do not fit together", place=path)
    if any(name.split() != [name] or len(name) > 70 or not name.isprintable() for name in names):
        raise InputError("a mode name is not one word", place=path, remedy="write it without blanks")
    if len(set(names)) != n:
        raise InputError("two modes share a name", place=path)
    if not (np.all((freq > 0) & (freq < FREQ_LIMIT)) and np.all((damping >= 0) & (damping < 1))):
        raise InputError(
            "a frequency is not positive or a damping ratio is outside [0, 1)", place=path, remedy="correct it"
        )
    if len({sensor.name for sensor in sensors}) != len(sensors):
        raise InputError("a sensor is given twice", place=path)
    points = points_of_nodes(path, sensors)
    if unplaced := next((sensor for sensor in sensors if sensor.point is None), None):
        raise InputError(f"sensor {unplaced.name} has no place", place=path, remedy="give its point in m")
    known = np.isfinite(values)
    if np.any(np.isinf(values)) or np.any(np.abs(values[known]) > VALUE_LIMIT):
        raise InputError("a shape value is not a finite number", place=path)
    for node in points:
        rows = known[[k for k, sensor in enumerate(sensors) if sensor.node == node]]
        if np.any(rows.any(axis=0) & ~rows.all(axis=0)):
            raise InputError(
                f"node {node} lacks some of its directions in a mode, which the format would write as zero",
                place=path,
                remedy="write CSV",
            )
    return points
