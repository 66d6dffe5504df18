"""Variants of a function of scalar responses or of modes: with any of its effects and local perturbations."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import TracebackType
from typing import Any, Generic, NamedTuple, TypeVar

from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.eigenproblem.mode_tracking import Moved
from calib.structure.function_model import DERIVES, FunctionModel, extend_function, responses_of, slope_entry
from calib.structure.modal_function import ModalFunctionModel

F = TypeVar("F", FunctionModel, ModalFunctionModel)


MOVES = "moves"
"""Attribute of a function that a local perturbation built: the parameter that it moves in one kind of results."""


class _Raised(NamedTuple):
    """An exception of a function, with the traceback of its first call."""

    fault: Exception
    trace: TracebackType | None


@dataclass(frozen=True, eq=False)
class Kept:
    """A function with cached results: variants of a model request the same points repeatedly.

    Attributes
    ----------
    function : callable
    """

    function: Callable[[Mapping[str, float]], Any]
    _found: dict[tuple[tuple[str, float], ...], Any] = field(init=False, repr=False, default_factory=dict)

    @property
    def calls(self) -> int:
        """Calls so far, failed ones included."""
        return len(self._found)

    def __call__(self, values: Mapping[str, float]) -> Any:
        """A copy of the function's results; an exception it raised is raised again."""
        key = tuple(sorted((n, float(v)) for n, v in values.items()))
        if key not in self._found:
            try:
                self._found[key] = self.function(dict(values))
            except Exception as fault:  # the user's function may raise anything; it is raised again below
                self._found[key] = _Raised(fault, fault.__traceback__)
        found = self._found[key]
        if isinstance(found, _Raised):
            raise found.fault.with_traceback(found.trace)  # else its traceback would grow by every call
        return copy.deepcopy(found)


def kept(model: F) -> F:
    """The model with the results of its function cached."""
    return model if isinstance(model.function, Kept) else replace(model, function=Kept(model.function))


@dataclass(frozen=True, eq=False)
class FunctionVariants(Generic[F]):
    """A base function extended by effects and local perturbations.

    The counterpart for matrices is `calib.structure.effects.variants.Variants`. All effects and perturbations are
    parameters of one common model. An effect of magnitude 0 is left out of the evaluation, so that variants share their
    common calls.

    Attributes
    ----------
    model : FunctionModel or ModalFunctionModel
        The base model.
    effects, perturbations : tuple of Effect
        Named effects, then local perturbations, in the order in which they are built upon each other.
    """

    model: F
    effects: tuple[Effect, ...]
    perturbations: tuple[Effect, ...]
    _built: dict[tuple[str, ...], F] = field(init=False, repr=False, default_factory=dict)

    @property
    def basis(self) -> None:
        """None: there is nothing to reduce."""
        return

    @property
    def calls(self) -> int:
        """Calls of the base function so far, failed ones included."""
        cached: Any = self._base.function
        return int(cached.calls)

    def exchanged(self, effect: Effect, other: Effect, basis: Any) -> FunctionVariants[F]:
        """The same with one effect in the place of another; calls of the base function are shared."""
        return FunctionVariants(
            self._base, tuple(other if e is effect else e for e in self.effects), self.perturbations
        )

    def added(self, names: Sequence[str]) -> int:
        """No further modes: a function returns a fixed number."""
        return 0

    def with_effects(self, names: Sequence[str]) -> F:
        """A model with the parameters of all effects and local perturbations; InputError for an unknown name."""
        for name in names:
            if name not in self._by_name:
                raise InputError(f"there is no effect {name!r}", place=f"model {self.model.name}")
        return self._common

    @cached_property
    def unproven(self) -> tuple[str, ...]:
        """Effects of nominal magnitude 0: user code builds them and may change the model even then."""
        return tuple(e.name for e in self.effects if e.magnitude.value == 0)

    def built(self, names: Sequence[str]) -> F:
        """The base model with only the named effects and local perturbations, built even at magnitude 0."""
        key = tuple(name for name in self._by_name if name in names)
        if key not in self._built:
            self._built[key] = kept(extend_function(self._base, [self._by_name[name] for name in key]))
        return self._built[key]

    @cached_property
    def read(self) -> frozenset[str]:
        """Effects and local perturbations whose parameters the base function reads itself."""
        return frozenset(name for name, effect in self._by_name.items() if effect.build(self._base) is None)

    @cached_property
    def deriving(self) -> frozenset[str]:
        """Those that build a function with derivatives of its own."""
        built = {name: effect.build(self._base) for name, effect in self._by_name.items()}
        return frozenset(name for name, function in built.items() if getattr(function, DERIVES, False))

    @cached_property
    def moving(self) -> dict[str, Callable[[Mapping[str, float]], Moved]]:
        """What local perturbations of one kind of results move, at given values."""
        built = {effect.name: effect.build(self._base) for effect in self.perturbations}
        return {name: getattr(function, MOVES) for name, function in built.items() if hasattr(function, MOVES)}

    @property
    def names(self) -> tuple[str, ...]:
        """All effects and local perturbations."""
        return tuple(self._by_name)

    @cached_property
    def _base(self) -> F:
        return kept(self.model)

    @cached_property
    def _by_name(self) -> dict[str, Effect]:
        return {e.name: e for e in (*self.effects, *self.perturbations)}

    @cached_property
    def _common(self) -> F:
        further = tuple(p for e in self._by_name.values() for p in e.parameters)
        space = ParameterSpace(self.model.space.parameters + further, self.model.space.constraints)
        return replace(self.model, space=space, function=_Chosen(self))


@dataclass(frozen=True, eq=False)
class _Chosen:
    """The function of all parameters: effects of magnitude 0 are left out.

    Attributes
    ----------
    variants : FunctionVariants
    """

    variants: FunctionVariants[Any]

    def _model(self, values: Mapping[str, float]) -> Any:
        return self.variants.built([name for name in self.variants.names if values.get(name, 0.0) != 0])

    def function_at(self, values: Mapping[str, float]) -> Callable[..., Any]:
        """The function that is called at these values; see `calib.errors.own_code.defined_at`."""
        function: Callable[..., Any] = self._model(values).function
        return function

    def __call__(self, values: Mapping[str, float]) -> Any:
        return _called(self._model(values), values)

    def moving(self, values: Mapping[str, float]) -> dict[str, Moved]:
        """Local perturbations that move a parameter in one kind of results; none where an effect is present."""
        if any(values.get(name, 0.0) != 0 for name in self.variants.names):
            return {}
        return {name: moved(values) for name, moved in self.variants.moving.items()}

    def derivatives_by(self, values: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
        """Derivatives that the base function can tell by magnitudes of 0; see `DerivativesOnRequest`.

        What the function reads itself is told by one call. What is built upon it is told by one each, for which the
        base function is not called again.
        """
        present = [name for name in self.variants.names if values.get(name, 0.0) != 0]
        absent = [name for name in names if name in self.variants.names and name not in present]
        read = [name for name in absent if name in self.variants.read]
        groups = ([read] if read else []) + [[name] for name in absent if name in self.variants.deriving]
        out: dict[str, float] = {}
        for group in groups:
            result = _called(self.variants.built([*present, *group]), values)
            entries = [slope_entry(response, name) for response in responses_of(result) for name in group]
            out |= {entry: result[entry] for entry in entries if entry in result}
        return out


def _called(model: Any, values: Mapping[str, float]) -> Any:
    return model.function({name: float(values[name]) for name in model.space.names})
