"""Time records from CSV tables: a column ``time``, one column a sensor, and perhaps one of the force of a hammer."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.files.csv_format import parse_end, titled
from calib.measurement.files.time_stamps import is_stamp, seconds_of
from calib.measurement.frf_units import FORCES, FRFUnits, parse_unit
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.record import MOTION_OF, MeasuredRecord, Motion, even_rate, parse_motion_unit
from calib.results.table import read_rows

_FORCE = re.compile(r"(force|hammer)(?![a-z]).*", re.IGNORECASE)
_UNIT = re.compile(r"#\s*unit\s*[:=]\s*(.*?)[\s,;]*", re.IGNORECASE)
_SECONDS = ("", "s", "sec", "seconds")
_ROTATIONS = ("", "rad", "rad/s", "rad/s2", "rad/s^2", "rad/s²")


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


def is_time(column: str) -> bool:
    """Whether a column is that of the instants, such as ``time`` or ``Time (s)``."""
    return titled(column)[0].lower() == "time"


def is_force(column: str) -> bool:
    """Whether a column is that of a force, such as ``force 3z`` or ``3z (N)``."""
    name, unit = titled(column)
    return _FORCE.fullmatch(name) is not None or unit in FORCES


def read_record_csv(path: Path, unit: str | None = None) -> MeasuredRecord:
    """Read a record from a table with ``time`` and one column a sensor, such as ``12z`` or ``12-z``.

    The time is in s, or a time stamp (see `calib.measurement.files.time_stamps.seconds_of`). The force of a hammer has
    a column such as ``force 3z``. A minus sign reverses the values. The unit of all translations stands behind the
    names, as in ``12z (g)`` and ``force 3z (N)``, or in a comment line, with a force as in a table of FRFs::

        # unit: m/s2
        # unit: g/N

    Without either SI is assumed; rotations are in rad, moments in the unit of force times m.

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
    at = next((k for k, name in enumerate(header) if is_time(name)), None)
    if at is None:
        raise InputError("it has no column 'time'", place=path, remedy="give the time of every sample, s")
    if titled(header[at])[1] not in _SECONDS:
        raise InputError(f"its time is in {titled(header[at])[1]!r:.40}", place=path, remedy="give it in s")
    forced = [k for k, name in enumerate(header) if k != at and is_force(name)]
    moved = [k for k in range(len(header)) if k != at and k not in forced]
    ends, loads = ([_end(path, header[k]) for k in own] for own in (moved, forced))
    if not ends:
        raise InputError("it has no sensor", place=path, remedy="give one column a sensor, such as 12z")
    twice = next(
        (one for own in (ends, loads) for k, (one, _) in enumerate(own) if one in [end for end, _ in own[:k]]), None
    )
    if twice is not None:
        raise InputError(f"the sensor {Sensor(*twice).name} is there twice", place=path, remedy="keep one")
    along, turned = ([header[k] for k, (end, _) in zip(moved, ends, strict=True) if end[1].startswith("r") is rotates]
                     for rotates in (False, True))  # fmt: skip
    if (own := _one_unit(path, turned)) not in _ROTATIONS:
        raise InputError(f"its rotation {turned[0]!r:.40} is in {own!r:.40}", place=path, remedy="give it in rad")
    pushed = [header[k] for k, (end, _) in zip(forced, loads, strict=True) if not end[1].startswith("r")]
    motion, units, notes = _stated(path, unit, along, pushed, bool(loads))
    table = _numbers(path, header, separator, at)
    time, values, forces = table[:, at], table[:, moved], table[:, forced]
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
    found = parse_end(titled(name)[0])
    if found is not None:
        return found
    words = "is neither 'time' nor a node with a direction"
    remedy = "write it like 12z or 12-z, a force like 'force 3z'"
    if is_force(name):
        words, remedy = "is a force that names no node", "call it like 'force 3z', by where and along what it acts"
    raise InputError(
        f"its column {name!r:.60} {words}", place=path, remedy=f"{remedy}; directions are {', '.join(DIRECTIONS)}"
    )


def _stated(
    path: Path, unit: str | None, motions: Sequence[str], forces: Sequence[str], forced: bool
) -> tuple[Motion | None, FRFUnits, tuple[str, ...]]:
    """Motion, SI values of its unit and that of the force, and what is assumed; from the names of columns too."""
    moved, pushed = (_one_unit(path, columns) for columns in (motions, forces))
    if pushed and pushed not in FORCES:
        remedy = f"give it in one of {', '.join(FORCES)}"
        raise InputError(f"its force {forces[0]!r:.40} is in {pushed!r:.40}", place=path, remedy=remedy)
    given: list[tuple[str, str | Path | Place]] = [(moved, path)] if moved else []
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            if not line.startswith("#"):
                if line.strip() and given:
                    break
                if number > _COMMENTS:
                    break
                continue
            if (match := _UNIT.fullmatch(line.strip())) is not None:
                given.append((match.group(1), Place(str(path), number, line.rstrip())))
    if unit is not None:
        given.append((unit, path))
    found: list[tuple[Motion, FRFUnits, bool]] = []
    for text, place in given:
        one = parse_record_unit(text, place, forced)
        found.append(parse_record_unit(f"({text})/{pushed}", place, True) if pushed and not one[2] else one)
    for other in found[1:]:
        own, first = (one[1] if other[2] and found[0][2] else FRFUnits(one[1].motion) for one in (other, found[0]))
        if other[0] != found[0][0] or not own.agrees(first):
            raise InputError("two units are stated for it", place=path, remedy="correct one of them")
    if not found:
        return None, FRFUnits(force=FORCES.get(pushed, 1.0)), (f"{path}: no unit is stated: SI assumed",)
    motion, units, stated = max(found, key=lambda one: one[2])
    return motion, units, () if stated or not forced else (f"{path}: no unit of the force is stated: N assumed",)


def _one_unit(path: Path, columns: Sequence[str]) -> str:
    """The unit behind the names of columns, empty where none has one."""
    units = dict.fromkeys(titled(name)[1] for name in columns)
    if len(units) > 1:
        words = f"its columns {columns[0]!r:.40} and "
        other = next(name for name in columns if titled(name)[1] != titled(columns[0])[1])
        raise InputError(f"{words}{other!r:.40} differ in unit", place=path, remedy="convert them to one unit")
    return next(iter(units), "")


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


def _numbers(path: Path, header: list[str], separator: str, at: int) -> np.ndarray:
    """All values, (n_samples, n_columns); NaN where one is missing, and seconds where the time is a time stamp."""
    text = path.read_text("utf-8-sig", errors="replace")  # what is no text is refused below, with its place
    given = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    cells = given[1].split(separator) if len(given) > 1 else []
    seconds: list[float] | None = None
    if len(cells) > at and is_stamp(cells[at]):
        stamps = [line.split(separator)[at] if line.count(separator) >= at else "" for line in given[1:]]
        seconds = list(seconds_of(stamps, path))
    elif separator == ",":
        try:
            with path.open(encoding="utf-8-sig") as lines:
                body = (line for line in lines if line.strip() and not line.lstrip().startswith("#"))
                next(body)
                table = np.loadtxt(body, delimiter=separator, ndmin=2)
            if table.shape[1] == len(header):
                return table
        except (ValueError, StopIteration):
            pass  # read again below, line by line, for the place of the fault
    rows = read_rows(path, tuple(header))
    return np.array([
        [
            seconds[number] if seconds is not None and k == at
            else row.number(name) if row.cells[name].lower() != "nan" else np.nan
            for k, name in enumerate(header)
        ]
        for number, row in enumerate(rows)
    ])  # fmt: skip
