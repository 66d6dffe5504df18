"""Modes and shapes from variables of MATLAB files and from sheets of workbooks, by names that the user gives.

Both become the rows that tables of modes and of shapes have, so that they are read and refused in the same way.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.files.csv_format import OF_MODES, OF_SHAPES, parse_end
from calib.measurement.files.frf_columns import MATLAB, rows_of
from calib.measurement.modal import DIRECTIONS
from calib.results.table import TableRow

_KINDS = {"freq": "natural", "damped_freq": "damped"}
_OF_MODE = (*_KINDS, "freq_std", "damping", "damping_std")
_PART = re.compile(r"(.*\S)\s+(re|im)(?:al|ag)?", re.IGNORECASE)


@dataclass(frozen=True)
class MappedRow(TableRow):
    """A row that stands in no line of text.

    Attributes
    ----------
    where : str
        What it is in its file, such as ``sheet Modes, row 3``.
    names : mapping from column to text
        What the file calls its columns.
    """

    where: str = ""
    names: Mapping[str, str] | None = None

    def place(self, column: str) -> Place:
        """Where the file has the entry of a column."""
        return Place(str(self.path), what=f"{self.where}, {(self.names or {}).get(column, column)}")


@dataclass(frozen=True)
class MappedModes:
    """Rows of a table of modes and, where there are any, of its shapes; ``named`` unless modes are only counted."""

    modes: list[TableRow]
    shapes: list[TableRow] | None
    named: bool


def read_mapped_modes(path: Path, variables: Mapping[str, str], channels: Sequence[str]) -> MappedModes:
    """Rows of modes and shapes of a MATLAB file or a workbook.

    Parameters
    ----------
    path : Path
    variables : mapping from str to str
        Of a MATLAB file the names of its variables: ``freq`` (natural) or ``damped_freq`` (n_modes,), Hz, and perhaps
        ``damping`` (ratios), ``freq_std``, ``damping_std`` and ``shapes``, (n_sensors, n_modes) or its transpose. Of a
        workbook the names of columns for the same and for ``mode`` (names) and ``repeat``, on the ``sheet`` (the first
        one by default), and the sheet with the ``shapes``; a column that has the name which tables have needs none.
        Shapes are a table ``mode, node, direction, re, im, std``, or have a line for each sensor, ``12z`` or ``12-z``
        in the first column, and a column for each mode, or two, such as ``M1 re`` and ``M1 im``.
    channels : sequence of str
        Sensors, such as ``12z`` or ``12-z``, in the order of the rows of a MATLAB file's shapes.

    Raises
    ------
    InputError
        For a name that the file does not have, and sizes that do not fit.
    """
    matlab = path.suffix.lower() in MATLAB
    known = (*_OF_MODE, "shapes", *(() if matlab else ("sheet", "mode", "repeat")))
    if unknown := next((name for name in variables if name not in known), None):
        raise InputError(f"{unknown!r:.40} is nothing that modes have", place=path, remedy=f"name {', '.join(known)}")
    if set(_KINDS) <= set(variables):
        raise InputError("natural and damped frequencies are named", place=path, remedy="name one of them")
    return _of_matlab(path, variables, channels) if matlab else _of_workbook(path, variables, channels)


def _of_matlab(path: Path, variables: Mapping[str, str], channels: Sequence[str]) -> MappedModes:
    remedy = "name the variables: variables = { freq = 'f', damping = 'zeta', shapes = 'Phi' }"
    kind = next((name for name in _KINDS if name in variables), None)
    if kind is None:
        raise InputError("its frequencies are not named", place=path, remedy=remedy)
    from calib.measurement.files.matlab import matlab_variables  # few files are of MATLAB

    held = matlab_variables(path, tuple(variables.values()), remedy)
    count = held[variables[kind]].size
    cells: list[dict[str, str]] = [{"mode": str(k + 1), "freq_kind": _KINDS[kind]} for k in range(count)]
    names = {"freq" if name == kind else name: f"variable {own}" for name, own in variables.items()}
    for name in _OF_MODE:
        if name not in variables:
            continue
        values = np.ravel(held[variables[name]])
        if np.iscomplexobj(values) or len(values) != count:
            words = f"{variables[name]!r} has {len(values)} {'complex ' * np.iscomplexobj(values)}numbers"
            raise InputError(f"{words} for {count} modes", place=path, remedy="give one real number for each mode")
        for own, value in zip(cells, values, strict=True):
            own["freq" if name == kind else name] = _text(float(value))
    rows: list[TableRow] = [MappedRow(path, 0, own, where=f"mode {own['mode']}", names=names) for own in cells]
    if "shapes" not in variables:
        return MappedModes(rows, None, named=False)
    name, ends = variables["shapes"], [_end(path, one) for one in channels]
    if not ends:
        remedy = "name the sensor of each row: channels = ['1z', '2z', ...]"
        raise InputError(f"the sensors of {name!r} are not named", place=path, remedy=remedy)
    shapes = held[name]
    if 1 in (len(ends), count) and shapes.size == len(ends) * count:
        shapes = shapes.reshape(len(ends), count)
    if shapes.shape == (count, len(ends)) and count != len(ends):
        shapes = shapes.T
    if shapes.shape != (len(ends), count):
        words = f"{name!r} has the shape {held[name].shape}, for {len(ends)} channels and {count} modes"
        raise InputError(words, place=path, remedy="name the sensor of each of its rows")
    entries = (
        (end, str(k + 1), complex(value), f"row {n + 1}")
        for n, (end, row) in enumerate(zip(ends, shapes, strict=True))
        for k, value in enumerate(row)
    )
    return MappedModes(rows, list(_shape_rows(path, entries, f"variable {name}")), named=False)


def _of_workbook(path: Path, variables: Mapping[str, str], channels: Sequence[str]) -> MappedModes:
    if channels:
        raise InputError("channels are named for modes of a workbook", place=path, remedy="name sensors in its shapes")
    kind = next((name for name in _KINDS if name in variables), "freq")
    columns = {"freq" if k == kind else k: own for k, own in variables.items() if k not in ("sheet", "shapes")}
    sheet = variables.get("sheet")
    table, names = _table(path, sheet, ("freq",), ("mode", "freq_kind", *OF_MODES), columns)
    rows: list[TableRow] = [
        MappedRow(path, 0, {"mode": str(k + 1), "freq_kind": _KINDS[kind]} | cells, where=where, names=names)
        for k, (where, cells) in enumerate(table)
    ]
    named = "mode" in table[0][1]
    if "shapes" not in variables:
        return MappedModes(rows, None, named)
    cells = rows_of(path, variables["shapes"])
    if {"node", "direction", "re"} <= {_text(cell) for cell in cells[0]} if cells else False:
        table, names = _table(path, variables["shapes"], ("mode", "node", "direction", "re"), OF_SHAPES, {})
        return MappedModes(rows, [MappedRow(path, 0, own, where=at, names=names) for at, own in table], named)
    modes = list(dict.fromkeys(row.cells["mode"] for row in rows))
    entries = _wide_shapes(path, variables["shapes"], cells, modes, named)
    return MappedModes(rows, list(_shape_rows(path, entries, f"sheet {variables['shapes']}")), named)


def _table(
    path: Path, sheet: str | None, required: Sequence[str], optional: Sequence[str], columns: Mapping[str, str]
) -> tuple[list[tuple[str, dict[str, str]]], dict[str, str]]:
    """Rows of a sheet below the first one that names the required columns, with their places; what it calls them."""
    cells = rows_of(path, sheet)
    called = {name: columns.get(name, name) for name in (*required, *optional)}
    heads = [[_text(cell) for cell in row] for row in cells]
    at = next((k for k, head in enumerate(heads) if {called[name] for name in required} <= set(head)), None)
    if at is None or at + 1 == len(cells):
        needed = ", ".join(called[name] for name in required)
        seen = ", ".join(filter(None, heads[0])) if heads else "none"
        remedy = f"name them, as in variables = {{ freq = 'Frequency' }}; its first row holds {seen:.200}"
        words = "no row" if at is None else "nothing below the row"
        raise InputError(f"its sheet has {words} with the columns {needed}", place=path, remedy=remedy)
    head = heads[at]
    if lacking := next((own for own in columns.values() if own not in head), None):
        raise InputError(f"its sheet has no column {lacking!r:.60}", place=path, remedy=f"they are {', '.join(head)}")
    others = [own for own in head if own and own not in called.values()]
    if others and not columns:
        remedy = f"the columns are {', '.join(called)}; name those that count, as in variables = {{ freq = '...' }}"
        raise InputError(f"unknown column {others[0]!r:.60}", place=path, remedy=remedy)
    index = {name: head.index(own) for name, own in called.items() if own in head}
    where = "row" if sheet is None else f"sheet {sheet}, row"
    rows = [
        (f"{where} {k}", {name: _text(row[n]) if n < len(row) else "" for name, n in index.items()})
        for k, row in enumerate(cells[at + 1 :], start=at + 2)
    ]
    return rows, {name: f"column {head[n]}" for name, n in index.items()}


def _wide_shapes(
    path: Path, sheet: str, cells: Sequence[Sequence[Any]], modes: Sequence[str], named: bool
) -> Iterator[tuple[tuple[str, str], str, complex, str]]:
    """Sensor, mode, value and place of every entry of a sheet with a line for each sensor."""
    head = [_text(cell) for cell in cells[0]] if cells else []
    apart = 2 if head[:2] == ["node", "direction"] else 1
    titles = [match.groups() if (match := _PART.fullmatch(text)) else (text, "re") for text in head[apart:] if text]
    order = list(dict.fromkeys(title for title, _ in titles))
    if not named and not set(order) <= set(modes) and len(order) == len(modes):
        own = dict(zip(order, modes, strict=True))
    elif unknown := next((title for title in order if title not in modes), None):
        remedy = f"the modes are {', '.join(modes)}"
        raise InputError(f"unknown mode {unknown!r:.60} on its sheet {sheet!r:.40}", place=path, remedy=remedy)
    else:
        own = {title: title for title in order}
    for k, row in enumerate(cells[1:], start=2):
        texts = [_text(cell) for cell in row]
        end = _end(path, "".join(texts[:apart]))
        for title in order:
            parts = {"re": 0.0, "im": 0.0}
            for n, (other, part) in enumerate(titles, start=apart):
                if other == title:
                    value = row[n] if n < len(row) else None
                    if value is not None and not isinstance(value, int | float):
                        words = f"row {k} of its sheet {sheet!r:.40} holds {str(value)[:40]!r}"
                        raise InputError(words, place=path, remedy="give a number, or leave the cell empty")
                    parts[part.lower()] = np.nan if value is None else float(value)
            yield end, own[title], complex(parts["re"], parts["im"]), f"row {k}"


def _shape_rows(
    path: Path, entries: Iterator[tuple[tuple[str, str], str, complex, str]], what: str
) -> Iterator[TableRow]:
    """Rows of a table of shapes, without entries that were not measured."""
    for (node, direction), mode, value, where in entries:
        if np.isnan(value):
            continue
        cells = {"mode": mode, "node": node, "direction": direction, "re": repr(value.real), "im": repr(value.imag)}
        yield MappedRow(path, 0, cells, where=f"{what}, {where}")


def _end(path: Path, text: str) -> tuple[str, str]:
    """Node and direction of a sensor such as ``12z``, as texts."""
    found = parse_end(text.strip())
    if found is None:
        remedy = f"write it like 12z or 12-z; directions are {', '.join(DIRECTIONS)}"
        raise InputError(f"the sensor {text[:40]!r} is no node with a direction", place=path, remedy=remedy)
    (node, direction), sign = found
    return str(node), ("-" if sign < 0 else "") + direction


def _text(cell: Any) -> str:
    """Text of a cell as a table has it: whole numbers without a point, nothing for what is not there."""
    if cell is None or (isinstance(cell, float) and np.isnan(cell)):
        return ""
    return str(int(cell)) if isinstance(cell, float) and cell.is_integer() and abs(cell) < 1e15 else str(cell).strip()
