"""A function with any of its possible effects, be it of plain responses or of modes."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

from calib.effect import Effect
from calib.errors import InputError
from calib.function import FunctionModel, extend_function
from calib.space import ParameterSpace
from calib.structure.modal_function import ModalFunctionModel

F = TypeVar("F", FunctionModel, ModalFunctionModel)


@dataclass(frozen=True, eq=False)
class Kept:
    """A function whose answers are kept: variants of a model ask for the same points again and again.

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
        """A copy of the function's answer; what it raised, it raises again."""
        key = tuple(sorted((n, float(v)) for n, v in values.items()))
        if key not in self._found:
            try:
                self._found[key] = self.function(dict(values))
            except Exception as fault:
                self._found[key] = fault
        if isinstance(self._found[key], Exception):
            raise self._found[key]
        return copy.deepcopy(self._found[key])


def kept(model: F) -> F:
    """The model with its function's answers kept."""
    return model if isinstance(model.function, Kept) else replace(model, function=Kept(model.function))


@dataclass(frozen=True, eq=False)
class FunctionVariants(Generic[F]):
    """A base function extended by effects and local changes; what `calib.structure.variants.Variants` is for matrices.

    All of them are parameters of one common model. An effect of strength 0 is left out when it is asked, so that all
    variants share the calls that they have in common.

    Attributes
    ----------
    model : FunctionModel or ModalFunctionModel
        The base model.
    effects, atoms : tuple of Effect
        Named effects, then local changes, in the order they are built one upon the other.
    """

    model: F
    effects: tuple[Effect, ...]
    atoms: tuple[Effect, ...]
    _built: dict[tuple[str, ...], F] = field(init=False, repr=False, default_factory=dict)

    @property
    def basis(self) -> None:
        """None: there is nothing to reduce."""
        return

    @property
    def calls(self) -> int:
        """Calls of the base function so far, failed ones included."""
        asked: Any = self._base.function
        return int(asked.calls)

    def added(self, names: Sequence[str]) -> int:
        """No modes: a function gives as many as it is declared to."""
        return 0

    def with_effects(self, names: Sequence[str]) -> F:
        """A model whose parameters include those of all effects and local changes; InputError for an unknown name."""
        for name in names:
            if name not in self._by_name:
                raise InputError(f"there is no effect {name!r}", place=f"model {self.model.name}")
        return self._common

    @cached_property
    def unproven(self) -> tuple[str, ...]:
        """Effects that the base model has with a strength of 0; their builders are the user's."""
        return tuple(e.name for e in self.effects if e.strength.value == 0)

    def built(self, names: Sequence[str]) -> F:
        """The base model with the named effects and local changes alone, none of them left out at strength 0."""
        key = tuple(name for name in self._by_name if name in names)
        if key not in self._built:
            self._built[key] = kept(extend_function(self._base, [self._by_name[name] for name in key]))
        return self._built[key]

    @cached_property
    def _base(self) -> F:
        return kept(self.model)

    @cached_property
    def _by_name(self) -> dict[str, Effect]:
        return {e.name: e for e in (*self.effects, *self.atoms)}

    @cached_property
    def _common(self) -> F:
        further = tuple(p for e in self._by_name.values() for p in e.parameters)
        space = ParameterSpace(self.model.space.parameters + further, self.model.space.constraints)
        return replace(self.model, space=space, function=self._ask)

    def _ask(self, values: Mapping[str, float]) -> Any:
        model = self.built([name for name in self._by_name if values.get(name, 0.0) != 0])
        return model.function({name: float(values[name]) for name in model.space.names})
