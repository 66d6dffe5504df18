"""What a study can be asked about missing effects when its model is a plain function."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.correlation.problem import FunctionProblem
from calib.correlation.response_residual import ResponseResidual
from calib.correlation.responses import ResponseRow, response_freedom, response_rows
from calib.differences import difference
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.function import FunctionModel, extend_function
from calib.outcome import Outcome, attempt
from calib.questions.function_atoms import Remembered, function_atoms
from calib.questions.hypotheses import question_space, whole_space
from calib.space import ParameterSpace

_ROUNDING = 1e-6
"""Change of the residual at strength 0 up to which it counts as none."""

Targets = Mapping[str, tuple[float, float | None]]


class Failure(NamedTuple):
    """A point at which the function gave no answer.

    Attributes
    ----------
    effects : tuple of str
        Effects and local changes that were not 0.
    outcome : Outcome
        Its values are those of all parameters, of these effects too.
    """

    effects: tuple[str, ...]
    outcome: Outcome


@dataclass(frozen=True, eq=False)
class Answers:
    """The whitened residual of a function with any of its effects; no point is asked twice.

    An effect of strength 0 is left out, so that all questions share what they have in common; whether it really changes
    nothing is checked once, at the adopted values.

    Attributes
    ----------
    model : FunctionModel
    targets : mapping from response name to (value, std or None)
    effects, atoms : tuple of Effect
        Named effects, then local changes, in the order they are built one upon the other.
    failures : list of Failure
    """

    model: FunctionModel
    targets: Targets
    effects: tuple[Effect, ...]
    atoms: tuple[Effect, ...]
    failures: list[Failure] = field(init=False, repr=False, default_factory=list)
    _found: dict[tuple[tuple[str, ...], tuple[float, ...]], np.ndarray | str] = field(
        init=False, repr=False, default_factory=dict
    )
    _problems: dict[tuple[str, ...], FunctionProblem] = field(init=False, repr=False, default_factory=dict)
    _neutral: set[str] = field(init=False, repr=False, default_factory=set)

    @cached_property
    def by_name(self) -> dict[str, Effect]:
        """Effects and local changes, in their order."""
        return {e.name: e for e in (*self.effects, *self.atoms)}

    @cached_property
    def whitened(self) -> ResponseResidual:
        """What makes residuals of responses."""
        return ResponseResidual(FunctionProblem(self.model.space, self.model.function, self.targets, ""))

    @property
    def evaluations(self) -> int:
        """Calls of the function so far, failed ones included."""
        return self._function.calls

    @cached_property
    def _function(self) -> Remembered:
        return Remembered(self.model.function)

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Vector (n_rows,) at all parameters of the model and of any effects; EvaluationError at a failed point."""
        active = tuple(name for name in self.by_name if values.get(name, 0.0) != 0)
        for effect in self.effects:
            if effect.name in active:
                self._require_neutral(effect)
        return self._ask(active, values)

    def _ask(self, active: tuple[str, ...], values: Mapping[str, float]) -> np.ndarray:
        if active not in self._problems:
            model = replace(self.model, function=self._function)
            extended = extend_function(model, [self.by_name[name] for name in active])
            self._problems[active] = FunctionProblem(extended.space, extended.function, self.targets, "")
        problem = self._problems[active]
        given = {name: float(values[name]) for name in problem.space.names}
        key = (active, tuple(given.values()))
        if key not in self._found:
            outcome = attempt(problem.evaluate, given)
            if outcome.error:
                self.failures.append(Failure(active, outcome))
                self._found[key] = outcome.error
            else:
                residual = self.whitened.of(outcome.responses)
                residual.flags.writeable = False
                self._found[key] = residual
        found = self._found[key]
        if isinstance(found, str):
            raise EvaluationError(found)
        return found

    def _require_neutral(self, effect: Effect) -> None:
        """InputError when strength 0 is not the base model: the derivative there would be that of a jump."""
        if effect.name in self._neutral or effect.strength.value != 0:
            return
        self._neutral.add(effect.name)
        adopted = self.model.space.values
        try:
            base = self._ask((), adopted)
            change = self._ask((effect.name,), adopted | {p.name: p.value for p in effect.parameters}) - base
        except EvaluationError:
            return
        if np.abs(change).max() > _ROUNDING:
            row = list(self.targets)[int(np.argmax(np.abs(change)))]
            raise InputError(
                f"with strength 0 it changes {row!r} by {np.abs(change).max():.3g} standard deviations",
                place=f"effect {effect.name}",
                remedy="let what it builds give the base model's responses there",
            )


@dataclass(frozen=True, eq=False)
class FunctionQuestion:
    """The whitened residual of a function with some effects, and its derivative by differences.

    Attributes
    ----------
    space : ParameterSpace
        The model's parameters, without those that the test holds, and those of the effects it has.
    answers : Answers
    step : float
        Half a central difference, over the range between the limits.
    """

    space: ParameterSpace
    answers: Answers
    step: float

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Vector (n_rows,) at named values; EvaluationError where the function gives no answer."""
        return self.answers.residual(self._complete(values))

    def _complete(self, values: Mapping[str, float]) -> dict[str, float]:
        return {**self.answers.model.space.values, **self.space.complete(values)}

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the vector per one of each parameter's own unit, (n_rows, n_params).

        Central differences within the limits. At a limit, or where one end fails, they are one-sided. Names may also be
        those of effects or local changes that the model lacks; the derivative is then that at strength 0, and 0 where
        the function gives no answer on either side (see `Answers.failures`).

        Raises
        ------
        EvaluationError
            When the function fails at the point, or on both sides of it along one of the model's own parameters.
        """
        complete = self._complete(values)
        here = self.answers.residual(complete)
        columns = []
        for name in names:
            if name in self.space:
                columns.append(difference(self.answers.residual, complete, self.space[name], self.step))
                continue
            effect = self.answers.by_name[name]
            extended = complete | {p.name: p.value for p in effect.parameters}
            try:
                columns.append(difference(self.answers.residual, extended, effect.strength, self.step))
            except EvaluationError:
                columns.append(np.zeros(len(here)))
        return np.column_stack(columns) if columns else np.zeros((len(here), 0))


@dataclass(frozen=True, eq=False)
class FunctionHypotheses:
    """Plain responses against all variants of a function.

    Attributes
    ----------
    model : FunctionModel
        The base model.
    targets : mapping from response name to (value, std or None)
        Measured, with the standard deviation of the value; where it is unknown 1 % of the value is taken.
    space : ParameterSpace
        Parameters of the base model, without those that its space holds for this test only; free are those that a
        calibration would fit.
    effects : tuple of Effect
        Named candidates.
    repeats : float or None
        Repeats behind the standard deviations, when those are pooled over the responses of each kind; None takes the
        deviations for known.
    step : float
        Half a central difference, over the range; to be raised for a function whose last digits are not exact.
    shares : mapping from response name to float
        Part of each variance that the repeats tell; 1 for one left out.
    test : str
        Told with changes that are of one test only, where there are several.

    Raises
    ------
    InputError
        When a target is not usable.
    """

    model: FunctionModel
    targets: Targets
    space: ParameterSpace
    effects: tuple[Effect, ...]
    repeats: float | None = None
    step: float = 1e-4
    shares: Mapping[str, float] = field(default_factory=dict)
    test: str = ""

    def __post_init__(self) -> None:
        if self.repeats is not None and self.repeats < 2:
            raise InputError(f"repeats = {self.repeats}", place="explain", remedy="give at least 2 or none")

    @cached_property
    def answers(self) -> Answers:
        """What was asked of the function so far."""
        return Answers(replace(self.model, space=self._whole), self.targets, self.effects, self.atoms)

    @cached_property
    def _whole(self) -> ParameterSpace:
        """What the function is called with: the space, and what is held for this test."""
        return whole_space(self.space, self.model.space)

    @cached_property
    def atoms(self) -> tuple[Effect, ...]:
        """Unnamed changes, see `function_atoms`."""
        measured = {name: value for name, (value, _) in self.targets.items()}
        held = [name for name in self.model.space.names if name not in self.space]
        return function_atoms(self._whole, measured, self.test, held)

    @property
    def evaluations(self) -> int:
        """Calls of the function so far."""
        return self.answers.evaluations

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Points at which the function gave no answer."""
        return tuple(self.answers.failures)

    @cached_property
    def rows(self) -> tuple[ResponseRow, ...]:
        """Rows of every residual, in the order of the targets."""
        return response_rows(self.targets)

    @cached_property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over the size of its value, (n_rows,); infinite for a value of 0."""
        return self.answers.whitened.relative_std

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """No response has a free factor."""
        return {}

    @cached_property
    def scatter_freedom(self) -> Mapping[str, float]:
        """Degrees of freedom behind the scatter of each kind."""
        return response_freedom(self.targets, self.repeats, self.shares)

    def question(self, names: tuple[str, ...]) -> FunctionQuestion:
        """The model with the named effects or local changes added; InputError for an unknown name."""
        for name in names:
            if name not in self.answers.by_name:
                raise InputError(f"there is no effect {name!r}", place=f"model {self.model.name}")
        added = [e for name, e in self.answers.by_name.items() if name in names]
        return FunctionQuestion(question_space(self.space, added), self.answers, self.step)

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """None: plain responses are told by their names."""
        return frozenset()
