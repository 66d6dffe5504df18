"""What the search for a missing effect asks of whoever knows the model and the measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from calib.effect import Effect
from calib.inference.gauss_newton import LeastSquares
from calib.problem import Labelled
from calib.space import ParameterSpace


class Question(LeastSquares, Protocol):
    """Measurement against the model with some effects: whitened residual, its derivative, and what is free."""

    @property
    def space(self) -> ParameterSpace:
        """Free are the parameters that a calibration would fit, and those of the effects."""
        ...


class Hypotheses(Labelled, Protocol):
    """The base model, the effects it may lack, and its unnamed local changes, all against one measurement.

    Every question has the same rows, whitened by the same scatter.
    """

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Named effects that the base model lacks."""
        ...

    @property
    def atoms(self) -> tuple[Effect, ...]:
        """Unnamed local changes."""
        ...

    @property
    def evaluations(self) -> int:
        """Models solved so far."""
        ...

    def question(self, names: tuple[str, ...]) -> Question:
        """The model with the named effects or atoms added."""
        ...

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """Measured modes for which that model has no partner at named values; none where nothing is paired."""
        ...


@dataclass(frozen=True, eq=False)
class Altered:
    """A question with a factor on its scatter, about some of its rows, or with parameters held.

    Attributes
    ----------
    inner : Question
    scale : float
        That factor.
    kept : ndarray (n_kept,), int, or None
        Those rows; None for all.
    held : mapping from str to float
        Values of those parameters.
    """

    inner: Question
    scale: float = 1.0
    kept: np.ndarray | None = None
    held: Mapping[str, float] = field(default_factory=dict)

    @property
    def space(self) -> ParameterSpace:
        """That of the question, with those parameters fixed."""
        return self.inner.space.freeze(self.held) if self.held else self.inner.space

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual, (n_kept,)."""
        return self._seen(self.inner.residual({**values, **self.held}))

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Its derivative, (n_kept, n_params)."""
        return self._seen(self.inner.jacobian({**values, **self.held}, names))

    def _seen(self, rows: np.ndarray) -> np.ndarray:
        return (rows if self.kept is None else rows[self.kept]) / self.scale
