"""Candidates for the next measurement, and the log Bayes factor between two competing models to expect of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.linalg as la

from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES

_TESTS = 200
"""Simulated measurements per posterior sample: the standard error of the mean is 7 % of the spread due to noise."""
EIGHT_OF_TEN = (0.1, 0.9)
"""Quantile levels between which eight of ten cases lie."""


class Excitation(NamedTuple):
    """How a mode is best excited.

    Attributes
    ----------
    at : tuple of float
        Place, m.
    direction : str
        ``x``, ``y`` or ``z``.
    freq : float
        Its natural frequency, Hz.
    damping : float
        Its damping ratio.
    hung : str
        Effect whose added degrees of freedom the mode moves most; empty for a mode of the structure.
    """

    at: tuple[float, float, float]
    direction: str
    freq: float
    damping: float
    hung: str = ""


@dataclass(frozen=True, eq=False)
class CandidateMeasurement:
    """A candidate for the next measurement.

    Attributes
    ----------
    name : str
        In words.
    kind : {"sensor", "mode", "reference", "held out", "repeats", "bench"}
    rows : ndarray (n_rows,), bool or None
        Rows that it adds to the measured ones.
    scale : float
        Factor on the standard deviation of all rows, such as ``1/sqrt(2)`` for twice the repeats.
    prior_sd : mapping from str to float
        Standard deviations of parameters after a bench test of a component.
    excitation : Excitation or None
        Of a further mode.
    """

    name: str
    kind: str
    rows: np.ndarray | None = None
    scale: float = 1.0
    prior_sd: Mapping[str, float] = field(default_factory=dict)
    excitation: Excitation | None = None


def at_effect(name: str) -> str:
    """Beginning of the name of the measurement with sensors where an effect acts."""
    return f"all directions where {name} acts"


@dataclass(frozen=True)
class BayesFactor:
    """Distribution of the log Bayes factor in favour of the true model, over posterior samples and simulated data.

    Attributes
    ----------
    mean, low, high : float
        Mean, and the quantiles at the levels `EIGHT_OF_TEN`.
    chance : float
        Probability that it is beyond 20:1 for the true model.
    """

    mean: float
    low: float
    high: float
    chance: float


@dataclass(frozen=True, eq=False)
class CompetingModel:
    """A fitted model and its predictions for all rows.

    Attributes
    ----------
    name : str
        Its effect.
    ln_evidence : float
    fit : LinearisedFit
    predicted : ndarray (n_rows,)
        Predictions at the fit, in standard deviations, relative to an origin common to all competing models.
    slope : ndarray (n_rows, p)
        Their derivatives, per unit of each parameter.
    points : tuple of mapping
        Posterior samples of the parameters, length n_samples.
    sampled : ndarray (n_samples, n_rows)
        Predictions at the samples.
    sampled_rows : ndarray (n_samples, n_rows), bool
        Rows that exist at each sample.
    rows_at_fit : ndarray (n_rows,), bool
        Rows that exist at the fit.
    loose : ndarray (n_rows, q)
        Sensitivity to profiled-out factors, such as the scale of a shape, per standard deviation of each.
    """

    name: str
    ln_evidence: float
    fit: LinearisedFit
    predicted: np.ndarray
    slope: np.ndarray
    points: tuple[Mapping[str, float], ...]
    sampled: np.ndarray
    sampled_rows: np.ndarray
    rows_at_fit: np.ndarray
    loose: np.ndarray

    @property
    def spread(self) -> np.ndarray:
        """Columns of a root of the covariance of the predictions at the fit, (n_rows, p + q)."""
        return np.hstack([self.slope @ root(self.fit), self.loose])


@dataclass(frozen=True, eq=False)
class CompetingModels:
    """Two models, one of which is taken to be true, with the probabilities that the data give them.

    Attributes
    ----------
    pair : (CompetingModel, CompetingModel)
    measured : ndarray (n_rows,), bool
    seed : int
        Of the noise of the simulated data.
    """

    pair: tuple[CompetingModel, CompetingModel]
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

    def bayes_factor(self, measurement: CandidateMeasurement) -> BayesFactor:
        """Log Bayes factor in favour of the true model after a candidate measurement (Box and Hill 1967).

        The measured data keep the log Bayes factor that they gave. New data y are simulated from each model in turn, at
        its posterior samples and with noise. They add the difference of the log predictive densities
        ``-(r^T S^-1 r + ln|S|)/2``, with ``r = y - prediction at the fit`` and ``S = I + G C G^T + L L^T``, where C is
        the covariance of the parameters after the first measurement, G the slope of the new rows and L their
        sensitivity to profiled-out factors (`CompetingModel.loose`).
        """
        rng = np.random.default_rng(self.seed)
        found, weight = [], []
        for truth, other, share in zip(self.pair, self.pair[::-1], self.weights, strict=True):
            now, both = truth.ln_evidence - other.ln_evidence, truth.rows_at_fit & other.rows_at_fit
            for point, drawn, seen in zip(truth.points, truth.sampled, truth.sampled_rows, strict=True):
                size = self._size(measurement) * (seen & both)
                kept = size > 0
                bench = {n: sd for n, sd in measurement.prior_sd.items() if n in truth.fit.names}
                sharp = [sharpness(truth.fit, n, sd) for n, sd in bench.items()]
                values = np.array([s * point[n] for n, s in zip(bench, sharp, strict=True)])
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
        return BayesFactor(float(np.average(values, weights=weights)), float(low), float(high), chance)

    def difference(self, measurement: CandidateMeasurement) -> float:
        """Squared distance of the predictions for a candidate measurement, in units of their standard deviations.

        ``m^T (S_a^-1 + S_b^-1) m/2`` with the difference m of the predictions: ranks many measurements quickly.
        """
        size = self._size(measurement) * (self.pair[0].rows_at_fit & self.pair[1].rows_at_fit)
        kept = size > 0
        m = (size * (self.pair[0].predicted - self.pair[1].predicted))[kept]
        total = 0.0
        for one in self.pair:
            wide = (size[:, None] * one.spread)[kept]
            inner = la.cho_factor(np.eye(wide.shape[1]) + wide.T @ wide)
            along = wide.T @ m
            total += float(m @ m - along @ la.cho_solve(inner, along)) / 2
        return total

    def _size(self, measurement: CandidateMeasurement) -> np.ndarray:
        """Root of the weight of the new data in every row, (n_rows,)."""
        again = np.sqrt(max(1 / measurement.scale**2 - 1, 0.0))
        rows = np.zeros_like(self.measured) if measurement.rows is None else measurement.rows
        return np.where(self.measured, again, np.where(rows, 1 / measurement.scale, 0.0))


def sharpness(fit: LinearisedFit, name: str, sd: float) -> float:
    """Root of the weight of a bench test that reduces the standard deviation of one parameter to ``sd``."""
    prior = float(fit.prior_sd[fit.names.index(name)])
    return float(np.sqrt(max(1 / sd**2 - 1 / prior**2, 0.0)))


def root(fit: LinearisedFit) -> np.ndarray:
    """Cholesky root of the covariance of the parameters, (p, p)."""
    return la.cholesky(fit.covariance, lower=True)


def _density(
    one: CompetingModel, tests: np.ndarray, size: np.ndarray, kept: np.ndarray, bench: Mapping[str, float]
) -> np.ndarray:
    """Log predictive density of new data (n_tests, n_new), up to a constant that all models share, (n_tests,)."""
    fit = one.fit
    rows, spread = [(size[:, None] * one.spread)[kept]], root(fit)
    predicted = [(size * one.predicted)[kept]]
    for name, sd in bench.items():
        weight = sharpness(fit, name, sd)
        rows.append(weight * np.append(spread[fit.names.index(name)], np.zeros(one.loose.shape[1]))[None])
        predicted.append(np.array([weight * fit.values[name]]))
    wide = np.vstack(rows)
    r = tests - np.concatenate(predicted)
    inner = la.cho_factor(np.eye(wide.shape[1]) + wide.T @ wide)
    along = r @ wide
    square = np.sum(r * r, axis=1) - np.sum(along * la.cho_solve(inner, along.T).T, axis=1)
    return -0.5 * square - float(np.sum(np.log(np.diag(inner[0]))))
