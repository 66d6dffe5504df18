"""A table of runs as a model: metamodels predict its responses, and their errors count in every fit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from calib.errors.arguments import path as path_of
from calib.errors.errors import EvaluationError, InputError
from calib.errors.place import Place
from calib.measurement.files.csv_record import header_of
from calib.problem.parameter import SI_FACTORS, Parameter
from calib.problem.space import ParameterSpace
from calib.results.cell import number_of
from calib.results.fingerprint import digest_of
from calib.results.table import TableRow, read_rows
from calib.sensitivity.prognosis import Prognosis, prognosis
from calib.sensitivity.rules import PROGNOSIS
from calib.structure.function_model import FunctionModel
from calib.structure.model import Assumption

_EMPTY = "leave the cell of a failed run empty, or name the columns that are responses as 'outputs'"
_NUMBER_OF_RUN = re.compile(
    r"#|(design|run|sample|point|id|no|nr|number|index)s?[ _.-]*(id|no|nr|number|index)?\.?", re.I
)
"""Names of columns that number the runs, such as ``Design``, ``Run_No.`` or ``ID``."""


@dataclass(frozen=True, eq=False)
class Runs:
    """Metamodels of a table of runs, as the function of a model.

    Attributes
    ----------
    space : ParameterSpace
        The inputs, between the smallest and the largest value of the runs.
    prognosis : Prognosis
    points : DataFrame (n_runs, n_inputs)
        The inputs of the runs.
    values : DataFrame (n_runs, n_outputs)
        Their outputs; NaN where a run failed.
    units : mapping from str to str
        Of the outputs, as the second line of the table has them.
    """

    space: ParameterSpace
    prognosis: Prognosis
    points: pd.DataFrame
    values: pd.DataFrame
    units: Mapping[str, str] = field(default_factory=dict)

    def __call__(self, values: Mapping[str, float]) -> dict[str, float]:
        """Predicted responses; EvaluationError outside the runs, where metamodels do not hold."""
        x = np.array([[values[name] for name in self.space.free_names]])
        if not self.space.feasible(x).all():
            raise EvaluationError(outside(self.space, dict(zip(self.space.free_names, x[0].tolist(), strict=True))))
        return {one.response: float(one(x)[0]) for one in self.prognosis.models if one.kind != "none"}

    @property
    def errors(self) -> dict[str, float]:
        """Root mean square error of each metamodel, cross-validated, in the unit of the response."""
        return {one.response: one.error for one in self.prognosis.models if one.error > 0}


def outside(space: ParameterSpace, values: Mapping[str, float]) -> str:
    """Which value is outside the runs, in words; empty where none is."""
    for p in space.free:
        slack = 1e-9 * (p.upper - p.lower)
        if p.name in values and not p.lower - slack <= values[p.name] <= p.upper + slack:
            return f"{p.name} = {values[p.name]:g} is outside the runs, which go from {p.lower:g} to {p.upper:g}"
    return ""


def require_within_runs(model: FunctionModel, space: ParameterSpace, place: Place) -> None:
    """InputError where the limits of a study go beyond the runs of its table."""
    if not isinstance(runs := model.metamodels, Runs):
        return
    for p in space.free:
        for value in (p.lower, p.upper):
            if p.name in runs.space and (words := outside(runs.space, {p.name: value})):
                own = runs.space[p.name]
                remedy = (
                    f"narrow its limits to {own.lower:g} to {own.upper:g}, or add runs: metamodels do not extrapolate"
                )
                raise InputError(f"the limit {words}", place=place, remedy=remedy)


def read_runs(path: str | Path, inputs: Sequence[str], outputs: Sequence[str] = ()) -> FunctionModel:
    r"""Read a table of runs, one row a run or one a response, as a model whose responses metamodels predict.

    Parameters
    ----------
    path : str or Path
        CSV with one column for every input and output, or, one row for every run and response, with the columns
        ``response`` and ``value`` beside the inputs, and ``run`` where runs have the same inputs. A second line may
        hold the units. Empty cells of outputs are those of failed runs.
    inputs : sequence of str
        Columns that become parameters, free between their smallest and largest value, in the unit of the second line.
    outputs : sequence of str
        Columns, or entries of ``response``, that become responses; by default all others but those of words, such as
        the status of each run, and those that number the runs, such as ``Design``.

    Returns
    -------
    FunctionModel
        Its metamodels are chosen by `calib.sensitivity.prognosis.prognosis`; their errors, found by cross-validation,
        add to the standard deviation of every measured response. ``model.metamodels.prognosis.table`` tells each.

    Raises
    ------
    InputError
        With file, line and column: a missing column, text in a cell, an input that never changes, an unknown unit, or
        fewer than 3 runs for every input or than 20 in all.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> rows = [f"{k},{m},{(k / m) ** 0.5}" for k in range(10, 20) for m in range(1, 4)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = Path(folder, "runs.csv")
    ...     _ = table.write_text("\n".join(["k,m,w", "N/m,kg,rad/s", *rows]))
    ...     problem = calib.Problem.from_runs(table, ["k", "m"], calib.ResponseTest({"w": (2.5, 0.01)}))
    >>> round(problem.keep(["k"]).calibrate().values["k"], 1)  # m at 2 kg
    12.5
    """
    path = path_of(path, "table of runs")
    named = [inputs] if isinstance(inputs, str) else list(inputs)
    header, _ = header_of(path)
    is_long = {"response", "value"} <= {*header} - {*named, *outputs}
    found = ["response", "value"] if is_long else list(outputs or [name for name in header if name not in named])
    wanted = [*named, *found]
    rows = read_rows(path, [*wanted, *(name for name in header if name not in wanted)])
    units, numbers = _units(rows[0]) if rows else None, list[str]()
    rows = rows if units is None else rows[1:]
    if not outputs and not is_long:
        numbers = [name for name in found if _numbers_runs(rows, name)]
        found = [name for name in found if name not in numbers and not _is_text(rows, name)]
        wanted = [*named, *found]
    if not named or len(wanted) == len(named):
        raise InputError("it has no " + ("inputs" if not named else "outputs"), place=path,
                         remedy=f"name columns among {', '.join(header)}")  # fmt: skip
    points = pd.DataFrame([[row.number(name) for name in named] for row in rows], columns=named)
    if is_long:
        points, values = _by_run(rows, points, outputs)
        found = [str(name) for name in values]
    else:
        values = pd.DataFrame([[_output(row, name) for name in found] for row in rows], columns=found)
    known, least = (
        int(values.notna().any(axis=1).sum()),
        max(PROGNOSIS.rows_least, PROGNOSIS.runs_an_input * len(named)),
    )
    if known < least:
        words = f"{known} runs that did not fail are too few for {len(named)} inputs"
        raise InputError(words, place=path, remedy=f"add runs, {least} at least, or name fewer inputs")
    space = ParameterSpace(tuple(_parameter(path, name, points[name], (units or {}).get(name, "")) for name in named))
    of_outputs = {} if is_long or units is None else {name: units[name] for name in found if units[name]}
    runs = Runs(space, prognosis(space, points, values), points, values, of_outputs)
    # Which metamodels these are depends on what is installed: points that others predicted are not theirs.
    chosen = [(one.kind, one.inputs) for one in runs.prognosis.models]
    identity = digest_of("runs 1", named, found, points.to_numpy(), values.to_numpy(), PROGNOSIS, chosen)[:16]
    notes = (_error_of(path, runs), *(_numbering(path, name) for name in numbers))
    return FunctionModel(path.stem, space, runs, notes, (), identity, runs)


def _units(row: TableRow) -> dict[str, str] | None:
    """The units of a second line; None where the row has a number."""
    cells = row.cells
    if any(number_of(cell, row.comma) is not None for cell in cells.values()) or not any(cells.values()):
        return None
    return {name: cell.strip("[]() ") for name, cell in cells.items()}


def _is_text(rows: Sequence[TableRow], name: str) -> bool:
    """Whether a column has words and no number, such as the status of each run."""
    cells = [(row.cells[name], row.comma) for row in rows if row.cells[name]]
    return bool(cells) and all(number_of(cell, comma) is None for cell, comma in cells)


def _numbers_runs(rows: Sequence[TableRow], name: str) -> bool:
    """Whether a column numbers the runs: 0 or 1, 2, 3 in order, or, by its name, other integers that differ."""
    numbers = [number_of(row.cells[name], row.comma) for row in rows]
    known = [int(n) for n in numbers if n is not None and math.isfinite(n) and n == int(n)]
    if len(known) < len(rows) or not known:
        return False
    in_order = known[0] in (0, 1) and known == list(range(known[0], known[0] + len(known)))
    return in_order or (bool(_NUMBER_OF_RUN.fullmatch(name.strip())) and len(set(known)) == len(known))


def _numbering(path: Path, name: str) -> Assumption:
    reason = "it numbers the runs, so that it is no response; name it among 'outputs' if it is one"
    return Assumption(f"column {name} of {path.name}", "number of each run", "-", reason)


def _by_run(
    rows: Sequence[TableRow], points: pd.DataFrame, outputs: Sequence[str]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Inputs and responses of each run, from a row for each run and response."""
    first, found, given = dict[object, int](), dict[object, dict[str, float]](), list(map(tuple, points.to_numpy()))
    for k, row in enumerate(rows):
        run = row.cells.get("run") or given[k]
        begun = first.setdefault(run, k)
        for name, here, there in zip(points, given[k], given[begun], strict=True):
            if here != there:
                words = f"run {run} has {here:g} here and {there:g} in line {rows[begun].line}"
                raise row.error(str(name), words, "give every run one value of each input")
        responses = found.setdefault(run, {})
        if not (response := row.cells["response"]):
            continue  # a run that failed as a whole
        if response in responses:
            words = f"run {run} has {response} twice" if "run" in row.cells else f"these inputs have {response} twice"
            raise row.error("response", words, "name the runs in a column 'run', or leave one out")
        responses[response] = _output(row, "value")
    known = list(dict.fromkeys(name for one in found.values() for name in one))
    if missing := [name for name in outputs if name not in known]:
        words, remedy = f"it has no response {missing[0]!r}", f"the responses are {', '.join(known)}"
        raise InputError(words, place=rows[0].path, remedy=remedy)
    return points.iloc[list(first.values())].reset_index(drop=True), pd.DataFrame(
        list(found.values()), columns=list(outputs) or known, dtype=float
    )


def _output(row: TableRow, name: str) -> float:
    try:
        return row.optional(name)
    except InputError as fault:
        raise InputError(fault.problem, place=fault.place, remedy=_EMPTY) from None


def _parameter(path: Path, name: str, values: pd.Series[float], unit: str) -> Parameter:
    low, high = float(values.min()), float(values.max())
    place = f"{path.name}, column {name}"
    if not low < high:
        raise InputError(f"it is {low:g} in every run", place=place, remedy="leave it out of 'inputs'")
    if unit not in ("", *SI_FACTORS):
        known = ", ".join(SI_FACTORS)
        raise InputError(f"unknown unit {unit!r}", place=place, remedy=f"write one of {known}, or leave it empty")
    return Parameter(name, 0.5 * (low + high), low, high, unit or "-")


def _error_of(path: Path, runs: Runs) -> Assumption:
    """That errors of prediction count, with the worst."""
    worst = sorted((m for m in runs.prognosis.models if m.error > 0), key=lambda m: m.cop)[:3]
    words = ", ".join(f"{m.response} {m.error:.3g} (CoP {m.cop:.2f})" for m in worst) or "0"
    reason = (
        "cross-validated; added to the standard deviation of every measured response, the least predicted named here"
    )
    return Assumption(f"prediction error of the metamodels of {path.name}", words, "unit of each", reason)
