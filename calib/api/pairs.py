"""Models and their tests as a problem holds them: what it requires of them, and the study that the analyses take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

from calib.api.progress import in_python
from calib.errors.arguments import objects
from calib.errors.arguments import path as path_of
from calib.errors.errors import EvaluationError, InputError
from calib.errors.place import excerpt
from calib.execution.stage import Progress
from calib.experiment import Test
from calib.experiment.test import Model
from calib.problem.effect import Effect
from calib.problem.joint import JointProblem
from calib.problem.problem import Counts
from calib.problem.problem import PairProblem as OneTestProblem
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.study.in_memory import TestedModel, study_in_memory
from calib.study.loading import extended, lacking, require_distinct
from calib.study.measurement_settings import GENERIC
from calib.study.settings import StudySettings
from calib.study.several import AnyStudy

if TYPE_CHECKING:
    from calib.api.protocols import Candidates, Effects, ProblemLike


def ledger_at(ledger: Any) -> Ledger | None:
    """A ledger from a path, or as it is; InputError where the file cannot be written or is none."""
    if ledger is None or isinstance(ledger, Ledger):
        return ledger
    file = path_of(ledger, "problem, ledger")
    try:
        return Ledger.open(file)
    except InputError as fault:
        raise InputError(
            fault.problem, place=f"ledger {file}", remedy="name a new file in a folder that can be written"
        ) from None


def ledger_or_memory(ledger: Ledger | None) -> AbstractContextManager[Ledger]:
    """That ledger, which stays open, or one in memory."""
    return Ledger.in_memory() if ledger is None else nullcontext(ledger)


def require_names(tests: Sequence[Test]) -> None:
    """InputError without a test, and for two tests of one name."""
    if not tests:
        raise InputError("no test is given", place="problem", remedy="give a ModalTest, an FRFTest or a ResponseTest")
    names = [test.name for test in tests]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"two tests are named {name!r}", place="problem", remedy='give each its own, such as name="loaded"'
            )


def require_within(space: ParameterSpace) -> None:
    """InputError for a value of a free parameter outside its limits."""
    for p in space.free:
        if not p.lower <= p.value <= p.upper:
            raise InputError(
                f"value {p.value:g} {p.unit} is outside its limits [{p.lower:g}, {p.upper:g}]",
                place=f"parameter {p.name}", remedy="move one of them",
            )  # fmt: skip


class Paired(Protocol):
    """A model, and problems of other models beside it; see `calib.api.problem.Problem`."""

    @property
    def model(self) -> Any:
        """Its model."""
        ...

    @property
    def beside(self) -> Sequence[Any]:
        """Problems of other models."""
        ...


P = TypeVar("P", bound=Paired)


def holding(problem: P, values: Mapping[str, float]) -> P:
    """A problem whose models hold parameters at values, each those that it has."""
    space = problem.model.space.freeze({name: v for name, v in values.items() if name in problem.model.space})
    beside, changed = tuple(holding(p, values) for p in problem.beside), cast(Any, problem)
    return cast(P, replace(changed, model=replace(problem.model, space=space), beside=beside))


def including(
    problem: P, effects: Mapping[str, tuple[Effect, ...]], known: Mapping[str, float] = MappingProxyType({})
) -> P:
    """A problem whose models have effects, given by the name of the model; ``known`` are values that fit them."""
    own = effects.get(problem.model.name, ())
    model, changed = extended(problem.model, own) if own else problem.model, cast(Any, problem)
    beside = tuple(including(p, effects) for p in problem.beside)
    names = tuple(e.name for one in effects.values() for e in one)
    settings = changed.settings.model_copy(update={"with_effects": (*changed.settings.with_effects, *names)})
    base = changed.base or changed.model
    made = replace(changed, model=model, base=base, beside=beside, settings=settings)
    fitted = {name: float(value) for name, value in known.items() if name in made.space.free_names}
    if fitted:
        from calib.analyses.extend import beginning_at

        calibration = settings.calibration.model_copy(update=beginning_at(settings.calibration, fitted))
        made = replace(made, settings=settings.model_copy(update={"calibration": calibration}))
    return cast(P, made)


def under(model: Model, test: str, condition: Mapping[str, float]) -> Model:
    """A model with the parameters of a test's condition fixed; InputError for one that it lacks."""
    try:
        return replace(model, space=model.space.held(condition))
    except InputError as fault:
        raise InputError(fault.problem, place=f"condition of test {test}", remedy=fault.remedy) from None


def fit_problem_of(tested: Sequence[TestedModel], ledger: Any) -> OneTestProblem[Any] | JointProblem:
    """Rows, responses, residual and Jacobian of all tests; the space of each has its own parameters too.

    ``ledger`` is an opened one, or None.
    """
    counts, made = Counts(), dict[str, OneTestProblem[Any]]()
    for one in tested:
        pair = one.test.residual(one.test.problem(one.held, one.base))
        made[one.test.name] = OneTestProblem(pair, pair.space.without(dict(one.test.condition)), ledger, counts=counts)
    return next(iter(made.values())) if len(made) == 1 else JointProblem(made)


def studied(
    problem: Any,
    settings: StudySettings,
    effects: Mapping[str, tuple[Effect, ...]],
    finer: Mapping[str, Model],
) -> AnyStudy:
    """A problem in memory as the analyses take it; ``effects`` and ``finer`` by the name of the model."""

    def finer_of(tested: TestedModel) -> Any:
        found = finer.get(tested.model.name)
        if found is None:
            return None
        return under(found, tested.test.name, tested.test.condition)

    return study_in_memory(problem.tested, settings, effects, problem.unselected, problem.held_sd, finer_of)


def library_of(problem: ProblemLike, effects: Effects) -> dict[str, tuple[Effect, ...]]:
    """Effects by the name of the model; a plain sequence is for the first. InputError for an unknown model."""
    known = [model.name for model, _ in problem.by_model]
    if not isinstance(effects, Mapping):
        return {known[0]: objects(effects, Effect, "effects")}
    for name in effects:
        if name not in known:
            raise InputError(
                f"no model is named {name!r}", place="effects", remedy=f"the models are {', '.join(known)}"
            )
    return {name: objects(own, Effect, f"effects of {name}") for name, own in effects.items()}


def generic_of(problem: ProblemLike) -> dict[str, tuple[Effect, ...]]:
    """Effects composed of each model's own parts, joints, supports and points, by the name of the model."""
    from calib.structure.effects.compositions import generic_effects  # for these alone

    out, taken = dict[str, tuple[Effect, ...]](), list[str]()
    for name in dict.fromkeys(one.model.name for one in problem.tested):
        own = [one for one in problem.tested if one.model.name == name]
        base, sensed = own[0].test.located(own[0].base), [data for one in own for data in one.test.sensed]
        out[name] = generic_effects(base, sensed, taken)
        taken += [parameter for effect in out[name] for parameter in effect.names]
    return out


def lacking_effects(problem: ProblemLike, effects: Candidates) -> dict[str, tuple[Effect, ...]]:
    """Effects that a problem's models may lack, by the name of the model; those that they have are left out.

    InputError for an unknown model, and where two parameters share a name.
    """
    listed = generic_of(problem) if is_generic(effects) else library_of(problem, cast("Effects", effects))
    library = {name: lacking(own, problem.settings.with_effects) for name, own in listed.items()}
    for model, _ in problem.by_model:
        require_distinct(library.get(model.name, ()), model, "effects")
    return library


def is_generic(effects: Candidates) -> bool:
    """Whether effects are to be composed of the models' own parts."""
    return isinstance(effects, str) and effects == GENERIC


def by_model(pairs: Sequence[tuple[Model, Test]]) -> tuple[tuple[Model, tuple[Test, ...]], ...]:
    """Every model with all of its tests."""
    out: dict[str, tuple[Model, tuple[Test, ...]]] = {}
    for model, test in pairs:
        known, before = out.get(model.fingerprint, (model, ()))
        out[model.fingerprint] = (known, (*before, test))
    return tuple(out.values())


@contextmanager
def reporting(verb: str, progress: bool) -> Iterator[Progress]:
    """How far an analysis is; a failure of the user's code shows its line."""
    try:
        with in_python(verb, progress) as step:
            yield step
    except EvaluationError as fault:
        if fault.at is not None:
            fault.add_note("\n".join(excerpt(fault.at)))
        raise
