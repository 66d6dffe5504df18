"""Problem: models and their tests over one parameter space, with every analysis as a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from calib.analyses.compare import comparison_of
from calib.analyses.fit_statistics import Terms, fitted, statistics_at
from calib.analyses.uncertainty import in_words
from calib.api.display import Compared
from calib.api.explained import Explained, explained, library_of
from calib.api.fit import Fit
from calib.api.pairs import by_model, holding, including, opened, posed, require_names, require_within, told
from calib.api.protocols import Effects, Finer
from calib.api.responses import own
from calib.api.search import refined, searched
from calib.api.sensitivity import Assessed, assessed
from calib.errors.arguments import integer, objects
from calib.errors.arguments import names as names_of
from calib.errors.arguments import values as values_of
from calib.execution.executor import Injected
from calib.experiment.modal import TESTS, Model, Test, under
from calib.hypotheses.linear_start import linear_starts
from calib.inference.genetic import GeneticSettings
from calib.inference.rules import RULES
from calib.problem.joint import JointProblem
from calib.problem.problem import Problem as Posed
from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.structure.function_model import FunctionModel
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """Models and their tests over one parameter space.

    Nothing is written to disk unless a ledger is named; a study in a folder (`calib.Study`) stores its results.

    Attributes
    ----------
    model : StructuralModel, ModalFunctionModel or FunctionModel
    tests : ModalTest, FRFTest or ResponseTest, or a sequence of them
        Tests of that model, each under its own condition.
    beside : tuple of Problem
        Other models with their tests; parameters of the same name are shared. See `join`.
    ledger : str or Path, optional
        File in which solved points of fits, searches and samples are kept and looked up, made where there is none: the
        same call again solves none of them. `compare` and `explain` keep none. The key of a point holds all
        parameter values, and matrices or the function's file, its code and the objects it holds; name another file
        when something else changes that a function reads. Of joined problems that of the first counts.
    unselected : tuple of str
        Parameters that `keep` has left out.

    Raises
    ------
    InputError
        Where models, tests and parameters are inconsistent.

    Examples
    --------
    A mass on a spring; its frequency was measured empty and loaded with 25 kg:

    >>> import math
    >>> import calib
    >>> space = calib.ParameterSpace((
    ...     calib.Parameter("k", 30.0, 1.0, 100.0, "kN/m"), calib.Parameter("m", 7.0, 1.0, 50.0, "kg"),
    ...     calib.Parameter("load", 0.0, 0.0, 50.0, "kg"),
    ... ))
    >>> def frequency(v):
    ...     return {"f": math.sqrt(1e3 * v["k"] / (v["m"] + v["load"])) / (2 * math.pi)}
    >>> model = calib.FunctionModel("oscillator", space, frequency)
    >>> empty = calib.ResponseTest({"f": (10.066, 0.01)}, name="empty", condition={"load": 0.0})
    >>> loaded = calib.ResponseTest({"f": (5.380, 0.005)}, name="loaded", condition={"load": 25.0})
    >>> fit = calib.Problem(model, [empty, loaded]).calibrate()
    >>> round(fit.values["k"]), round(fit.values["m"])
    (40, 10)
    """

    model: Model
    tests: Test | Sequence[Test]
    beside: tuple[Problem, ...] = ()
    ledger: str | Path | Ledger | None = None
    unselected: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        objects([self.model], (StructuralModel, ModalFunctionModel, FunctionModel), "problem, model")
        tests = objects(self.tests, TESTS, "problem, tests")
        object.__setattr__(self, "tests", tests[0] if len(tests) == 1 else tests)
        object.__setattr__(self, "beside", objects(self.beside, Problem, "problem, beside"))
        object.__setattr__(self, "ledger", opened(self.ledger))
        require_names(self._given)
        require_within(self.space)  # building the space raises any other inconsistency

    @staticmethod
    def join(first: Problem, *others: Problem) -> Problem:
        """Several problems as one; parameters of the same name are shared, see `calib.problem.joint.joined`."""
        first, *rest = objects((first, *others), Problem, "join")
        return replace(first, beside=(*first.beside, *rest))

    @property
    def _tests(self) -> tuple[Test, ...]:
        return (self.tests,) if isinstance(self.tests, TESTS) else tuple(self.tests)

    @property
    def pairs(self) -> tuple[tuple[Model, Test], ...]:
        """Every test with its model, whose parameters are fixed as the test's condition says."""
        return tuple((under(model, test.name, test.condition), test) for model, test in self._given)

    @property
    def _given(self) -> tuple[tuple[Model, Test], ...]:
        """Every test with its model, no condition applied, joined problems after this one."""
        own = tuple((self.model, test) for test in self._tests)
        every = (*own, *(pair for problem in self.beside for pair in problem._given))
        return tuple((model, test.beside) for model, test in every) if len(every) > 1 else every

    @property
    def by_model(self) -> tuple[tuple[Model, tuple[Test, ...]], ...]:
        """Every model, no condition applied, with all of its tests."""
        return by_model(self._given)

    @property
    def space(self) -> ParameterSpace:
        """All parameters except those that a test's condition sets; free are those that a fit may move."""
        return self.posed.space

    @cached_property
    def posed(self) -> Posed[Any] | JointProblem:
        """Rows, responses, residual and Jacobian, as fits use them."""
        return posed(self.pairs, self.ledger)

    def __repr__(self) -> str:
        pairs = ", ".join(f"{model.name} against {test.name}" for model, test in self.pairs)
        return f"Problem({pairs}; {len(self.posed.rows)} rows, {len(self.space.free)} free parameters)"

    def keep(self, names: Sequence[str]) -> Problem:
        """A copy with only the named parameters free; the others keep their nominal values."""
        kept = self.space.keep(names_of(names, "parameters"))
        held = holding(self, {p.name: p.value for p in kept.parameters if p.distribution == "fixed"})
        left_out = (name for name in self.space.free_names if name not in kept.free_names)
        return replace(held, unselected=(*self.unselected, *left_out))

    def with_effects(self, effects: Effects) -> Problem:
        """A copy with effects in its model, their magnitudes free.

        Models of joined problems are unchanged, unless effects are given by the name of the model.
        """
        return including(self, library_of(self, effects))

    # -- analyses ------------------------------------------------------------------------------------------------------

    def compare(self, values: Mapping[str, float] | None = None) -> Compared:
        """Compare models and tests at given values, by default the nominal ones, without fitting.

        Raises
        ------
        EvaluationError
            Where a model cannot be solved.
        """
        complete = self._complete({} if values is None else values)
        with told("compare", False):
            found = {t.name: comparison_of(t.problem(model), own(model, t, complete)) for model, t in self.pairs}
        return Compared(found)

    def calibrate(
        self, parameters: Sequence[str] = (), *, starts: int = 1, seed: int = 1, progress: bool = True
    ) -> Fit[Problem]:
        """Fit by weighted least squares with the priors, and assess which parameters the data determine.

        Parameters
        ----------
        parameters : sequence of str
            Parameters to fit; all free ones by default.
        starts : int
            Number of starting points: the nominal values, then Latin hypercube points. FRFs add the solution of the
            linear cross-model equations.
        seed : int
            Seed of these points.
        progress : bool
            Whether a terminal or a notebook shows how far it is.

        Raises
        ------
        InputError
            For an unknown or a fixed parameter.
        EvaluationError
            When no start can be evaluated.
        """
        starts, seed = integer(starts, 1, "starts"), integer(seed, 0, "seed")
        problem = self._of(parameters)
        space = problem.space
        sampled = sample(space, starts - 1, seed).points if starts > 1 else ()
        linear = linear_starts(problem.posed, space.values)
        points = [*linear, space.values, *(space.complete(point) for point in sampled)]
        with told("calibrate", progress) as heard:
            return Fit(problem, fitted(problem.posed, problem.terms, points, RULES.refits_in_notebook, told=heard))

    def search(
        self,
        parameters: Sequence[str] = (),
        *,
        cases: int = 3,
        population: int = 30,
        generations: int = 250,
        seed: int = 1,
        executor: Executor | Injected | None = None,
        progress: bool = True,
    ) -> Fit[Problem]:
        """Fit by genetic searches from several seeds, followed by least squares.

        The search minimises the sum over all tests of relative frequency errors and MAC deficits, or of relative errors
        of scalar responses (Ribeiro et al. 2013). Least squares, as in `calibrate`, then start from the end of every
        case and from the nominal values; the solution of the latter is taken only where the data clearly prefer it.
        The fit's ``search`` holds the results of the searches alone. Models are solved at full order: only a study
        searches on a reduced basis.

        Parameters
        ----------
        parameters : sequence of str
            Parameters to fit; all free ones by default.
        cases : int
            Number of independent searches, with seeds ``seed, seed + 1, ...``; their agreement shows whether the
            solution is unique.
        population, generations : int
            Each case requests ``population * generations`` points; further settings are those of
            `calib.inference.genetic.GeneticSettings`.
        seed : int
            Seed of the first case. Same seed, same fit, whatever the executor.
        executor : concurrent.futures.Executor or calib.execution.executor.Injected, optional
            Evaluates the points of a generation; this process by default. Threads suit models that are solved outside
            Python; other processes must be able to import the model's functions. The caller shuts it down.
        progress : bool
            As in `calibrate`.

        Raises
        ------
        InputError
            For an unknown or a fixed parameter, and a model that cannot be sent to the executor's processes.
        EvaluationError
            When no point of an initial population can be evaluated.

        Examples
        --------
        Two pairs of stiffnesses fit the two frequencies of a chain; its sag discriminates between them. Least squares
        alone stay at the pair near which they start:

        >>> import numpy as np
        >>> import calib
        >>> space = calib.ParameterSpace((
        ...     calib.Parameter("k1", 12.0, 1.0, 20.0, "kN/m"), calib.Parameter("k2", 2.0, 1.0, 10.0, "kN/m"),
        ... ))
        >>> def chain(v):
        ...     stiffness = 1e3 * np.array([[v["k1"] + v["k2"], -v["k2"]], [-v["k2"], v["k2"]]])
        ...     low, high = np.sqrt(np.linalg.eigvalsh(stiffness / 10.0)) / (2 * np.pi)
        ...     return {"f1": low, "f2": high, "sag": 98.1 / v["k1"]}
        >>> measured = calib.ResponseTest({"f1": (2.06, 0.01), "f2": (6.02, 0.03), "sag": (24.5, 2.0)})
        >>> problem = calib.Problem(calib.FunctionModel("chain", space, chain), measured)
        >>> round(problem.calibrate().values["k1"])
        12
        >>> fit = problem.search(cases=2, population=10, generations=20)
        >>> round(fit.values["k1"]), round(fit.values["k2"])
        (4, 6)
        >>> fit.search.table["asked"].tolist()
        [200, 200]
        """
        cases, seed = integer(cases, 1, "cases"), integer(seed, 0, "seed")
        settings = GeneticSettings(integer(population, 4, "population"), integer(generations, 1, "generations"))
        problem = self._of(parameters)
        with told("search", progress) as heard:
            found = searched(problem, range(seed, seed + cases), settings, executor, heard)
            return Fit(problem, refined(problem, found, heard), found)

    def sensitivity(
        self,
        parameters: Sequence[str] = (),
        *,
        samples: int = 500,
        seed: int = 1,
        executor: Executor | Injected | None = None,
        progress: bool = True,
    ) -> Assessed:
        """Global sensitivity: a Latin hypercube within the limits, rank correlations, variance shares, a selection.

        Parameters
        ----------
        parameters : sequence of str
            Parameters to vary; all free ones by default. The others keep their nominal values.
        samples : int
            Number of points that keep the constraints.
        seed : int
            Seed of the points.
        executor : concurrent.futures.Executor or calib.execution.executor.Injected, optional
            As in `search`.
        progress : bool
            As in `calibrate`.

        Raises
        ------
        InputError
            For an unknown or a fixed parameter, and for constraints that hardly any point keeps.
        EvaluationError
            When no point can be evaluated.

        Examples
        --------
        The frequency of a beam depends mostly on its thickness, and not on its colour:

        >>> import calib
        >>> space = calib.ParameterSpace((
        ...     calib.Parameter("thickness", 10.0, 8.0, 12.0, "mm"), calib.Parameter("length", 1.0, 0.95, 1.05, "m"),
        ...     calib.Parameter("colour", 0.5, 0.0, 1.0),
        ... ))
        >>> model = calib.FunctionModel("beam", space, lambda v: {"f": 0.8 * v["thickness"] / v["length"] ** 2})
        >>> found = calib.Problem(model, calib.ResponseTest({"f": 8.1})).sensitivity(samples=200)
        >>> found.selected
        ('thickness', 'length')
        >>> float(found.spearman["f"].round(1)["thickness"])
        0.9
        """
        samples, seed = integer(samples, 3, "samples"), integer(seed, 0, "seed")
        with told("sensitivity", progress) as heard:
            return assessed(self._of(parameters), samples, seed, executor, heard)

    def statistics_at(self, values: Mapping[str, float]) -> Fit[Problem]:
        """Fit statistics at given values, without fitting."""
        with told("statistics_at", False):
            return Fit(self, statistics_at(self.posed, self.terms, self._complete(values)))

    def _of(self, parameters: Sequence[str]) -> Problem:
        """The problem with only the named parameters free; itself without any names."""
        return self.keep(chosen) if (chosen := names_of(parameters, "parameters")) else self

    def _complete(self, values: Mapping[str, float]) -> dict[str, float]:
        return self.space.complete(values_of(values, "values"))

    def explain(
        self, effects: Effects = (), *, seed: int = 1, progress: bool = True, fixed_sd: str | None = None,
        finer: Finer = None, mesh_sd: float | None = None,
    ) -> Explained[Problem]:  # fmt: skip
        """Find which effects the models lack: calibrate, test, refit with promising effects, test the remaining misfit.

        Without effects it reports whether anything is missing, and which local perturbation fits best. All tests are
        analysed together. An effect acts in every test of its model.

        Parameters
        ----------
        effects : sequence of Effect, or mapping from str to sequences of them
            Effects that the model may lack; for joined problems by the name of the model. Effects of the same name are
            one effect.
        seed : int
            Seed of the samples behind probabilities and the recommended measurement.
        progress : bool
            As in `calibrate`.
        fixed_sd : str, optional
            Standard deviation of the parameters that `keep` or a fit left out, a share of their nominal values such as
            ``"3 %"``; exact by default.
        finer : StructuralModel, or mapping from str to StructuralModel, optional
            The model on a finer mesh, which tells the scores that are due to the mesh alone; by the name of the model.
        mesh_sd : float, optional
            Standard deviation of the error of the mesh, over the change that the finer mesh makes in the predictions;
            see `calib.correlation.mesh_error.MeshError`. Exact by default.

        Raises
        ------
        InputError
            Where too little was measured to name any effect, or a stated error is out of range.

        Examples
        --------
        A spring is fitted, the masses that it carries are taken from a list that may be off by 5 %:

        >>> import calib
        >>> space = calib.ParameterSpace((
        ...     calib.Parameter("k", 10.0, 5.0, 20.0), calib.Parameter("m", 2.0, 1.0, 4.0),
        ... ))
        >>> def responses(v):
        ...     return {"k": v["k"], "m": 9.81 * v["m"], "sum": v["k"] + v["m"], "rest": v["k"] - v["m"]}
        >>> test = calib.ResponseTest({"k": (10.1, 0.1), "m": (20.2, 0.1), "sum": (12.2, 0.1), "rest": (8.0, 0.1)})
        >>> problem = calib.Problem(calib.FunctionModel("spring", space, responses), test).keep(["k"])
        >>> problem.explain(progress=False).verdict
        'none_explains'
        >>> problem.explain(fixed_sd="5 %", progress=False).verdict
        'nothing_detectable'
        """
        return explained(self, effects, seed, progress, fixed_sd, finer, mesh_sd)

    @property
    def terms(self) -> Terms:
        """Inputs of the fit statistics besides the rows."""
        return Terms(assumed=in_words(a for _, test in self.pairs for a in test.assumed))
