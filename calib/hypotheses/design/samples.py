"""Posterior samples of a fit."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
from scipy.special import ndtri

from calib.missing.linearised_fit import LinearisedFit

_TRIES = 200
"""Attempts to draw a sample inside the limits before it is moved onto them."""


def posterior_samples(fit: LinearisedFit, count: int, seed: int) -> tuple[dict[str, float], ...]:
    """Posterior samples of all parameters; the same seed gives the same samples.

    The posterior is a Gaussian about the fit (Laplace's approximation), truncated at the limits. The samples are a
    Latin hypercube (McKay, Beckman and Conover 1979), so that a few of them fill it evenly. A sample outside the limits
    is drawn again, and moved onto them if all attempts fail.

    Parameters
    ----------
    fit : LinearisedFit
    count : int
    seed : int
    """
    rng = np.random.default_rng(seed)
    p = len(fit.names)
    space = fit.fit_problem.space
    lower, upper = (np.array([getattr(space[n], side) for n in fit.names], dtype=float) for side in ("lower", "upper"))
    centre = np.array([fit.values[n] for n in fit.names])
    # Magnitudes first: the first coordinate of a triangular root keeps the stratification.
    order = np.array(sorted(range(p), key=lambda k: fit.names[k] not in fit.effects), dtype=int)
    root = np.zeros((p, p))
    root[order] = la.cholesky(fit.covariance[np.ix_(order, order)], lower=True) if p else root
    strata = np.array([rng.permutation(count) for _ in range(p)]).reshape(p, count)
    even = ndtri((strata + rng.uniform(size=(p, count))) / count)
    out = []
    for k in range(count):
        point = centre + root @ even[:, k]
        for _ in range(_TRIES):
            if np.all((point >= lower) & (point <= upper)):
                break
            point = centre + root @ rng.standard_normal(p)
        inside = np.clip(point, lower, upper)
        out.append({**fit.values, **dict(zip(fit.names, inside.tolist(), strict=True))})
    return tuple(out)
