"""Time records from CSV tables: a column ``time`` and one column a sensor."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.files.csv_format import parse_end
from calib.measurement.frf_units import SAME_UNIT
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.record import MeasuredRecord, Motion, even_rate, parse_motion_unit
from calib.results.table import read_rows

_UNIT = re.compile(r"#\s*unit\s*[:=]\s*(.*?)[\s,;]*", re.IGNORECASE)
TIME = "time"
"""Column of the instants, s."""


def header_of(path: Path) -> tuple[list[str], str]:
    """Columns of a CSV file and their separator; no columns where it has none that can be read."""
    try:
        with path.open(encoding="utf-8-sig") as lines:
            for line in lines:
                bare = line.strip()
                if bare and not bare.startswith("#"):
                    separator = next((c for c in (";", "\t", ",") if c in bare), ",")
                    return [cell.strip().strip('"') for cell in bare.split(separator)], separator
    except (OSError, UnicodeDecodeError):
        pass
    return [], ","


def read_record_csv(path: Path, unit: str | None = None) -> MeasuredRecord:
    """Read a record from a table with ``time`` in s and one column a sensor, such as ``12z`` or ``12-z``.

    A minus sign reverses the values. A comment line states the unit of all translations once::

        # unit: m/s2

    Without it SI is assumed; rotations are in rad.

    Parameters
    ----------
    path : Path
    unit : str, optional
        Where the file does not state it; see `calib.measurement.record.parse_motion_unit`.

    Raises
    ------
    InputError
        With file and, where possible, line and column: for a column that is no sensor, an unknown or contradicted unit,
        missing values, or instants that are not equally spaced.
    """
    header, separator = header_of(path)
    ends = [_end(path, name) for name in header if name != TIME]
    if not ends:
        raise InputError("it has no sensor", place=path, remedy="give one column a sensor, such as 12z")
    twice = next((one for k, (one, _) in enumerate(ends) if one in [own for own, _ in ends[:k]]), None)
    if twice is not None:
        raise InputError(f"the sensor {Sensor(*twice).name} is there twice", place=path, remedy="keep one")
    motion, factor, notes = _stated(path, unit)
    table = _numbers(path, header, separator)
    time = table[:, header.index(TIME)]
    values = table[:, [k for k, name in enumerate(header) if name != TIME]]
    if not np.all(np.isfinite(time)):
        raise InputError("a value of its column 'time' is missing", place=path, remedy="give the time of every sample")
    signs = np.array([sign * (1.0 if end[1].startswith("r") else factor) for end, sign in ends])
    sensors = tuple(Sensor(*end) for end, _ in ends)
    return MeasuredRecord(even_rate(time, str(path)), values * signs, sensors, motion, source=str(path), notes=notes)


def _end(path: Path, name: str) -> tuple[tuple[int, str], int]:
    found = parse_end(name)
    if found is None:
        raise InputError(
            f"its column {name!r:.60} is neither {TIME!r} nor a node with a direction", place=path,
            remedy=f"write it like 12z or 12-z; directions are {', '.join(DIRECTIONS)}",
        )  # fmt: skip
    return found


def _stated(path: Path, unit: str | None) -> tuple[Motion | None, float, tuple[str, ...]]:
    """Motion, SI value of its unit, and what is assumed."""
    found: list[tuple[Motion, float]] = []
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            if not line.startswith("#"):
                if line.strip() and found:
                    break
                if number > _COMMENTS:
                    break
                continue
            if (match := _UNIT.fullmatch(line.strip())) is not None:
                found.append(parse_motion_unit(match.group(1), Place(str(path), number, line.rstrip())))
    if unit is not None:
        found.append(parse_motion_unit(unit, path))
    for other in found[1:]:
        if other[0] != found[0][0] or abs(other[1] / found[0][1] - 1) > SAME_UNIT:
            raise InputError("two units are stated for it", place=path, remedy="correct one of them")
    if found:
        return *found[0], ()
    return None, 1.0, (f"{path}: no unit is stated: SI assumed",)


_COMMENTS = 100
"""Lines in which a unit may be stated."""


def _numbers(path: Path, header: list[str], separator: str) -> np.ndarray:
    """All values, (n_samples, n_columns); NaN where one is missing."""
    if separator == ",":
        try:
            with path.open(encoding="utf-8-sig") as lines:
                body = (line for line in lines if line.strip() and not line.lstrip().startswith("#"))
                next(body)
                table = np.loadtxt(body, delimiter=separator, ndmin=2)
            if table.shape[1] == len(header):
                return table
        except (ValueError, StopIteration):
            pass  # read again below, line by line, for the place of the fault
    rows = read_rows(path, (TIME, *(name for name in header if name != TIME)))
    return np.array([[row.number(name) if row.cells[name].lower() != "nan" else np.nan for name in header]
                     for row in rows])  # fmt: skip
