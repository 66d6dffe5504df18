"""Time records from CSV tables: a column ``time``, one column a sensor, and perhaps one of the force of a hammer."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.files.csv_format import parse_end
from calib.measurement.files.time_stamps import is_stamp, seconds_of
from calib.measurement.frf_units import FRFUnits, parse_unit
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.record import MOTION_OF, MeasuredRecord, Motion, even_rate, parse_motion_unit
from calib.results.table import read_rows

_FORCE = re.compile(r"force[\s_]+(.*)", re.ASCII | re.IGNORECASE)
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


def is_force(column: str) -> bool:
    """Whether a column is that of a force, such as ``force 3z``."""
    return _FORCE.fullmatch(column) is not None


def read_record_csv(path: Path, unit: str | None = None) -> MeasuredRecord:
    """Read a record from a table with ``time`` and one column a sensor, such as ``12z`` or ``12-z``.

    The time is in s, or a time stamp (see `calib.measurement.files.time_stamps.seconds_of`). The force of a hammer has
    a column such as ``force 3z``. A minus sign reverses the values. A comment line states the unit of all translations
    once, with a force as in a table of FRFs::

        # unit: m/s2
        # unit: g/N

    Without it SI is assumed; rotations are in rad, moments in the unit of force times m.

    Parameters
    ----------
    path : Path
    unit : str, optional
        Where the file does not state it; see `calib.measurement.record.parse_motion_unit` and
        `calib.measurement.frf_units.parse_unit`.

    Raises
    ------
    InputError
        With file and, where possible, line and column: for a column that is no sensor, an unknown or contradicted unit,
        missing values, or instants that are not equally spaced.
    """
    header, separator = header_of(path)
    forced = [name for name in header if is_force(name)]
    ends, loads = (
        [_end(path, name) for name in names]
        for names in ([name for name in header if name != TIME and name not in forced], forced)
    )
    if not ends:
        raise InputError("it has no sensor", place=path, remedy="give one column a sensor, such as 12z")
    twice = next(
        (one for own in (ends, loads) for k, (one, _) in enumerate(own) if one in [end for end, _ in own[:k]]), None
    )
    if twice is not None:
        raise InputError(f"the sensor {Sensor(*twice).name} is there twice", place=path, remedy="keep one")
    motion, units, notes = _stated(path, unit, bool(loads))
    table = _numbers(path, header, separator)
    time = table[:, header.index(TIME)]
    values = table[:, [k for k, name in enumerate(header) if name != TIME and name not in forced]]
    forces = table[:, [header.index(name) for name in forced]]
    if not np.all(np.isfinite(time)):
        raise InputError("a value of its column 'time' is missing", place=path, remedy="give the time of every sample")
    signs = np.array([sign * (1.0 if end[1].startswith("r") else units.motion) for end, sign in ends])
    newtons = np.array([sign * units.force for _, sign in loads])
    sensors, references = (tuple(Sensor(*end) for end, _ in own) for own in (ends, loads))
    return MeasuredRecord(
        even_rate(time, str(path)), values * signs, sensors, motion, source=str(path), notes=notes,
        references=references, forces=forces * newtons if loads else None,
    )  # fmt: skip


def _end(path: Path, name: str) -> tuple[tuple[int, str], int]:
    force = _FORCE.fullmatch(name)
    found = parse_end(force.group(1) if force else name)
    if found is None:
        raise InputError(
            f"its column {name!r:.60} is neither {TIME!r} nor a node with a direction", place=path,
            remedy=f"write it like 12z or 12-z, a force like 'force 3z'; directions are {', '.join(DIRECTIONS)}",
        )  # fmt: skip
    return found


def _stated(path: Path, unit: str | None, forced: bool) -> tuple[Motion | None, FRFUnits, tuple[str, ...]]:
    """Motion, SI values of its unit and that of the force, and what is assumed."""
    found: list[tuple[Motion, FRFUnits, bool]] = []
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            if not line.startswith("#"):
                if line.strip() and found:
                    break
                if number > _COMMENTS:
                    break
                continue
            if (match := _UNIT.fullmatch(line.strip())) is not None:
                found.append(parse_record_unit(match.group(1), Place(str(path), number, line.rstrip()), forced))
    if unit is not None:
        found.append(parse_record_unit(unit, path, forced))
    for other in found[1:]:
        own, first = (one[1] if other[2] and found[0][2] else FRFUnits(one[1].motion) for one in (other, found[0]))
        if other[0] != found[0][0] or not own.agrees(first):
            raise InputError("two units are stated for it", place=path, remedy="correct one of them")
    if not found:
        return None, FRFUnits(), (f"{path}: no unit is stated: SI assumed",)
    motion, units, stated = max(found, key=lambda one: one[2])
    return motion, units, () if stated or not forced else (f"{path}: no unit of the force is stated: N assumed",)


def parse_record_unit(text: str, place: str | Path | Place, forced: bool) -> tuple[Motion, FRFUnits, bool]:
    """Motion and units of a record, and whether the text states that of the force; InputError where it is no unit."""
    if forced:
        try:
            quantity, units = parse_unit(text, place)
            return MOTION_OF[quantity], units, True
        except InputError:
            pass  # a motion alone
    motion, metres = parse_motion_unit(text, place)
    return motion, FRFUnits(metres), False


_COMMENTS = 100
"""Lines in which a unit may be stated."""


def _numbers(path: Path, header: list[str], separator: str) -> np.ndarray:
    """All values, (n_samples, n_columns); NaN where one is missing, and seconds where the time is a time stamp."""
    at, names = header.index(TIME), (TIME, *(name for name in header if name != TIME))
    text = path.read_text("utf-8-sig", errors="replace")  # what is no text is refused below, with its place
    given = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    cells = given[1].split(separator) if len(given) > 1 else []
    if len(cells) > at and is_stamp(cells[at]):
        stamps = [line.split(separator)[at] if line.count(separator) >= at else "" for line in given[1:]]
        seconds = seconds_of(stamps, path)
        rows = read_rows(path, names)
        values = [[row.number(name) if name != TIME and row.cells[name].lower() != "nan" else np.nan for name in header]
                  for row in rows]  # fmt: skip
        table = np.array(values)
        table[:, at] = seconds
        return table
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
    rows = read_rows(path, names)
    return np.array([[row.number(name) if row.cells[name].lower() != "nan" else np.nan for name in header]
                     for row in rows])  # fmt: skip
