"""Frequency response functions from columns of numbers: wide tables, workbooks, text files, MATLAB variables."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.files.csv_format import END, FREQ_LIMIT, NO_MOTION, VALUE_LIMIT, parse_end, titled
from calib.measurement.frf import NO_PHASE
from calib.measurement.frf_repeats import Key, few, function_name, off_axis
from calib.measurement.modal import DIRECTIONS
from calib.measurement.places import Doubt

_CHANNEL = re.compile(rf"{END}\s*/\s*{END}", re.ASCII)
_FOREIGN = re.compile(rf"(?<![a-z])({NO_MOTION})", re.ASCII | re.IGNORECASE)
_PARTS: Mapping[str, str] = {
    "re": "re", "real": "re", "im": "im", "imag": "im", "imaginary": "im", "mag": "magnitude", "magnitude": "magnitude",
    "amplitude": "magnitude", "amp": "magnitude", "abs": "magnitude", "modulus": "magnitude", "phase": "phase",
    "coherence": "coherence", "coh": "coherence",
}  # fmt: skip
"""What a word in the name of a column says that it holds."""
_SEPARATORS = (";", "\t", ",", None)
_COMMENT = ("#", "%", "!")
VARIABLES = frozenset({"freq", "frf", "coherence"})
"""What variables of a MATLAB file of FRFs hold."""
WORKBOOKS = (".xlsx", ".xlsm")
MATLAB = (".mat",)


def channel_of(text: str, place: str | Path | Place) -> tuple[Key, int]:
    """Response and reference of a channel such as ``12z/3z`` or ``12-z/3z``, and the sign of their directions."""
    ends = [parse_end(part.strip()) for part in text.split("/")]
    if len(ends) != 2 or ends[0] is None or ends[1] is None:
        raise InputError(
            f"the channel {text[:40]!r} is no response over a reference", place=place,
            remedy=f"write it like 12z/3z or 12-z/3z; directions are {', '.join(DIRECTIONS)}",
        )  # fmt: skip
    (response, one), (reference, other) = ends[0], ends[1]
    return (response, reference), one * other


def is_wide(names: Sequence[str]) -> bool:
    """Whether the columns of a table are those of functions side by side: ``freq, 2z/1z re, 2z/1z im, ...``."""
    return "response" not in names and any(_CHANNEL.search(name) for name in names)


def unit_of_columns(names: Sequence[str], place: str | Path) -> str | None:
    """The unit behind the names of columns, such as ``2z/1z re (g/N)``; None where none stands there.

    InputError where columns differ, which a phase in degrees or a magnitude in dB does not.
    """
    units = [unit for unit in (titled(name)[1] for name in names) if "/" in unit and not unit.lower().startswith("db")]
    if other := next((unit for unit in units if unit != units[0]), None):
        words = f"its columns are in {units[0]!r:.40} and {other!r:.40}"
        raise InputError(words, place=place, remedy="convert them to one unit")
    return units[0] if units else None


def read_columns(
    path: Path, channels: Sequence[str] = (), sheet: str | None = None
) -> tuple[np.ndarray, dict[Key, np.ndarray], dict[Key, np.ndarray], str | None, tuple[Doubt, ...]]:
    """Frequencies, functions and coherences from a table with the functions side by side.

    The first column holds the frequencies in Hz. Each function has two more, real and imaginary part, or magnitude and
    phase, and may have its coherence. A column is named by channel and part, such as ``2z/1z re`` or
    ``2z/1z phase (deg)``, ``Point2:+Z/Point1:+Z Mag (g/N)``; phases are in degrees unless the name says rad, magnitudes
    may be in dB where it says so.
    Columns of a channel that measures no motion, such as ``Mic 2z/1z re``, are left out and noted.
    With ``channels`` the names need tell the part alone, and without any names the parts are real and imaginary.

    Returns
    -------
    freq : ndarray (n_freq,)
    functions : dict from Key to ndarray (n_freq,), complex
        In the unit of the file; NaN where an entry is empty or ``nan``.
    coherence : dict from Key to ndarray (n_freq,)
    unit : str or None
        Behind the names of the columns.
    notes : tuple of Doubt

    Raises
    ------
    InputError
        With file and line, for what is no such table.
    """
    names, table = sheet_of(path, sheet) if path.suffix.lower() in WORKBOOKS else numbers_of(path)
    columns = names or ["freq", *["re", "im"] * ((table.shape[1] - 1) // 2)]
    if len(columns) != table.shape[1]:
        words = f"it has {table.shape[1]} columns of numbers, but names {len(columns)}"
        raise InputError(words, place=path, remedy="name every column")
    freq = table[:, 0]
    if (unit := titled(columns[0])[1]) not in ("", "Hz"):
        raise InputError(f"its frequencies are in {unit!r:.40}", place=path, remedy="give them in Hz")
    if not np.all(np.isfinite(freq)) or freq.min() < 0 or freq.max() >= FREQ_LIMIT:
        raise InputError("a frequency in its first column is none", place=path, remedy="give it in Hz")
    foreign = [name for name in columns[1:] if not channels and _is_foreign(name)]
    if foreign and len(foreign) == len(columns) - 1:
        words = f"its columns, such as {foreign[0]!r:.60}, are of no motion"
        raise InputError(words, place=path, remedy="give functions of accelerations, velocities or displacements")
    own_columns = [k for k, name in enumerate(columns) if name not in foreign]
    columns, table = [columns[k] for k in own_columns], table[:, own_columns]
    parts: dict[tuple[Key, int], dict[str, np.ndarray]] = {}
    given, order = [channel_of(one, path) for one in channels], -1
    seen: set[str] = set()
    for name, column in zip(columns[1:], table[:, 1:].T, strict=True):
        part, values = _part(path, name, column)
        if given:
            if order < 0 or part in seen or (part in ("re", "magnitude") and seen):
                order, seen = order + 1, set()
            seen.add(part)
            if order >= len(given):
                words = f"it has more functions than the {len(given)} channels"
                raise InputError(words, place=path, remedy="name every function, in the order of the columns")
            key = given[order]
        else:
            match = _CHANNEL.search(name)
            key = channel_of(match.group(0) if match else name, path)
        own = parts.setdefault(key, {})
        if part in own:
            raise InputError(f"{function_name(key[0])} has two columns of its {part}", place=path, remedy="keep one")
        own[part] = values
    if given and len(parts) != len(given):
        raise InputError(f"it has {len(parts)} functions for {len(given)} channels", place=path, remedy="name as many")
    rows = np.argsort(freq, kind="stable")
    if np.any(np.diff(freq[rows]) <= 0):
        raise InputError("a frequency is there twice", place=path, remedy="keep one of the lines")
    functions = {key: sign * _complex(path, key, own)[rows] for (key, sign), own in parts.items()}
    if len(functions) < len(parts):
        twice = next(key for key in functions if {(key, 1), (key, -1)} <= set(parts))
        words = f"{function_name(twice)} is there along and against an axis"
        raise InputError(words, place=path, remedy="keep one")
    coherence = {key: own["coherence"][rows] for (key, _), own in parts.items() if "coherence" in own}
    notes = (Doubt(f"{path}: left out, since it measures no motion: {few(foreign)}"),) if foreign else ()
    return freq[rows], functions, coherence, unit_of_columns(columns[1:], path), notes


def _is_foreign(column: str) -> bool:
    """Whether what stands before the channel names something else than a motion."""
    match = _CHANNEL.search(column)
    return match is not None and _FOREIGN.search(column[: match.start()]) is not None


def read_function_files(
    paths: Sequence[Path], channels: Sequence[str]
) -> tuple[np.ndarray, dict[Key, np.ndarray], dict[Key, np.ndarray], str | None]:
    """The same from text files that hold one function each, in the order of the channels; see `read_columns`."""
    axis: np.ndarray | None = None
    functions: dict[Key, np.ndarray] = {}
    coherence: dict[Key, np.ndarray] = {}
    units: dict[str | None, Path] = {}
    for path, channel in zip(paths, channels, strict=True):
        freq, own, gamma, unit, _ = read_columns(path, [channel])
        units.setdefault(unit, path)
        axis = freq if axis is None else axis
        if off_axis(freq, axis).any():
            words = f"its frequencies are not those of {paths[0]}"
            raise InputError(words, place=path, remedy="export all on common frequencies")
        if twice := set(own) & set(functions):
            raise InputError(f"the channel {function_name(twice.pop())} is named twice", place=path)
        functions |= own
        coherence |= gamma
    assert axis is not None
    if len(units) > 1:
        words = f"its unit is not that of {paths[0]}"
        raise InputError(words, place=list(units.values())[1], remedy="convert them to one unit")
    return axis, functions, coherence, next(iter(units))


def numbers_of(path: Path) -> tuple[list[str], np.ndarray]:
    """Names of the columns (none where the file has none) and numbers, (n_rows, n_columns), of a text file.

    Lines that begin with ``#``, ``%`` or ``!`` are skipped. Entries are separated by semicolons, tabs, commas or
    blanks; the line before the first one of numbers names the columns.
    """
    try:
        text = path.read_bytes()
    except OSError as err:
        raise InputError(f"it cannot be read ({err.strerror})", place=path, remedy="check the path") from None
    try:
        lines = text.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        lines = text.decode("latin-1").splitlines()
    kept = [
        (k, line) for k, line in enumerate(lines, start=1) if line.strip() and not line.lstrip().startswith(_COMMENT)
    ]
    separator, first = None, None
    for at, (_, line) in enumerate(kept):
        separator = next((c for c in _SEPARATORS if c is None or c in line), None)
        if len(cells := line.split(separator)) > 1 and all(_number(cell, separator) is not None for cell in cells):
            first = at
            break
    if first is None:
        raise InputError("it holds no line of numbers", place=path, remedy="give one line for each frequency")
    names = [cell.strip().strip('"') for cell in kept[first - 1][1].split(separator)] if first else []
    body = [line for _, line in kept[first:]]
    try:
        table = np.loadtxt(body, delimiter=separator, ndmin=2)
    except ValueError:  # an empty entry or a decimal comma, or the place of a fault
        table = _by_cell(path, kept[first:], separator)
    if first and len(names) != table.shape[1] and len(words := kept[first - 1][1].split()) == table.shape[1]:
        names = words  # a header in blanks above other separators
    return names, table


def arrays_of(
    path: Path, variables: Mapping[str, str], channels: Sequence[str]
) -> tuple[np.ndarray, dict[Key, np.ndarray], dict[Key, np.ndarray]]:
    """Frequencies, functions and coherences from variables of a MATLAB file; see `read_columns`.

    Parameters
    ----------
    path : Path
        Of version 5, or 7.3 where h5py is installed.
    variables : mapping from ``freq`` (Hz), ``frf`` (complex) and perhaps ``coherence`` to names of variables
        One axis of the functions is that of the frequencies; the others are taken as stored, the last one inmost.
    channels : sequence of str
        In that order.

    Raises
    ------
    InputError
        For a file without such variables, and sizes that do not fit.
    """
    remedy = "name the variables: variables = { freq = 'f', frf = 'H' }"
    if not VARIABLES - {"coherence"} <= set(variables) <= VARIABLES:
        raise InputError("its frequencies and functions are not named", place=path, remedy=remedy)
    from calib.measurement.files.matlab import matlab_variables  # few files are of MATLAB

    held = matlab_variables(path, tuple(variables.values()), remedy)
    freq = np.real(np.ravel(held[variables["freq"]])).astype(float)
    real = not np.iscomplexobj(held[variables["freq"]])
    if not real or len(freq) < 2 or not np.all(np.diff(freq) > 0) or freq[0] < 0 or not np.isfinite(freq[-1]):
        raise InputError(f"its frequencies {variables['freq']!r} do not ascend", place=path, remedy="give them in Hz")
    keys = [channel_of(one, path) for one in channels]
    out: dict[str, dict[Key, np.ndarray]] = {"frf": {}, "coherence": {}}
    for kind in out:
        if kind not in variables:
            continue
        whole = np.squeeze(held[variables[kind]])
        axes = [k for k, size in enumerate(whole.shape) if size == len(freq)]
        count = whole.size // len(freq)
        if len(axes) != 1 or count != len(keys):
            words = (
                f"{variables[kind]!r} has the shape {whole.shape}, for {len(freq)} frequencies and {len(keys)} channels"
            )
            raise InputError(
                words, place=path, remedy="name every channel; only one axis may be that of the frequencies"
            )
        flat = np.moveaxis(whole, axes[0], 0).reshape(len(freq), -1)
        if kind == "frf" and not np.iscomplexobj(flat):
            raise InputError(f"{variables[kind]!r} is real", place=path, remedy=NO_PHASE)
        for (key, sign), column in zip(keys, flat.T, strict=True):
            out[kind][key] = (
                sign * np.asarray(column, dtype=complex) if kind == "frf" else np.asarray(column, dtype=float)
            )
    if len(out["frf"]) < len(keys):
        raise InputError("a channel is named twice", place=path, remedy="name each once")
    return freq, out["frf"], out["coherence"]


def sheet_of(path: Path, sheet: str | None = None) -> tuple[list[str], np.ndarray]:
    """Names of the columns and numbers of a sheet of a workbook (the first one by default); see `numbers_of`."""
    rows = rows_of(path, sheet)
    at = next((k for k, row in enumerate(rows) if isinstance(row[0], int | float)), None)
    if at is None:
        raise InputError("it holds no line of numbers", place=path, remedy="begin each with its frequency in Hz")
    width = max(k + 1 for row in rows[at:] for k, cell in enumerate(row) if cell is not None)
    names = ["" if cell is None else str(cell).strip() for cell in rows[at - 1][:width]] if at else []
    table = np.full((len(rows) - at, width), np.nan)
    for k, row in enumerate(rows[at:]):
        for n, cell in enumerate(row[:width]):
            if cell is not None and not isinstance(cell, int | float):
                words = f"row {k + 1} of its numbers holds {str(cell)[:40]!r}"
                raise InputError(words, place=path, remedy="give a number, or leave the cell empty")
            table[k, n] = np.nan if cell is None else cell
    return names, table


def rows_of(path: Path, sheet: str | None = None) -> list[list[Any]]:
    """Rows of cells of a sheet of a workbook (the first one by default), without those that are empty."""
    try:
        from openpyxl import load_workbook
    except ImportError:
        remedy = "pip install 'calib[files]', or save the sheet as CSV"
        raise InputError("openpyxl, which reads workbooks, is not installed", place=path, remedy=remedy) from None
    rows: list[list[Any]] | None = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            book = load_workbook(path, read_only=True, data_only=True)
            sheets = list(book.sheetnames)
            if sheet is None or sheet in sheets:
                page = book[sheet] if sheet is not None else book.worksheets[0]
                read = (list(row) for row in page.iter_rows(values_only=True))
                rows = [row for row in read if any(cell is not None for cell in row)]
            book.close()
    except Exception as fault:  # a damaged archive raises what its parts raise, its sheets row by row
        raise InputError(f"it is no workbook ({type(fault).__name__})", place=path, remedy="save it again") from None
    if rows is None:
        raise InputError(f"it has no sheet {sheet!r:.40}", place=path, remedy=f"the sheets are {', '.join(sheets)}")
    return rows


def _by_cell(path: Path, lines: Sequence[tuple[int, str]], separator: str | None) -> np.ndarray:
    rows: list[list[float]] = []
    for number, line in lines:
        row = [_number(cell, separator) for cell in line.split(separator)]
        if None in row or (rows and len(row) != len(rows[0])):
            wrong = (
                "an entry that is no number" if None in row else f"{len(row)} entries, the first line {len(rows[0])}"
            )
            raise InputError(f"it has {wrong}", place=Place(str(path), number, line), remedy="correct it")
        rows.append([np.nan if value is None else value for value in row])
    return np.array(rows)


def _number(cell: str, separator: str | None) -> float | None:
    """Value of an entry, NaN for an empty one; None for words."""
    bare = cell.strip()
    try:
        return float(bare.replace(",", ".") if separator in (";", "\t") else bare) if bare else np.nan
    except ValueError:
        return None


@np.errstate(over="ignore")
def _part(path: Path, name: str, column: np.ndarray) -> tuple[str, np.ndarray]:
    """What a column holds, by its name, and its values with phases in rad and plain magnitudes."""
    match = _CHANNEL.search(name)
    rest = name[match.end() :] if match else name
    words = re.findall(r"[a-zA-Z]+", rest)
    bare = re.findall(r"[a-zA-Z]+", titled(rest)[0]) or words  # "Mag (dB re 1 m/N)" is no real part
    said = list(dict.fromkeys(_PARTS[word.lower()] for word in bare if word.lower() in _PARTS))
    if "phase" in said:
        said = ["phase"]
    if len(said) != 1:
        raise InputError(
            f"the name of its column {name!r:.60} does not say what it holds", place=path,
            remedy="name channel and part: 2z/1z re, 2z/1z im, or magnitude, phase; or coherence",
        )  # fmt: skip
    lower = [word.lower() for word in words]
    if said == ["phase"] and "rad" not in lower:
        return "phase", np.radians(column)
    if said == ["magnitude"] and "db" in lower:
        return "magnitude", 10 ** (column / 20)
    return said[0], column


@np.errstate(over="ignore", invalid="ignore")  # what is not finite is no value
def _complex(path: Path, key: Key, parts: Mapping[str, np.ndarray]) -> np.ndarray:
    if {"re", "im"} <= set(parts):
        values = parts["re"] + 1j * parts["im"]
        known = np.isfinite(values)
        if np.all(values[known].imag == 0) and np.all(values[known].real >= 0):
            words = f"{function_name(key)} is real and nowhere negative: amplitudes"
            raise InputError(words, place=path, remedy=NO_PHASE)
    elif {"magnitude", "phase"} <= set(parts):
        if np.nanmin(parts["magnitude"]) < 0:
            raise InputError(f"a magnitude of {function_name(key)} is negative", place=path, remedy="check its columns")
        values = parts["magnitude"] * np.exp(1j * parts["phase"])
    else:
        words = f"{function_name(key)} has the columns {', '.join(sorted(parts))} only"
        raise InputError(words, place=path, remedy=f"{NO_PHASE}: re and im, or magnitude and phase")
    if np.any(np.abs(values[np.isfinite(values)]) > VALUE_LIMIT):
        raise InputError(f"a value of {function_name(key)} is above {VALUE_LIMIT:g}", place=path, remedy="correct it")
    return np.where(np.isfinite(values), values, np.nan)
