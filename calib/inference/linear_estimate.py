"""Standard deviations of an estimate that is linear in the data and is not the least-squares one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.inference.considered import At
from calib.inference.constraints import ConstraintRows
from calib.inference.identify import posterior, with_held

_NEGLIGIBLE = 1e-12
"""Eigenvalue over the largest, below which a direction of a covariance is rounding error."""


class Tested(NamedTuple):
    """What tests the model at some values: see `calib.inference.freed.freed`, whose arguments these are."""

    at: At
    uncertain: np.ndarray
    constraints: ConstraintRows


@dataclass(frozen=True, eq=False)
class LinearEstimate:
    """Values that follow from linear equations between data and parameters.

    Attributes
    ----------
    values : mapping from str to float
        All parameters.
    names : tuple of str
        Those that the equations determine.
    gain : ndarray (n_names, n_rows)
        Change of each, in its unit, by one standard deviation of every row of the residual.
    prior_gain : ndarray (n_names, n_names)
        Change of each by one standard deviation of the prior of each.
    """

    values: Mapping[str, float]
    names: tuple[str, ...]
    gain: np.ndarray
    prior_gain: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (n_names, n_names) by errors of the data, which are independent, and of the priors."""
        return np.asarray(self.gain @ self.gain.T + self.prior_gain @ self.prior_gain.T)

    def beyond_least_squares(self, at: At, uncertain: np.ndarray) -> np.ndarray:
        """Changes of the residual that stand for what the estimate errs by more than that of least squares.

        Both err by the noise and by whatever else is uncertain, in different ways. The difference of both covariances
        is factored, and each factor taken as one standard deviation of an error that all rows share, as a held
        parameter is; see `calib.inference.identify.posterior`. Where least squares err more, theirs counts.

        Parameters
        ----------
        at : At
            The values, and the slope of the residual there.
        uncertain : ndarray (n_rows, n_errors)
            Changes of the residual by one standard deviation of what else is uncertain.

        Returns
        -------
        ndarray (n_rows, n_directions)
        """
        index, others = self._split(at)
        errors = self.gain @ np.hstack([uncertain, at.slope[:, others] * at.prior_sd[others]])
        count = len(at.names)
        theirs = with_held(posterior(at.names, at.slope, at.prior_sd), at.slope, uncertain)[:count, :count]
        more = self.covariance + errors @ errors.T - theirs[np.ix_(index, index)]
        return np.asarray(at.slope[:, index] @ _factors(more))

    def tested(self, at: At, uncertain: np.ndarray, constraints: ConstraintRows) -> Tested:
        """What tests the model: the estimate may err as it does, and what it leaves alone is free under its prior.

        With the residual r of the true values the estimate is off by ``gain r``, so that its own residual is
        ``(I + G gain) r`` with the slope G.

        Parameters
        ----------
        at : At
        uncertain : ndarray (n_rows, n_errors)
            Changes of the residual by one standard deviation of what else is uncertain.
        constraints : ConstraintRows
            Its held quantities are the first of these errors.
        """
        index, others = self._split(at)
        own, factors = at.slope[:, index], _factors(self.covariance)
        by_errors, by_others = self.gain @ uncertain, self.gain @ at.slope[:, others]
        ours = constraints.slope[:, index]
        held = constraints.beside(uncertain.shape[1] - constraints.held.shape[1]).held + ours @ by_errors
        return Tested(
            At(
                tuple(at.names[k] for k in others), at.values, at.residual, at.slope[:, others] + own @ by_others,
                at.prior_sd[others], True,
            ),
            np.hstack([uncertain + own @ by_errors, own @ factors]),
            constraints._replace(
                slope=constraints.slope[:, others] + ours @ by_others, held=np.hstack([held, ours @ factors])
            ),
        )  # fmt: skip

    def _split(self, at: At) -> tuple[list[int], list[int]]:
        """Indices of the parameters of the estimate, and of the others that have a prior."""
        index = [at.names.index(name) for name in self.names]
        return index, [k for k in range(len(at.names)) if k not in index and np.isfinite(at.prior_sd[k])]


def _factors(covariance: np.ndarray) -> np.ndarray:
    """Factors F (n, n_directions) of ``F F^T``, the part of a symmetric matrix (n, n) that is a covariance."""
    spread = np.sqrt(np.abs(np.diag(covariance)))
    scale = np.where(spread > 0, spread, 1.0)
    size, direction = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = size > _NEGLIGIBLE * max(size.max(initial=0.0), 1.0)
    return np.asarray(scale[:, None] * direction[:, kept] * np.sqrt(size[kept]))
