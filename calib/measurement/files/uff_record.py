"""Time records from universal files: datasets 58 of function type 1, with the units of 164."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from calib.errors.errors import InputError
from calib.measurement.files.uff import length_factor, points_of
from calib.measurement.files.uff_blocks import extract_sets, read_blocks
from calib.measurement.files.uff_sets import pyuff_faults
from calib.measurement.frf_units import GRAVITY
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.places import Point
from calib.measurement.record import SAME_RATE, MeasuredRecord, Motion, even_rate, parse_motion_unit

TIME_RESPONSE = 1
"""Function type of a time record."""
_MOTIONS: Mapping[int, Motion] = {8: "displacement", 11: "velocity", 12: "acceleration"}
_TIME = (0, 17)
"""Data types of the abscissa: unknown, time."""
_COMPLEX = (5, 6)


def function_types(path: Path) -> set[int]:
    """Function types of the datasets 58 of a file."""
    return {int(data["func_type"]) for data in _function_sets(path, header_only=True)}


def _function_sets(path: Path, header_only: bool = False) -> list[dict[str, Any]]:
    """Datasets 58 of a file."""
    read_blocks(path)  # a truncated file would lose its last functions without a word
    remedy = "export it again"
    with pyuff_faults(lambda words: InputError(f"its functions cannot be read ({words})", place=path, remedy=remedy)):
        reader = pyuff.UFF(str(path))
        kinds = reader.get_set_types()
        return [dict(reader.read_sets(k, header_only)) for k, kind in enumerate(kinds) if int(kind) == 58]


def read_record_uff(path: Path, unit: str | None = None) -> tuple[MeasuredRecord, dict[int, Point]]:
    """Read a record and the places of its nodes (m) from a universal file.

    Every dataset 58 of function type 1 is a sensor; other functions are noted. A sensor mounted against its axis
    (negative direction) reverses the sign. Lengths are those of dataset 164, accelerations in g are converted.

    Parameters
    ----------
    path : Path
    unit : str, optional
        Where the file has no dataset 164; see `calib.measurement.record.parse_motion_unit`.

    Raises
    ------
    InputError
        For a file that cannot be read, without such functions, with a sensor twice, with samples that differ between
        sensors, or with several motions.
    """
    blocks = read_blocks(path)
    every = _function_sets(path)
    own = [data for data in every if int(data["func_type"]) == TIME_RESPONSE]
    if not own:
        raise InputError("it holds no time record (dataset 58 of function type 1)", place=path, remedy="export records")
    notes = [f"{path}: {len(every) - len(own)} functions that are no time records skipped"] * (len(own) < len(every))
    units = [block for block in blocks if block.kind == 164]
    per_metre = length_factor(path, units, extract_sets(path, units), []) if units else 1.0
    stated = None if unit is None else parse_motion_unit(unit, path)
    if not units and stated is None:
        notes.append(f"{path}: no units (dataset 164): SI assumed")
    sensors: list[Sensor] = []
    columns, motions = [], set()
    for data in own:
        where = f"{path}, response {data['rsp_node']}, direction {data['rsp_dir']}"
        sensor, sign = _sensor(where, data)
        if sensor.name in [one.name for one in sensors]:
            raise InputError("this sensor is there twice", place=where, remedy="export one record a file")
        motion = _MOTIONS.get(int(data["ordinate_spec_data_type"]), None if stated is None else stated[0])
        if stated is not None and motion != stated[0]:
            raise InputError(f"it says that it is {motion}, not in {unit}", place=where, remedy="correct one of them")
        motions.add(motion)
        if len(motions) > 1:
            raise InputError(
                "its motion is not that of the first sensor", place=where, remedy="give sensors of one kind a file"
            )
        in_g = str(data.get("ordinate_axis_units_lab", "")).strip().lower() in ("g", "gn")
        factor = GRAVITY if in_g else 1 / per_metre if units or stated is None else stated[1]
        columns.append(sign * (1.0 if sensor.direction.startswith("r") else factor) * _samples(where, data))
        sensors.append(sensor)
    lengths = {len(column) for column in columns}
    rates = [_rate(f"{path}, response {data['rsp_node']}", data) for data in own]
    if len(lengths) > 1 or max(rates) > (1 + SAME_RATE) * min(rates):
        raise InputError(
            "its sensors are not sampled at the same instants", place=path, remedy="export all with one rate and length"
        )
    (motion,) = motions
    record = MeasuredRecord(
        rates[0], np.stack(columns, axis=1), tuple(sensors), motion, source=str(path), notes=tuple(notes)
    )
    return record, points_of(path, blocks, per_metre, [])


def _sensor(where: str, data: Mapping[str, Any]) -> tuple[Sensor, float]:
    code = int(data["rsp_dir"])
    if not 1 <= abs(code) <= 6:
        raise InputError(f"its direction is {code}", place=where, remedy="give 1 to 6, negative against the axis")
    return Sensor(int(data["rsp_node"]), DIRECTIONS[abs(code) - 1]), float(np.sign(code))


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
