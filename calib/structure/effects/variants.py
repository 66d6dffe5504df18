"""A model with any combination of its candidate effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.structure.effects.extend import addition_of, extend
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.reduced import ReducedModel


@dataclass(frozen=True, eq=False)
class Variants:
    """A base model extended by effects and local perturbations.

    Effects that add no degrees of freedom, and all local perturbations, are terms of one common model, of magnitude 0
    unless set; only effects with degrees of freedom of their own need another model.

    Attributes
    ----------
    model : StructuralModel
        The base model.
    effects, perturbations : tuple of Effect
    basis : Basis or None
        Of the base model, see `calib.structure.reduction.effect_basis`; None for full order.
    """

    model: StructuralModel
    effects: tuple[Effect, ...]
    perturbations: tuple[Effect, ...]
    basis: Basis | None = None
    _made: dict[tuple[str, ...], StructuralModel | ReducedModel] = field(init=False, repr=False, default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_made": {}}  # dozens of models, which are made again where they are needed

    @cached_property
    def _added(self) -> dict[str, int]:
        """Degrees of freedom that each effect adds."""
        added = {e.name: addition_of(self.model, e).n_added for e in self.effects}
        for effect in self.effects:
            if added[effect.name] and not effect.grid:
                raise InputError(
                    "it adds degrees of freedom and has no grid", place=f"effect {effect.name}",
                    remedy="give it a grid of one or more magnitudes",
                )  # fmt: skip
        return added

    @property
    def calls(self) -> None:
        """None: no user function is called."""
        return

    @property
    def unproven(self) -> tuple[str, ...]:
        """Empty: a term of magnitude 0 changes nothing."""
        return ()

    def built(self, names: Sequence[str]) -> StructuralModel:
        """The base model with only the named effects and local perturbations, at full order."""
        own = [e for e in (*self.effects, *self.perturbations) if e.name in names]
        return extend(self.model, own) if own else self.model

    def added(self, names: Sequence[str]) -> int:
        """Degrees of freedom that the named effects add together."""
        return sum(self._added.get(name, 0) for name in names)

    def exchanged(self, effect: Effect, other: Effect, basis: Basis | None) -> Variants:
        """The same with one effect in the place of another, and a basis for that."""
        effects = tuple(other if e is effect else e for e in self.effects)
        return Variants(self.model, effects, self.perturbations, basis)

    def with_effects(self, names: Sequence[str]) -> StructuralModel | ReducedModel:
        """A model whose parameters include those of the named effects and of every local perturbation.

        Raises InputError for an unknown name.
        """
        known = set(self._added) | {a.name for a in self.perturbations}
        for name in names:
            if name not in known:
                raise InputError(f"there is no effect {name!r}", place=f"model {self.model.name}")
        key = tuple(e.name for e in self.effects if e.name in names and self._added[e.name])
        if key not in self._made:
            self._made[key] = self._make(key)
        return self._made[key]

    def _make(self, with_dofs: tuple[str, ...]) -> StructuralModel | ReducedModel:
        own, common = [e for e in self.effects if e.name in with_dofs], self._common
        if not own:
            return common
        return common.extended(own) if isinstance(common, ReducedModel) else extend(common, own)

    @cached_property
    def _common(self) -> StructuralModel | ReducedModel:
        """The model with all effects that add no degrees of freedom, and all local perturbations."""
        without_dofs = [*(e for e in self.effects if not self._added[e.name]), *self.perturbations]
        if self.basis is None:
            return extend(self.model, without_dofs)
        return self.reduced.extended(without_dofs)

    @cached_property
    def reduced(self) -> ReducedModel:
        """The base model on its basis, which there must be."""
        assert self.basis is not None
        return ReducedModel(self.model, self.basis)
