"""Draw every figure whose tables lie in a folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.errors import InputError
from calib.report.calibration import draw_convergence, draw_parameters
from calib.report.comparison import comparison_figure, draw_comac, draw_mac_matrix
from calib.report.sensitivity import MEASURES, draw_input_correlation, draw_selection, draw_sensitivity
from calib.report.shapes import mode_shapes_figure
from calib.report.style import add_heading, save, style

_ENDS = ("x1", "y1", "z1", "x2", "y2", "z2", "u1", "v1", "w1", "u2", "v2", "w2")
_STAGES = ("before", "after")


def draw_all(folder: Path, title: str, synthetic: bool) -> list[Path]:
    """Draw every figure whose tables exist in a folder, beside the tables; nothing is computed anew.

    Parameters
    ----------
    folder : Path
        Holds the CSV tables, and perhaps ``summary.json`` with a key ``best_case``.
    title : str
        Begins the heading of every figure.
    synthetic : bool
        Whether the measurement is invented, which every figure then says.

    Returns
    -------
    list of Path
        The PNG files written, in a fixed order.

    Raises
    ------
    InputError
        The folder is missing, or a table is damaged; nothing is drawn then.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("there is no such folder of results", place=folder)
    with style():
        written = []
        for name, caption, draw in _plan(folder):
            figure = draw()
            add_heading(figure, f"{title}: {caption}" if title else caption, synthetic)
            written.append(save(figure, folder / f"{name}.png"))
    return written


def read_table(
    path: Path,
    text: Sequence[str],
    numbers: Sequence[str] = (),
    *,
    complete: Sequence[str] = (),
    unbounded: Sequence[str] = (),
    flags: Sequence[str] = (),
    if_there: Sequence[str] = (),
    others_are_numbers: bool = False,
    unique: str | None = None,
) -> pd.DataFrame:
    """Read a CSV table and check the columns that a figure needs; other columns are left out.

    Parameters
    ----------
    path : Path
    text, numbers, flags : sequence of str
        Columns of words, of numbers (empty or nan where unknown) and of ``True``/``False`` (empty where unknown).
    complete : sequence of str
        Those of `numbers` that must not be unknown.
    unbounded : sequence of str
        Those of `numbers` that may be infinite.
    if_there : sequence of str
        Further columns of numbers that a table may have.
    others_are_numbers : bool
        Whether every other column is kept and holds numbers.
    unique : str, optional
        Column in which no value may occur twice.

    Raises
    ------
    InputError
        Naming the file, the column and the line.
    """
    try:
        raw = pd.read_csv(path, dtype=str, keep_default_na=False, skipinitialspace=True)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as problem:
        raise InputError(f"the table cannot be read: {' '.join(str(problem).split())}", place=path) from problem
    wanted = [*text, *numbers, *flags]
    for column in wanted:
        if column not in raw.columns:
            raise InputError(f"column {column!r} is missing", place=path, remedy="run the study again to write it anew")
    if raw.empty:
        raise InputError("the table has no rows", place=path, remedy="run the study again to write it anew")
    wanted += [column for column in if_there if column in raw.columns]
    others = [c for c in raw.columns if c not in wanted] if others_are_numbers else []
    if others_are_numbers and not others:
        raise InputError(f"there is no column beside {', '.join(text)}", place=path)
    out: dict[str, pd.Series] = {}
    for column in [*wanted, *others]:
        cells = raw[column].fillna("").str.strip()
        if column in text:
            _reject(cells == "", cells, column, path, "a name")
            out[column] = cells
        elif column in flags:
            known = cells.str.lower().map({"true": True, "false": False, "": None, "nan": None})
            _reject(known.isna() & ~cells.str.lower().isin(["", "nan"]), cells, column, path, "True or False")
            out[column] = known.astype(object)
        else:
            values = pd.to_numeric(cells, errors="coerce").astype(float)
            unknown = cells.str.lower().isin(["", "nan"])
            bad = (values.isna() & ~unknown) | (np.isinf(values) & (column not in unbounded))
            _reject(bad | (unknown & (column in complete)), cells, column, path, "a number")
            out[column] = values
    if unique is not None and raw[unique].duplicated().any():
        row = int(raw[unique].duplicated().to_numpy().argmax())
        raise InputError(f"column {unique!r} holds {raw[unique].iloc[row]!r} twice", place=f"{path}, line {row + 2}")
    return pd.DataFrame(out)


def _reject(bad: pd.Series, cells: pd.Series, column: str, path: Path, expected: str) -> None:
    if bad.any():
        row = int(bad.to_numpy().argmax())
        raise InputError(
            f"column {column!r} holds {cells.iloc[row]!r}, which is not {expected}", place=f"{path}, line {row + 2}"
        )


def _plan(folder: Path) -> list[tuple[str, str, Callable[[], Figure]]]:
    """Name, caption and drawing of every figure; all tables are read here, before anything is drawn."""
    plan: list[tuple[str, str, Callable[[], Figure]]] = []

    def add(name: str, caption: str, draw: Callable[[], Figure]) -> None:
        plan.append((name, caption, draw))

    compared = {stage: _comparison(folder / f"comparison_{stage}.csv") for stage in _STAGES}
    before, after = compared["before"], compared["after"]
    if before is not None or after is not None:
        add("comparison", "model against measurement", lambda: comparison_figure(before, after))
    for stage in _STAGES:
        path = folder / f"mac_{stage}.csv"
        if path.exists():
            mac = read_table(path, ["mode"], others_are_numbers=True, unique="mode")
            add(path.stem, f"MAC {stage} calibration", lambda mac=mac: _owner(draw_mac_matrix(mac)))  # type: ignore[misc]
    sensors = {stage: _comac(folder / f"comac_{stage}.csv") for stage in _STAGES}
    if any(table is not None for table in sensors.values()):
        add("comac", "CoMAC of the sensors", lambda: _owner(draw_comac(sensors["before"], sensors["after"])))
    for stage in _STAGES:
        shapes, deflection = folder / f"shapes_{stage}.csv", folder / f"deflection_{stage}.csv"
        if shapes.exists() and deflection.exists():
            points = read_table(shapes, ["mode", "direction"], ["x", "y", "z", "measured_re"])
            lines = read_table(deflection, ["mode"], _ENDS, complete=_ENDS)
            facts = compared[stage]
            add(
                f"mode_shapes_{stage}",
                f"mode shapes {stage} calibration, measured/model",
                lambda points=points, lines=lines, facts=facts: mode_shapes_figure(points, lines, facts),  # type: ignore[misc]
            )
    path = folder / "sensitivity.csv"
    if path.exists():
        rank = read_table(path, ["parameter"], others_are_numbers=True, unique="parameter")
        add("sensitivity", "sensitivity of the responses", lambda: _owner(draw_sensitivity(rank)))
    path = folder / "partial.csv"
    if path.exists():
        held = read_table(path, ["parameter"], others_are_numbers=True, unique="parameter")
        label = "partial rank correlation (–)"
        add("partial", "sensitivity, all other parameters held", lambda: _owner(draw_sensitivity(held, label=label)))
    path = folder / "influence.csv"
    if path.exists():
        own = read_table(path, ["parameter"], others_are_numbers=True, unique="parameter")
        share = "root of the share of variance (–)"
        add("influence", "influence of each parameter alone", lambda: _owner(draw_sensitivity(own, None, 0.1, share)))
    path = folder / "input_correlation.csv"
    if path.exists():
        inputs = _square(path)
        if len(inputs) > 1:
            add("input_correlation", "what constraints tie together", lambda: _owner(draw_input_correlation(inputs)))
    path = folder / "selection.csv"
    if path.exists():
        numbers = [name for measure in MEASURES for name in (f"max_{measure}", f"{measure}_floor")]
        flags = ["measured", "selected"]
        chosen = read_table(path, ["parameter"], numbers, flags=flags, unique="parameter")
        add("selection", "which parameters matter", lambda: _owner(draw_selection(chosen)))
    path = folder / "parameters.csv"
    if path.exists():
        found = read_table(
            path,
            ["case", "parameter", "unit"],
            ["value", "ratio", "spread"],
            complete=["ratio"],
            flags=["on_bound", "stable"],
            if_there=["lower", "upper", "std", "search_value"],
        )
        best = _best_case(folder / "summary.json", list(dict.fromkeys(found["case"])))
        add("parameters", "parameters found", lambda: _owner(draw_parameters(found, best_case=best)))
    path = folder / "convergence.csv"
    if path.exists():
        misfit = ["best", "mean"]
        runs = read_table(path, ["case"], ["generation", *misfit], complete=["generation"], unbounded=misfit)
        add("convergence", "convergence of the search", lambda: _owner(draw_convergence(runs)))
    return plan


def _comparison(path: Path) -> pd.DataFrame | None:
    if not path.exists() or _of_plain_responses(path):
        return None
    numbers = ["natural_freq_measured", "natural_freq_model", "freq_error", "mac"]
    return read_table(path, ["mode"], numbers, complete=["natural_freq_measured"], unique="mode")


def _square(path: Path) -> pd.DataFrame:
    table = read_table(path, ["parameter"], others_are_numbers=True, unique="parameter")
    if table["parameter"].tolist() != [c for c in table.columns if c != "parameter"]:
        raise InputError(
            "rows and columns do not name the same parameters",
            place=path,
            remedy="run the study again to write it anew",
        )
    return table


def _of_plain_responses(path: Path) -> bool:
    """Whether a comparison is of plain responses, which have no modes to draw."""
    try:
        with path.open(encoding="utf-8") as stream:
            return stream.readline().startswith("response,")
    except (OSError, UnicodeDecodeError):
        return False  # whoever reads it whole tells what is wrong


def _comac(path: Path) -> pd.DataFrame | None:
    return read_table(path, ["sensor"], ["comac"], unique="sensor") if path.exists() else None


def _best_case(path: Path, cases: list[str]) -> str | None:
    if not path.exists():
        return None
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        raise InputError(f"the summary cannot be read: {problem}", place=path) from problem
    best = summary.get("best_case") if isinstance(summary, dict) else None
    if best is not None and str(best) not in cases:
        raise InputError(f"best_case {best!r} is not a case of parameters.csv ({', '.join(cases)})", place=path)
    return None if best is None else str(best)


def _owner(ax: Axes) -> Figure:
    figure = ax.get_figure(root=True)
    assert figure is not None  # these Axes have just been made in one
    return figure
