"""What a test can be asked about missing effects, whatever its model is made of."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.outcome import Outcome, key_of
from calib.problem import Counts, Label, Pair, Problem
from calib.space import ParameterSpace
from calib.structure.basis import Basis

NEUTRAL = 1e-4
"""Change of a row by an effect of strength 0, in standard deviations, up to which it counts as none."""

_REMEMBERED = 64
"""Points kept, so that a derivative does not solve a model again."""


def question_space(space: ParameterSpace, effects: Sequence[Effect]) -> ParameterSpace:
    """What is free in a question: the parameters of a calibration, and those of the effects in the model."""
    return ParameterSpace(space.parameters + tuple(p for e in effects for p in e.parameters), space.constraints)


class ModelVariants(Protocol):
    """One model with any of its possible effects.

    Such as `calib.structure.variants.Variants` of matrices and `calib.questions.function_variants.FunctionVariants`.
    """

    @property
    def model(self) -> Any:
        """The base model, whose parameters are all that the model is asked with."""
        ...

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Named effects."""
        ...

    @property
    def atoms(self) -> tuple[Effect, ...]:
        """Unnamed local changes."""
        ...

    @property
    def basis(self) -> Basis | None:
        """A reduced basis of the base model; None where none is used."""
        ...

    @property
    def calls(self) -> int | None:
        """Calls of a user's function so far; None where nothing of the user's is asked."""
        ...

    def added(self, names: Sequence[str]) -> int:
        """Modes more that the named effects bring."""
        ...

    def with_effects(self, names: Sequence[str]) -> Any:
        """A model whose parameters include those of the named effects and of every local change."""
        ...

    def built(self, names: Sequence[str]) -> Any:
        """The base model with the named effects alone, at full order and whatever their strength."""
        ...

    @property
    def unproven(self) -> Collection[str]:
        """Effects that may change the base model although their strength is 0, since a user's code adds them."""
        ...


class VariantPair(Pair, Protocol):
    """A test of a model that can be held against variants of that model."""

    def with_model(self, model: Any, added: int | None = None) -> Self:
        """The same test of another model; see `calib.correlation.residual.ModalResidual.with_model`."""
        ...

    def unpaired(self, solution: Any) -> frozenset[str]:
        """Measured modes for which a solution has no partner; none where nothing is paired."""
        ...


P = TypeVar("P", bound=VariantPair)


class Failure(NamedTuple):
    """A point at which a user's function gave no answer.

    Attributes
    ----------
    effects : tuple of str
        Effects and local changes that were not 0.
    outcome : Outcome
        Its values are those of the model's parameters and of these effects.
    """

    effects: tuple[str, ...]
    outcome: Outcome


@dataclass(frozen=True, eq=False)
class VariantProblem(Problem[P]):
    """A problem whose pair knows effects that its space lacks; they can be differentiated by.

    Attributes
    ----------
    hypotheses : ModelHypotheses
        To which it belongs.
    """

    hypotheses: ModelHypotheses[P] = field(kw_only=True, repr=False)

    def at(self, values: Mapping[str, float]) -> Any:
        """The pair's solution; EvaluationError where there is none, InputError for an effect that is not neutral."""
        complete = self.pair.space.complete(dict(values))
        self.hypotheses.require_neutral(complete)
        try:
            return super().at(complete)
        except EvaluationError as fault:
            self.hypotheses.failed(complete, fault)
            raise

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """As of any problem; an effect that is not in the model, and fails with it on either side, has the slope 0."""
        try:
            return super().jacobian(values, names)
        except EvaluationError:
            self.at(values)  # without an answer there is no derivative at all
            return np.hstack([self._column(values, name) for name in names])

    def _column(self, values: Mapping[str, float], name: str) -> np.ndarray:
        try:
            return super().jacobian(values, [name])
        except EvaluationError:
            if name in self.space:
                raise
            return np.zeros((len(self.rows), 1))


@dataclass(frozen=True, eq=False)
class ModelHypotheses(Generic[P]):
    """One test against all variants of a model.

    Attributes
    ----------
    pair : Pair
        The test against the base model.
    variants : ModelVariants
    space : ParameterSpace
        Parameters of the base model; free are those that a calibration would fit. What a test's condition holds may be
        missing.
    without : tuple of str
        Effects of the variants that are no candidates.
    """

    pair: P
    variants: ModelVariants
    space: ParameterSpace
    without: tuple[str, ...] = ()
    counts: Counts = field(init=False, repr=False, default_factory=Counts)
    _questions: dict[tuple[str, ...], VariantProblem[P]] = field(init=False, repr=False, default_factory=dict)
    _failures: dict[str, Failure] = field(init=False, repr=False, default_factory=dict)
    _proven: set[str] = field(init=False, repr=False, default_factory=set)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Named candidates."""
        return tuple(e for e in self.variants.effects if e.name not in self.without)

    @property
    def atoms(self) -> tuple[Effect, ...]:
        """Unnamed local changes."""
        return self.variants.atoms

    @property
    def evaluations(self) -> int:
        """Models solved so far; of a user's function its calls, failed ones included."""
        calls = self.variants.calls
        return self.counts.solved + self.counts.failed if calls is None else calls

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Points at which a user's function gave no answer.

        Of matrices there are none: they run no code of the user's at a point, and their effects are built before any is
        solved. One with which the model cannot be solved has failed where it is not among the candidates.
        """
        return () if self.variants.calls is None else tuple(self._failures.values())

    @cached_property
    def rows(self) -> Sequence[Label]:
        """Rows of every residual."""
        return self.question(()).rows

    @cached_property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over its value, of shapes over the largest entry, (n_rows,)."""
        return self.question(()).relative_std

    @cached_property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Real numbers that scale and turn each shape."""
        return self.question(()).fitted_factors

    @cached_property
    def scatter_freedom(self) -> Mapping[str, float]:
        """Degrees of freedom behind the scatter of each kind."""
        return self.question(()).scatter_freedom

    def question(self, names: tuple[str, ...]) -> VariantProblem[P]:
        """The model with the named effects or atoms added; InputError for an unknown name."""
        key = tuple(sorted(names))
        if key not in self._questions:
            model = self.variants.with_effects(names)
            pair = self.pair.with_model(model, self.variants.added(names) if names else None)
            space = question_space(self.space, [self._known[n] for n in key])
            self._questions[key] = VariantProblem(
                pair, space, remembered=_REMEMBERED, counts=self.counts, hypotheses=self
            )
        return self._questions[key]

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """Measured modes for which that model has no partner at named values."""
        question = self.question(names)
        return question.pair.unpaired(question.at(values))

    @cached_property
    def _known(self) -> dict[str, Effect]:
        return {e.name: e for e in (*self.effects, *self.atoms)}

    # -- what a user's code may do -------------------------------------------------------------------------------------

    def require_neutral(self, values: Mapping[str, float]) -> None:
        """InputError where an effect among some values is not the base model at strength 0.

        The derivative there would be that of a jump. Each effect is looked at once, when it is first asked for, at the
        adopted values.
        """
        for name in self.variants.unproven:
            if name not in self._proven and values.get(name, 0.0) != 0:
                self._proven.add(name)
                self._prove(name)

    def _prove(self, name: str) -> None:
        model, base = self.variants.built((name,)), self.question(())
        adopted, pair = self.variants.model.space.values, base.pair.with_model(model)
        try:
            change = np.abs(pair.of(pair.solve(model.space.values)) - base.residual(adopted))
        except EvaluationError:
            return
        if change.max(initial=0.0) > NEUTRAL:
            row = self.rows[int(np.argmax(change))]
            told = " of ".join(filter(None, (repr(row.sensor) if row.sensor else row.kind, row.mode)))
            raise InputError(
                f"with strength 0 it changes {told} by {change.max():.3g} standard deviations",
                place=f"effect {name}", remedy="let what it builds answer as the base model does there",
            )  # fmt: skip

    def failed(self, values: Mapping[str, float], fault: EvaluationError) -> None:
        """Note a point without an answer."""
        effects = tuple(name for name in self._known if values.get(name, 0.0) != 0)
        own = {*self.variants.model.space.names, *(n for name in effects for n in self._known[name].names)}
        point = {name: value for name, value in values.items() if name in own}
        trace = "\n".join(getattr(fault, "__notes__", ()))
        outcome = Outcome(point, "failed", {}, str(fault), trace=trace)
        self._failures.setdefault(key_of(point), Failure(effects, outcome))
