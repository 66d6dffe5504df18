"""How much better a model with an effect is supported than one without."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as la
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr

from calib.effect import Effect
from calib.inference.region import ACTIVE
from calib.missing.state import State


def ln_evidence(state: State, added: Sequence[Effect]) -> float:
    """Log evidence of a fitted model, up to a constant that all models of the same data share.

    Laplace's approximation ``-(|e|^2 + |shift|^2)/2 - ln|S G^T G S + I|/2`` (MacKay 1992). A strength that cannot be
    negative has a half-normal prior: twice the density, and only the part of the posterior above 0. Where the fit ended
    at such a limit, the Gaussian is that about the minimum it would have without the limit.

    Nobody can say beforehand how far a measurement is off. Of a fault of it the plausible size counts, up to the one
    stated, that speaks most for it (Berger and Sellke 1987).

    Parameters
    ----------
    state : State
    added : sequence of Effect
        Effects that the state's model has.
    """
    information = state.scaled_information
    factor = la.cho_factor(information)
    total = -0.5 * state.misfit - float(np.sum(np.log(np.diag(factor[0]))))
    centre = np.array([state.values[n] for n in state.names])
    # Only strengths at 0 pull beyond the limit; whatever else is off its optimum is no evidence for them.
    held = [state.names.index(effect.name) for effect in added if at_lower(state, effect)]
    if held:
        gradient = np.zeros(len(centre))
        gradient[held] = ((state.slope * state.prior_sd).T @ state.residual - state.shift)[held]
        step = la.cho_solve(factor, gradient)
        total += 0.5 * float(gradient @ step)
        centre = centre + state.prior_sd * step
    std = np.sqrt(np.diag(state.covariance))
    for effect in added:
        if not effect.signed:
            k = state.names.index(effect.name)
            total += float(np.log(2.0) + log_ndtr(centre[k] / std[k]))
        if effect.of_measurement:
            k = state.names.index(effect.name)
            total = favoured(total, float(centre[k]), float(std[k]), effect.plausible)
    return total


def at_lower(state: State, effect: Effect) -> bool:
    """Whether the fitted strength of an effect that cannot be negative is next to nothing."""
    p = effect.strength
    return not effect.signed and state.values[effect.name] - p.lower <= ACTIVE * (p.upper - p.lower)


def ln_bayes_linear(z: np.ndarray, size: np.ndarray, plausible: np.ndarray) -> np.ndarray:
    """Log Bayes factor of a strength with a normal prior in a linear model, (m,).

    ``z^2/2 q/(1 + q) - ln(1 + q)/2`` with ``q = (plausible size)^2``; negative scores count as 0.
    """
    q = (plausible * size) ** 2
    return np.maximum(z, 0.0) ** 2 / 2 * q / (1 + q) - 0.5 * np.log1p(q)


def rescaled(ln_bayes: float, strength: float, std: float, prior_sd: float, factor: float) -> float:
    """What a log Bayes factor becomes when the plausible strength is multiplied by a factor.

    Exact for a Gaussian posterior of the strength: the likelihood ``N(m, v)`` that turns the prior into that posterior
    is integrated over the other prior.
    """
    precision = 1 / std**2 - 1 / prior_sd**2
    if precision <= 0:
        return ln_bayes
    v = 1 / precision
    m = strength * v / std**2

    def ln(sd: float) -> float:
        return -0.5 * (np.log(v + sd**2) + m**2 / (v + sd**2))

    return float(ln_bayes + ln(factor * prior_sd) - ln(prior_sd))


def favoured(ln_bayes: float, strength: float, std: float, prior_sd: float) -> float:
    """The largest that a log Bayes factor becomes when the plausible strength is made smaller.

    With the likelihood ``N(m, v)`` of the strength that is at the variance ``m^2 - v`` of its prior.
    """
    precision = 1 / std**2 - 1 / prior_sd**2
    if precision <= 0:
        return ln_bayes
    m = strength / (precision * std**2)
    best = np.sqrt(max(m**2 - 1 / precision, 0.0))
    return rescaled(ln_bayes, strength, std, prior_sd, min(float(best) / prior_sd, 1.0))


def ln_wrong(difference: np.ndarray, covariance: np.ndarray) -> float:
    """Largest log density, less ``-n/2 ln 2 pi``, of data that are wrong by errors of any common plausible size.

    Independent normal errors of the size s raise the covariance C of the difference d between the data and what all
    others predict to ``C + s^2 I``. As of every fault of a measurement that size counts which speaks most for it, see
    `ln_evidence`; of one value it is ``s^2 = d^2 - C``.

    Parameters
    ----------
    difference : ndarray (n,)
        d, whitened.
    covariance : ndarray (n, n)
        C, of a right measurement.
    """
    own, axes = np.linalg.eigh(covariance)
    square = (axes.T @ difference) ** 2

    def ln(variance: float) -> float:
        return -0.5 * float(np.sum(np.log(own + variance) + square / (own + variance)))

    largest = float(np.max(square - own))  # beyond it no part of the sum grows
    if largest <= 0:
        return ln(0.0)
    # C is no less than one, beside which e^-12 of an error that matters is nothing.
    found = minimize_scalar(lambda u: -ln(np.exp(u) * largest), bounds=(-12.0, 0.0), method="bounded")
    return max(-float(found.fun), ln(largest), ln(0.0))


def expected_ln_bayes(score: float, rho: float) -> float:
    """Log Bayes factor to expect between an effect of an expected score and one of correlated fingerprint."""
    return 0.5 * score**2 * (1 - rho**2)


def posterior(ln_bayes: np.ndarray, shares: np.ndarray | None = None) -> tuple[float, np.ndarray]:
    """Probability of the base model and of each effect within the library.

    Half of the prior belongs to the base model, the other half is shared by all groups of effects that look the same,
    and within a group by its effects, so that a longer library does not raise false alarms (multiplicity; Scott and
    Berger 2010).

    Parameters
    ----------
    ln_bayes : ndarray (m,)
    shares : ndarray (m,), optional
        One over the size of each effect's group; by default each is by itself.
    """
    shares = np.ones(len(ln_bayes)) if shares is None else shares
    prior = 0.5 * shares / max(float(shares.sum()), 1.0)
    weights = np.concatenate([[np.log(0.5)], ln_bayes + np.log(prior)])
    weights = np.exp(weights - weights.max())
    weights /= weights.sum()
    return float(weights[0]), weights[1:]
