"""Designs of a study: every evaluated point of its searches and samples, ranked by the objective."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from calib.analyses.calibration_tables import RUNS
from calib.analyses.case import objective_of
from calib.analyses.joint_responses import Responses
from calib.analyses.sensitivity import runs_of
from calib.errors.errors import InputError
from calib.execution.outcome import point_key
from calib.inference.objective import Objective
from calib.problem.space import ParameterSpace
from calib.results.answer import Answer
from calib.results.cell import guarded_table
from calib.results.json_file import ANY, read_json
from calib.results.ledger import Ledger
from calib.results.results import NUMBER, Results
from calib.results.written import whole
from calib.study.several import AnyStudy

IMPORTED = "runs"
"""Case of a design that is a run of the table that is the model; its responses are those of the table."""
OTHER = "other"
"""Case of a design that no search requested: of a sample, or a point that another analysis asked for."""
HEAD = ("rank", "design", "case", "generation", "status", "objective", "mean_error", "mean_mac")


@dataclass(frozen=True, eq=False)
class Designs:
    """Evaluated points of a study as it is.

    Attributes
    ----------
    table : DataFrame (n_designs, ...)
        `HEAD`, then a column for every parameter, in its unit; the sum of every linear constraint; every response; and
        ``error <mode or response>``, the errors that the objective weighs (signed fractions). Ranked by the objective,
        failed points last. ``design`` is the number of the point in the ledger, and stays what it is.
    space : ParameterSpace
        Of the searches.
    infeasible : int
        Individuals of the searches that broke a constraint: they were not evaluated and are not in the table.
    """

    table: pd.DataFrame
    space: ParameterSpace
    infeasible: int = 0

    @property
    def feasible(self) -> Designs:
        """Those that could be evaluated."""
        return Designs(self.table[self.table["status"] == "ok"], self.space)

    @property
    def best_of_cases(self) -> pd.DataFrame:
        """The best design of each case and of the samples, by case."""
        good = self.table[self.table["status"] == "ok"].drop_duplicates("case")
        return good.sort_values("case", key=lambda case: case.where(case != OTHER, "\uffff"), kind="stable")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Responses that are compared with the measurement: targets of the objective, then MAC."""
        compared = [name.removeprefix("error ") for name in map(str, self.table) if name.startswith("error ")]
        shapes = [str(name) for name in self.table if str(name).rpartition(": ")[2].startswith("mac_")]
        return tuple(dict.fromkeys([*compared, *shapes]))

    def values(self, design: int) -> dict[str, float]:
        """The free parameters of a design; ``begin_at = "design NUMBER"`` begins least squares there.

        Raises
        ------
        InputError
            Where no design has that number.
        """
        row = self.table[self.table["design"] == design]
        if row.empty:
            raise InputError("no design of the study as it is has that number", place=f"design {design}",
                             remedy="choose one of the table")  # fmt: skip
        return {name: float(row[name].iloc[0]) for name in self.space.free_names}

    def write(self, path: Path) -> Path:
        """Write the table as CSV; InputError where that cannot be."""
        try:
            with whole(path) as draft:
                guarded_table(self.table).to_csv(draft, index=False, float_format=NUMBER)
        except OSError as fault:
            remedy = "choose another file"
            raise InputError(f"it cannot be written ({fault.strerror})", place=path, remedy=remedy) from None
        return path

    @property
    def answer(self) -> Answer:
        """The best design, how many there are, and how one is taken as a start."""
        best = self.table.iloc[0]
        if best["status"] != "ok":
            return Answer("Every design failed.", self.sentences[0], "Try again: calib again STUDY.")
        known = best["case"] in (OTHER, IMPORTED)
        of = best["case"] if known else f"generation {best['generation']:.0f} of {best['case']}"
        mac = "" if pd.isna(best["mean_mac"]) else f", mean MAC {best['mean_mac']:.3f}"
        found = f"The best design is number {best['design']} ({of}): objective {best['objective']:.4g}"
        found += f", mean error {100 * best['mean_error']:.2f} %{mac}."
        then = "Begin least squares at one of them: calib designs STUDY --design NUMBER prints the line for study.toml."
        return Answer(found, self.sentences[0], then)

    @property
    def sentences(self) -> tuple[str, ...]:
        """How many there are."""
        number = Counter(self.table["case"].astype(str))
        own = [f"{number[case]} of {case}" for case in sorted(number) if case not in (OTHER, IMPORTED)]
        own += [f"{number[IMPORTED]} of the table of runs"] if IMPORTED in number else []
        own += [f"{number[OTHER]} of samples and other analyses"] if OTHER in number else []
        failed = int((self.table["status"] == "failed").sum())
        words = f"{len(self.table)} evaluated designs: {', '.join(own)}"
        words += f"; {failed} of them failed" if failed else ""
        words += f"; {self.infeasible} more broke a constraint and were not evaluated" if self.infeasible else ""
        return (f"{words}.",)


def designs(study: AnyStudy, ledger: Ledger, results: Results) -> Designs:
    """Every evaluated point of the study as it is.

    Parameters
    ----------
    study : Study
        With one test or several.
    ledger : Ledger
    results : Results
        Folder of the calibration, whose ``summary.json`` names the searches.

    Raises
    ------
    InputError
        Where nothing has been evaluated.
    """
    objective, fingerprint = objective_of(study), Responses.of(study).fingerprint
    summary = results.path / "summary.json"
    runs = read_json(summary, {RUNS: {ANY: str}}).get(RUNS, {}) if summary.exists() else {}
    parts, infeasible, searched = [], 0, set[str]()
    for case, run in runs.items():
        history = ledger.history(run)
        infeasible += int((history["status"] == "infeasible").sum())
        own = history[history["status"] != "infeasible"].drop_duplicates("key").set_index("key")
        found = _evaluated(ledger, ledger.searched(run), own.index.to_list())
        parts.append(found.join(own[["generation", "misfit"]]).assign(case=case))
        searched.update(own.index)
    others = [key for key in ledger.keys(fingerprint) if key not in searched]
    found = _as_imported(
        _evaluated(ledger, fingerprint, others).assign(case=OTHER, generation=np.nan), study, objective
    )
    found["misfit"] = [objective(one) if one else np.nan for one in found["responses"]]
    parts.append(found)
    table = pd.concat([part for part in parts if len(part)] or parts[-1:], ignore_index=True)
    if not len(table):
        words = "no design of the study as it is has been evaluated"
        raise InputError(words, place=results.path, remedy="run 'calib sensitivity' or 'calib calibrate' first")
    return Designs(_ranked(table, objective, study.search_space), study.search_space, infeasible)


def _as_imported(points: pd.DataFrame, study: AnyStudy, objective: Objective) -> pd.DataFrame:
    """The points, those that are runs of the study's table with its outputs instead of predicted ones."""
    runs = runs_of(study)
    if runs is None or set(study.search_space.free_names) != set(runs.points):
        return points
    inputs = runs.points[list(study.search_space.free_names)].to_numpy(dtype=float)
    number = {point_key(study.search_space.complete(x)): k for k, x in enumerate(inputs)}
    table = points.reset_index().to_dict("records")
    for row in table:
        if (k := number.get(str(row["key"]))) is not None:
            own = {str(name): float(value) for name, value in runs.values.iloc[k].items() if np.isfinite(value)}
            good = set(objective.targets) <= set(own)
            row |= {"case": IMPORTED, "status": "ok" if good else "failed", "responses": own if good else {}}
    return pd.DataFrame(table, columns=["key", *points]).set_index("key")


def _evaluated(ledger: Ledger, fingerprint: str, keys: list[str]) -> pd.DataFrame:
    """Stored points with these keys: ``design, status, values, responses``, indexed by key."""
    found, numbers = ledger.lookup(fingerprint, keys), ledger.numbers(fingerprint, keys)
    rows = [(numbers[key], one.status, one.values, one.responses) for key, one in found.items()]
    return pd.DataFrame(rows, columns=["design", "status", "values", "responses"], index=pd.Index(found, name="key"))


def _ranked(points: pd.DataFrame, objective: Objective, space: ParameterSpace) -> pd.DataFrame:
    """The wide table, ranked."""
    points = points.sort_values(["misfit", "design"], kind="stable", ignore_index=True)
    values, responses = (pd.DataFrame(points[column].to_list()) for column in ("values", "responses"))
    sums = {
        constraint.name: sum(weight * values[name] for name, weight in constraint.coefficients)
        for constraint in space.constraints
        if {name for name, _ in constraint.coefficients} <= set(values)
    }
    errors = pd.DataFrame({name: (responses[name] - value) / abs(value) for name, value in objective.targets.items()})
    good = points["status"] == "ok"
    mac = [name for name in map(str, responses) if name.rpartition(": ")[2].startswith("mac_")]
    out = points[["design", "case", "generation", "status"]].assign(
        objective=points["misfit"],
        mean_error=errors.abs().fillna(1.0).mean(axis=1).where(good),
        mean_mac=responses[mac].fillna(0.0).mean(axis=1).where(good) if mac else np.nan,
    )
    out.insert(0, "rank", np.arange(1, len(out) + 1))
    errors.columns = [f"error {name}" for name in errors]
    return pd.concat([out, values, pd.DataFrame(sums), responses, errors], axis=1)
