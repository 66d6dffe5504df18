"""A study: one model, one measurement and the settings of their analyses, read from ``study.toml``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.response.problem import Targets
from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.experiment import Test
from calib.experiment.held_out import HeldOutGroups
from calib.experiment.test import ForwardProblem, Residual
from calib.measurement.disagreements import Disagreement
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import digest_of, digest_of_files
from calib.structure.effects.perturbations import scaling_by_function
from calib.structure.function_model import FunctionModel
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.study.experiment import experiment_of, problem_of, with_place
from calib.study.limits import parameter_hints, search_space, sensitivity_space
from calib.study.loading import Model, Sources, fingerprint_of, lacking, with_effects
from calib.study.study_file import Measured, StudyFile

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class LoadedStudy(StudyFile):
    """Model and measurement of one study, checked, with held-out data removed.

    Attributes
    ----------
    model : StructuralModel, ModalFunctionModel or FunctionModel
        With the study's effects, parameter values, limits and constraints.
    experiment : ModalTest, FRFTest or ResponseTest
        What was measured, and how it is compared with the model.
    problem : ModalProblem, FunctionProblem or FRFProblem
        Named parameters in, named responses out; with the data in use.
    sensitivity_space, search_space : ParameterSpace
        All free parameters within their limits; the selected ones within the limits of the search.
    library : tuple of Effect
        Every effect of the study's library, in its model or not.
    adopted, adopted_sd : mapping from parameter name to value
        Values adopted from an earlier study, and the standard deviations of those that this one holds.
    initial : mapping from parameter name to value
        All values before any calibration; adopted parameters have the model's own value.
    hints : tuple of str
        Warnings of values that may be in another unit than the model's parameter.
    read_files : mapping from path to digest
        Named files and all code as they were when the study was read; see `file_digests`.
    library_digest : str
        Hash over the functions that build the effects and their source files.
    base : StructuralModel, ModalFunctionModel or FunctionModel, optional
        The model before effects were added; None where none are.
    """

    model: Model
    experiment: Test
    problem: ForwardProblem
    sensitivity_space: ParameterSpace
    search_space: ParameterSpace
    library: tuple[Effect, ...] = ()
    adopted: Mapping[str, float] = field(default_factory=dict)
    adopted_sd: Mapping[str, float] = field(default_factory=dict)
    initial: Mapping[str, float] = field(default_factory=dict)
    hints: tuple[str, ...] = ()
    read_files: Mapping[str, str] = field(default_factory=dict)
    library_digest: str = ""
    base: Model | None = None

    in_memory: ClassVar[bool] = False
    """Whether it has no folder; see `calib.study.in_memory`."""

    @property
    def model_key(self) -> str:
        """Same for the tests of one model."""
        return repr((self.settings.model, self.settings.model_options))

    @property
    def model_label(self) -> str:
        """What tells its model from those of other tests."""
        return self.test

    @property
    def states_mesh(self) -> bool:
        """Whether an explanation counts an error of its mesh, where one is stated: that of numbers does not."""
        return self.experiment.shows_mesh

    @property
    def unselected(self) -> tuple[str, ...]:
        """Free parameters that a selection leaves out, those that a condition or an earlier study holds excepted."""
        held = {*self.search_space.free_names, *self.condition, *self.adopted}
        return tuple(name for name in self.sensitivity_space.free_names if name not in held)

    @property
    def studies(self) -> tuple[LoadedStudy, ...]:
        """The study itself, its only test; see `calib.study.several.JointStudy`."""
        return (self,)

    def each(self, change: Callable[[LoadedStudy], LoadedStudy]) -> LoadedStudy:
        """A copy with ``change`` applied, as for every test of a `calib.study.several.JointStudy`."""
        return change(self)

    @property
    def space(self) -> ParameterSpace:
        """All parameters, those of its test's nuisances included."""
        return self.problem.space

    @property
    def held_sd(self) -> dict[str, float]:
        """Standard deviations of the held parameters whose values are uncertain.

        These are adopted ones, as an earlier study left them, and those that a selection leaves out, by their priors.
        Integers count as exact: they have no derivative. Those that an explanation fits along are not held.
        """
        fitted = self.search_space.free_names
        adopted = {name: sd for name, sd in self.adopted_sd.items() if sd > 0}
        left_out = (self.model.space[name] for name in self.unselected if name not in (*adopted, *fitted))
        return adopted | {p.name: p.prior_width for p in left_out if not p.integer and p.lower < p.upper}

    def measurement(self) -> Measured:
        """Everything that was measured, as it was when the study was read; for verification only."""
        found: Measured = self.experiment.measured
        return found

    @property
    def whole(self) -> MeasuredModes | None:
        """All modes; None where scalar responses or FRFs were measured."""
        return self.experiment.measured_modes

    @property
    def frfs(self) -> MeasuredFRFs | None:
        """All FRFs; None where modes or scalar responses were measured."""
        return self.experiment.measured_frfs

    @property
    def measured(self) -> MeasuredModes | None:
        """Modes in use; None where scalar responses or FRFs were measured."""
        return self.experiment.fitted_modes

    @property
    def targets(self) -> Targets:
        """Scalar responses in use; empty where modes or FRFs were measured."""
        return self.experiment.fitted_responses

    @property
    def pair(self) -> Residual:
        """The whitened residual of the problem."""
        return self.experiment.residual(self.problem)

    @property
    def solved_model(self) -> Any:
        """The model as the problem asks it, which may be behind a ledger."""
        return getattr(self.problem, "model", self.model)  # a problem of a function holds no model

    @property
    def unseen(self) -> HeldOutGroups:
        """Held-out scalar responses or FRFs, by group; empty where modes were measured. For verification only."""
        return self.experiment.unseen

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Where one repeat of the measurement disagrees with the others."""
        return self.experiment.disagreements

    @property
    def repeats(self) -> int | None:
        """Repeats behind the measured values; None where a study of scalar responses does not state them."""
        return self.experiment.repeats

    @property
    def included(self) -> tuple[Effect, ...]:
        """Effects of the library that are in the model, in the order they were added."""
        known = {one.name: one for effect in self.library for one in effect.family}
        return tuple(known[name] for name in self.settings.with_effects)

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """Effects of the library that the model lacks, in whatever detail."""
        return lacking(self.library, self.settings.with_effects)

    def whole_problem(self) -> ModalProblem | None:
        """The modal problem over everything measured; None where no mode and no sensor is held out."""
        with with_place(self, self.model):
            return self.experiment.whole_problem(self.problem)

    @property
    def has_finer_mesh(self) -> bool:
        """Whether a finer mesh of its model is known."""
        return bool(self.settings.explain.finer_options)

    def on_finer_mesh(self) -> Model | None:
        """The model on a finer mesh, effects included; None when the study names no options for one."""
        finer = Sources(self.settings, self.folder, self.place).finer()
        return (
            None
            if finer is None
            else with_effects(self.experiment.located(finer), self.included, self.place("with_effects"))
        )

    def finer_model(self) -> StructuralModel | None:
        """The same of a model of matrices; None for others."""
        finer = self.on_finer_mesh()
        return finer if isinstance(finer, StructuralModel) else None

    def selecting(self, names: tuple[str, ...]) -> LoadedStudy:
        """The same study with the named parameters selected, for a selection left to the sensitivity analysis."""
        elsewhere = names if self.test else ()
        space = search_space(self.sensitivity_space, self.settings, self.place, names, elsewhere)
        space = with_nuisances(space, self.problem)
        return replace(self, search_space=space)

    @staticmethod
    def load(
        path: str | Path, adopted: Mapping[str, float] = _NONE, adopted_sd: Mapping[str, float] = _NONE, test: str = ""
    ) -> LoadedStudy:
        """Read a study folder (or its TOML file) with everything it names; InputError for anything wrong in it.

        ``adopted`` are fitted values of an earlier study, where this one adopts some, and ``adopted_sd`` their standard
        deviations as far as they are known; see `calib.analyses.staged`. Of several tests ``test`` is read; all of them
        together are a `calib.study.several.JointStudy`.
        """
        file = StudyFile.read(path_of(path, "study"), test)
        if file.settings.several:
            names = ", ".join(one.name for one in file.settings.tests)
            raise InputError(f"it has several tests, {names}", place=file.file, remedy="name one of them")
        read = file.file_digests  # before the code runs: later changes of the files are not part of this state
        return _study(file, read, adopted, adopted_sd)


def _study(
    file: StudyFile, read: Mapping[str, str], adopted: Mapping[str, float], adopted_sd: Mapping[str, float]
) -> LoadedStudy:
    """Load and check everything that a study's file names; see `LoadedStudy.load`."""
    sources = Sources(file.settings, file.folder, file.place, lambda: file.measured_sensors)
    base = sources.model()
    library = sources.library(base, lambda: _sensed(file, base))
    members = [(one.name, one.build) for effect in library for one in effect.family]
    digest = digest_of(members)[:16]  # before any effect is built, which may fill caches
    included = sources.included(library)
    model = with_effects(base, included, file.place("with_effects"))
    elsewhere = {name for _, name in file.settings.mentioned} if file.test else ()
    for name, value in file.condition.items():
        if name in model.space:
            try:
                model.space.held({name: value})
            except InputError as fault:
                raise InputError(fault.problem, place=file.place("set", name), remedy=fault.remedy) from None
    space = sensitivity_space(model.space, file.settings, file.place, adopted, elsewhere)
    hints = parameter_hints(model.space, file.settings)
    taken = file.settings.adopted.parameters if file.settings.adopted else ()
    initial = {**space.values, **{name: model.space[name].value for name in taken if name in model.space}}
    if isinstance(model, FunctionModel) and model.metamodels is not None:
        from calib.study.runs import require_within_runs  # metamodels are for tables of runs alone

        require_within_runs(model, space, file.place("parameters"))
    model = replace(model, space=space)
    for k, name in enumerate(file.settings.depends_on):
        file.path(name, "depends_on", k)
    experiment = experiment_of(file, model)
    base, model = experiment.located(base), experiment.located(model)
    model = _identified(file, base, included, model)
    problem = problem_of(file, experiment, model, base)
    selected = with_nuisances(search_space(space, file.settings, file.place, elsewhere=elsewhere), problem)
    if not file.settings.calibration.weight_freq + file.settings.calibration.weight_mac > 0:
        place = file.place("calibration", "weight_freq")
        raise InputError("both weights are zero", place=place, remedy="give one of them weight")
    sd = {n: adopted_sd[n] for n in taken if n in adopted_sd}
    return LoadedStudy(
        file.name, file.file, file.settings, model, experiment, problem, space, selected, library, dict(adopted), sd,
        initial, hints, read, digest, base if included else None, part=file.part,
    )  # fmt: skip


def _sensed(file: StudyFile, base: Model) -> tuple[Model, list[MeasuredModes | MeasuredFRFs]]:
    """The model as its tests locate sensors on it, and what they measured at sensors, held-out data excepted."""
    own = file.settings.model, file.settings.model_options
    tests = [one for one in StudyFile.read(file.file).parts if (one.settings.model, one.settings.model_options) == own]
    experiments = [experiment_of(one, base) for one in tests]
    located: Any = experiments[0].located(base)
    for one, experiment in zip(tests, experiments, strict=True):
        with with_place(one, base):  # a sensor that lies off the model is told as without generic effects
            for data in experiment.sensed if isinstance(base, StructuralModel) else ():
                located.sensor_rows(data.sensors)
    return located, [data for one in experiments for data in one.sensed]


def with_nuisances(space: ParameterSpace, problem: ForwardProblem) -> ParameterSpace:
    """Parameters of a search and those of a test's nuisances, which are always fitted."""
    own = tuple(p for p in problem.space.parameters if p.name not in space)
    return ParameterSpace(space.parameters + own, space.constraints) if own else space


def _identified(file: StudyFile, base: Any, included: tuple[Effect, ...], model: Model) -> Model:
    """A function with a hash over it and its effects, its options, all code in the study's folder, and what it reads.

    The files that it depends on are named in the study. Matrices identify themselves.
    """
    if isinstance(model, StructuralModel):
        return model
    files = [*file.code_files, *(file.path(name, "depends_on") for name in file.settings.depends_on)]
    function, code = fingerprint_of(base, included, model), digest_of_files(files, file.folder)
    return replace(model, identity=digest_of(function, file.settings.model_options, code)[:16])


@dataclass(frozen=True)
class EvaluationSource:
    """Builds a study's evaluation function in another process.

    Attributes
    ----------
    path : str
        The study file.
    fingerprint : str
        Of the problem at the start; a study edited meanwhile is refused.
    basis : str
        File of a reduced basis to work on; empty for full order.
    adopted : tuple of (parameter name, value)
        Adopted from an earlier study.
    test : str
        Name of the test, if there are several.
    """

    path: str
    fingerprint: str
    basis: str = ""
    adopted: tuple[tuple[str, float], ...] = ()
    test: str = ""

    @classmethod
    def of(cls, study: LoadedStudy, problem: ForwardProblem, basis: Path | None = None) -> EvaluationSource:
        """The source of a problem of the study, which may be reduced to a basis in a file."""
        file = "" if basis is None else str(basis.resolve())
        return cls(str(study.file.resolve()), problem.fingerprint, file, tuple(study.adopted.items()), study.test)

    def __call__(self) -> Callable[[Mapping[str, float]], Mapping[str, float]]:
        """The function from named values to named responses."""
        study = LoadedStudy.load(Path(self.path), dict(self.adopted), test=self.test)
        problem: Any = study.problem
        if self.basis:
            problem = problem.reduced(Basis.load(Path(self.basis)))
        if problem.fingerprint != self.fingerprint:
            raise InputError(
                "the study or its model changed while it was running, or the model holds something that differs each "
                "time it is built (a temporary folder, a time stamp)",
                place=self.path,
                remedy="start the command again, or create such things inside the function",
            )
        known: Callable[[Mapping[str, float]], Mapping[str, float]] = problem.evaluate
        return known if problem.user_function is None else _Extendable(study).evaluate


@dataclass(frozen=True, eq=False)
class _Extendable:
    """The function of a study, extended by those of its library's effects and its parts that are among the values.

    A function of modes returns them as numbers, see `calib.structure.modal_result.mode_numbers`.
    """

    study: LoadedStudy
    _made: dict[tuple[str, ...], Callable[[Mapping[str, float]], dict[str, float]]] = field(
        init=False, repr=False, default_factory=dict
    )

    def evaluate(self, values: Mapping[str, float]) -> dict[str, float]:
        """As `FunctionProblem.evaluate`; effects are added in the order of the values."""
        own: Any = self.study.model
        of_library = [one for effect in self.study.candidates for one in effect.family]
        owner = {effect.name: effect for effect in (*of_library, *map(scaling_by_function, own.parts))}
        effects = {owner[name].name: owner[name] for name in values if name in owner}
        key = tuple(effects)
        if key not in self._made:
            model = with_effects(self.study.model, tuple(effects.values()), str(self.study.file))
            problem: Any = self.study.problem
            extended = problem.with_model(model)
            self._made[key] = extended.numbers_function or extended.evaluate
        return self._made[key](values)
