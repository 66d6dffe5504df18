"""Protocols of the search for a missing effect: models with effects against a measurement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np

from calib.inference.gauss_newton import LeastSquares
from calib.problem.candidate import Candidate
from calib.problem.labels import Labelled
from calib.problem.space import ParameterSpace


class FitProblem(LeastSquares, Protocol):
    """Least-squares problem of a model with some effects: whitened residual, Jacobian and free parameters."""

    @property
    def space(self) -> ParameterSpace:
        """The parameters that a calibration would fit, and those of the effects, are free."""
        ...


class Hypotheses(Labelled, Protocol):
    """The base model, the effects it may lack, and its unnamed local perturbations, all against one measurement.

    Every fit problem has the same rows, whitened by the same standard deviations.
    """

    @property
    def effects(self) -> tuple[Candidate, ...]:
        """Named effects that the base model lacks."""
        ...

    @property
    def perturbations(self) -> tuple[Candidate, ...]:
        """Unnamed local perturbations."""
        ...

    @property
    def faults(self) -> tuple[Candidate, ...]:
        """Faults that the measurement itself may have."""
        ...

    @property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over its value, of shapes over the largest entry, (n_rows,)."""
        ...

    @property
    def row_freqs(self) -> np.ndarray:
        """Frequency of every row, (n_rows,), Hz: of its measured mode or its line; NaN where it has none."""
        ...

    @property
    def shared_errors(self) -> np.ndarray:
        """Change of the residual by one standard deviation of every error that rows share, (n_rows, n_errors)."""
        ...

    @property
    def evaluations(self) -> int:
        """Number of model evaluations so far."""
        ...

    def fit_problem(self, names: tuple[str, ...]) -> FitProblem:
        """The model with the named effects or perturbations added, and the named faults of the measurement."""
        ...

    def granting(self, faults: tuple[str, ...]) -> Self:
        """The same with the magnitudes of some faults among the parameters of the base model; they compete no more."""
        ...

    def linear_start(self, names: tuple[str, ...], values: Mapping[str, float]) -> dict[str, float] | None:
        """Values from a linear solution about named ones, from which that model can be fitted; None where none is."""
        ...

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """Measured modes that the model leaves unpaired at the given values; empty where nothing is paired."""
        ...


@dataclass(frozen=True, eq=False)
class Altered:
    """A fit problem with a factor on its standard deviation, restricted to some rows, or with parameters held.

    Attributes
    ----------
    inner : FitProblem
    scale : float or ndarray (n_kept,)
        Factor on the standard deviation, of all rows or of each.
    kept : ndarray (n_kept,), int, or None
        Rows kept; None for all.
    held : mapping from str to float
        Values of the held parameters.
    """

    inner: FitProblem
    scale: float | np.ndarray = 1.0
    kept: np.ndarray | None = None
    held: Mapping[str, float] = field(default_factory=dict)

    @property
    def space(self) -> ParameterSpace:
        """Parameter space of the inner problem, with the held parameters fixed."""
        return self.inner.space.freeze(self.held) if self.held else self.inner.space

    @property
    def by_differences(self) -> bool:
        """Whether derivatives of the inner problem cost evaluations; see `calib.inference.gauss_newton.fit`."""
        return bool(getattr(self.inner, "by_differences", False))

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual, (n_kept,)."""
        return self._weighted(self.inner.residual({**values, **self.held}))

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the residual, (n_kept, n_params)."""
        return self._weighted(self.inner.jacobian({**values, **self.held}, names))

    def inner_points(self, values: Mapping[str, float]) -> Iterator[tuple[FitProblem, dict[str, float]]]:
        """The inner problem and its values; see `calib.problem.shared_points`."""
        yield self.inner, {**values, **self.held}

    def _weighted(self, rows: np.ndarray) -> np.ndarray:
        of_all = rows if self.kept is None else rows[self.kept]
        return (of_all.T / self.scale).T
