"""Measured time records from files: UFF/UNV or CSV, one file a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.measurement.files.csv_format import read_sensor_table
from calib.measurement.files.csv_record import header_of, is_force, is_time, read_record_csv
from calib.measurement.files.read import UFF_SUFFIXES, Named, found_files, require_files, require_no_copies
from calib.measurement.files.uff_record import FORCE, TIME_RESPONSE, function_types, read_record_uff
from calib.measurement.frf_units import parse_length_unit
from calib.measurement.places import Point, common_points
from calib.measurement.record import SAME_RATE, MeasuredRecord
from calib.measurement.sensors import place_sensors

_FRF = 4


def hold_records(paths: Sequence[Path]) -> bool:
    """Whether files hold time records of responses alone rather than FRFs or hammer records, by their content.

    Raises InputError for files that cannot be read and where records and FRFs are given.
    """
    return _hold_times(paths) and not any(map(has_force, paths))


def hold_hits(paths: Sequence[Path]) -> bool:
    """Whether files hold hammer records, time records with the force; raises as `hold_records`."""
    if not _hold_times(paths):
        return False
    return _all_or_none(paths, list(map(has_force, paths)), "force", "hammer records or records of responses alone")


def _all_or_none(paths: Sequence[Path], found: Sequence[bool], what: str, kinds: str) -> bool:
    """Whether all files hold something; InputError where some do and some do not."""
    if len(set(found)) > 1:
        raise InputError(
            f"it holds no {what}, as {paths[found.index(True)]} does", place=paths[found.index(False)],
            remedy=f"give {kinds}, one kind at a time",
        )  # fmt: skip
    return found[0]


def has_force(path: Path) -> bool:
    """Whether a universal file or a table holds the force of a hammer."""
    if path.suffix.lower() == ".csv":
        return any(map(is_force, header_of(path)[0]))
    return FORCE in function_types(path)


def _hold_times(paths: Sequence[Path]) -> bool:
    if any(path.suffix.lower() not in (*UFF_SUFFIXES, ".csv") for path in paths):
        return False  # text files, workbooks and MATLAB files hold FRFs
    is_uff = require_files(paths)
    kinds = [_holds_uff(path) if is_uff else any(map(is_time, header_of(path)[0])) for path in paths]
    return _all_or_none(paths, kinds, "time record", "records or FRFs")


def _holds_uff(path: Path) -> bool:
    types = function_types(path)
    if {TIME_RESPONSE, _FRF} <= types:
        raise InputError("it holds FRFs and time records", place=path, remedy="export them to files of their own")
    return TIME_RESPONSE in types


def read_record(
    path: Path, unit: str | None = None, length_unit: float | None = None
) -> tuple[MeasuredRecord, dict[int, Point]]:
    """A record and the places of its nodes, m, of which a table has none; see `read_record_csv`, `read_record_uff`."""
    if path.suffix.lower() in UFF_SUFFIXES:
        return read_record_uff(path, unit, length_unit)
    return read_record_csv(path, unit), {}


def read_records(
    files: Named,
    *,
    unit: str | None = None,
    sensors: str | Path | None = None,
    length_unit: str | None = None,
    synthetic: bool = False,
) -> tuple[MeasuredRecord, ...]:
    r"""Read measured time records; each file is one record, a repeat or, with sensors of its own, another set-up.

    Parameters
    ----------
    files : path, pattern such as ``"measured/*.csv"``, or sequence of them
        Files that match a pattern are sorted by name. Universal files (``.uff``, ``.unv``, ``.uf``; see
        `calib.measurement.files.uff_record.read_record_uff`) or tables (``.csv``; see
        `calib.measurement.files.csv_record.read_record_csv`), one kind only.
    unit : str, optional
        Of translations, such as ``m/s2`` or ``g``, where the files do not state it.
    sensors : path, optional
        Table of node places in metres; it takes precedence over places in universal files.
    length_unit : str, optional
        Of places in universal files without dataset 164, such as ``mm``; by default m.
    synthetic : bool
        True when no structure was measured.

    Returns
    -------
    tuple of MeasuredRecord
        Those with the same sensors in the order of the first one.

    Raises
    ------
    InputError
        For files that cannot be read, and records whose sensors, motions or rates differ.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = Path(folder, "ambient.csv")
    ...     lines = (f"{0.01 * k:.2f},{(-1) ** k},{0.5 * (-1) ** k}" for k in range(1000))
    ...     _ = table.write_text("\n".join(["time,1z,2z", *lines]))
    ...     (record,) = calib.read_records(table, unit="m/s2")
    >>> round(record.rate), [sensor.name for sensor in record.sensors]
    (100, ['1z', '2z'])
    """
    paths = found_files(files)
    is_uff = require_files(paths)
    require_no_copies(paths)
    table_path = None if sensors is None else path_of(sensors, "sensors")
    table = read_sensor_table(table_path) if table_path is not None else {}
    points: list[tuple[str, dict[int, Point]]] = []
    read: list[MeasuredRecord] = []
    for path in paths:
        own, places = read_record(path, unit, parse_length_unit(length_unit))
        if own.references:
            remedy = "read its FRFs: calib.read_frfs, or leave the force out"
            raise InputError("it holds the force of a hammer", place=path, remedy=remedy)
        if is_uff:
            points.append((str(path), places))
        names = {sensor.name for sensor in own.sensors}
        same = next((one for one in read if {sensor.name for sensor in one.sensors} == names), None)
        read.append(own if same is None else own.in_order(same.sensors))
        if abs(own.rate / read[0].rate - 1) > SAME_RATE or own.motion != read[0].motion:
            what = "motion" if own.motion != read[0].motion else f"rate of {own.rate:.6g} Hz"
            raise InputError(
                f"its {what} is not that of {read[0].source}", place=path, remedy="give records measured alike"
            )
    _require_setups(read)
    measured = list(dict.fromkeys((sensor.node, sensor.direction) for one in read for sensor in one.sensors))
    placed = place_sensors(measured, common_points(points, table), table, paths[0], table_path)
    of = {sensor.name: sensor for sensor in placed.sensors}
    return tuple(
        replace(one, sensors=tuple(of[sensor.name] for sensor in one.sensors),
                notes=(*placed.notes * (k == 0), *one.notes), misplaced=placed.misplaced, synthetic=synthetic)
        for k, one in enumerate(read)
    )  # fmt: skip


def _require_setups(records: Sequence[MeasuredRecord]) -> None:
    """InputError for a record that lacks sensors of another and brings none of its own: it is no set-up."""
    every = [{sensor.name for sensor in one.sensors} for one in records]
    for own, one in zip(every, records, strict=True):
        if (larger := next((k for k, other in enumerate(every) if own < other), None)) is not None:
            one.in_order(records[larger].sensors)  # which names what it lacks
