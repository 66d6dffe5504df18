"""Fit: the solution of a problem, with what the data determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Unpack

from calib.analyses.calibrate import CalibrationRun
from calib.analyses.calibrate import calibrated as run_calibration
from calib.analyses.calibration import Calibration, Fitted
from calib.analyses.case import CaseFinder
from calib.analyses.every_mode import errors_at
from calib.analyses.fit_statistics import FitStatistics
from calib.analyses.joint_responses import own_values
from calib.analyses.provenance.places import tasks_shared
from calib.api.analysis_result import AnalysisResult, interval_result, pareto_result, robustness_result
from calib.api.arguments import (
    ExplainKeys,
    ParetoKeys,
    RobustnessKeys,
    calibration_settings,
    pareto_settings,
    robustness_settings,
)
from calib.api.display import Compared, Displayed, compared
from calib.api.entries.entry import Entry
from calib.api.pairs import lacking_effects, ledger_or_memory, reporting
from calib.api.protocols import Candidates, Finer, P
from calib.errors.arguments import path as path_of
from calib.execution.executor import AnyExecutor, injected
from calib.inference.agreement import Agreement, Searched
from calib.results.answer import Answer

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from calib.analyses.intervals import Intervals
    from calib.analyses.pareto import Pareto
    from calib.analyses.robustness import Robustness
    from calib.api.explained import Explained


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Displayed, Generic[P]):
    """A fitted problem with the covariance and identifiability of its parameters.

    Attributes
    ----------
    problem : Problem
        Its free parameters are the fitted ones.
    statistics : FitStatistics
    calibration : Calibration, JointCalibration or None
        All results of the calibration, as a study has them; None for statistics at given values.

    Examples
    --------
    The natural frequency, here squared and measured three times, determines the ratio of stiffness to mass, not both:

    >>> import calib
    >>> space = calib.ParameterSpace((
    ...     calib.Parameter("k", 3.0, 1.0, 9.0, "kN/m"), calib.Parameter("m", 1.0, 0.1, 5.0, "kg"),
    ... ))
    >>> def responses(v):
    ...     return {f"w2_{n}": 1e3 * v["k"] / v["m"] for n in "abc"}
    >>> test = calib.ResponseTest({"w2_a": (4000.0, 40.0), "w2_b": (3970.0, 40.0), "w2_c": (4020.0, 40.0)})
    >>> def identified(space):
    ...     fit = calib.Problem(calib.FunctionModel("oscillator", space, responses), test).calibrate()
    ...     return fit.parameters["identified"].to_dict()
    >>> identified(space)
    {'k': False, 'm': False}
    >>> identified(space.freeze({"m": 1.0}))
    {'k': True}
    """

    problem: P
    statistics: FitStatistics
    calibration: Fitted | None = None

    @property
    def values(self) -> dict[str, float]:
        """All parameters, each in its own unit."""
        return self.statistics.values

    @property
    def cases(self) -> Calibration | None:
        """Cases of the calibration with their searches and statistics; those of the first of several tests."""
        if self.calibration is None:
            return None
        return self.calibration if isinstance(self.calibration, Calibration) else self.calibration.any

    @property
    def agreement(self) -> Agreement | None:
        """Whether the cases and their starts found one solution; None for statistics at given values."""
        return None if self.cases is None else self.cases.agreement

    @property
    def search(self) -> Searched | None:
        """The genetic searches before least squares; None without."""
        found = () if self.cases is None else self.cases.cases
        searches = tuple(case.search for case in found if case.search is not None)
        return Searched(self.problem.space, searches) if searches else None

    @cached_property
    def parameters(self) -> Any:
        """One row per fitted parameter: value, standard deviation, and whether the data determine it.

        Columns as in `calib.inference.verdicts.parameter_verdicts`; the index is the parameter.
        """
        if self.cases is not None:
            return self.cases.verdicts.set_index("parameter")
        return self.statistics.verdicts(self.problem.space, {}, {}).set_index("parameter")

    @property
    def table(self) -> Any:
        """The main columns of `parameters`."""
        main = ["value", "unit", "std", "identified", "on_limit", "confounded_with"]
        return self.parameters[main].reset_index()

    @property
    def std_by_test(self) -> Any:
        """What each of several tests alone would determine; see `calib.inference.joint_part.std_by_test`.

        ``parameter, unit, test, std, prior_sd``, with rows of ``all tests``; empty for one test.
        """
        return self.statistics.by_test

    @property
    def between_tests(self) -> Any:
        """Parameters that vary between the tests (``varies``); see `calib.inference.between.between_tests`.

        ``parameter, unit, what, value, low, high, p``: the mean of the tests, the spread between them and the value of
        each test, with 95 % intervals; None without.
        """
        return None if self.statistics.between is None else self.statistics.between.table

    @property
    def answer(self) -> Answer | None:
        """What was found, how sure that is, and what to do next; None for statistics at given values."""
        return None if self.calibration is None else self.calibration.answer

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, and where the rest is."""
        if self.answer is None:
            return {}
        rest = ".parameters, .errors, .compare(), .std_by_test, .calibration; .figure(name) draws "
        return {**self.answer.labelled, "Evidence": f"{rest}{', '.join(self.figures)}"}

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer; empty for statistics at given values."""
        from calib.api.entries.calibrated import calibrated_entries

        return [] if self.calibration is None else calibrated_entries(self.problem.study(), self.calibration)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Goodness of fit, held-out data that contradict, agreement and notes, then identifiability one by one."""
        each = tuple(f"{name}: {sentence}" for name, sentence in self.parameters["sentence"].items())
        if self.calibration is None:
            return (self.statistics.sentence, *each)
        return (*self.calibration.sentences, *each)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Sentences on held-out data that contradict the fitted model; see `calib.analyses.every_mode`."""
        return () if self.calibration is None else self.calibration.contradictions

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures that it can draw."""
        from calib.api.page import figures_of

        return figures_of(self)

    def __repr__(self) -> str:
        known = int(self.parameters["identified"].fillna(False).astype(bool).sum())
        return f"Fit({len(self.parameters)} parameters, {known} identified; p = {self.statistics.p_fit:.2g})"

    @cached_property
    def errors(self) -> Any:
        """Errors on fitted, left-one-out and held-out data, in standard deviations, test by test.

        ``test, group, rows, rms, expected, p, unpaired``; ``expected`` is the rms of a correctly specified model.
        """
        import pandas as pd

        parts, statistics = [], self.statistics
        for one in self.problem.study().studies:
            found = None if self.calibration is None else self.calibration.seen(one.test).errors
            if found is None:
                found = errors_at(one, own_values(one, self.values), statistics)
            parts.append(found.assign(test=one.experiment.name))
        return pd.concat(parts, ignore_index=True)[["test", "group", "rows", "rms", "expected", "p", "unpaired"]]

    def compare(self) -> Compared:
        """Models against tests at the fitted values."""
        if self.calibration is None:
            return compared(self.problem, self.values)
        tests = self.problem.study().studies
        found = {one.experiment.name: self.calibration.seen(one.test).best.answer for one in tests}
        return Compared(found, {one.experiment.name: one for one in tests})

    def explain(
        self,
        effects: Candidates = (),
        *,
        finer: Finer = None,
        reduction: bool | Mapping[str, Any] | None = None,
        executor: AnyExecutor | None = None,
        progress: bool = True,
        **keys: Unpack[ExplainKeys],
    ) -> Explained[P]:
        """See `calib.Problem.explain`; the fit of the models as they are is not repeated: it begins at this one."""
        from calib.api.explained import explained

        return explained(self.problem, effects, keys, finer, reduction, progress, self.values, executor)

    def intervals(
        self,
        parameters: Sequence[str] = (),
        *,
        samples: int = 0,
        seed: int = 1,
        reduction: bool | Mapping[str, Any] | None = None,
        progress: bool = True,
    ) -> AnalysisResult[Intervals]:
        """95 % intervals that assume no linear model, by the profile likelihood (Raue et al. 2009).

        One parameter is moved away from its fitted value while all others are fitted again, until the data exclude
        what lies beyond or a limit is reached.

        Parameters
        ----------
        parameters : sequence of str
            Fitted parameters that are not integers; all of them if empty.
        samples : int
            Also sample the posterior with so many steps of an ensemble of walkers (package emcee); 0 for none.
        seed : int
            Of the walkers.
        reduction : bool or mapping, optional
            As in `calib.Problem.calibrate`.
        progress : bool

        Raises
        ------
        InputError
            For a parameter that was not fitted, and for samples without emcee.
        """
        from calib.analyses.intervals import IntervalsRun, intervals_at

        problem = self.problem
        study = problem.study(calibration_settings(problem.settings, {}, None, None, reduction, "intervals"))
        with reporting("intervals", progress) as step, ledger_or_memory(problem.ledger) as ledger:
            run = IntervalsRun(ledger, parameters=tuple(parameters), samples=samples, seed=seed, progress=step)
            return interval_result(intervals_at(study, self.values, run))

    def robustness(
        self,
        *,
        posterior: pd.DataFrame | None = None,
        reduction: bool | Mapping[str, Any] | None = None,
        progress: bool = True,
        **keys: Unpack[RobustnessKeys],
    ) -> AnalysisResult[Robustness]:
        """Responses over what is known of the parameters: quantiles, and the share outside limits.

        Parameters
        ----------
        posterior : DataFrame, optional
            Samples of the fitted parameters, such as ``fit.intervals(samples=2000).of.sampled.samples``; by default
            they are drawn from the linearised posterior.
        reduction, progress
            As in `intervals`.
        **keys
            ``samples`` of the posterior (500), their ``seed``, and ``limits``: least and largest allowed value of
            responses by name, either may be infinite.

        Raises
        ------
        InputError
            For limits of an unknown response.
        """
        from calib.analyses.robustness import RobustnessRun, robustness_at

        problem = self.problem
        settings = calibration_settings(problem.settings, {}, None, None, reduction, "robustness")
        study = problem.study(robustness_settings(settings, keys))
        with reporting("robustness", progress) as step, ledger_or_memory(problem.ledger) as ledger:
            run = RobustnessRun(ledger, study.settings.robustness, posterior, progress=step)
            return robustness_result(robustness_at(study, self.values, run))

    def pareto(
        self,
        *,
        reduction: bool | Mapping[str, Any] | None = None,
        executor: AnyExecutor | None = None,
        progress: bool = True,
        **keys: Unpack[ParetoKeys],
    ) -> AnalysisResult[Pareto]:
        """Weigh two groups of responses against each other: the Pareto front by NSGA-II (Deb et al. 2002).

        Parameters
        ----------
        reduction, executor, progress
            As in `calib.Problem.calibrate`.
        **keys
            ``objectives``, two groups by name, each a list of responses in which ``*`` stands for any text, by default
            frequencies against MAC; ``population`` (40), ``generations`` (50) and ``seed``.

        Raises
        ------
        InputError
            For groups that match no response or overlap.
        """
        from calib.analyses.pareto import ParetoRun, pareto_at

        problem = self.problem
        settings = calibration_settings(problem.settings, {}, None, None, reduction, "pareto")
        study = problem.study(pareto_settings(settings, keys))
        with (
            injected(executor) as workers, reporting("pareto", progress) as step,
            ledger_or_memory(problem.ledger) as ledger,
        ):  # fmt: skip
            run = ParetoRun(ledger, study.settings.pareto, workers=workers, progress=step)
            return pareto_result(pareto_at(study, self.values, run))

    def figure(self, name: str, ax: Axes | None = None, *, test: str = "") -> Axes:
        """Draw one figure of the fit.

        Parameters
        ----------
        name : str
            ``frequency_errors``, ``mac``, ``comac`` (before and after the fit), ``mac_matrix``,
            ``cross_orthogonality``, ``self_orthogonality`` (after it) or ``parameters``.
        ax : Axes, optional
            Axes to draw on; a new figure by default.
        test : str
            Name of the test, where there are several.

        Raises
        ------
        InputError
            For an unknown figure or test, and where the data for it were not measured.
        """
        from calib.api.page import draw_figure

        return draw_figure(self, name, test, ax)

    def report(self, path: str | Path) -> tuple[Path, ...]:
        """Write an HTML report of the fit that opens offline; several tests are told in one.

        Raises
        ------
        InputError
            Where it cannot be written.
        """
        from calib.api.page import write_page

        return (write_page(self, path_of(path, "report")),)


def calibrated_fit(
    problem: P,
    verb: str,
    keys: Mapping[str, Any],
    cases: int | Sequence[int] | None,
    seed: int | None,
    effects: Candidates,
    reduction: bool | Mapping[str, Any] | None,
    executor: AnyExecutor | None,
    progress: bool,
) -> Fit[P]:
    """See `calib.api.problem.Problem.calibrate`."""
    settings = calibration_settings(problem.settings, keys, cases, seed, reduction, verb)
    study = problem.study(settings, lacking_effects(problem, effects))
    with (
        injected(executor) as workers, reporting(verb, progress) as step, ledger_or_memory(problem.ledger) as ledger,
        tasks_shared(workers),
    ):  # fmt: skip
        found = run_calibration(study, CalibrationRun(ledger, workers=workers, progress=step))
    best = found.seen(study.studies[0].test).best
    # What is stated of levels, of the mesh and of weights holds for what is asked of the fit, too.
    held: Any = problem
    stated, own = settings.calibration, problem.settings.calibration
    weights = {name: getattr(stated, name) for name in ("weight_freq", "weight_mac")}
    changed = {name: weight for name, weight in weights.items() if weight != getattr(own, name)}
    update = {"explain": settings.explain, "calibration": own.model_copy(update=changed)}
    return Fit(replace(held, settings=problem.settings.model_copy(update=update)), best.statistics, found)


def assessed_at(problem: P, values: Mapping[str, float]) -> Fit[P]:
    """See `calib.api.problem.Problem.statistics_at`."""
    study = problem.study()
    with reporting("statistics_at", False), ledger_or_memory(problem.ledger) as ledger:
        return Fit(problem, CaseFinder(study, ledger).statistics_at(values))
