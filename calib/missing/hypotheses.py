"""What the search for a missing effect asks of whoever knows the model and the measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib.effect import Effect
from calib.inference.gauss_newton import LeastSquares
from calib.problem import Label
from calib.space import ParameterSpace


class Question(LeastSquares, Protocol):
    """Measurement against the model with some effects: whitened residual, its derivative, and what is free."""

    @property
    def space(self) -> ParameterSpace:
        """Free are the parameters that a calibration would fit, and those of the effects."""
        ...


class Hypotheses(Protocol):
    """The base model, the effects it may lack, and its unnamed local changes, all against one measurement.

    Every question has the same rows, whitened by the same scatter.
    """

    @property
    def rows(self) -> Sequence[Label]:
        """Rows of every residual, length n_rows."""
        ...

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Named effects that the base model lacks."""
        ...

    @property
    def atoms(self) -> tuple[Effect, ...]:
        """Unnamed local changes."""
        ...

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Numbers fitted by (mode, kind) that are no degrees of freedom: scale and phase of shapes."""
        ...

    @property
    def scatter_freedom(self) -> Mapping[str, float]:
        """Degrees of freedom behind the scatter of each kind; infinite where it is known."""
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
class Scaled:
    """A question whose scatter is multiplied by a factor."""

    inner: Question
    scale: float

    @property
    def space(self) -> ParameterSpace:
        """That of the question."""
        return self.inner.space

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual, (n_rows,)."""
        return self.inner.residual(values) / self.scale

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Its derivative, (n_rows, n_params)."""
        return self.inner.jacobian(values, names) / self.scale
