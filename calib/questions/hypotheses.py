"""What a study can be asked about missing effects, for models with modes and for plain functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual, Row
from calib.correlation.scatter import Floors
from calib.effect import Effect
from calib.problem import Counts, Problem
from calib.space import ParameterSpace
from calib.structure.basis import Basis
from calib.structure.modal_model import ModalModel

_REMEMBERED = 64
"""Points kept, so that a derivative does not solve a model again."""


def question_space(space: ParameterSpace, effects: Sequence[Effect]) -> ParameterSpace:
    """What is free in a question: the parameters of a calibration, and those of the effects in the model."""
    return ParameterSpace(space.parameters + tuple(p for e in effects for p in e.parameters), space.constraints)


def whole_space(space: ParameterSpace, own: ParameterSpace) -> ParameterSpace:
    """What a function is called with: the parameters of a question, and its own that are held for one test only."""
    held = tuple(p for p in own.parameters if p.name not in space)
    return ParameterSpace(space.parameters + held, space.constraints)


class ModelVariants(Protocol):
    """One model with any of its possible effects, such as `calib.structure.variants.Variants`."""

    @property
    def model(self) -> ModalModel:
        """The base model."""
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

    def added(self, names: Sequence[str]) -> int:
        """Modes more that the named effects bring."""
        ...

    def with_effects(self, names: Sequence[str]) -> ModalModel:
        """A model whose parameters include those of the named effects and of every local change."""
        ...


@dataclass(frozen=True, eq=False)
class ModalHypotheses:
    """A modal measurement against all variants of a model.

    Attributes
    ----------
    problem : ModalProblem
        Measurement and pairing; its model is the base model.
    variants : ModelVariants
    space : ParameterSpace
        Parameters of the base model; free are those that a calibration would fit.
    floors : Floors
    without : tuple of str
        Effects of the variants that are no candidates.
    """

    problem: ModalProblem
    variants: ModelVariants
    space: ParameterSpace
    floors: Floors = field(default_factory=Floors)
    without: tuple[str, ...] = ()
    counts: Counts = field(init=False, repr=False, default_factory=Counts)
    _questions: dict[tuple[str, ...], Problem[ModalResidual]] = field(init=False, repr=False, default_factory=dict)

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
        """Models solved so far."""
        return self.counts.solved + self.counts.failed

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """Rows of every residual."""
        return self.question(()).pair.rows

    @cached_property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row; see `ModalResidual.relative_std`."""
        return self.question(()).pair.relative_std

    @cached_property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Real numbers that scale and turn each shape."""
        return self.question(()).pair.fitted_factors

    @cached_property
    def scatter_freedom(self) -> Mapping[str, float]:
        """Degrees of freedom behind the scatter of each kind."""
        return self.question(()).pair.scatter_freedom

    def question(self, names: tuple[str, ...]) -> Problem[ModalResidual]:
        """The model with the named effects or atoms added."""
        key = tuple(sorted(names))
        if key not in self._questions:
            known = {e.name: e for e in (*self.effects, *self.atoms)}
            model = self.variants.with_effects(names)
            count = self.problem.mode_count + self.variants.added(names)
            base = self.problem if names else None
            problem = replace(self.problem, model=model, mode_count=count, base=base)
            space = question_space(self.space, [known[n] for n in key])
            self._questions[key] = Problem(
                ModalResidual(problem, self.floors), space, remembered=_REMEMBERED, counts=self.counts
            )
        return self._questions[key]

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """Measured modes for which that model has no partner at named values."""
        found = self.question(names).at(values)
        return frozenset(self.problem.measured.names[i] for i in found.pairing.unpaired_measured)
