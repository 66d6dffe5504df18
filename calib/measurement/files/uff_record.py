"""Time records from universal files: datasets 58 of function type 1, the force of a hammer among them, and units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.csv_record import parse_record_unit
from calib.measurement.files.uff_blocks import read_blocks
from calib.measurement.files.uff_frf import file_units
from calib.measurement.files.uff_labels import MOTIONS, force_unit, measures_force, motion_axis
from calib.measurement.files.uff_nodes import length_factor, nodes_of
from calib.measurement.files.uff_sets import pyuff_faults
from calib.measurement.frf_units import SAME_UNIT
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.places import Doubt, Point
from calib.measurement.record import SAME_RATE, MeasuredRecord, Motion, even_rate

TIME_RESPONSE = 1
"""Function type of a time record."""
_TIME = (0, 17)
"""Data types of the abscissa: unknown, time."""
_COMPLEX = (5, 6)


FORCE = "force"


def function_types(path: Path) -> set[int | str]:
    """Function types of the datasets 58 of a file, and `FORCE` where one is the record of a force."""
    every = _function_sets(path, header_only=True)
    forced = any(int(data["func_type"]) == TIME_RESPONSE and measures_force(data) for data in every)
    return {*(int(data["func_type"]) for data in every), *([FORCE] if forced else [])}


def _function_sets(path: Path, header_only: bool = False) -> list[dict[str, Any]]:
    """Datasets 58 of a file."""
    read_blocks(path)  # a truncated file would lose its last functions without a word
    remedy = "export it again"
    with pyuff_faults(lambda words: InputError(f"its functions cannot be read ({words})", place=path, remedy=remedy)):
        reader = pyuff.UFF(str(path))
        kinds = reader.get_set_types()
        return [dict(reader.read_sets(k, header_only)) for k, kind in enumerate(kinds) if int(kind) == 58]


def read_record_uff(
    path: Path, unit: str | None = None, length_unit: float | None = None
) -> tuple[MeasuredRecord, dict[int, Point]]:
    """Read a record and the places of its nodes (m) from a universal file.

    Every dataset 58 of function type 1 that is a motion is a sensor, and one that is a force is that of a hammer;
    others are noted. A sensor mounted against its axis (negative direction) reverses the sign. Units are those on the
    labels, else those of dataset 164; motions in local axes are turned into global ones (see
    `calib.measurement.files.uff_nodes`).

    Parameters
    ----------
    path : Path
    unit : str, optional
        Where neither labels nor dataset 164 say; see `calib.measurement.files.csv_record.parse_record_unit`.
    length_unit : float, optional
        Metres per unit of length, where the file has no dataset 164.

    Raises
    ------
    InputError
        For a file that cannot be read, without such functions, with a sensor twice, with samples that differ between
        sensors, or with several motions.
    """
    notes: list[str] = []
    blocks = read_blocks(path, notes)
    every = _function_sets(path)
    own, loads, foreign = [], [], Counter[str]()
    for data in every:
        if int(data["func_type"]) == TIME_RESPONSE:
            kind = motion_axis(data)[0].kind
            if kind in (None, *MOTIONS.values()):
                own.append(data)
            elif measures_force(data):
                loads.append(data)
            else:
                foreign[f"{kind}"] += 1
    if not own:
        what = f"; its records are of {' and '.join(sorted(foreign))}" if foreign else ""
        words = f"it holds no time record of a motion (dataset 58 of function type 1){what}"
        raise InputError(words, place=path, remedy="export records of motions")
    if others := len(every) - len(own) - len(loads) - foreign.total():
        notes.append(f"{path}: {others} functions that are no time records skipped")
    notes += [f"{path}: {count} records of {kind} skipped: no motion" for kind, count in foreign.items()]
    per_metre = length_factor(path, blocks, [], length_unit)
    units = file_units(path, blocks)
    given = None if unit is None else parse_record_unit(unit, path, bool(loads))
    stated = None if given is None else (given[0], given[1].motion)
    columns: dict[tuple[int, str], np.ndarray] = {}
    motions = set()
    for data in own:
        where = f"{path}, response {data['rsp_node']}, direction {data['rsp_dir']}"
        end, sign = _sensor(where, data)
        if end in columns:
            raise InputError("this sensor is there twice", place=where, remedy="export one record a file")
        motion, on_label = _motion(where, data, stated, notes)
        motions.add(motion)
        if len(motions) > 1:
            raise InputError(
                "its motion is not that of the first sensor", place=where, remedy="give sensors of one kind a file"
            )
        if on_label is None and not units and stated is None:
            notes.append(f"{path}: no units (dataset 164): SI assumed")
        factor = on_label or (1 / per_metre if units or stated is None else stated[1])
        columns[end] = sign * (1.0 if end[1].startswith("r") else factor) * _samples(where, data)
    newtons = units.force if units else 1.0 if given is None else given[1].force
    forces: dict[tuple[int, str], np.ndarray] = {}
    for data in loads:
        where = f"{path}, force at {data['rsp_node']}, direction {data['rsp_dir']}"
        end, sign = _sensor(where, data)
        if end in forces:
            raise InputError("this force is there twice", place=where, remedy="export one hit a file")
        forces[end] = sign * (force_unit(data) or newtons) * _samples(where, data)
    lengths = {len(column) for column in (*columns.values(), *forces.values())}
    rates = [_rate(f"{path}, response {data['rsp_node']}", data) for data in (*own, *loads)]
    if len(lengths) > 1 or max(rates) > (1 + SAME_RATE) * min(rates):
        raise InputError(
            "its sensors are not sampled at the same instants", place=path, remedy="export all with one rate and length"
        )
    (motion,) = motions
    nodes = nodes_of(path, blocks, per_metre, notes)
    columns = nodes.turned(columns, str(path))
    forces = nodes.turned(forces, str(path)) if forces else {}
    record = MeasuredRecord(
        rates[0], np.stack(list(columns.values()), axis=1), tuple(Sensor(*end) for end in columns), motion,
        source=str(path), notes=tuple(dict.fromkeys(notes)), references=tuple(Sensor(*end) for end in forces),
        forces=np.stack(list(forces.values()), axis=1) if forces else None,
    )  # fmt: skip
    return record, dict(nodes.points)


def _motion(
    where: str, data: Mapping[str, Any], stated: tuple[Motion, float] | None, notes: list[str]
) -> tuple[Motion | None, float | None]:
    """Motion of a record by its type, its label or as stated, and the SI value of the unit on its label."""
    axis, _ = motion_axis(data)
    said = [own for own in MOTIONS.values() if own in (axis.typed, axis.labelled)]
    wanted = None if stated is None else stated[0]
    if axis.contradicts:
        words = f"its ordinate is of the type {axis.typed}, but its label says {axis.text!r:.60}"
        if wanted not in said:
            raise InputError(words, place=where, remedy="correct one of them, or state the unit")
        notes.append(Doubt(f"{where}: {words}: taken as {wanted}, as stated"))
        return wanted, axis.unit if axis.labelled == wanted else None
    if said and wanted not in (None, said[0]):
        raise InputError(f"it says that it is {said[0]}, not {wanted}", place=where, remedy="correct one of them")
    if axis.unit is not None and stated is not None and abs(axis.unit / stated[1] - 1) > SAME_UNIT:
        raise InputError("its unit is not the stated one", place=where, remedy="correct one of them")
    return said[0] if said else wanted, axis.unit


def _sensor(where: str, data: Mapping[str, Any]) -> tuple[tuple[int, str], float]:
    code = int(data["rsp_dir"])
    if not 1 <= abs(code) <= 6:
        raise InputError(f"its direction is {code}", place=where, remedy="give 1 to 6, negative against the axis")
    return (int(data["rsp_node"]), DIRECTIONS[abs(code) - 1]), float(np.sign(code))


def _samples(where: str, data: Mapping[str, Any]) -> np.ndarray:
    """Values of a sensor, (n_samples,)."""
    if int(data["ord_data_type"]) in _COMPLEX:
        raise InputError("its values are complex", place=where, remedy="export the record as real values")
    values = np.asarray(np.real(data["data"]), dtype=float)
    if len(values) != int(data["num_pts"]):
        words = f"it has {len(values)} values, but announces {int(data['num_pts'])}"
        raise InputError(words, place=where, remedy="export it again")
    return values


def _rate(where: str, data: Mapping[str, Any]) -> float:
    """Samples a second, Hz."""
    if int(data["abscissa_spec_data_type"]) not in _TIME:
        raise InputError("its abscissa is no time", place=where, remedy="export it over time in s")
    return even_rate(np.asarray(data["x"], dtype=float), where)
