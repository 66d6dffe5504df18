"""Modes, shapes and sensor places from CSV tables, read strictly: mistakes are refused by line and column."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.measurement.modal import DIRECTIONS
from calib.measurement.repeats import Repeat, ShapeSet

FREQ_LIMIT = 1e12
"""Hz; a larger frequency is damage, not a vibration."""
VALUE_LIMIT = 1e100
"""Modulus; larger shape entries are damage and would overflow when squared."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_INTEGER = re.compile(r"\d{1,10}", re.ASCII)


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes
    ----------
    path : Path
    line : int
        Counted from 1.
    cells : mapping from column to text
        Stripped; columns that the file does not have are absent.
    """

    path: Path
    line: int
    cells: Mapping[str, str]

    def error(self, column: str, problem: str, remedy: str | None = None) -> InputError:
        """An InputError that names file, line and column."""
        return InputError(problem, place=f"{self.path}, line {self.line}, column {column}", remedy=remedy)

    def text(self, column: str) -> str:
        """Text that must not be empty."""
        if not self.cells[column]:
            raise self.error(column, "it is empty", "give a value")
        return self.cells[column]

    def number(self, column: str) -> float:
        """A finite number that must be there."""
        text = self.text(column)
        if not _NUMBER.fullmatch(text):
            raise self.error(column, f"{text!r} is not a number", "write it like 12.5 or 1.25e1")
        value = float(text)
        if not math.isfinite(value):
            raise self.error(column, f"{text!r} is not finite", "correct it")
        return value

    def optional(self, column: str) -> float:
        """A finite number, or NaN when the column or the entry is empty."""
        return self.number(column) if self.cells.get(column) else math.nan

    def node(self) -> int:
        """The node label, a whole number from 0."""
        text = self.text("node")
        if not _INTEGER.fullmatch(text):
            raise self.error("node", f"{text!r} is not a node label", "write a whole number of at most 10 digits")
        return int(text)


def read_table(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> list[Row]:
    """Rows of a comma-separated table with a header line; lines that start with # and blank lines are skipped.

    Raises InputError for a file that cannot be read, is no UTF-8 text, has a wrong column, or holds no row.
    """
    try:
        data = path.read_bytes()
    except OSError as err:
        raise InputError(f"it cannot be read ({err.strerror})", place=path, remedy="check the path") from None
    header: list[str] | None = None
    rows = []
    for number, raw in enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines(), start=1):
        cells = _cells(path, number, raw)
        if cells is None:
            continue
        if header is None:
            header = cells
            _check_header(path, number, header, required, optional)
            continue
        if len(cells) != len(header):
            raise InputError(
                f"it has {len(cells)} entries, but the header has {len(header)} columns",
                place=f"{path}, line {number}, column {header[min(len(cells), len(header) - 1)]}",
                remedy="give every line one entry a column",
            )
        rows.append(Row(path, number, dict(zip(header, cells, strict=True))))
    if header is None:
        raise InputError("it is empty", place=path, remedy=f"start it with the header {', '.join(required)}")
    if not rows:
        raise InputError("it holds a header but no rows", place=path, remedy="add one line a mode, sensor or node")
    return rows


def _cells(path: Path, number: int, raw: bytes) -> list[str] | None:
    """Stripped entries of one line; None for a comment or blank line."""
    place = f"{path}, line {number}"
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as err:
        raise InputError(
            f"byte {err.start + 1} is not UTF-8 text", place=place, remedy="save the table as UTF-8 CSV"
        ) from None
    bad = next((k for k, c in enumerate(text) if not c.isprintable() and c != "\t"), None)
    if bad is not None:
        raise InputError(
            f"character {bad + 1} is not printable: this is no text", place=place, remedy="save the table as UTF-8 CSV"
        )
    if not text.strip() or text.lstrip().startswith("#"):
        return None
    try:
        # one line at a time, so that a forgotten quote cannot swallow the lines after it
        return [cell.strip() for cell in next(csv.reader([text], strict=True, skipinitialspace=True))]
    except csv.Error as err:
        raise InputError(f"it is no comma-separated line ({err})", place=place, remedy="check its quotes") from None


def _check_header(path: Path, line: int, header: list[str], required: Sequence[str], optional: Sequence[str]) -> None:
    allowed = (*required, *optional)
    for name in header:
        if name not in allowed:
            raise InputError(
                f"unknown column {name[:60]!r}",
                place=f"{path}, line {line}, column {header.index(name) + 1}",
                remedy=f"the columns are {', '.join(allowed)}, separated by commas",
            )
        if header.count(name) > 1:
            raise InputError(f"column {name!r} appears twice", place=f"{path}, line {line}", remedy="remove one")
    for name in required:
        if name not in header:
            raise InputError(f"column {name!r} is missing", place=f"{path}, line {line}", remedy="add it")


def read_modes_csv(path: Path) -> Repeat:
    """Frequencies and damping from a table ``mode, freq, freq_kind, freq_std, damping, damping_std``.

    Frequencies and their deviations in Hz, damping as a ratio; the last three columns may be absent or empty. A damped
    frequency is turned into the natural one, ``natural = damped / sqrt(1 - damping**2)``, and so is its deviation;
    where the damping is unknown the two are taken as equal.

    Raises
    ------
    InputError
        With file, line and column, for anything that is no such table.
    """
    names: list[str] = []
    values = []
    for row in read_table(path, ("mode", "freq", "freq_kind"), ("freq_std", "damping", "damping_std")):
        name = row.text("mode")
        if name in names:
            raise row.error("mode", f"mode {name!r} appears twice", "give every mode one line")
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
        deviations = []
        for column in ("freq_std", "damping_std"):
            std = row.optional(column)
            if not (math.isnan(std) or 0 < std < FREQ_LIMIT):
                raise row.error(
                    column, f"standard deviation {std:g} is not positive", "give a positive one, or leave it empty"
                )
            deviations.append(std)
        factor = 1.0
        if kind == "damped" and not math.isnan(damping):
            factor = 1.0 / math.sqrt(1.0 - damping**2)
        names.append(name)
        values.append((freq * factor, deviations[0] * factor, damping, deviations[1]))
    table = np.array(values)
    freqs, freq_stds, dampings, damping_stds = table.T.copy()
    return Repeat(str(path), tuple(names), True, freqs, freq_stds, dampings, damping_stds)


def parse_direction(text: str) -> tuple[str, int] | None:
    """Direction name and sign from ``y``, ``-y``, ``rz`` or a universal-file code such as ``2`` or ``-6``.

    Returns None when the text is no direction.
    """
    sign = -1 if text.startswith("-") else 1
    bare = text[1:] if text[:1] in ("-", "+") else text
    if bare in ("1", "2", "3", "4", "5", "6"):
        return DIRECTIONS[int(bare) - 1], sign
    return (bare.lower(), sign) if bare.lower() in DIRECTIONS else None


def read_shapes_csv(path: Path, names: Sequence[str]) -> ShapeSet:
    """Shapes from a table ``mode, node, direction, re, im, std``, columns in the order of ``names``.

    ``im`` (zero) and ``std`` (unknown) may be absent or empty; a negative direction turns the sign of the shape; a
    sensor without a line for a mode was not measured in it (NaN).

    Raises
    ------
    InputError
        With file, line and column, for anything that is no such table, unknown modes, and sensors given twice.
    """
    column = {name: k for k, name in enumerate(names)}
    where: dict[tuple[int, str], int] = {}
    entries: dict[tuple[int, int], tuple[complex, float]] = {}
    for row in read_table(path, ("mode", "node", "direction", "re"), ("im", "std")):
        mode, node = row.text("mode"), row.node()
        if mode not in column:
            raise row.error("mode", f"unknown mode {mode!r}", f"the modes are {', '.join(names)}")
        parsed = parse_direction(row.text("direction"))
        if parsed is None:
            raise row.error(
                "direction",
                f"{row.text('direction')!r} is no direction",
                f"write {', '.join(DIRECTIONS)} or a code 1 to 6, with a minus sign if turned round",
            )
        direction, sign = parsed
        key = (where.setdefault((node, direction), len(where)), column[mode])
        if key in entries:
            raise row.error(
                "direction", f"sensor {node}{direction} is given twice for mode {mode}", "remove one of the lines"
            )
        im = row.optional("im")
        value = sign * complex(row.number("re"), 0.0 if math.isnan(im) else im)
        if max(abs(value.real), abs(value.imag)) > VALUE_LIMIT:
            raise row.error("re", f"a shape entry above {VALUE_LIMIT:g} is not plausible", "correct it")
        std = row.optional("std")
        if not (math.isnan(std) or 0 <= std <= VALUE_LIMIT):
            raise row.error("std", f"standard deviation {std:g} is negative or too large", "correct or empty it")
        entries[key] = (value, std)
    shapes = np.full((len(where), len(names)), complex(np.nan, np.nan))
    std_table = np.full(shapes.shape, np.nan)
    for key, (value, std) in entries.items():
        shapes[key], std_table[key] = value, std
    for name, k in column.items():
        given = shapes[np.isfinite(shapes[:, k]), k]
        if given.size and np.max(np.abs(given)) < 1 / VALUE_LIMIT:
            raise InputError(f"the shape of mode {name!r} is zero everywhere", place=path, remedy="leave its lines out")
    return ShapeSet(str(path), tuple(where), shapes, std_table)


def read_sensor_table(path: Path) -> dict[int, tuple[tuple[float, float, float], str | None]]:
    """Places of nodes from a table ``node, x, y, z, on``, in metres; ``on`` (the part that carries it) is optional.

    Returns
    -------
    dict
        ``{node: ((x, y, z), on)}``.

    Raises
    ------
    InputError
        With file, line and column, for anything that is no such table, and nodes given twice.
    """
    places: dict[int, tuple[tuple[float, float, float], str | None]] = {}
    for row in read_table(path, ("node", "x", "y", "z"), ("on",)):
        node = row.node()
        if node in places:
            raise row.error("node", f"node {node} is given twice", "remove one of the lines")
        places[node] = ((row.number("x"), row.number("y"), row.number("z")), row.cells.get("on") or None)
    return places
