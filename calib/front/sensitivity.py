"""Which parameters matter, as a notebook asks it."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import pandas as pd

from calib.errors import EvaluationError
from calib.executor import Injected
from calib.front.asked import Asked
from calib.front.responses import Responses
from calib.front.shown import Shown
from calib.questions.failures import reasons, reasons_sentence
from calib.questions.sensitivity import Sensitivity, measured
from calib.sampling import sample


@dataclass(frozen=True, eq=False, repr=False)
class Assessed(Shown):
    """Which parameters matter for what was measured.

    Attributes
    ----------
    answer : Sensitivity
        All measures, their noise floors, and what stands behind them.
    """

    answer: Sensitivity

    @property
    def samples(self) -> pd.DataFrame:
        """Latin hypercube points with the model's responses there, NaN where there is none."""
        return self.answer.sampled

    @property
    def selected(self) -> tuple[str, ...]:
        """Parameters that matter, as `Problem.calibrate` takes them."""
        table = self.answer.assessment.selection
        return tuple(table["parameter"][table["selected"]])

    @property
    def spearman(self) -> pd.DataFrame:
        """Rank correlation of each parameter (rows) with each response (columns), -1 to 1 (Spearman 1904)."""
        return self.answer.assessment.spearman

    @property
    def partial(self) -> pd.DataFrame:
        """The same after what the other parameters explain; see `calib.sensitivity.partial`."""
        return self.answer.assessment.partial

    @property
    def influence(self) -> pd.DataFrame:
        """Root of the share of a response's variance that only this parameter brings, 0 to 1."""
        return self.answer.assessment.influence.table

    @property
    def table(self) -> pd.DataFrame:
        """One row a parameter: its largest measures, on which response, and whether that selects it."""
        shown = ["parameter", "max_spearman", "spearman_response", "max_partial", "max_influence", "influence_response"]
        return self.answer.assessment.selection[[*shown, "selected"]]

    @property
    def sentences(self) -> tuple[str, ...]:
        """What stands behind the measures, and what they select."""
        return self.answer.sentences

    def __repr__(self) -> str:
        return f"Assessed({len(self.table)} parameters, {len(self.selected)} selected; {self.answer.samples} samples)"


def assessed(problem: Asked, samples: int, seed: int, executor: Executor | Injected | None) -> Assessed:
    """See `calib.front.problem.Problem.sensitivity`."""
    space, responses = problem.space, Responses.of(problem)
    drawn = sample(space, samples, seed)
    with responses.evaluator(executor) as evaluator:
        outcomes = evaluator.evaluate([space.complete(point) for point in drawn.points])
    if all(o.status != "ok" for o in outcomes):
        why = reasons_sentence(space, reasons(outcomes), len(outcomes))
        raise EvaluationError(f"the model cannot be evaluated within its limits: {why}")
    return Assessed(measured(space, drawn, outcomes, responses.measured))
