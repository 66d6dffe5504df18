"""Frequency response functions from CSV tables; errors name line and column."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.files.csv_format import FREQ_LIMIT, VALUE_LIMIT, parse_end
from calib.measurement.files.csv_record import header_of
from calib.measurement.files.frf_columns import (
    MATLAB,
    WORKBOOKS,
    arrays_of,
    is_wide,
    read_columns,
    read_function_files,
)
from calib.measurement.frf import NO_PHASE, QUANTITIES, Quantity
from calib.measurement.frf_repeats import FRFRepeat, Key, common_axis, function_name, off_axis, on_axis, repeat_of
from calib.measurement.frf_units import FRFUnits, parse_unit
from calib.measurement.modal import DIRECTIONS
from calib.measurement.places import Doubt
from calib.results.table import TableRow, read_rows

_STATED = re.compile(r"#\s*(quantity|unit)\s*[:=]\s*(.*?)[\s,;]*", re.IGNORECASE)


def read_columns_frfs(
    paths: Sequence[Path],
    channels: Sequence[str],
    quantity: Quantity | None = None,
    unit: str | None = None,
    variables: Mapping[str, str] | None = None,
) -> FRFRepeat:
    """Read one repeat from a wide table, a workbook or a MATLAB file, or from a text file for each channel.

    See `calib.measurement.files.frf_columns`; quantity and unit as for `read_frfs_csv`. ``variables`` names those of a
    MATLAB file, or the ``sheet`` of a workbook.
    """
    named, left_out = dict(variables or {}), tuple[Doubt, ...]()
    if paths[0].suffix.lower() in MATLAB:
        axis, functions, coherence, behind = *arrays_of(paths[0], named, channels), None
    elif len(paths) == 1:
        axis, functions, coherence, behind, left_out = read_columns(paths[0], channels, named.get("sheet"))
    else:
        axis, functions, coherence, behind = read_function_files(paths, channels)
    found, units, notes = _stated(paths[0], quantity, unit, behind)
    functions = {key: values * units.factor(key) for key, values in functions.items()}
    return repeat_of(", ".join(map(str, paths)), axis, found, functions, coherence, [*notes, *left_out])


def read_frfs_csv(
    path: Path, quantity: Quantity | None = None, unit: str | None = None, channels: Sequence[str] = ()
) -> FRFRepeat:
    """Read one repeat from a table ``freq, response, reference, re, im, coherence``.

    A line holds one value of one function: its frequency in Hz, response and reference such as ``12z`` or ``12-z`` (a
    minus sign reverses the value), real and imaginary part, and the coherence, which may be absent or empty. Lines may
    stand in any order; a function may leave out lines at which it has no value, up to a quarter. Comment lines state
    quantity and unit once::

        # quantity: accelerance
        # unit: g/N

    The unit is that of translations under forces (see `calib.measurement.frf_units.parse_unit`) and implies the
    quantity; without it SI is assumed and noted. At 0 Hz only a receptance is kept.

    Parameters
    ----------
    path : Path
    quantity : {"receptance", "mobility", "accelerance"}, optional
    unit : str, optional
        Where the file does not state them; a contradiction is refused.
    channels : sequence of str, optional
        Of a table with the functions side by side, such as ``12z/3z``, where its columns do not name them; see
        `read_columns_frfs`.

    Raises
    ------
    InputError
        With file, line and column, for anything that is not such a table: amplitudes alone, no quantity, an unknown
        unit, an entry given twice, frequencies that differ between functions, a dead channel.
    """
    header = header_of(path)[0]
    if channels or is_wide(header):
        return read_columns_frfs([path], channels, quantity, unit)
    if len(header) > 2 and not {"response", "reference"} & set(header):
        raise InputError(
            f"its columns, such as {header[1]!r:.60}, name no response and reference", place=path,
            remedy="call them '12z/3z re' and '12z/3z im', or give the functions in the order of the columns: "
            "--channels 12z/3z,13z/3z (channels = in a study and in Python)",
        )  # fmt: skip
    if (large := _large_table(path)) is not None:
        found, units, notes = _stated(path, quantity, unit)
        if (sorted_lines := _of_large(large, found)) is not None:
            axis = common_axis([freq for freq, _, _ in sorted_lines.values()])
            if axis is not None:
                return _on_axis(path, axis, found, units, notes, sorted_lines)
    rows = read_rows(path, ("freq", "response", "reference"), ("re", "im", "coherence"))
    for column in ("re", "im"):
        if column not in rows[0].cells:
            raise InputError(f"it has no column {column!r}", place=path, remedy=NO_PHASE)
    found, units, notes = _stated(path, quantity, unit)
    entries: dict[Key, dict[float, tuple[complex, float, TableRow]]] = {}
    for row in rows:
        freq = row.number("freq")
        if freq == 0 and found != "receptance":
            continue  # dropped anyway, see `repeat_of`
        value, coherence = _entry(row, freq)
        (response, one), (reference, other) = _end(row, "response"), _end(row, "reference")
        own = entries.setdefault((response, reference), {})
        if freq in own:
            raise row.error("freq", f"this function has its line at {freq:g} Hz twice", "keep one, one file a repeat")
        own[freq] = one * other * value, coherence, row
    if not entries:
        raise InputError("it has no line above 0 Hz", place=path, remedy="give at least one frequency in Hz")
    _require_phase(path, entries)
    lines: dict[Key, _Lines] = {}
    for key, own in entries.items():
        ordered = [own[freq] for freq in sorted(own)]
        values = np.array([value for value, _, _ in ordered])
        if not values.any():
            raise ordered[0][2].error("re", "this function is zero on every line: a dead channel", "leave it out")
        lines[key] = np.array(sorted(own)), values, np.array([gamma for _, gamma, _ in ordered])
    axis = common_axis([freq for freq, _, _ in lines.values()])
    if axis is None:
        for key, own in entries.items():
            _require_axis(path, key, own, next(iter(lines.values()))[0])
    assert axis is not None
    return _on_axis(path, axis, found, units, notes, lines)


_Lines = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Frequencies in ascending order, values and coherences of a function, (n_lines,) each."""
LARGE = 20_000
"""Lines from which a table is read at once; what is wrong in it is looked for line by line."""


def _on_axis(
    path: Path, axis: np.ndarray, found: Quantity, units: FRFUnits, notes: Sequence[str], lines: Mapping[Key, _Lines]
) -> FRFRepeat:
    functions = {key: on_axis(values * units.factor(key), freq, axis) for key, (freq, values, _) in lines.items()}
    coherence = {key: on_axis(own, freq, axis) for key, (freq, _, own) in lines.items() if np.isfinite(own).any()}
    return repeat_of(str(path), axis, found, functions, coherence, notes)


def _large_table(path: Path) -> pd.DataFrame | None:
    """A table of many lines separated by commas; None for another one, and for anything that is not plain."""
    header, separator = header_of(path)
    named = {"freq", "response", "reference", "re", "im"}
    if separator != "," or len(set(header)) < len(header) or not named <= set(header) <= {*named, "coherence"}:
        return None
    try:
        with path.open("rb") as file:
            if sum(chunk.count(b"\n") for chunk in iter(lambda: file.read(1 << 20), b"")) < LARGE:
                return None
        with warnings.catch_warnings():
            # the default of older versions is not exact to the last digit, newer ones deprecate the choice
            warnings.filterwarnings("ignore", message="The 'float_precision' argument")
            table = pd.read_csv(
                path, comment="#", encoding="utf-8-sig", float_precision="round_trip", skipinitialspace=True,
                dtype={"response": "category", "reference": "category"}, keep_default_na=False, na_values=[""],
            )  # fmt: skip
    except (OSError, TypeError, ValueError):  # pandas' own errors among them
        return None
    numbers = [column for column in table.columns if column not in ("response", "reference")]
    plain = all(table[column].dtype.kind in "if" for column in numbers) and list(table.columns) == header
    return table if plain and isinstance(table.index, pd.RangeIndex) else None


def _of_large(table: pd.DataFrame, found: Quantity) -> dict[Key, _Lines] | None:
    """Lines by function; None where one is wrong, which is then told by its line."""
    if found != "receptance":
        table = table[table["freq"] != 0]
    values = table["re"].to_numpy(dtype=float) + 1j * table["im"].to_numpy(dtype=float)
    freq = table["freq"].to_numpy(dtype=float)
    coherence = table["coherence"].to_numpy(dtype=float) if "coherence" in table else np.full(len(table), np.nan)
    parts = np.maximum(np.abs(values.real), np.abs(values.imag))
    fine = np.all((freq >= 0) & (freq < FREQ_LIMIT)) and np.all(parts <= VALUE_LIMIT)
    if not len(table) or not fine or (np.all(values.imag == 0) and np.all(values.real >= 0)):
        return None
    out: dict[Key, _Lines] = {}
    grouped: Mapping[Any, Any] = table.groupby(["response", "reference"], observed=True, sort=False).indices
    for names, indices in grouped.items():
        rows = np.asarray(indices)
        ends = [parse_end(str(name).strip()) for name in names]
        order = rows[np.argsort(freq[rows], kind="stable")]
        if ends[0] is None or ends[1] is None:
            return None
        (response, one), (reference, other) = ends[0], ends[1]
        if (response, reference) in out or np.any(np.diff(freq[order]) <= 0) or not values[order].any():
            return None
        out[response, reference] = freq[order], one * other * values[order], coherence[order]
    return out


def _stated(
    path: Path, quantity: Quantity | None, unit: str | None, behind: str | None = None
) -> tuple[Quantity, FRFUnits, tuple[str, ...]]:
    """Quantity, units, and what is assumed of them, from comments, names of columns (``behind``) and arguments."""
    said = _comments(path)
    where = {name: place for name, (_, place) in said.items()}
    texts: list[tuple[str, Path | Place]] = [said["unit"]] if "unit" in said else []
    texts += [(text, path) for text in (behind, unit) if text is not None]
    units = [parse_unit(*one) for one in texts]
    for (text, _), (_, other) in zip(texts[1:], units[1:], strict=True):
        if not other.agrees(units[0][1]):
            words = f"it states the unit {texts[0][0]}, not {text}"
            raise InputError(words, place=texts[0][1], remedy="correct one of them")
    given = [implied for implied, _ in units] + ([] if quantity is None else [quantity])
    if "quantity" in said:
        own = next((known for known in QUANTITIES if known == said["quantity"][0].lower()), None)
        if own is None:
            raise InputError(
                f"the quantity {said['quantity'][0][:40]!r} is unknown", place=where["quantity"],
                remedy=f"one of {', '.join(QUANTITIES)}",
            )  # fmt: skip
        given.append(own)
    if not given:
        state = "state the unit, --unit '(m/s2)/N' (unit = in a study and in Python)"
        line = "" if path.suffix.lower() in (*MATLAB, *WORKBOOKS) else "start it with a line '# unit: (m/s2)/N', or "
        raise InputError("neither quantity nor unit is stated", place=path, remedy=line + state)
    for further in given[1:]:
        if further != given[0]:
            place = where.get("quantity", where.get("unit", path))
            raise InputError(f"it is {given[0]} and {further}", place=place, remedy="correct quantity or unit")
    if units:
        return given[0], units[0][1], ()
    return given[0], FRFUnits(), (f"{path}: no unit is stated: metres and newtons assumed",)


def _comments(path: Path) -> dict[str, tuple[str, Place]]:
    """What comment lines say of quantity and unit, and where."""
    said: dict[str, tuple[str, Place]] = {}
    if path.suffix.lower() in (*MATLAB, *WORKBOOKS):
        return said
    for number, line in enumerate(path.read_text("utf-8-sig", errors="replace").splitlines(), start=1):
        match = _STATED.fullmatch(line.strip())
        if match is None:
            continue
        name, place = match.group(1).lower(), Place(str(path), number, line)
        if name in said and said[name][0] != match.group(2):
            raise InputError(f"the {name} is stated twice, differently", place=place, remedy="keep one")
        said[name] = match.group(2), place
    return said


def _entry(row: TableRow, freq: float) -> tuple[complex, float]:
    """Value and coherence of a line; the coherence is checked where it is used."""
    value, coherence = complex(row.number("re"), row.number("im")), row.optional("coherence")
    if not 0 <= freq < FREQ_LIMIT:
        raise row.error("freq", f"frequency {freq:g} Hz is outside [0, {FREQ_LIMIT:g})", "give it in Hz")
    if max(abs(value.real), abs(value.imag)) > VALUE_LIMIT:
        raise row.error("re", f"a value above {VALUE_LIMIT:g} is not plausible", "correct it")
    return value, coherence


def _end(row: TableRow, column: str) -> tuple[tuple[int, str], int]:
    """Node and direction of a response or reference, and the sign of the direction."""
    found = parse_end(row.text(column))
    if found is None:
        raise row.error(
            column, f"{row.text(column)!r:.60} is no node with a direction",
            f"write it like 12z or 12-z; directions are {', '.join(DIRECTIONS)}",
        )  # fmt: skip
    return found


def _require_phase(path: Path, entries: Mapping[Key, Mapping[float, tuple[complex, float, TableRow]]]) -> None:
    """InputError for amplitudes; an undamped simulation is real too, but changes its sign."""
    values = [value for own in entries.values() for value, _, _ in own.values()]
    if all(value.imag == 0 for value in values) and all(value.real >= 0 for value in values):
        raise InputError("its values are real and nowhere negative: amplitudes", place=path, remedy=NO_PHASE)


def _require_axis(path: Path, key: Key, own: Mapping[float, tuple[complex, float, TableRow]], axis: np.ndarray) -> None:
    """InputError where the frequencies of a function are not those of the first one."""
    freq = np.array(sorted(own))
    remedy = "export all on common frequencies"
    if len(freq) != len(axis):
        words = f"the function {function_name(key)} has {len(freq)} lines, the first one {len(axis)}"
        raise InputError(words, place=path, remedy=remedy)
    off = off_axis(freq, axis)
    if off.any():
        row = own[float(freq[np.argmax(off)])][2]
        raise row.error("freq", f"the first function has no line at {row.number('freq'):g} Hz", remedy)
