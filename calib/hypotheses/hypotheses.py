"""Hypotheses of a test: fit problems of the base model with any effects or local perturbations, for any model type."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from calib.errors.errors import EvaluationError, InputError
from calib.errors.own_code import defined_at
from calib.execution.outcome import Outcome, point_key
from calib.hypotheses.linear_start import has_linear_start, linear_starts
from calib.problem.candidate import Candidate, Fault
from calib.problem.differences import STEP
from calib.problem.effect import Effect
from calib.problem.labels import Label
from calib.problem.problem import Counts, Pair, PairProblem
from calib.problem.space import ParameterSpace
from calib.structure.reduction.basis import Basis

NEUTRAL = STEP
"""Tolerance for the change of a row by an effect of magnitude 0, in standard deviations.

A difference that ends at 0 takes a jump there for a slope: over a step of `STEP` times the range of the magnitude, a
jump of this size for one standard deviation over the whole range. Solvers round below it: by some 1e-9 of a frequency,
whose standard deviation is rarely less than 1e-5 of it.
"""

_REMEMBERED = 64
"""Points cached, so that a derivative does not solve the model again."""


def fit_problem_space(space: ParameterSpace, effects: Sequence[Candidate]) -> ParameterSpace:
    """Parameters of a fit problem: those of a calibration, and those of the effects in the model."""
    return ParameterSpace(space.parameters + tuple(p for e in effects for p in e.parameters), space.constraints)


class ModelVariants(Protocol):
    """One model with any of its possible effects.

    Such as `calib.structure.effects.variants.Variants` of matrices and
    `calib.hypotheses.function_variants.FunctionVariants`.
    """

    @property
    def model(self) -> Any:
        """The base model, with all parameters it is evaluated with."""
        ...

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Named effects."""
        ...

    @property
    def perturbations(self) -> tuple[Effect, ...]:
        """Unnamed local perturbations."""
        ...

    @property
    def basis(self) -> Basis | None:
        """A reduced basis of the base model; None where none is used."""
        ...

    @property
    def calls(self) -> int | None:
        """Calls of a user's function so far; None where no user code is evaluated."""
        ...

    def added(self, names: Sequence[str]) -> int:
        """Number of modes that the named effects add."""
        ...

    def with_effects(self, names: Sequence[str]) -> Any:
        """A model whose parameters include those of the named effects and of every local perturbation."""
        ...

    def built(self, names: Sequence[str]) -> Any:
        """The base model with only the named effects, at full order and at any magnitude."""
        ...

    def exchanged(self, effect: Effect, other: Effect, basis: Any) -> Self:
        """The same with one effect in the place of another, and a basis for that; None where none is used."""
        ...

    @property
    def unproven(self) -> Collection[str]:
        """Effects that may change the base model even at magnitude 0, since user code adds them."""
        ...


class VariantPair(Pair, Protocol):
    """A test that can be paired with variants of its model."""

    def with_model(self, model: Any, added: int | None = None) -> Self:
        """The same test of another model; see `calib.correlation.modal.residual.ModalResidual.with_model`."""
        ...

    def unpaired(self, solution: Any) -> frozenset[str]:
        """Measured modes for which a solution has no partner; none where nothing is paired."""
        ...

    @property
    def row_freqs(self) -> np.ndarray:
        """Frequency of every row, (n_rows,), Hz: of its measured mode or its line; NaN where it has none."""
        ...

    @property
    def faults(self) -> Sequence[Fault]:
        """Faults of this measurement; their magnitudes are in its space."""
        ...


P = TypeVar("P", bound=VariantPair)


class Failure(NamedTuple):
    """A point at which a user's function failed.

    Attributes
    ----------
    effects : tuple of str
        Effects and local perturbations that were not 0.
    outcome : Outcome
        Its values are the parameters of the model and of these effects.
    """

    effects: tuple[str, ...]
    outcome: Outcome


@dataclass(frozen=True, eq=False)
class VariantProblem(PairProblem[P]):
    """A problem whose pair has effects that its space lacks; derivatives by them are available.

    Attributes
    ----------
    hypotheses : ModelHypotheses
        The hypotheses it belongs to.
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
        """As for any problem; the slope of an effect outside the model that fails on either side is 0."""
        try:
            return super().jacobian(values, names)
        except EvaluationError:
            self.at(values)  # raises where the point itself fails
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
        Parameters of the base model; free are those that a calibration would fit. Parameters that a test's condition
        holds may be missing.
    without : tuple of str
        Effects of the variants that are not candidates.
    granted : tuple of str
        Faults of the measurement whose magnitudes are among the parameters of the base model.
    counts : Counts
        Points requested from all fit problems.
    """

    pair: P
    variants: ModelVariants
    space: ParameterSpace
    without: tuple[str, ...] = ()
    granted: tuple[str, ...] = ()
    counts: Counts = field(init=False, repr=False, default_factory=Counts)
    _fit_problems: dict[tuple[str, ...], VariantProblem[P]] = field(init=False, repr=False, default_factory=dict)
    _pairs: dict[tuple[int, int | None], tuple[Any, P]] = field(init=False, repr=False, default_factory=dict)
    _failures: dict[str, Failure] = field(init=False, repr=False, default_factory=dict)
    _proven: set[str] = field(init=False, repr=False, default_factory=set)

    def __getstate__(self) -> dict[str, Any]:
        # A decision builds hundreds; a task brings the problems that it needs.
        return {**self.__dict__, "_pairs": {}, "_fit_problems": {}}

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Named candidates."""
        return tuple(e for e in self.variants.effects if e.name not in self.without)

    @cached_property
    def perturbations(self) -> tuple[Effect, ...]:
        """Unnamed local perturbations."""
        return tuple(e for e in self.variants.perturbations if not (self.pair.faults and e.of_measurement))

    @cached_property
    def faults(self) -> tuple[Candidate, ...]:
        """Faults of the measurement: those of the test, and those that a model has for it.

        Where a test offers none, those of the model count as local perturbations.
        """
        own: tuple[Candidate, ...] = tuple(self.pair.faults)
        every = (*own, *(e for e in self.variants.perturbations if e.of_measurement)) if own else ()
        return tuple(e for e in every if e.name not in self.granted)

    def granting(self, faults: tuple[str, ...]) -> Self:
        """The same with some faults granted; evaluations are counted together."""
        more = tuple(p for e in self.faults if e.name in faults for p in e.parameters)
        space = ParameterSpace((*self.space.parameters, *more), self.space.constraints)
        out = replace(self, space=space, granted=(*self.granted, *faults))
        object.__setattr__(out, "counts", self.counts)
        return out

    def with_more(self, effects: Sequence[Effect]) -> ModelHypotheses[P]:
        """The same with further effects."""
        variants: Any = self.variants
        return replace(self, variants=replace(variants, effects=(*variants.effects, *effects)))

    @property
    def evaluations(self) -> int:
        """Model solutions so far; for a user's function its calls, failed ones included."""
        calls = self.variants.calls
        return self.counts.solved + self.counts.failed if calls is None else calls

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Points at which a user's function failed.

        Models of matrices have none: they run no user code at a point, and their effects are built before any solve. An
        effect with which such a model cannot be solved is missing from the candidates instead.
        """
        return () if self.variants.calls is None else tuple(self._failures.values())

    @cached_property
    def rows(self) -> Sequence[Label]:
        """Rows of every residual."""
        return self.fit_problem(()).rows

    @cached_property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over its value, of shapes over the largest entry, (n_rows,)."""
        return self.fit_problem(()).relative_std

    @property
    def row_freqs(self) -> np.ndarray:
        """Frequency of every row, (n_rows,), Hz: of its measured mode or its line; NaN where it has none."""
        return self.pair.row_freqs

    @property
    def shared_errors(self) -> np.ndarray:
        """Change of the residual by one standard deviation of every error that rows share, (n_rows, n_errors)."""
        return self.fit_problem(()).shared_errors

    @cached_property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Number of real factors that scale and rotate each shape."""
        return self.fit_problem(()).fitted_factors

    @cached_property
    def std_dof(self) -> Mapping[str, float]:
        """Degrees of freedom behind the standard deviation of each kind."""
        return self.fit_problem(()).std_dof

    def fit_problem(self, names: tuple[str, ...]) -> VariantProblem[P]:
        """The model with the named effects, perturbations or faults added; InputError for an unknown name."""
        key = tuple(sorted(names))
        if key not in self._fit_problems:
            own = tuple(name for name in names if name not in self._of_test)
            pair = self._pair_with(own)
            space = fit_problem_space(self.space, [self._known[n] for n in key])
            self._fit_problems[key] = VariantProblem(
                pair, space, remembered=_REMEMBERED, counts=self.counts, hypotheses=self
            )
        return self._fit_problems[key]

    def _pair_with(self, names: tuple[str, ...]) -> P:
        """The test of the model with named effects; all effects without degrees of freedom of their own share one."""
        model, added = self.variants.with_effects(names), self.variants.added(names) if names else None
        key = id(model), added
        if key not in self._pairs:
            self._pairs[key] = model, self.pair.with_model(model, added)  # kept, so that no other takes its number
        return self._pairs[key][1]

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """Measured modes for which that model has no partner at named values."""
        fit_problem = self.fit_problem(names)
        return fit_problem.pair.unpaired(fit_problem.at(values))

    def linear_start(self, names: tuple[str, ...], values: Mapping[str, float]) -> dict[str, float] | None:
        """Values from a linear solution about named ones, from which that model can be fitted; None where none is."""
        if not has_linear_start(self.pair):
            return None
        fit_problem = self.fit_problem(names)
        found = linear_starts(fit_problem, fit_problem.pair.space.complete(dict(values)))
        return {**values, **{name: v for name, v in found[0].items() if name in fit_problem.space}} if found else None

    @cached_property
    def _of_test(self) -> frozenset[str]:
        return frozenset(fault.name for fault in self.pair.faults)

    @cached_property
    def _known(self) -> dict[str, Candidate]:
        return {e.name: e for e in (*self.effects, *self.perturbations, *self.faults)}

    # -- user code -----------------------------------------------------------------------------------------------------

    def require_neutral(self, values: Mapping[str, float]) -> None:
        """InputError where an effect with nonzero value does not reduce to the base model at magnitude 0.

        Its response would jump there, and the derivative would be meaningless. Each effect is checked once, at the
        nominal values, when it is first used.
        """
        for name in self.variants.unproven:
            if name not in self._proven and values.get(name, 0.0) != 0:
                self._proven.add(name)
                self._prove(name)

    def _prove(self, name: str) -> None:
        model, base = self.variants.built((name,)), self.fit_problem(())
        nominal, pair = self.variants.model.space.values, base.pair.with_model(model)
        try:
            change = np.abs(pair.of(pair.solve(model.space.values)) - base.residual(nominal))
        except EvaluationError:
            return
        if change.max(initial=0.0) > NEUTRAL:
            (effect,) = (e for e in (*self.variants.effects, *self.variants.perturbations) if e.name == name)
            row = self.rows[int(np.argmax(change))]
            label = " of ".join(filter(None, (repr(row.sensor) if row.sensor else row.kind, row.mode)))
            raise InputError(
                f"with magnitude 0 it changes {label} by {change.max():.3g} standard deviations",
                place=f"effect {name}", remedy="let the function that it builds return the base model's results there",
                at=defined_at(effect.build),
            )  # fmt: skip

    def failed(self, values: Mapping[str, float], fault: EvaluationError) -> None:
        """Record a failed point."""
        effects = tuple(name for name in self._known if values.get(name, 0.0) != 0)
        own = {*self.variants.model.space.names, *(n for name in effects for n in self._known[name].names)}
        point = {name: value for name, value in values.items() if name in own}
        trace = "\n".join(getattr(fault, "__notes__", ()))
        outcome = Outcome(point, "failed", {}, str(fault), trace=trace, at=fault.at)
        self._failures.setdefault(point_key(point), Failure(effects, outcome))
