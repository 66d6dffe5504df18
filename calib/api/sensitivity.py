"""Global sensitivity analysis of a problem."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

import pandas as pd

from calib.analyses.failures import reasons, reasons_sentence
from calib.analyses.sensitivity import Sensitivity, measured
from calib.api.display import Shown
from calib.api.pairs import kept_in
from calib.api.protocols import PosedProblem
from calib.api.responses import Responses
from calib.errors.errors import EvaluationError
from calib.execution.executor import Injected
from calib.execution.stage import Progress
from calib.problem.sampling import sample


@dataclass(frozen=True, eq=False, repr=False)
class Assessed(Shown):
    """Which parameters matter for the measured responses.

    Attributes
    ----------
    answer : Sensitivity
        All measures with their noise floors and samples.

    Examples
    --------
    >>> import calib
    >>> space = calib.ParameterSpace((
    ...     calib.Parameter("E", 200.0, 180.0, 220.0, "GPa"), calib.Parameter("nu", 0.3, 0.2, 0.4),
    ... ))
    >>> model = calib.FunctionModel("rod", space, lambda v: {"f": 360.0 * v["E"] ** 0.5})
    >>> found = calib.Problem(model, calib.ResponseTest({"f": 5100.0})).sensitivity(samples=100)
    >>> found
    Assessed(2 parameters, 1 selected; 100 samples)
    >>> float(found.spearman.loc["E", "f"])
    1.0
    """

    answer: Sensitivity

    @property
    def samples(self) -> pd.DataFrame:
        """Latin hypercube points with the model's responses, NaN where one is not available."""
        return self.answer.sampled

    @property
    def selected(self) -> tuple[str, ...]:
        """Parameters that matter, such as `Problem.calibrate` takes."""
        table = self.answer.assessment.selection
        return tuple(table["parameter"][table["selected"]])

    @property
    def spearman(self) -> pd.DataFrame:
        """Rank correlation of each parameter (rows) with each response (columns), -1 to 1 (Spearman 1904)."""
        return self.answer.assessment.spearman

    @property
    def partial(self) -> pd.DataFrame:
        """Partial rank correlation, given the other parameters; see `calib.sensitivity.partial`."""
        return self.answer.assessment.partial

    @property
    def variance_share(self) -> pd.DataFrame:
        """Square root of the share of a response's variance due to this parameter alone, 0 to 1."""
        return self.answer.assessment.variance_share.table

    @property
    def table(self) -> pd.DataFrame:
        """One row per parameter: its largest measures, the responses they belong to, and whether it is selected."""
        shown = [
            "parameter",
            "max_spearman",
            "spearman_response",
            "max_partial",
            "max_variance_share",
            "variance_share_response",
        ]
        return self.answer.assessment.selection[[*shown, "selected"]]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The samples behind the measures, and the selection."""
        return self.answer.sentences

    def __repr__(self) -> str:
        return f"Assessed({len(self.table)} parameters, {len(self.selected)} selected; {self.answer.samples} samples)"


def assessed(
    problem: PosedProblem, samples: int, seed: int, executor: Executor | Injected | None, told: Progress
) -> Assessed:
    """See `calib.api.problem.Problem.sensitivity`."""
    space, responses = problem.space, Responses.of(problem)
    sampled = sample(space, samples, seed)
    with kept_in(problem.ledger) as ledger, responses.evaluator(executor) as evaluator:
        points = [space.complete(point) for point in sampled.points]
        outcomes = ledger.evaluate(
            responses.fingerprint, points, evaluator, lambda done: told("sampling", done, len(points))
        )
    if all(o.status != "ok" for o in outcomes):
        found = reasons(outcomes)
        words = f"the model cannot be evaluated within its limits: {reasons_sentence(space, found, len(outcomes))}"
        raise EvaluationError(words, at=found[0].first.at)
    return Assessed(measured(space, sampled, outcomes, responses.measured))
