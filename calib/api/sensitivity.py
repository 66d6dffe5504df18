"""Global sensitivity analysis of a problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from calib.analyses.refine import Refined, refined
from calib.analyses.screening import screened
from calib.analyses.sensitivity import Sensitivity, sampled
from calib.api.analysis_result import AnalysisResult, refined_result
from calib.api.arguments import with_keys
from calib.api.display import Displayed
from calib.api.entries.entry import Entry
from calib.api.pairs import ledger_or_memory, reporting
from calib.api.protocols import ProblemLike
from calib.errors.arguments import integer
from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.execution.executor import AnyExecutor, injected
from calib.results.ledger import Ledger
from calib.sensitivity.prognosis import Prognosis
from calib.study.several import AnyStudy


@dataclass(frozen=True, eq=False, repr=False)
class Assessed(Displayed):
    """Which parameters matter for the measured responses.

    Attributes
    ----------
    answer : Sensitivity or Screening
        All measures with their noise floors and samples; the latter of Morris' and Sobol's methods.
    study : LoadedStudy or JointStudy
        The models and tests that were sampled.
    ledger : Ledger or None
        That of the problem.

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

    answer: Any
    study: AnyStudy
    ledger: Ledger | None = None

    @property
    def samples(self) -> pd.DataFrame:
        """Latin hypercube points with the model's responses, NaN where one is not available."""
        return self.answer.sampled

    @property
    def selected(self) -> tuple[str, ...]:
        """Parameters that matter, such as `Problem.calibrate` takes; none of Morris' and Sobol's methods."""
        if not isinstance(self.answer, Sensitivity):
            return ()
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
    def prognosis(self) -> Prognosis:
        """Metamodels: ``.table`` and ``.inputs`` of CoP, ``prognosis["f"](points)`` predicts a response."""
        found: Prognosis = self.answer.prognosis
        return found

    def draw(self, path: str | Path, response: str, inputs: tuple[str, str] | None = None) -> Path:
        """Draw a metamodel against the model, or its surface over two inputs, into a PNG file; returns the file.

        The other inputs of a surface have their nominal values.
        """
        from calib.api.metamodel_figures import draw_metamodel

        return draw_metamodel(self.prognosis[response], self.study, self.samples, path_of(path, "path"), inputs)

    def refine(
        self, runs: int = 20, *, seed: int = 1, executor: Any = None, progress: bool = True
    ) -> AnalysisResult[Refined]:
        """New runs where they help most, evaluated where the model computes; see `calib.analyses.refine.refined`.

        ``seed`` is that of the candidates; the other arguments are as in `calib.Problem.sensitivity`.
        """
        count = integer(runs, 1, "runs")
        with (
            injected(executor) as workers, reporting("refine", progress) as step,
            ledger_or_memory(self.ledger) as ledger,
        ):  # fmt: skip
            return refined_result(refined(self.study, self.answer, ledger, count, seed, workers, step))

    @property
    def table(self) -> pd.DataFrame:
        """One row per parameter: its largest measures, the responses they belong to, and whether it is selected."""
        if not isinstance(self.answer, Sensitivity):
            return self.answer.table
        main = [
            "parameter",
            "max_spearman",
            "spearman_response",
            "max_partial",
            "max_variance_share",
            "variance_share_response",
        ]
        return self.answer.assessment.selection[[*main, "selected"]]

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, and where the rest is."""
        rest = ".sentences, .spearman, .partial, .variance_share, .prognosis, .samples; .selected for calibrate"
        evidence = rest if isinstance(self.answer, Sensitivity) else ".table"
        return {**self.answer.answer.labelled, "Evidence": evidence}

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer."""
        from calib.api.entries.compared import sensitivity_entries

        return sensitivity_entries(self.study, self.answer)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The samples behind the measures, and the selection."""
        found: tuple[str, ...] = self.answer.sentences
        return found

    def __repr__(self) -> str:
        if not isinstance(self.answer, Sensitivity):
            return f"Assessed({self.answer.method}, {self.answer.points} points)"
        return f"Assessed({len(self.table)} parameters, {len(self.selected)} selected; {self.answer.samples} samples)"


def require_suited(method: str, ignore_constraints: bool, drawn: bool = False) -> None:
    """InputError where constraints or drawn metamodels are named that a method has none of."""
    if method == "ranks" and ignore_constraints:
        words, remedy = "the samples of 'ranks' keep the constraints", "leave it out; 'morris' and 'sobol' take it"
        raise InputError(words, place="ignore_constraints", remedy=remedy)
    if method != "ranks" and drawn:
        raise InputError("it has no metamodels", place=f"method {method}", remedy="use the method 'ranks'")


def assessed(
    problem: ProblemLike,
    method: Literal["ranks", "morris", "sobol"],
    keys: Mapping[str, Any],
    ignore_constraints: bool,
    executor: AnyExecutor | None,
    progress: bool,
) -> Assessed:
    """See `calib.api.problem.Problem.sensitivity`."""
    require_suited(method, ignore_constraints)
    settings = with_keys(problem.settings.sensitivity, "sensitivity", keys)
    study = problem.study(problem.settings.model_copy(update={"sensitivity": settings}))
    with (
        injected(executor) as workers, reporting("sensitivity", progress) as step,
        ledger_or_memory(problem.ledger) as ledger,
    ):  # fmt: skip
        if method == "ranks":
            return Assessed(sampled(study, ledger, workers, progress=step), study, problem.ledger)
        found = screened(study, ledger, method, workers, ignore_constraints=ignore_constraints, progress=step)
        return Assessed(found, study)
