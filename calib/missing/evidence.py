"""Evidence of models with effects, and the Bayes factors between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg as la
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr

from calib.inference.region import ACTIVE
from calib.missing.linearised_fit import LinearisedFit
from calib.problem.candidate import Candidate
from calib.problem.parameter import Parameter


def ln_evidence(fit: LinearisedFit, added: Sequence[Candidate]) -> float:
    """Log evidence of a fitted model, up to a constant that all models of the same data share.

    Laplace's approximation ``-(|e|^2 + |shift|^2)/2 - ln|S G^T G S + I|/2`` (MacKay 1992). A magnitude that cannot be
    negative has a half-normal prior: twice the density, and only the part of the posterior above 0. When the fit ended
    at such a limit, the Gaussian is centred on the minimum that it would have without the limit.

    A choice among places, an integer parameter of an effect, has the same prior for each: the evidence is that of the
    best place over their number.

    The size of a measurement fault is not known beforehand. Its plausible size is therefore the one, up to the stated
    value, that maximises the evidence (Berger and Sellke 1987).

    Parameters
    ----------
    fit : LinearisedFit
    added : sequence of Candidate
        Effects of the fitted model.
    """
    information = fit.scaled_information
    factor = la.cho_factor(information)
    total = -0.5 * fit.misfit - float(np.sum(np.log(np.diag(factor[0]))))
    centre = np.array([fit.values[n] for n in fit.names])
    # Only magnitudes held at 0 are released; a gradient in any other parameter is no evidence for them.
    held = [fit.names.index(effect.name) for effect in added if at_lower(fit, effect)]
    if held:
        gradient = np.zeros(len(centre))
        gradient[held] = ((fit.slope * fit.prior_sd).T @ fit.residual - fit.shift)[held]
        step = la.cho_solve(factor, gradient)
        total += 0.5 * float(gradient @ step)
        centre = centre + fit.prior_sd * step
    std = np.sqrt(np.diag(fit.covariance))
    for effect in added:
        total -= sum(float(np.log(q.upper - q.lower + 1)) for q in effect.nuisance if q.integer)
        if not effect.signed:
            k = fit.names.index(effect.name)
            total += float(np.log(2.0) + log_ndtr(centre[k] / std[k]))
        if effect.of_measurement:
            k = fit.names.index(effect.name)
            total = favoured(total, float(centre[k]), float(std[k]), effect.plausible)
    return total


def at_lower(fit: LinearisedFit, effect: Candidate) -> bool:
    """Whether the fitted magnitude of an effect that cannot be negative is on its lower limit."""
    p = effect.magnitude
    return not effect.signed and fit.values[effect.name] - p.lower <= ACTIVE * (p.upper - p.lower)


def ln_bayes_linear(z: np.ndarray, size: np.ndarray, plausible: np.ndarray) -> np.ndarray:
    """Log Bayes factor of a magnitude with a normal prior in a linear model, (m,).

    ``z^2/2 q/(1 + q) - ln(1 + q)/2`` with ``q = (plausible size)^2``; negative scores count as 0.
    """
    q = (plausible * size) ** 2
    return np.maximum(z, 0.0) ** 2 / 2 * q / (1 + q) - 0.5 * np.log1p(q)


def rescaled(ln_bayes: float, magnitude: float, std: float, prior_sd: float, factor: float) -> float:
    """Log Bayes factor after the plausible magnitude is multiplied by a factor.

    Exact for a Gaussian posterior of the magnitude: the likelihood ``N(m, v)`` that turns the prior into that posterior
    is integrated over the other prior.
    """
    precision = 1 / std**2 - 1 / prior_sd**2
    if precision <= 0:
        return ln_bayes
    v = 1 / precision
    m = magnitude * v / std**2

    def ln(sd: float) -> float:
        return -0.5 * (np.log(v + sd**2) + m**2 / (v + sd**2))

    return float(ln_bayes + ln(factor * prior_sd) - ln(prior_sd))


def resized(ln_bayes: float, magnitude: float, std: float, p: Parameter, factor: float) -> float:
    """`rescaled` for the prior of a magnitude.

    Heavy tails bend little over the posterior, so that the ratio is that of their densities at the magnitude.
    """
    if p.prior_kind != "heavy-tailed":
        return rescaled(ln_bayes, magnitude, std, p.prior_width, factor)
    return ln_bayes + replace(p, prior_sd=factor * p.prior_width).log_prior(magnitude) - p.log_prior(magnitude)


def favoured(ln_bayes: float, magnitude: float, std: float, prior_sd: float) -> float:
    """Largest log Bayes factor over all plausible magnitudes up to the stated one.

    With the likelihood ``N(m, v)`` of the magnitude, the maximum is at the prior variance ``m^2 - v``.
    """
    precision = 1 / std**2 - 1 / prior_sd**2
    if precision <= 0:
        return ln_bayes
    m = magnitude / (precision * std**2)
    best = np.sqrt(max(m**2 - 1 / precision, 0.0))
    return rescaled(ln_bayes, magnitude, std, prior_sd, min(float(best) / prior_sd, 1.0))


def ln_wrong(difference: np.ndarray, covariance: np.ndarray) -> float:
    """Largest log density, up to ``-n/2 ln 2 pi``, of wrong data over the plausible size of their errors.

    Let d be the difference between the data and their prediction from all others, with covariance C. Independent
    normal errors of standard deviation s raise it to ``C + s^2 I``. As for every measurement fault (`ln_evidence`), s
    maximises the density; for a single value ``s^2 = d^2 - C``.

    Parameters
    ----------
    difference : ndarray (n,)
        d, whitened.
    covariance : ndarray (n, n)
        C, for a correct measurement.
    """
    own, axes = np.linalg.eigh(covariance)
    square = (axes.T @ difference) ** 2

    def ln(variance: float) -> float:
        return -0.5 * float(np.sum(np.log(own + variance) + square / (own + variance)))

    largest = float(np.max(square - own))  # the density decreases beyond it
    if largest <= 0:
        return ln(0.0)
    # The eigenvalues of C are at least 1, beside which e^-12 of a relevant error is negligible.
    found = minimize_scalar(lambda u: -ln(np.exp(u) * largest), bounds=(-12.0, 0.0), method="bounded")
    return max(-float(found.fun), ln(largest), ln(0.0))


def expected_ln_bayes(score: float, rho: float) -> float:
    """Expected log Bayes factor between an effect of an expected score and one with correlated signature."""
    return 0.5 * score**2 * (1 - rho**2)


def model_probabilities(ln_bayes: np.ndarray, shares: np.ndarray | None = None) -> tuple[float, np.ndarray]:
    """Probability of the base model and of each effect within the library.

    Half of the prior probability belongs to the base model. The other half is shared equally by all groups of collinear
    effects, and within a group by its effects, so that a longer library does not raise the rate of false alarms
    (multiplicity; Scott and Berger 2010).

    Parameters
    ----------
    ln_bayes : ndarray (m,)
    shares : ndarray (m,), optional
        One over the size of each effect's group; by default every effect is its own group.
    """
    shares = np.ones(len(ln_bayes)) if shares is None else shares
    prior = 0.5 * shares / max(float(shares.sum()), 1.0)
    weights = np.concatenate([[np.log(0.5)], ln_bayes + np.log(prior)])
    weights = np.exp(weights - weights.max())
    weights /= weights.sum()
    return float(weights[0]), weights[1:]
