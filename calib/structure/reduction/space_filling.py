"""Space-filling designs over parameter spaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace


def box(spaces: Sequence[ParameterSpace]) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest value of every parameter."""
    ends = []
    for space in spaces:
        free = set(space.free_names)
        ends.append([(p.lower, p.upper) if p.name in free else (p.value, p.value) for p in space.parameters])
    table = np.array(ends, dtype=float)
    return table[:, :, 0].min(axis=0), table[:, :, 1].max(axis=0)


def middle(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Middle of the limits: the geometric mean where both are positive, so that both ends are equally far in ratio."""
    return np.where(lower > 0, np.sqrt(np.abs(lower * upper)), 0.5 * (lower + upper))


def levels(space: ParameterSpace) -> int:
    """Largest number of values of an integer parameter."""
    return int(max((p.upper - p.lower + 1 for p in space.free if p.integer), default=1))


def space_filling_points(space: ParameterSpace, count: int, rng: np.random.Generator) -> list[dict[str, float]]:
    """Latin hypercube points within the constraints, with integers distributed evenly; complete sets of values."""
    if not space.free:
        return [space.complete({})]
    lower, upper, integer = space.lower, space.upper, space.integer
    points = sample(space, count, rng, 4 * count).points
    dealt = points.copy()
    for j in np.flatnonzero(integer):
        dealt[:, j] = rng.permutation(np.resize(np.arange(lower[j], upper[j] + 1), count))
    good = space.feasible(dealt)  # with a constraint on integers the sampled values stay
    return [space.complete(row) for row in np.where(good[:, None], dealt, points)]
