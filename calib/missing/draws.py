"""Points drawn from what a fit leaves open."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
from scipy.special import ndtri

from calib.missing.state import State

_TRIES = 200
"""Draws of one point, after which the limits are taken to leave nearly nothing of the posterior."""


def drawn(state: State, count: int, seed: int) -> tuple[dict[str, float], ...]:
    """Values of all parameters at points of a fit's posterior, the same for the same seed.

    A Gaussian about the fit with its covariance (Laplace's approximation), kept within the limits. The points are a
    Latin hypercube (McKay, Beckman and Conover 1979), so that a few of them cover it evenly; one outside the limits is
    drawn anew, and moved to them where none inside is found.

    Parameters
    ----------
    state : State
    count : int
    seed : int
    """
    rng = np.random.default_rng(seed)
    p = len(state.names)
    space = state.question.space
    lower, upper = (
        np.array([getattr(space[n], side) for n in state.names], dtype=float) for side in ("lower", "upper")
    )
    centre = np.array([state.values[n] for n in state.names])
    # Strengths first: the first coordinate of a triangular root keeps its even spread.
    order = np.array(sorted(range(p), key=lambda k: state.names[k] not in state.effects), dtype=int)
    root = np.zeros((p, p))
    root[order] = la.cholesky(state.covariance[np.ix_(order, order)], lower=True) if p else root
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
        out.append({**state.values, **dict(zip(state.names, inside.tolist(), strict=True))})
    return tuple(out)
