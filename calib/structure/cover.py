"""Points that cover parameter spaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.errors import InputError
from calib.space import ParameterSpace

_TRIES = 200_000
"""Candidates drawn before the constraints are judged too narrow."""


def box(spaces: Sequence[ParameterSpace]) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest value of every parameter."""
    ends = []
    for space in spaces:
        free = set(space.free_names)
        ends.append([(p.lower, p.upper) if p.name in free else (p.value, p.value) for p in space.parameters])
    table = np.array(ends, dtype=float)
    return table[:, :, 0].min(axis=0), table[:, :, 1].max(axis=0)


def middle(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Middle of the limits: by ratio where both are positive, so that soft and stiff ends are equally far."""
    return np.where(lower > 0, np.sqrt(np.abs(lower * upper)), 0.5 * (lower + upper))


def levels(space: ParameterSpace) -> int:
    """Most values that a whole-number parameter takes."""
    return int(max((p.upper - p.lower + 1 for p in space.free if p.integer), default=1))


def covering_points(space: ParameterSpace, count: int, rng: np.random.Generator) -> list[dict[str, float]]:
    """Latin hypercube points that keep the constraints, whole numbers dealt out evenly; complete sets of values."""
    if not space.free:
        return [space.complete({})]
    from scipy.stats import qmc  # slow to import, and seldom asked for

    engine = qmc.LatinHypercube(len(space.free), rng=rng)
    lower, upper, whole = space.lower, space.upper, space.integer
    kept, tried = np.zeros((0, len(lower))), 0
    while len(kept) < count:
        unit = engine.random(4 * count)
        drawn = np.where(whole, lower + np.floor(unit * (upper - lower + 1)), lower + unit * (upper - lower))
        kept = np.vstack([kept, drawn[space.feasible(drawn)]])
        tried += len(drawn)
        if tried > _TRIES and len(kept) < count:
            raise InputError(
                f"only {len(kept)} of {tried} points keep the constraints", place="constraints", remedy="widen them"
            )
    points = kept[:count]
    dealt = points.copy()
    for j in np.flatnonzero(whole):
        dealt[:, j] = rng.permutation(np.resize(np.arange(lower[j], upper[j] + 1), count))
    good = space.feasible(dealt)  # a constraint on whole numbers keeps what was drawn
    return [space.complete(row) for row in np.where(good[:, None], dealt, points)]
