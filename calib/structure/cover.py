"""Points that cover parameter spaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.sampling import sample
from calib.space import ParameterSpace


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
    lower, upper, whole = space.lower, space.upper, space.integer
    points = sample(space, count, rng, 4 * count).points
    dealt = points.copy()
    for j in np.flatnonzero(whole):
        dealt[:, j] = rng.permutation(np.resize(np.arange(lower[j], upper[j] + 1), count))
    good = space.feasible(dealt)  # a constraint on whole numbers keeps what was drawn
    return [space.complete(row) for row in np.where(good[:, None], dealt, points)]
