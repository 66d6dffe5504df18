"""Two fitted models that explain the data about as well: what a further measurement would say about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la

from calib.missing.option import Option
from calib.missing.rules import RULES
from calib.missing.state import State

_TESTS = 200
"""Times that each drawn truth is measured: the mean then errs by 7 % of the spread that scatter brings."""
EIGHT_OF_TEN = (0.1, 0.9)
"""Levels between which eight of ten cases lie."""


@dataclass(frozen=True)
class Odds:
    """What the log odds in favour of the truth would be, over what the truth may be and what is then measured.

    Attributes
    ----------
    mean, low, high : float
        Mean, and the levels of `EIGHT_OF_TEN`.
    chance : float
        That they are beyond 20:1 for what is true.
    """

    mean: float
    low: float
    high: float
    chance: float


@dataclass(frozen=True, eq=False)
class Rival:
    """A fitted model and what it predicts of all rows.

    Attributes
    ----------
    name : str
        Its effect.
    ln_evidence : float
    state : State
    fit : ndarray (n_rows,)
        Predicted at the fit, in units of the scatter, from where all rivals count.
    slope : ndarray (n_rows, p)
        Derivative of it per one of each parameter's own unit.
    points : tuple of mapping
        Parameter values at points of the posterior, length n_draws.
    drawn : ndarray (n_draws, n_rows)
        Predicted there.
    seen : ndarray (n_draws, n_rows), bool
        Rows that would be there.
    there : ndarray (n_rows,), bool
        Rows that are there at the fit.
    loose : ndarray (n_rows, q)
        What one standard deviation of everything else that only data tell, such as the scale of a shape, does to them.
    """

    name: str
    ln_evidence: float
    state: State
    fit: np.ndarray
    slope: np.ndarray
    points: tuple[Mapping[str, float], ...]
    drawn: np.ndarray
    seen: np.ndarray
    there: np.ndarray
    loose: np.ndarray

    @property
    def spread(self) -> np.ndarray:
        """What is left open of the predictions at the fit: one standard deviation each, (n_rows, p + q)."""
        return np.hstack([self.slope @ root(self.state), self.loose])


@dataclass(frozen=True, eq=False)
class Rivals:
    """Two models, one of which is true; each as likely as the data leave it.

    Attributes
    ----------
    pair : (Rival, Rival)
    measured : ndarray (n_rows,), bool
    seed : int
        Of the scatter of what would be measured.
    """

    pair: tuple[Rival, Rival]
    measured: np.ndarray
    seed: int = 1

    @property
    def names(self) -> tuple[str, str]:
        """Names of their effects."""
        return self.pair[0].name, self.pair[1].name

    @property
    def weights(self) -> tuple[float, float]:
        """Probability of each, given that it is one of them."""
        first = 1 / (1 + float(np.exp(np.clip(self.pair[1].ln_evidence - self.pair[0].ln_evidence, -500, 500))))
        return first, 1 - first

    def odds(self, option: Option) -> Odds:
        """Log odds in favour of the truth once an option has been measured as well (Box and Hill 1967).

        What was measured stays as it is, with the odds it gave. New data y are drawn from each model in turn, at points
        of its posterior and with scatter; they move the log odds by the difference of the log predictive densities
        ``-(r^T S^-1 r + ln|S|)/2``, ``r = y - prediction at the fit`` and ``S = I + G C G^T + L L^T`` with the
        covariance C of the parameters after the first measurement, the slope G of the new rows and what else is loose.
        """
        rng = np.random.default_rng(self.seed)
        found, weight = [], []
        for truth, other, share in zip(self.pair, self.pair[::-1], self.weights, strict=True):
            now, both = truth.ln_evidence - other.ln_evidence, truth.there & other.there
            for point, drawn, seen in zip(truth.points, truth.drawn, truth.seen, strict=True):
                size = self._size(option) * (seen & both)
                kept = size > 0
                bench = {n: sd for n, sd in option.prior_sd.items() if n in truth.state.names}
                told = [sharpness(truth.state, n, sd) for n, sd in bench.items()]
                values = np.array([s * point[n] for n, s in zip(bench, told, strict=True)])
                clean = np.concatenate([(size * drawn)[kept], values])
                tests = clean + rng.standard_normal((_TESTS, len(clean)))
                moved = rng.standard_normal((_TESTS, truth.loose.shape[1])) @ (size[:, None] * truth.loose)[kept].T
                tests[:, : moved.shape[1]] += moved
                gain = _density(truth, tests, size, kept, bench) - _density(other, tests, size, kept, bench)
                found.append(now + gain)
                weight.append(np.full(_TESTS, share / (len(truth.points) * _TESTS)))
        values, weights = np.concatenate(found), np.concatenate(weight)
        low, high = np.quantile(values, EIGHT_OF_TEN, weights=weights, method="inverted_cdf")
        chance = float(np.sum(weights[values > RULES.credible]) / weights.sum())
        return Odds(float(np.average(values, weights=weights)), float(low), float(high), chance)

    def difference(self, option: Option) -> float:
        """How far the two fits are apart in what an option would measure, in units of what both leave open; a square.

        ``m^T (S_a^-1 + S_b^-1) m/2`` with the difference m of the predictions: to rank many options quickly.
        """
        size = self._size(option) * (self.pair[0].there & self.pair[1].there)
        kept = size > 0
        m = (size * (self.pair[0].fit - self.pair[1].fit))[kept]
        total = 0.0
        for one in self.pair:
            wide = (size[:, None] * one.spread)[kept]
            inner = la.cho_factor(np.eye(wide.shape[1]) + wide.T @ wide)
            along = wide.T @ m
            total += float(m @ m - along @ la.cho_solve(inner, along)) / 2
        return total

    def _size(self, option: Option) -> np.ndarray:
        """Root of the weight at which every row is measured anew, (n_rows,)."""
        again = np.sqrt(max(1 / option.scale**2 - 1, 0.0))
        rows = np.zeros_like(self.measured) if option.rows is None else option.rows
        return np.where(self.measured, again, np.where(rows, 1 / option.scale, 0.0))


def sharpness(state: State, name: str, sd: float) -> float:
    """Root of the weight of a test of one parameter that leaves it known to ``sd`` with what was known before."""
    prior = float(state.prior_sd[state.names.index(name)])
    return float(np.sqrt(max(1 / sd**2 - 1 / prior**2, 0.0)))


def root(state: State) -> np.ndarray:
    """A root of the covariance of the parameters, (p, p)."""
    return la.cholesky(state.covariance, lower=True)


def _density(
    one: Rival, tests: np.ndarray, size: np.ndarray, kept: np.ndarray, bench: Mapping[str, float]
) -> np.ndarray:
    """Log predictive density of new data (n_tests, n_new), less what all models share, (n_tests,)."""
    state = one.state
    rows, spread = [(size[:, None] * one.spread)[kept]], root(state)
    fit = [(size * one.fit)[kept]]
    for name, sd in bench.items():
        told = sharpness(state, name, sd)
        rows.append(told * np.append(spread[state.names.index(name)], np.zeros(one.loose.shape[1]))[None])
        fit.append(np.array([told * state.values[name]]))
    wide = np.vstack(rows)
    r = tests - np.concatenate(fit)
    inner = la.cho_factor(np.eye(wide.shape[1]) + wide.T @ wide)
    along = r @ wide
    square = np.sum(r * r, axis=1) - np.sum(along * la.cho_solve(inner, along.T).T, axis=1)
    return -0.5 * square - float(np.sum(np.log(np.diag(inner[0]))))
