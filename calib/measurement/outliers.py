"""Repeats that disagree with the others at one place: a value, a channel or a whole shape, found at a strict level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

LEVEL = 2e-4
"""Chance that anything in one table of Gaussian repeats is called outlying."""
REPEATS_FEWEST = 3
"""Of two repeats that disagree, nothing tells which one is wrong."""
OUTLIERS_MOST = 10
"""Outliers sought in one group, and never half of it or more."""
GROUPS_FEWEST = 4
"""With fewer groups their variances do not tell what a group without much data may have."""
SPREAD_DOUBT = 2.5
"""Relative standard error of a squared median absolute deviation, times the root of the number of values."""
SHAPE_RESOLUTION = 1e-4
"""Standard deviation, in parts of the largest entry, that rounding alone gives shapes."""


@dataclass(frozen=True)
class Outlying:
    """One block of one repeat that lies outside.

    Attributes
    ----------
    repeat, group : int
    times : float
        Its distance from the mean of the others, over the standard deviation (moderated) of one repeat.
    excess : float
        Sum over the block of the squared distances from the mean of the others.
    """

    repeat: int
    group: int
    times: float
    excess: float


def find_outlying(
    blocks: np.ndarray, resolution: float | np.ndarray = 0.0, level: float = LEVEL
) -> tuple[Outlying, ...]:
    """Blocks that do not belong to the other repeats of their group.

    The generalised extreme studentised deviate test (Rosner 1983) over the repeats of each group: the most distant
    repeat is taken out, up to `OUTLIERS_MOST` times and short of half of them; all that were taken out up to the last
    significant one are outlying, so that two alike do not mask each other. A distance is judged by an F test of

        ``|x_k - mean of the others|^2 (n - 1)/n / s^2``,

    on 1 (complex: 2) and as many times ``n - 2`` degrees of freedom: the errors within one block may move together, so
    that a block counts as a single observation. Three repeats know little about their scatter; ``s^2`` is therefore
    moderated by the other groups (Smyth 2004): ``(d0 s0^2 + d s^2)/(d0 + d)``, where ``s0^2`` and the ``d0`` degrees of
    freedom come from the median and the median absolute deviation of the logarithms of the groups' variances. Groups
    that scatter differently give a small ``d0``, and each is judged by itself. The level is divided by the number of
    blocks (Bonferroni).

    Parameters
    ----------
    blocks : ndarray (n_repeats, n_groups, n_entries), real or complex
        NaN where unknown.
    resolution : float or ndarray (n_groups,)
        Standard deviation that rounding alone gives.
    level : float
        Chance of any finding among Gaussian repeats.

    Returns
    -------
    tuple of Outlying
        Most distant first.

    References
    ----------
    Rosner 1983, Technometrics 25; Smyth 2004, Statistical Applications in Genetics and Molecular Biology 3.
    """
    n_repeats, n_groups, _ = blocks.shape
    if n_repeats < REPEATS_FEWEST or not n_groups:
        return ()
    parts = 2 if np.iscomplexobj(blocks) and np.any(np.nan_to_num(blocks).imag != 0) else 1
    kept = np.isfinite(blocks)
    # as differences from one of the repeats, so that squares do not cancel
    values = np.where(kept, blocks - _some(blocks), 0.0)
    start = kept.any(axis=2).sum(axis=0)
    tests = max(int(start.sum()), 1)
    floor = np.broadcast_to(np.asarray(resolution, dtype=float) ** 2, (n_groups,))
    removed: list[list[Outlying]] = [[] for _ in range(n_groups)]
    last = np.zeros(n_groups, dtype=int)
    for _ in range(min(OUTLIERS_MOST, (n_repeats - 1) // 2)):
        count = kept.any(axis=2).sum(axis=0)
        active = (count >= REPEATS_FEWEST) & (2 * (start - count + 1) < start)
        if not active.any():
            break
        distance, excess, others = _leave_one_out(values, kept)
        freedom = parts * (count - 2.0)
        borrowed, common = _prior(_variance(values, kept, floor), parts * (count - 1.0), active)
        scale = (borrowed * common + freedom * np.maximum(others, floor)) / np.maximum(borrowed + freedom, 1e-9)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(scale > 0, distance / scale, np.where(distance > 0, np.inf, 0.0))
        ratio[~kept.any(axis=2)] = -1.0
        worst = np.argmax(ratio, axis=0)
        largest = ratio[worst, np.arange(n_groups)]
        chance = special.fdtrc(parts, np.maximum(borrowed + freedom, 1e-9), np.maximum(largest, 0.0))
        for g in np.flatnonzero(active).tolist():
            k = int(worst[g])
            removed[g].append(Outlying(k, g, float(np.sqrt(largest[g])), float(excess[k, g])))
            kept[k, g] = False
            values[k, g] = 0.0
            if chance[g] * tests < level:
                last[g] = len(removed[g])
    found = [one for g in range(n_groups) for one in removed[g][: last[g]]]
    return tuple(sorted(found, key=lambda one: -one.times))


def _some(blocks: np.ndarray) -> np.ndarray:
    """A value of every entry (n_groups, n_entries): the median of the real parts, and of the imaginary ones."""
    known = np.isfinite(blocks)
    filled = np.where(known.any(axis=0), blocks, 0.0)
    middle = np.nanmedian(filled.real, axis=0)
    if not np.iscomplexobj(blocks):
        return np.asarray(middle)
    return np.asarray(middle + 1j * np.nanmedian(filled.imag, axis=0))


def _leave_one_out(values: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far every block (n_repeats, n_groups) is from the others, and how far these are from each other.

    Mean square distance from the mean of the others, scaled to the variance of one repeat; sum of squared distances;
    variance of the others. Variances are over both parts of a number.
    """
    n = kept.sum(axis=0)
    total, square = values.sum(axis=0), (np.abs(values) ** 2).sum(axis=0)
    rest = np.maximum(n - kept, 1)
    mean = (total - values) / rest
    usable = kept & (n > 1)
    apart = np.where(usable, np.abs(values - mean) ** 2, 0.0)
    entries = np.maximum(usable.sum(axis=2), 1)
    distance = (apart * rest / np.maximum(rest + 1, 1)).sum(axis=2) / entries
    spread = np.maximum(square - np.abs(values) ** 2 - rest * np.abs(mean) ** 2, 0.0)
    counted = usable & (n > 2)
    others = np.where(counted, spread / np.maximum(rest - 1, 1), 0.0).sum(axis=2) / np.maximum(counted.sum(axis=2), 1)
    return distance, apart.sum(axis=2), others


def _variance(values: np.ndarray, kept: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Variance of one repeat, (n_groups,), over both parts of a number."""
    n = kept.sum(axis=0)
    mean = values.sum(axis=0) / np.maximum(n, 1)
    square = np.where(kept, np.abs(values - mean) ** 2, 0.0).sum(axis=0)
    known = n > 1
    each = np.where(known, square / np.maximum(n - 1, 1), 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.asarray(np.maximum(each, floor))


def _prior(variance: np.ndarray, freedom: np.ndarray, active: np.ndarray) -> tuple[float, float]:
    """Degrees of freedom that a group borrows from the others, and their common variance."""
    used = active & (variance > 0)
    count = int(used.sum())
    if count < GROUPS_FEWEST:
        return 0.0, 0.0
    half = freedom[used] / 2.0
    logs = np.log(variance[used]) - special.digamma(half) + np.log(half)
    middle = float(np.median(logs))
    spread = (1.4826 * float(np.median(np.abs(logs - middle)))) ** 2
    # a spread seen in few groups may be larger than it looks; to borrow less is the safe side
    beyond = spread * (1.0 + SPREAD_DOUBT / np.sqrt(count)) - float(np.mean(special.polygamma(1, half)))
    # so few groups cannot vouch for more
    most = float(count)
    borrowed = most if beyond <= special.polygamma(1, most / 2.0) else 2.0 * _inverse_trigamma(beyond)
    return borrowed, float(np.exp(middle + special.digamma(borrowed / 2.0) - np.log(borrowed / 2.0)))


def _inverse_trigamma(value: float) -> float:
    """Argument at which the trigamma function has a value > 0, by Newton's method on its reciprocal (Smyth 2004)."""
    x = 0.5 + 1.0 / value
    for _ in range(50):
        first, second = float(special.polygamma(1, x)), float(special.polygamma(2, x))
        step = first * (1.0 - first / value) / second
        x += step
        if abs(step) < 1e-8 * x:
            break
    return x


def quantum(table: np.ndarray) -> float:
    """Smallest difference between repeats (n_repeats, n_groups): what rounding leaves; 0 where all are the same."""
    ordered = np.sort(table, axis=0)
    steps = np.diff(ordered, axis=0)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return float(steps.min()) if steps.size else 0.0
