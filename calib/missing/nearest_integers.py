"""Integer parameters next to a point: the most promising ones, and all that are one off."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np
import scipy.linalg as la

from calib.errors.errors import EvaluationError
from calib.missing.hypotheses import FitProblem
from calib.problem.prior import Prior

_ALL_AT_ONCE = 3
"""Up to so many integer parameters are moved together (26 neighbours), more one at a time."""


def nearest_whole(fit_problem: FitProblem, start: Mapping[str, float]) -> dict[str, float]:
    """A start with the integers for which one Gauss-Newton step predicts the lowest sum of squares.

    Every combination is linearised by itself, at the other values of the start, since moving a support changes the
    derivatives by all other parameters. Beginning with the integers of the start, the search moves to the best
    neighbour, each integer at most one off, until no neighbour predicts a lower sum of squares.
    """
    space = fit_problem.space
    whole = [p for p in space.free if p.integer]
    complete = space.complete(dict(start))
    names = [p.name for p in space.free if not p.integer]
    prior = Prior.of(space)
    sd, (own, pulling) = prior.widths(complete, names), prior.rows(complete, names)
    predicted: dict[tuple[int, ...], float] = {}

    def prediction(numbers: tuple[int, ...]) -> float:
        if numbers not in predicted:
            here = {**complete, **{p.name: float(n) for p, n in zip(whole, numbers, strict=True)}}
            try:
                slope, residual = fit_problem.jacobian(here, names), fit_problem.residual(here)
            except EvaluationError:
                predicted[numbers] = math.inf
                return math.inf
            matrix = np.vstack([slope, pulling]) * sd
            right = np.concatenate([residual, own])
            basis = la.qr(matrix, mode="economic")[0]
            predicted[numbers] = float(right @ right - np.sum((basis.T @ right) ** 2))
        return predicted[numbers]

    if not whole:
        return complete
    here = tuple(round(complete[p.name]) for p in whole)
    moves = _moves(len(whole))
    while True:
        near = [tuple(n + d for n, d in zip(here, move, strict=True)) for move in moves]
        inside = [n for n in near if all(p.lower <= k <= p.upper for k, p in zip(n, whole, strict=True))]
        best = min([here, *inside], key=prediction)
        if best == here:
            return {**complete, **{p.name: float(n) for p, n in zip(whole, here, strict=True)}}
        here = best


def other_whole(fit_problem: FitProblem, values: Mapping[str, float]) -> list[dict[str, float]]:
    """Other integers within their limits, each at most one off those of some values."""
    whole = [p for p in fit_problem.space.free if p.integer]
    out = []
    for move in _moves(len(whole)):
        change = {p.name: float(round(values[p.name]) + d) for p, d in zip(whole, move, strict=True)}
        if any(move) and all(p.lower <= change[p.name] <= p.upper for p in whole):
            out.append(change)
    return out


def _moves(count: int) -> list[tuple[int, ...]]:
    """Steps of so many integers, all at once where they are few."""
    if count <= _ALL_AT_ONCE:
        return list(itertools.product((-1, 0, 1), repeat=count))
    return [tuple(d if j == k else 0 for j in range(count)) for k in range(count) for d in (-1, 1)]
