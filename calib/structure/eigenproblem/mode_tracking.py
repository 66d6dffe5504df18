"""Derivatives of modes by central differences with mode tracking, for models without analytic derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.errors.errors import EvaluationError
from calib.measurement.mac import align, mac
from calib.problem.differences import difference
from calib.problem.space import ParameterSpace
from calib.structure.eigenproblem.derivatives import ModeDerivatives, eigenvalues
from calib.structure.modes import Modes
from calib.structure.rules import RULES


def followed_derivatives(
    at: Callable[[Mapping[str, float]], Modes],
    space: ParameterSpace,
    values: Mapping[str, float],
    modes: Modes,
    names: Sequence[str],
    which: Sequence[int] | np.ndarray,
    rows: np.ndarray,
    step: float,
) -> ModeDerivatives:
    """Central differences of modes, each tracked to both ends by its MAC, so that modes may cross in between.

    An end is half a step away, within the limits of the parameter. Modes are matched one to one with those of the end
    so that the sum of MAC less ``|ln(frequency ratio)|`` is largest: where modes cross, their shapes distinguish them;
    where two have similar shapes at all sensors, their frequencies do. The shape of a successor is scaled and
    phase-aligned to the mode by least squares.

    A difference is one-sided at a limit, where the model fails at one end, and for a mode without a successor there
    (`RULES.successor`). A mode without successors along a parameter has zero derivatives; one whose successor is a
    different mixture of modes (`RULES.smooth`) has derivatives of frequency and damping only, and 0 for its shape.

    Parameters
    ----------
    at : callable
        Returns the modes at named values.
    space : ParameterSpace
    values : mapping
        At which ``modes`` were solved.
    modes : Modes
    names : sequence of str
    which : sequence of int
        Indices of the modes wanted.
    rows : ndarray (n_rows, n_dof)
        Output rows for the shapes.
    step : float
        Half step of a difference, over the range between the limits.

    Raises
    ------
    EvaluationError
        When the model fails on both sides of the point along one of the parameters.
    """
    chosen = np.asarray(which, dtype=int)
    complete = space.complete(dict(values))
    kind = complex if modes.is_complex else float
    eigenvalue = np.zeros((len(names), len(chosen)), dtype=complex)
    shapes = np.zeros((len(names), len(rows), len(chosen)), dtype=kind)
    for q, name in enumerate(names if len(chosen) else ()):
        path = _Path(at, modes, chosen, complete)
        slope = difference(path.vector, complete, space[name], step).reshape(-1, 2, len(chosen))
        moved = np.nan_to_num(slope[:, 0] + 1j * slope[:, 1])
        eigenvalue[q] = moved[0]
        change = np.where(path.smooth, moved[1:], 0.0)
        shapes[q] = rows @ (change if kind is complex else change.real)
    here = eigenvalues(modes)[chosen]
    size = np.abs(here)
    grown = np.real(np.conj(here) * eigenvalue) / size
    return ModeDerivatives(
        names=tuple(names),
        eigenvalue=eigenvalue,
        shapes=shapes,
        natural_freq=grown / (2 * np.pi),
        damped_freq=eigenvalue.imag / (2 * np.pi),
        damping_ratio=-eigenvalue.real / size + here.real * grown / size**2,
        regular=np.ones(len(chosen), dtype=bool),
    )


def successors(shapes: np.ndarray, freq: np.ndarray, there: Modes) -> tuple[np.ndarray, np.ndarray]:
    """Successors of modes at another point, one to one, and their MAC, both (n_modes,).

    Parameters
    ----------
    shapes : ndarray (n_dof, n_modes)
    freq : ndarray (n_modes,)
        Hz.
    there : Modes
        At least as many.
    """
    similarity = np.nan_to_num(mac(shapes, there.shapes))
    ratio = np.log(there.natural_freq) - np.log(freq)[:, None]
    found = np.asarray(linear_sum_assignment(similarity - np.abs(ratio), maximize=True)[1])
    return found, similarity[np.arange(len(found)), found]


class _Path:
    """Modes tracked from one point, as a real vector for differencing."""

    def __init__(
        self,
        at: Callable[[Mapping[str, float]], Modes],
        modes: Modes,
        chosen: np.ndarray,
        values: Mapping[str, float],
    ):
        self.at, self.start, self.chosen, self.values = at, modes, chosen, dict(values)
        self.smooth = np.ones(len(chosen), dtype=bool)

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Real and imaginary part of eigenvalue and shape, ((1 + n_dof) * 2 * n_modes,); NaN for a lost mode."""
        if dict(values) == self.values:
            return _parts(eigenvalues(self.start)[self.chosen], self.start.shapes[:, self.chosen])
        there = self.at(values)
        if there.n_modes < len(self.chosen):
            raise EvaluationError(f"only {there.n_modes} modes were solved to track {len(self.chosen)}")
        shapes = self.start.shapes[:, self.chosen]
        found, reached = successors(shapes, self.start.natural_freq[self.chosen], there)
        pairs = [(shapes[:, k], there.shapes[:, j]) for k, j in enumerate(found)]
        moved = np.column_stack([end * align(start, end) for start, end in pairs])
        self.smooth &= (reached >= RULES.smooth) | (reached < RULES.successor)
        out = _parts(eigenvalues(there)[found], moved).reshape(-1, 2, len(found))
        out[:, :, reached < RULES.successor] = np.nan
        return out.ravel()


def _parts(eigenvalue: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    both = np.vstack([eigenvalue[None], shapes]).astype(complex)
    return np.stack([both.real, both.imag], axis=1).ravel()
