"""Problem: models and their tests over one parameter space, with every analysis as a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from calib.api.arguments import DEFAULTS, CalibrationKeys, ExplainKeys, SearchKeys
from calib.api.pairs import (
    by_model,
    fit_problem_of,
    holding,
    including,
    ledger_at,
    library_of,
    require_names,
    require_within,
    studied,
    under,
)
from calib.api.protocols import Candidates, Effects, Finer
from calib.errors.arguments import names as names_of
from calib.errors.arguments import objects
from calib.errors.arguments import values as values_of
from calib.execution.executor import AnyExecutor
from calib.experiment import TESTS, Test
from calib.experiment.test import Model
from calib.problem.effect import Effect
from calib.problem.joint import JointProblem
from calib.problem.problem import PairProblem as OneTestProblem
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.structure.function_model import FunctionModel
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.study.in_memory import TestedModel
from calib.study.settings import StudySettings
from calib.study.several import AnyStudy

if TYPE_CHECKING:
    from calib.api.display import Compared
    from calib.api.explained import Explained
    from calib.api.fit import Fit
    from calib.api.sensitivity import Assessed


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
        File that keeps solved points of fits, searches and samples: the same call again solves none of them. `compare`
        and `explain` keep none. The key of a point holds all parameter values, and matrices or the function's file,
        code and objects; name another file when something else changes that it reads. That of the first problem counts.
    unselected : tuple of str
        Parameters that `keep` has left out.
    settings : StudySettings
        Keys of the analyses that no argument gives; those of its file, of a problem that comes from a study.
    base : the same as model, optional
        The model before effects were added.
    held_sd : mapping from str to float
        Standard deviations of held parameters that an earlier study determined.
    finer : mapping from str to StructuralModel, ModalFunctionModel or FunctionModel
        Models on a finer mesh by the name of the model, for `calibrate` and, of matrices, `explain`.

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
    settings: StudySettings = DEFAULTS
    base: Model | None = None
    held_sd: Mapping[str, float] = field(default_factory=dict)
    finer: Mapping[str, Model] = field(default_factory=dict)

    def __post_init__(self) -> None:
        objects([self.model], (StructuralModel, ModalFunctionModel, FunctionModel), "problem, model")
        tests = objects(self.tests, Test, "problem, tests", such_as=TESTS)
        object.__setattr__(self, "tests", tests[0] if len(tests) == 1 else tests)
        object.__setattr__(self, "beside", objects(self.beside, Problem, "problem, beside"))
        object.__setattr__(self, "ledger", ledger_at(self.ledger))
        require_names([test for _, test in self._members])
        require_within(self.space)  # building the space raises any other inconsistency

    @classmethod
    def from_runs(cls, path: str | Path, inputs: Sequence[str], tests: Test | Sequence[Test], **more: Any) -> Problem:
        """The problem of a table of runs, ``more`` of `calib.study.runs.read_runs`; its ``model`` has metamodels."""
        from calib.study.runs import read_runs

        return cls(read_runs(path, inputs, **more), tests)

    @classmethod
    def from_solver(cls, command: str | Sequence[str], tests: Test | Sequence[Test], **more: Any) -> Problem:
        """The problem of a solver started for every evaluation, ``more`` of `calib.study.solver.solver_model`."""
        from calib.study.solver import solver_model

        return cls(solver_model(command, **more), tests)

    @staticmethod
    def join(first: Problem, *others: Problem) -> Problem:
        """Several problems as one; parameters of the same name are shared, see `calib.problem.joint.joined`."""
        first, *rest = objects((first, *others), Problem, "join")
        return replace(first, beside=(*first.beside, *rest))

    @property
    def _tests(self) -> tuple[Test, ...]:
        return (self.tests,) if isinstance(self.tests, Test) else tuple(self.tests)

    @property
    def pairs(self) -> tuple[tuple[Model, Test], ...]:
        """Every test with its model, whose parameters are fixed as the test's condition says."""
        return tuple((one.held, one.test) for one in self.tested)

    @property
    def _members(self) -> tuple[tuple[Problem, Test], ...]:
        """Every test with the problem that holds its model, joined problems after this one."""
        own = tuple((self, test) for test in self._tests)
        every = (*own, *(pair for problem in self.beside for pair in problem._members))
        return tuple((problem, test.beside) for problem, test in every) if len(every) > 1 else every

    @cached_property
    def tested(self) -> tuple[TestedModel, ...]:
        """Every test with its model, as the analyses take them."""
        return tuple(
            TestedModel(one.model, under(one.model, test.name, test.condition), one.base or one.model, test)
            for one, test in self._members
        )

    @property
    def by_model(self) -> tuple[tuple[Model, tuple[Test, ...]], ...]:
        """Every model, no condition applied, with all of its tests."""
        return by_model([(one.model, test) for one, test in self._members])

    @property
    def space(self) -> ParameterSpace:
        """All parameters except those that a test's condition sets; free are those that a fit may move."""
        return self.fit_problem.space

    @cached_property
    def fit_problem(self) -> OneTestProblem[Any] | JointProblem:
        """Rows, responses, residual and Jacobian, as fits use them."""
        return fit_problem_of(self.tested, self.ledger)

    def study(
        self, settings: StudySettings | None = None, effects: Mapping[str, tuple[Effect, ...]] | None = None,
        finer: Mapping[str, Model] | None = None,
    ) -> AnyStudy:  # fmt: skip
        """The problem as the analyses take it, with effects that its models may lack."""
        return studied(self, settings or self.settings, effects or {}, self.finer if finer is None else finer)

    def __repr__(self) -> str:
        pairs = ", ".join(f"{model.name} against {test.name}" for model, test in self.pairs)
        return f"Problem({pairs}; {len(self.fit_problem.rows)} rows, {len(self.space.free)} free parameters)"

    def keep(self, names: Sequence[str]) -> Problem:
        """A copy with only the named parameters free; the others keep their nominal values."""
        chosen_space = self.space.keep(names_of(names, "parameters"))
        held = holding(self, {p.name: p.value for p in chosen_space.parameters if p.distribution == "fixed"})
        others = (name for name in self.space.free_names if name not in chosen_space.free_names)
        return replace(held, unselected=(*self.unselected, *others))

    def with_effects(self, effects: Effects) -> Problem:
        """A copy with effects in its model, their magnitudes free.

        Models of joined problems are unchanged, unless effects are given by the name of the model.
        """
        return including(self, library_of(self, effects))

    # -- analyses ------------------------------------------------------------------------------------------------------

    def compare(self, values: Mapping[str, float] | None = None) -> Compared:
        """Compare models and tests at given values, by default the nominal ones; EvaluationError where one fails."""
        from calib.api.display import compared

        return compared(self, None if values is None else self._complete(values))

    def calibrate(
        self,
        parameters: Sequence[str] = (), *, cases: int | Sequence[int] | None = None, seed: int | None = None,
        effects: Candidates = (), reduction: bool | Mapping[str, Any] | None = None,
        executor: AnyExecutor | None = None, progress: bool = True, **keys: Unpack[CalibrationKeys],
    ) -> Fit[Problem]:  # fmt: skip
        """Fit the parameters as a study does, and assess which of them the data determine.

        By default least squares start from the nominal values and from sampled points until they agree. A genetic
        search follows where they do not, or comes first where integer parameters have many combinations. Models of many
        degrees of freedom are fitted on a reduced basis that grows where least squares lead, and searched on one that
        represents their modes within the limits; what is reported is solved at full order.

        Parameters
        ----------
        parameters : sequence of str
            Parameters to fit; all free ones by default.
        cases : int or sequence of int, optional
            Number of independent runs, with seeds ``seed, seed + 1, ...``, or their seeds; one by default.
        seed : int, optional
            Seed of the first case. Same seed, same fit, whatever the executor.
        effects : sequence of Effect, mapping from str to sequences of them, or "generic"
            Effects that the models may lack, as in `explain`: where a fit is rejected, its intervals with the misfit
            take each of them as present a little. A study takes those of its library.
        reduction : bool or mapping, optional
            Whether large models are reduced, or keys of ``[reduction]``: ``use``, ``tolerance``, ``seed``.
        executor : concurrent.futures.Executor or calib.execution.executor.Injected, optional
            Evaluates the points of a search; this process by default. Threads suit models that are solved outside
            Python; other processes must be able to import the model's functions. The caller shuts it down.
        progress : bool
            Whether a terminal or a notebook shows how far it is.
        **keys
            As in ``study.toml``, with the same defaults: ``method`` (``"auto"``, ``"genetic"``, ``"gauss-newton"`` or
            ``"cmcf"``), ``starts`` (of ``"gauss-newton"``, which it asks for), ``refine``, ``begin_at``,
            ``start_population``, ``weight_freq``, ``weight_mac``, ``population``, ``generations``, ``crossover``,
            ``mutation``, ``sigma_start``, ``sigma_end``, ``freq_kind``, ``varies`` (parameters with a value of their
            own in each test), and of ``[explain]`` ``alpha`` and ``mesh_sd`` (error of the mesh, over the change to
            that of ``finer``); see `calib.study.search_settings.CalibrationSettings`.

        Raises
        ------
        InputError
            For an unknown or a fixed parameter, an effect that cannot be built, and a key or a value that a study's
            file could not have.
        EvaluationError
            Where no start can be evaluated.
        """
        from calib.api.fit import calibrated_fit

        own = self._of(parameters)
        return calibrated_fit(own, "calibrate", keys, cases, seed, effects, reduction, executor, progress)

    def search(
        self,
        parameters: Sequence[str] = (), *, cases: int | Sequence[int] = 3, seed: int | None = None,
        effects: Candidates = (), reduction: bool | Mapping[str, Any] | None = None,
        executor: AnyExecutor | None = None, progress: bool = True, **keys: Unpack[SearchKeys],
    ) -> Fit[Problem]:  # fmt: skip
        """Fit by genetic searches from several seeds, followed by least squares: `calibrate` by ``"genetic"``.

        The search minimises the sum over all tests of relative errors of frequencies and scalar responses and of MAC
        deficits (Ribeiro et al. 2013); least squares follow from the end of every case. The fit's ``search`` holds the
        results of the searches alone; their agreement shows whether the solution is unique.

        Parameters
        ----------
        parameters, cases, seed, effects, reduction, executor, progress, **keys
            As in `calibrate`.

        Raises
        ------
        InputError, EvaluationError
            As `calibrate`; InputError also for a model that cannot be sent to the executor's processes.
        """
        from calib.api.fit import calibrated_fit

        own, genetic = self._of(parameters), {**keys, "method": "genetic"}
        return calibrated_fit(own, "search", genetic, cases, seed, effects, reduction, executor, progress)

    def sensitivity(
        self,
        parameters: Sequence[str] = (),
        *,
        method: Literal["ranks", "morris", "sobol"] = "ranks",
        samples: int | None = None,
        seed: int | None = None,
        ignore_constraints: bool = False,
        executor: AnyExecutor | None = None,
        progress: bool = True,
    ) -> Assessed:
        """Global sensitivity: a Latin hypercube within the limits, rank correlations, variance shares, a selection.

        Parameters
        ----------
        parameters : sequence of str
            Parameters to vary; all free ones by default. The others keep their nominal values.
        method : {"ranks", "morris", "sobol"}
            The last two are elementary effects and variance shares, for independent inputs.
        samples, seed : int, optional
            Number of points that keep the constraints, 500 by default, and their seed, 1 by default.
        ignore_constraints : bool
            Whether ``"morris"`` and ``"sobol"`` ignore the constraints. Executor and progress are as in `calibrate`.

        Raises
        ------
        InputError
            For an unknown or a fixed parameter, and for constraints that hardly any point keeps.
        EvaluationError
            When no point can be evaluated.
        """
        from calib.api.sensitivity import assessed

        own = self._of(parameters)
        return assessed(own, method, {"samples": samples, "seed": seed}, ignore_constraints, executor, progress)

    def statistics_at(self, values: Mapping[str, float]) -> Fit[Problem]:
        """Fit statistics at given values, without fitting."""
        from calib.api.fit import assessed_at

        return assessed_at(self, self._complete(values))

    def _of(self, parameters: Sequence[str]) -> Problem:
        """The problem with only the named parameters free; itself without any names."""
        return self.keep(chosen) if (chosen := names_of(parameters, "parameters")) else self

    def _complete(self, values: Mapping[str, float]) -> dict[str, float]:
        return self.space.complete(values_of(values, "values"))

    def explain(
        self,
        effects: Candidates = (),
        *,
        finer: Finer = None,
        reduction: bool | Mapping[str, Any] | None = None,
        executor: AnyExecutor | None = None,
        progress: bool = True,
        **keys: Unpack[ExplainKeys],
    ) -> Explained[Problem]:
        """Find which effects the models lack: calibrate, test, refit with promising effects, test the remaining misfit.

        Without effects it reports whether anything is missing, and which local perturbation fits best. All tests are
        analysed together. An effect acts in every test of its model.

        Parameters
        ----------
        effects : sequence of Effect, mapping from str to sequences of them, or "generic"
            Effects that the model may lack; for joined problems by the name of the model. Effects of the same name are
            one effect. ``"generic"`` composes them of each model's own parts, joints, supports and points.
        finer : StructuralModel, or mapping from str to StructuralModel, optional
            The model on a finer mesh, which tells the scores that are due to the mesh alone; by the name of the model.
        reduction, executor, progress
            As in `calibrate`.
        **keys
            As under ``[explain]`` of ``study.toml``, with the same defaults: ``alpha`` (false-alarm rate), ``refits``
            (most promising effects that are fitted), ``merge`` (correlation from which effects are collinear),
            ``samples`` and ``seed`` (of probabilities and recommendation) and ``mesh_sd`` (standard deviation of the
            error of the mesh, over the change that the finer mesh makes; see
            `calib.correlation.mesh_error.MeshError`). Parameters that `keep` or a fit left out are uncertain by their
            ``prior_sd``.

        Raises
        ------
        InputError
            Where too little was measured to name any effect, or a key has a value that it cannot have.

        Examples
        --------
        A spring is fitted, the masses that it carries are taken from a list, which is exact or may be off by 5 %:

        >>> import calib
        >>> def responses(v):
        ...     return {"k": v["k"], "m": 9.81 * v["m"], "sum": v["k"] + v["m"], "rest": v["k"] - v["m"]}
        >>> test = calib.ResponseTest({"k": (10.1, 0.1), "m": (20.2, 0.1), "sum": (12.2, 0.1), "rest": (8.0, 0.1)})
        >>> def explained(**mass):
        ...     masses = calib.Parameter("m", 2.0, 1.0, 4.0, **mass)
        ...     space = calib.ParameterSpace((calib.Parameter("k", 10.0, 5.0, 20.0), masses))
        ...     problem = calib.Problem(calib.FunctionModel("spring", space, responses), test)
        ...     return problem.keep(["k"]).explain(progress=False).verdict
        >>> explained(distribution="fixed")
        'none_explains'
        >>> explained(prior_sd=0.1)
        'nothing_detectable'
        """
        from calib.api.explained import explained

        return explained(self, effects, keys, finer, reduction, progress, executor=executor)
