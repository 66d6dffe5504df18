"""New runs where they help the question most: proposed for a table of runs, evaluated for a model that computes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.analyses.provenance.places import Workers
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.sensitivity import Sensitivity, evaluated, runs_of, sampled, table_of, varied
from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.problem.sampling import sample
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.sensitivity.infill import chosen_runs, coordinates, local_errors, tempered
from calib.sensitivity.prognosis import Metamodel, Prognosis, prognosis
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

CANDIDATES = 4000
"""Points of the space among which runs are chosen."""
_TINY = 1e-12
"""Variance, over the square of its size, below which nothing is known to be wrong."""
COLUMNS = ("response", "cop", "error", "error_near", "cop_after", "error_after", "error_near_after")


@dataclass(frozen=True, eq=False)
class Refined:
    """New runs, and what they do to the metamodels.

    Attributes
    ----------
    runs : DataFrame (n_runs, ...)
        Inputs in their units, ``weight`` (how well the metamodels there agree with the measurement, 1 for the best
        candidate), then the responses where they were evaluated, NaN where there is none.
    table : DataFrame
        `COLUMNS`, a row for each response: coefficient of prognosis, root mean square error of prediction, and the same
        near what was measured; NaN afterwards where the runs were only proposed.
    prognosis : Prognosis
        The metamodels with the new runs, or those of a table.
    proposed : bool
        Whether the runs are to be made by the user: the model is a table.
    failed : int
    """

    runs: pd.DataFrame
    table: pd.DataFrame
    prognosis: Prognosis
    proposed: bool
    failed: int = 0

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was proposed or evaluated, and the errors of prediction near the measurement."""
        known = self.table[self.table["error_near"].notna()]
        if self.proposed:
            worst = max(
                known.to_dict("records"), key=lambda row: row["error_near"] / row["error"] if row["error"] > 0 else 0.0
            )
            return (f"{len(self.runs)} runs are proposed, far from others where the metamodels agree with the "
                    f"measurement and predict worst. Near the measurement {worst['response']} is predicted within "
                    f"{worst['error_near']:.3g}, over all runs within {worst['error']:.3g}.",)  # fmt: skip
        failed = f"; {self.failed} failed" if self.failed else ""
        each = ", ".join(
            f"{row['response']} {row['error_near']:.3g} -> {row['error_near_after']:.3g}"
            for row in known.to_dict("records")[:6]
        )
        return (f"{len(self.runs)} further runs were evaluated{failed}.",
                f"Errors of prediction near the measurement: {each}.")  # fmt: skip

    @property
    def answer(self) -> Answer:
        """What the runs are, what they change, and what to do with them."""
        if self.proposed:
            then = "Make these runs, add them to the table, and run the analyses again."
            return Answer(self.sentences[0], "Errors are cross-validated; that between runs may be larger.", then)
        return Answer(self.sentences[0], self.sentences[1], "More runs: calib refine STUDY --runs N with a larger N.")


def refined(
    study: AnyStudy,
    found: Sensitivity,
    ledger: Ledger,
    runs: int,
    seed: int = 1,
    workers: Workers = None,
    progress: Progress = silent,
) -> Refined:
    """Choose new runs, and evaluate them where the model computes; nothing is written.

    Each candidate of the space counts by the agreement of its predicted responses with the measured ones, tempered so
    far that a twentieth of the candidates counts, by the error of prediction near it over the standard deviation of the
    measured value, and by its distance from all other runs. Without measured values all of the space counts.

    Parameters
    ----------
    study : Study or JointStudy
    found : Sensitivity
        With its metamodels; those of a table of runs are its own.
    ledger : Ledger
    runs, seed : int
        Number of new runs, and seed of the candidates: the first ones are the same for a larger number.
    workers, progress
        As in `calib.analyses.sensitivity.sampled`.

    Raises
    ------
    InputError
        Where no response has a metamodel.
    """
    runs_made, space = runs_of(study), varied(study)
    models = tuple(one for one in found.prognosis.models if one.model is not None)
    if not models:
        raise InputError("no response has a metamodel", place="refine", remedy="take more samples, or make more runs")
    names = list(models[0].space.free_names)
    designs = (found.sampled if runs_made is None else runs_made.points)[names]
    x, points = designs.to_numpy(dtype=float), [space.complete(one) for one in sample(space, CANDIDATES, seed).points]
    candidates = np.array([[one[name] for name in names] for one in points])
    measured = {one.response: _measured(study, one.response) for one in models}
    far, there = (coordinates(models, where) for where in (x, candidates))
    errors = local_errors(models, far, there)
    weight = tempered(_misfit(models, measured, candidates, errors))
    size = np.array([measured[one.response][1] or one.true.std() for one in models])
    unknown = (errors**2 / (size**2 + errors**2)).sum(axis=1)
    which = chosen_runs(weight * (unknown + _TINY), there, far, runs)
    made = pd.DataFrame(candidates[which], columns=names).assign(weight=weight[which])
    near = tempered(_misfit(models, measured, x, local_errors(models, far, far)))
    table, known, failed = _errors(found.prognosis, near), found.prognosis, 0
    after = pd.DataFrame(index=table.index, columns=table.columns, dtype=float)
    if runs_made is None:
        outcomes = evaluated(study, ledger, [points[k] for k in which], workers, progress)
        responses, failed = list(table.index), sum(one.status != "ok" for one in outcomes)
        made = pd.concat([made, table_of(outcomes, responses)], axis=1)
        whole = pd.concat([found.sampled, made], ignore_index=True)
        known = prognosis(space, whole[names], whole[responses])
        after = _errors(known, np.concatenate([near, weight[which]]))
    table = table.join(after.add_suffix("_after")).reset_index()
    return Refined(made, table[list(COLUMNS)], known, runs_made is not None, failed)


def _misfit(
    models: Sequence[Metamodel], measured: Mapping[str, tuple[float, float]], points: np.ndarray, errors: np.ndarray
) -> np.ndarray:
    """Sum of squares of predicted against measured values (n,), errors of prediction included; 0 without any."""
    out = np.zeros(len(points))
    for k, one in enumerate(models):
        value, std = measured[one.response]
        if np.isfinite(value):
            variance = std**2 + errors[:, k] ** 2
            out += (one(points) - value) ** 2 / np.maximum(variance, _TINY * value**2 + np.finfo(float).tiny)
    return out


def _measured(study: AnyStudy, response: str) -> tuple[float, float]:
    """Measured value of a response and its standard deviation; NaN and 0 where it was not measured as a number."""
    for one in study.studies:
        name = response.removeprefix(f"{one.test}: ") if len(study.studies) > 1 else response
        table = one.experiment.table()
        if "response" in table and len(row := table[table["response"] == name]):
            return float(row["value"].iloc[0]), float(row["std_used"].iloc[0])
        mode = name.removeprefix("natural_freq_")
        if mode != name and "natural_freq" in table and len(row := table[table["mode"] == mode]):
            return float(row["natural_freq"].iloc[0]), float(row["freq_std_used"].iloc[0])
    return float("nan"), 0.0


def _errors(found: Prognosis, near: np.ndarray) -> pd.DataFrame:
    """Coefficient of prognosis and errors of each response; ``near`` are weights of the designs."""
    rows = {}
    for one in found.models:
        squares, weight = (one.true - one.predicted) ** 2, near[one.rows]
        total = float(weight.sum())
        local = float(np.sqrt(weight @ squares / total)) if one.model is not None and total > 0 else float("nan")
        rows[one.response] = (one.cop, one.error, local)
    index = pd.Index(rows, name="response")
    return pd.DataFrame(list(rows.values()), index=index, columns=["cop", "error", "error_near"])


# -- of a study in a folder --------------------------------------------------------------------------------------------


def refine(
    study: LoadedStudy,
    results: Results,
    ledger: Ledger,
    runs: int,
    seed: int = 1,
    workers: Workers = None,
    quick: bool = False,
    progress: Progress = silent,
) -> Refined:
    """New runs of a study, from the samples of its sensitivity analysis; writes them and ``refined.csv``."""
    found = refined(study, sampled(study, ledger, workers, quick, progress), ledger, runs, seed, workers, progress)
    begin_analysis(results, "refine")
    results.write_table("proposed_runs", found.runs)
    results.write_table("refined", found.table)
    options = ("--runs", str(runs))
    write_record(study, results, "refine", {"candidates": seed}, found.sentences, quick, options, found.answer)
    return found
