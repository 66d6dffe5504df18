"""Modes, shapes, sensor places and scalar responses from CSV tables; errors name line and column."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.modal import DIRECTIONS
from calib.measurement.places import Doubt
from calib.measurement.repeats import Repeat, ShapeSet
from calib.measurement.rules import RULES
from calib.results.table import TableRow, read_rows

FREQ_LIMIT = 1e12
"""Hz; a larger frequency is a corrupt number."""
VALUE_LIMIT = 1e100
"""Modulus; larger shape entries and responses are corrupt and would overflow when squared."""
FINEST = 1e-12
"""Smallest plausible standard deviation of a measurement, relative to the value."""


NO_MOTION = "mic|sound|strain|temp|tacho|volt|press|current|rpm"
"""Beginnings of names of channels that measure no motion."""
END = (
    rf"(?<![\w.])(?:(?i:acc|accel|acceleration|vel|velocity|disp|displacement|point|pt|node|dof|frf|force|hammer)[\s_:]*|(?!(?i:{NO_MOTION}))[a-zA-Z]\w*:)?"
    r"(\d{1,10})[\s:]*([+-]?[a-zA-Z]+)"
)
"""Pattern of a node with a direction, perhaps behind a word or a component: ``12z``, ``Acc 12Z``, ``Wing:12:+Z``."""
_TITLE = re.compile(r"(.*?)\s*[(\[]((?:[^()\[\]]|\([^()]*\))*)[)\]]")
ONE = ""
"""Label of the repeat of a table without a column ``repeat``."""
OF_MODES = ("freq_std", "damping", "damping_std", "repeat", "mpc", "mpd", "note")
OF_SHAPES = ("im", "std", "repeat")
"""Columns that tables of modes and of shapes may have beside those that they need."""


def is_rigid(freq: float, highest: float) -> bool:
    """Whether a frequency is that of a rigid-body motion, 0 but for rounding, beside the highest of its file, Hz."""
    return freq == 0 or -RULES.rounded_freq * highest < freq < RULES.rigid_freq * highest


def read_modes_csv(path: Path) -> dict[str, Repeat]:
    """Frequencies and damping from a table ``mode, freq, freq_kind, freq_std, damping, damping_std, repeat, note``.

    Frequencies and their standard deviations in Hz, damping as a ratio; the last five columns may be absent or empty. A
    note is told with the name of its mode; ``mpc`` and ``mpd``, which `calib modes` writes beside them, are not used. A
    damped frequency is converted to the natural one, ``natural = damped / sqrt(1 - damping**2)``, and so is its
    standard deviation; where the damping is unknown the two are taken as equal. A rigid-body motion at 0 Hz is left
    out and noted. With a column ``repeat`` the table
    holds many repeats, each under its own label; a mode that a repeat lacks has no line there.

    Returns
    -------
    dict
        Repeats by their labels, in the order of the file; `ONE` is the label of a table without that column.

    Raises
    ------
    InputError
        With file, line and column, for anything that is not such a table.
    """
    return modes_of_rows(path, read_rows(path, ("mode", "freq", "freq_kind"), OF_MODES))


def modes_of_rows(path: Path, rows: Sequence[TableRow]) -> dict[str, Repeat]:
    """The same from the rows of such a table."""
    found: dict[str, dict[str, tuple[float, float, float, float]]] = {}
    notes: dict[str, list[str]] = {}
    rigid: dict[str, dict[str, TableRow]] = {}
    highest = max(abs(row.number("freq")) for row in rows)
    for row in rows:
        name, modes = row.text("mode"), found.setdefault(_label(row), {})
        if is_rigid(row.number("freq"), highest):
            rigid.setdefault(_label(row), {})[name] = row
            continue
        if name in modes:
            raise row.error("mode", f"mode {name!r} appears twice", "give every mode one line, or one a repeat")
        freq, kind, damping = row.number("freq"), row.text("freq_kind"), row.optional("damping")
        if not 0 < freq < FREQ_LIMIT:
            raise row.error("freq", f"frequency {freq:g} Hz is outside (0, {FREQ_LIMIT:g})", "give it in Hz")
        if kind not in ("natural", "damped"):
            raise row.error("freq_kind", f"{kind!r} is unknown", "write natural or damped")
        if not (math.isnan(damping) or 0 <= damping < 1):
            raise row.error(
                "damping",
                f"damping ratio {damping:g} is outside [0, 1)",
                "give it as a ratio (0.01 for one percent), or leave it empty",
            )
        deviations = [_deviation(row, "freq_std", freq, freq), _deviation(row, "damping_std", damping, 1.0)]
        factor = 1.0
        if kind == "damped" and not math.isnan(damping):
            factor = 1.0 / math.sqrt(1.0 - damping**2)
        modes[name] = (freq * factor, deviations[0] * factor, damping, deviations[1])
        if note := row.cells.get("note", "").strip():
            notes.setdefault(_label(row), []).append(f"mode {name}: {note}")
    out = {}
    for label, modes in found.items():
        left = rigid.get(label, {})
        source = _source(path, label)
        words = (
            Doubt(f"{source}: mode {n} is a rigid-body motion ({row.number('freq'):g} Hz): left out")
            for n, row in left.items()
        )
        if not modes:
            row = next(iter(left.values()))
            raise row.error("freq", "all modes are rigid-body motions", "give at least one vibration in Hz")
        freqs, freq_stds, dampings, damping_stds = np.array(list(modes.values())).T.copy()
        out[label] = Repeat(
            source, tuple(modes), True, freqs, freq_stds, dampings, damping_stds, None,
            (*words, *notes.get(label, ())), tuple(left),
        )  # fmt: skip
    return out


def _label(row: TableRow) -> str:
    """Label of the repeat that a line belongs to."""
    return row.text("repeat") if "repeat" in row.cells else ONE


def _source(path: Path, label: str) -> str:
    return str(path) if label == ONE else f"{path}, repeat {label}"


def _deviation(row: TableRow, column: str, value: float, most: float) -> float:
    """A plausible standard deviation, between `FINEST` times the value and ``most``; NaN where none is given."""
    std = row.optional(column)
    least = 0.0 if math.isnan(value) else FINEST * abs(value)
    if math.isnan(std) or (0 < std < most and std >= least):
        return std
    problem = f"standard deviation {std:g} of the value {value:g} is outside [{least:g}, {most:g})"
    remedy = "give a positive one, or leave it empty"
    if column == "freq_std" and std >= most:
        remedy = "check whether freq and freq_std are exchanged; both are in Hz"
    raise row.error(column, problem, remedy)


def parse_direction(text: str) -> tuple[str, int] | None:
    """Direction name and sign from ``y``, ``-y``, ``rz`` or a universal-file code such as ``2`` or ``-6``.

    Returns None when the text is not a direction.
    """
    sign = -1 if text.startswith("-") else 1
    bare = text[1:] if text[:1] in ("-", "+") else text
    if bare in ("1", "2", "3", "4", "5", "6"):
        return DIRECTIONS[int(bare) - 1], sign
    return (bare.lower(), sign) if bare.lower() in DIRECTIONS else None


def titled(column: str) -> tuple[str, str]:
    """Name and unit of a column such as ``Time (s)`` or ``12z [m/s2]``; an empty unit where none stands in brackets."""
    match = _TITLE.fullmatch(column.strip())
    return (match.group(1), match.group(2).strip()) if match else (column.strip(), "")


def parse_end(text: str) -> tuple[tuple[int, str], int] | None:
    """Node and direction of an end of a function such as ``12z``, ``12-z`` or `END`, and the sign of the direction.

    Returns None when the text is no node with a direction.
    """
    match = re.fullmatch(END, text, re.ASCII)
    parsed = parse_direction(match.group(2)) if match else None
    return None if match is None or parsed is None else ((int(match.group(1)), parsed[0]), parsed[1])


def read_shapes_csv(
    path: Path, names: Mapping[str, Sequence[str]], left_out: Iterable[str] = ()
) -> dict[str, ShapeSet]:
    """Shapes from a table ``mode, node, direction, re, im, std, repeat``, columns in the order of ``names``.

    ``im`` (zero) and ``std`` (unknown) may be absent or empty; a negative direction turns the sign of the shape; a
    sensor without a line for a mode was not measured in it (NaN).

    Parameters
    ----------
    path : Path
    names : mapping from label of a repeat to names of its modes
        A table without a column ``repeat`` has the one label `ONE`.
    left_out : iterable of str
        Modes that were left out on reading; their shapes are skipped.

    Returns
    -------
    dict
        Shapes by the labels of the repeats.

    Raises
    ------
    InputError
        With file, line and column, for anything that is not such a table, unknown repeats and modes, and sensors given
        twice.
    """
    return shapes_of_rows(path, read_rows(path, ("mode", "node", "direction", "re"), OF_SHAPES), names, left_out)


def shapes_of_rows(
    path: Path, rows: Sequence[TableRow], names: Mapping[str, Sequence[str]], left_out: Iterable[str] = ()
) -> dict[str, ShapeSet]:
    """The same from the rows of such a table."""
    tables: dict[str, dict[tuple[tuple[int, str], str], tuple[complex, float]]] = {}
    for row in rows:
        mode, node, label = row.text("mode"), row.node(), _label(row)
        if label not in names:
            known = ", ".join(one for one in names if one != ONE) or "unknown: their table has no column 'repeat'"
            raise row.error("repeat", f"unknown repeat {label!r}", f"the repeats of the modes are {known}")
        if mode not in names[label]:
            if mode in left_out:
                continue
            raise row.error("mode", f"unknown mode {mode!r}", f"the modes are {', '.join(names[label])}")
        parsed = parse_direction(row.text("direction"))
        if parsed is None:
            raise row.error(
                "direction",
                f"{row.text('direction')!r} is no direction",
                f"write {', '.join(DIRECTIONS)} or a code 1 to 6, with a minus sign if turned round",
            )
        direction, sign = parsed
        entries, key = tables.setdefault(label, {}), ((node, direction), mode)
        if key in entries:
            raise row.error(
                "direction", f"sensor {node}{direction} is given twice for mode {mode}", "remove one of the lines"
            )
        im = row.optional("im")
        value = sign * complex(row.number("re"), 0.0 if math.isnan(im) else im)
        if max(abs(value.real), abs(value.imag)) > VALUE_LIMIT:
            raise row.error("re", f"a shape entry above {VALUE_LIMIT:g} is not plausible", "correct it")
        std = row.optional("std")
        if not (math.isnan(std) or std == 0 or 1 / VALUE_LIMIT < std <= VALUE_LIMIT):
            remedy = "check whether im and std are exchanged" if std < 0 else "correct it"
            raise row.error("std", f"standard deviation {std:g} is negative, too small or too large", remedy)
        entries[key] = (value, std)
    return {label: _shape_set(path, label, entries, names[label]) for label, entries in tables.items()}


def _shape_set(
    path: Path,
    label: str,
    entries: Mapping[tuple[tuple[int, str], str], tuple[complex, float]],
    names: Sequence[str],
) -> ShapeSet:
    sensors = tuple(dict.fromkeys(sensor for sensor, _ in entries))
    where = {sensor: k for k, sensor in enumerate(sensors)}
    column = {name: k for k, name in enumerate(names)}
    shapes = np.full((len(sensors), len(names)), complex(np.nan, np.nan))
    std_table = np.full(shapes.shape, np.nan)
    for (sensor, mode), (value, std) in entries.items():
        key = where[sensor], column[mode]
        shapes[key], std_table[key] = value, std
    for name, k in column.items():
        given = shapes[np.isfinite(shapes[:, k]), k]
        if given.size and np.max(np.abs(given)) < 1 / VALUE_LIMIT:
            raise InputError(
                f"the shape of mode {name!r} is zero everywhere", place=_source(path, label),
                remedy="leave its lines out",
            )  # fmt: skip
    return ShapeSet(_source(path, label), sensors, shapes, std_table)


def read_sensor_table(path: Path) -> dict[int, tuple[tuple[float, float, float], str | None]]:
    """Places of nodes from a table ``node, x, y, z, on``, in metres; ``on`` (the part that carries it) is optional.

    Returns
    -------
    dict
        ``{node: ((x, y, z), on)}``.

    Raises
    ------
    InputError
        With file, line and column, for anything that is not such a table, and nodes given twice.
    """
    places: dict[int, tuple[tuple[float, float, float], str | None]] = {}
    for row in read_rows(path, ("node", "x", "y", "z"), ("on",)):
        node = row.node()
        if node in places:
            raise row.error("node", f"node {node} is given twice", "remove one of the lines")
        places[node] = ((row.number("x"), row.number("y"), row.number("z")), row.cells.get("on") or None)
    return places


def place_of_node(path: Path, node: int) -> Place | None:
    """Line of a sensor table that gives the place of a node; None where it has none or cannot be read any more."""
    try:
        rows = read_rows(path, ("node", "x", "y", "z"), ("on",))
        return next((row.place("node") for row in rows if row.node() == node), None)
    except InputError:
        return None


def read_responses_csv(path: Path) -> dict[str, dict[str, tuple[float, float | None]]]:
    """Scalar responses from a table ``response, value, std, repeat``; ``std`` may be absent or empty (unknown).

    A column ``unit`` is that of `read_response_units`.

    With a column ``repeat`` the table holds many repeats, each under its own label; a response that a repeat lacks has
    no line there.

    Returns
    -------
    dict
        ``{label of the repeat: {response: (value, standard deviation or None)}}``, each in the response's own unit;
        `ONE` is the label of a table without that column.

    Raises
    ------
    InputError
        With file, line and column, for anything that is not such a table, and responses given twice.
    """
    found: dict[str, dict[str, tuple[float, float | None]]] = {}
    for row in read_rows(path, ("response", "value"), ("std", "repeat", "unit")):
        name, value, own = row.text("response"), row.number("value"), found.setdefault(_label(row), {})
        if name in own:
            raise row.error("response", f"response {name!r} is given twice", "remove one of the lines")
        if abs(value) > VALUE_LIMIT:
            raise row.error("value", f"a response above {VALUE_LIMIT:g} is not plausible", "correct it")
        std = _deviation(row, "std", value, VALUE_LIMIT)
        if 0 < std < 1 / VALUE_LIMIT:
            raise row.error("std", f"standard deviation {std:g} is too small", "correct it, or leave it empty")
        own[name] = (value, None if math.isnan(std) else std)
    return found


def read_response_units(path: Path) -> dict[str, str]:
    """Units of the responses of such a table, as text, from its column ``unit``; a response without one has no entry.

    Raises
    ------
    InputError
        Where repeats give a response different units.
    """
    units: dict[str, str] = {}
    for row in read_rows(path, ("response", "value"), ("std", "repeat", "unit")):
        name, unit = row.text("response"), row.cells.get("unit", "")
        if unit and units.setdefault(name, unit) != unit:
            raise row.error("unit", f"response {name!r} has the unit {units[name]!r} before", "give one unit")
    return units
