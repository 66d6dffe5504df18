"""New designs where metamodels know least of what is asked: far from other designs, near what was measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.sensitivity.prognosis import Metamodel

NEIGHBOURS = 10
"""Designs whose errors tell that of a metamodel near them."""
SHARE = 0.05
"""Part of the candidates that a weight by the measured values effectively leaves."""


def local_errors(models: Sequence[Metamodel], designs: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Root mean square error of each metamodel near points, (n, n_models), in the unit of its response.

    That of the nearest designs, each as predicted without its own fold, weighted by the inverse of the distance.

    Parameters
    ----------
    models : sequence of Metamodel
    designs : ndarray (n_designs, n_inputs)
        Those of the metamodels, in coordinates of `coordinates`.
    points : ndarray (n, n_inputs)
        In the same coordinates.
    """
    distance = distances(points, designs)
    out = np.empty((len(points), len(models)))
    for k, one in enumerate(models):
        own = distance[:, one.rows]
        near = np.argsort(own, axis=1, kind="stable")[:, :NEIGHBOURS]
        weights = 1.0 / np.maximum(np.take_along_axis(own, near, axis=1), 1e-12)
        squares = ((one.true - one.predicted) ** 2)[near]
        out[:, k] = np.sqrt((weights * squares).sum(axis=1) / weights.sum(axis=1))
    return out


def coordinates(models: Sequence[Metamodel], points: np.ndarray) -> np.ndarray:
    """Points (n, n_inputs), each input between 0 and the root of its largest CoP: one that does nothing has no length.

    ``points`` are in the units of the inputs.
    """
    space = models[0].space
    shares = np.max([one.shares["cop"].to_numpy() for one in models], axis=0)
    return np.asarray(space.position(points) * np.sqrt(np.clip(np.nan_to_num(shares), 0.0, 1.0)))


def distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distances (n_points, n_others)."""
    squares = (points**2).sum(axis=1)[:, None] + (others**2).sum(axis=1) - 2.0 * points @ others.T
    return np.sqrt(np.maximum(squares, 0.0))


def tempered(misfit: np.ndarray) -> np.ndarray:
    """Weights (n,) of points by their sums of squares, as much flatter than ``exp(-misfit / 2)`` as leaves `SHARE`.

    The effective number of points is ``sum(w)^2 / sum(w^2)`` (Kish 1965).
    """
    rise = misfit - misfit.min()

    def weights(temperature: float) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * rise / temperature))

    low, high = 1.0, 1.0
    least = SHARE * len(rise)

    def effective(temperature: float) -> float:
        w = weights(temperature)
        return float(w.sum() ** 2 / (w**2).sum())

    while effective(high) < least:
        low, high = high, 4.0 * high
    for _ in range(30):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if effective(middle) < least else (low, middle)
    return weights(high)


def chosen_runs(score: np.ndarray, candidates: np.ndarray, designs: np.ndarray, count: int) -> list[int]:
    """Candidates one after the other: the largest score times the squared distance from designs and earlier choices.

    Parameters
    ----------
    score : ndarray (n,)
    candidates, designs : ndarray (n, n_inputs), (n_designs, n_inputs)
        In the coordinates of `coordinates`.
    count : int
    """
    nearest = distances(candidates, designs).min(axis=1)
    out = list[int]()
    for _ in range(min(count, len(candidates))):
        best = int(np.argmax(score * nearest**2))
        out.append(best)
        nearest = np.minimum(nearest, distances(candidates, candidates[best : best + 1])[:, 0])
        nearest[best] = 0.0
    return out
