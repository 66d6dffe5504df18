"""Trade-off between two groups of responses of a fitted model: the Pareto front, its knee, and where the fit lies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from calib.analyses.case import CaseFinder, genetic_settings, objective_of
from calib.analyses.case_starts import evaluable, initial_population
from calib.analyses.joint_responses import Responses
from calib.analyses.provenance.places import QUICK_GENERATIONS, QUICK_POPULATION, Workers
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.state import PARETO
from calib.analyses.sensitivity import evaluated
from calib.analyses.staged import required_calibration
from calib.errors.errors import InputError
from calib.execution.outcome import Outcome, failure, point_key
from calib.execution.stage import Progress, silent
from calib.inference.objective import Objective
from calib.inference.pareto import ResponseGroup, front_of, groups_of, knee_of, search_front
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.search_settings import ParetoSettings
from calib.study.several import AnyStudy

if TYPE_CHECKING:
    from calib.inference.genetic import GeneticSettings

FRONT, FITTED = "front", "least squares"
"""Kinds of rows."""
COLUMNS = ("kind", "design", "first", "second", "objective", "knee", "lowest")
"""Columns of the front before those of the parameters."""
OBJECTIVES = ("name", "of", "responses", "weight", "least", "most", "knee", "lowest", "least_squares")


@dataclass(frozen=True)
class ParetoRun:
    """What a front is searched with besides the study.

    Attributes
    ----------
    ledger : Ledger
    settings : ParetoSettings
    homes, workers, progress
        As in `calib.analyses.intervals.IntervalsRun`.
    quick : bool
        A small search.
    """

    ledger: Ledger
    settings: ParetoSettings
    homes: Mapping[str, Results] = field(default_factory=dict)
    workers: Workers = None
    quick: bool = False
    progress: Progress = silent


@dataclass(frozen=True, eq=False)
class Pareto:
    """The designs of which no other one is better in both of two objectives, at full order.

    Attributes
    ----------
    table : DataFrame
        ``kind, design, first, second, objective, knee, lowest``, then every free parameter in its unit. ``first`` and
        ``second`` are the mean errors of the two groups, ``objective`` is their sum by the weights of a search. Rows of
        the front are sorted by ``first``; the fit by least squares follows. ``design`` is the number of the point in
        the ledger.
    objectives : DataFrame
        `OBJECTIVES`, a row for each group; NaN where there is no knee.
    searched : int
        Designs that the search evaluated.
    settings : GeneticSettings
    notes : tuple of str
    """

    table: pd.DataFrame
    objectives: pd.DataFrame
    searched: int
    settings: GeneticSettings
    notes: tuple[str, ...] = ()

    @property
    def front(self) -> pd.DataFrame:
        """The rows of the front."""
        return self.table[self.table["kind"] == FRONT]

    def _at(self, column: str) -> str:
        """The two objectives at one of the named designs, in words."""
        rows = self.objectives.to_dict("records")
        return ", ".join(f"{row['name']} {in_words(row[column], row['of'])}" for row in rows)

    @property
    def sentences(self) -> tuple[str, ...]:
        """How the front was searched, its knee, the best design by the weights of the objective, and the fit."""
        front, (fitted,) = self.front, self.table[self.table["kind"] == FITTED].to_dict("records")
        searched = f"NSGA-II evaluated {self.searched} designs in {self.settings.generations} generations of "
        searched += f"{self.settings.population}; {len(front)} of them form the front."
        knee = front[front["knee"]]
        bent = "The front has no knee: it is straight, or one of its ends is best in both."
        if len(knee):
            bent = f"Its knee is design {knee['design'].iloc[0]} ({self._at('knee')}): beyond it a gain in one costs "
            bent += "most of the other."
        (lowest,) = front[front["lowest"]].to_dict("records")
        weights = " and ".join(f"{row['weight']:g} for {row['name']}" for row in self.objectives.to_dict("records"))
        weighed = f"By the weights of the objective, {weights}, design {lowest['design']} is best "
        weighed += f"({self._at('lowest')})."
        better = int(((front["first"] < fitted["first"]) & (front["second"] < fitted["second"])).sum())
        ends = f"Least squares end at {self._at('least_squares')}: "
        ends += f"{better} designs of the front are better in both." if better else "no design is better in both."
        return (searched, bent, weighed, ends, *self.notes)

    @property
    def answer(self) -> Answer:
        """How far the two can be improved, at what cost, and how a design is taken."""
        front, rows = self.front, self.objectives.to_dict("records")
        if len(front) == 1:
            found = f"The two do not compete: design {front['design'].iloc[0]} is best in both ({self._at('least')})."
        else:
            spans = (
                f"{row['name']} from {in_words(row['least'], row['of'])} to {in_words(row['most'], row['of'])}"
                for row in rows
            )
            found = f"The front has {len(front)} designs: {' against '.join(spans)}."
        chosen = front[front["knee"] if front["knee"].any() else front["lowest"]]["design"].iloc[0]
        then = f'Begin least squares at a design of the front: begin_at = "design {chosen}".'
        return Answer(found, self.sentences[3], then)


def in_words(value: float, of: str) -> str:
    """A mean error in percent, or a mean of 1 - MAC."""
    return f"1 - MAC {value:.3g}" if of == "1 - MAC" else f"{100 * value:.2f} %"


def pareto_at(study: AnyStudy, values: Mapping[str, float], run: ParetoRun) -> Pareto:
    """Search the front of two groups of responses, from fitted values and a sample; nothing is written.

    Large models are searched on their reduced bases; the front is solved at full order.

    Raises
    ------
    InputError
        For groups that match no response or overlap, and where the model can be evaluated at no point.
    """
    objective, space, settings = objective_of(study), study.search_space, _sizes(study, run)
    if taken := [name for name in space.free_names if name in COLUMNS]:
        words = f"a parameter has the name {taken[0]!r}, which a column of its table has too"
        raise InputError(words, place="pareto", remedy="give the parameter another name")
    groups = groups_of(objective, run.settings.objectives)
    finder = CaseFinder(
        study.each(lambda one: recorded(one, run.ledger, run.workers)), run.ledger, run.homes, run.workers, run.quick,
        run.progress,
    )  # fmt: skip
    reductions = finder.reductions()
    responses = Responses.of(finder.study, {test: one.problem for test, one in reductions.items()})
    initial = initial_population(study, run.ledger, settings.population, run.settings.seed)
    fitted = np.array([values[name] for name in space.free_names])
    initial[-1] = np.clip(fitted, space.lower, space.upper)
    count = settings.population * settings.generations
    with finder.evaluator(responses, reductions, count) as evaluator, evaluable(study):
        found = search_front(
            space, objective, groups, settings, evaluator, run.ledger, responses.fingerprint, initial,
            run.settings.seed, partial(run.progress, "searching the front"),
        )  # fmt: skip
    reached = list(found.values())
    candidates = [reached[k].values for k in front_of(_errors(reached, groups, objective))]
    outcomes = evaluated(study, run.ledger, [*candidates, space.complete(dict(values))], run.workers, run.progress)
    if outcomes[-1].status != "ok":
        raise failure(outcomes[-1])
    good = [one for one in outcomes[:-1] if one.status == "ok" and np.isfinite(_errors([one], groups, objective)).all()]
    if not good:
        raise failure(next((one for one in outcomes if one.status != "ok"), outcomes[0]))
    shown = [*(good[k] for k in front_of(_errors(good, groups, objective))), outcomes[-1]]
    keys = [point_key(one.values) for one in shown]
    numbers = run.ledger.numbers(Responses.of(study).fingerprint, keys)
    table = _table(_errors(shown, groups, objective), groups)
    table.insert(1, "design", [numbers[key] for key in keys])
    parameters = pd.DataFrame([{name: one.values[name] for name in space.free_names} for one in shown])
    notes = tuple(words for own in finder.reduction_notes.values() for words in own)
    return Pareto(table[list(COLUMNS)].join(parameters), _objectives(table, groups), len(found), settings, notes)


def _sizes(study: AnyStudy, run: ParetoRun) -> GeneticSettings:
    """Settings of the search: those of a calibration, with sizes of its own."""
    population, generations = run.settings.population, run.settings.generations
    if run.quick:
        population, generations = min(population, QUICK_POPULATION), min(generations, QUICK_GENERATIONS)
    return replace(genetic_settings(study, False), population=population, generations=generations)


def _errors(
    outcomes: Sequence[Outcome], groups: tuple[ResponseGroup, ResponseGroup], objective: Objective
) -> np.ndarray:
    """Both mean errors of each outcome, (n, 2)."""
    terms = [objective.terms(one.responses) for one in outcomes]
    return np.array([[group(one) for group in groups] for one in terms]).reshape(-1, 2)


def _table(errors: np.ndarray, groups: tuple[ResponseGroup, ResponseGroup]) -> pd.DataFrame:
    """The rows of a front, with its knee and the design that the weights of the objective prefer, and of the fit."""
    objective, number = errors @ [group.weight for group in groups], np.arange(len(errors))
    lowest, knee = int(np.argmin(objective[:-1])), knee_of(errors[:-1])
    table = pd.DataFrame(errors, columns=["first", "second"])
    table.insert(0, "kind", np.where(number < len(errors) - 1, FRONT, FITTED))
    return table.assign(objective=objective, knee=number == knee, lowest=number == lowest)


def _objectives(table: pd.DataFrame, groups: tuple[ResponseGroup, ResponseGroup]) -> pd.DataFrame:
    """One row for each of the two groups."""
    rows, front = [], table[table["kind"] == FRONT]
    chosen = [front[front["knee"]], front[front["lowest"]], table[table["kind"] == FITTED]]
    for group, column in zip(groups, ("first", "second"), strict=True):
        of_shapes = all(name.rpartition(": ")[2].startswith("mac_") for name in group.weights)
        of, ends = "1 - MAC" if of_shapes else "error", (front[column].min(), front[column].max())
        there = [float(part[column].mean()) for part in chosen]  # of one row; NaN of none
        rows.append((group.name, of, ", ".join(group.weights), group.weight, *ends, *there))
    return pd.DataFrame(rows, columns=list(OBJECTIVES))


# -- of a study in a folder --------------------------------------------------------------------------------------------


def pareto(study: AnyStudy, results: Results, run: ParetoRun) -> Pareto:
    """The front beside the stored calibration of a study; writes ``pareto.csv`` and ``pareto_objectives.csv``.

    Raises
    ------
    InputError
        Where the study is not calibrated as it is now.
    """
    found = pareto_at(study, required_calibration(study, results).values, run)
    begin_analysis(results, "pareto")
    results.remove(*PARETO)
    results.write_table("pareto", found.table)
    results.write_table("pareto_objectives", found.objectives)
    seeds = {"search": run.settings.seed}
    write_record(study, results, "pareto", seeds, found.sentences, run.quick, answer=found.answer)
    return found
