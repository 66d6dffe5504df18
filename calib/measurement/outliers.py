"""Outlier test for repeats: a value, a channel or a whole shape that disagrees with the other repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.measurement.rules import RULES


@dataclass(frozen=True)
class Outlying:
    """One outlying block of one repeat.

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
    blocks: np.ndarray, resolution: float | np.ndarray = 0.0, level: float = RULES.outlier_level
) -> tuple[Outlying, ...]:
    """Blocks that are outliers among the repeats of their group.

    The generalised extreme studentised deviate test (Rosner 1983) over the repeats of each group: the most distant
    repeat is removed, up to `RULES.outliers_most` times and short of half of them; all that were removed up to the last
    significant one are outliers, so that two similar ones do not mask each other. Outliers are then left out of the
    other groups' variances, and the test is repeated until no more are found. A distance is tested by an F test of

        ``|x_k - mean of the others|^2 (n - 1)/n / s^2``,

    on 1 (complex: 2) and as many times ``n - 2`` degrees of freedom: the errors within one block may be correlated, so
    that a block counts as a single observation. The variance of few repeats is uncertain; ``s^2`` is therefore
    moderated by the other groups (Smyth 2004): ``(d0 s0^2 + d s^2)/(d0 + d)``. The prior of a group is estimated
    without the group itself, so that an outlier is not compared with its own variance: ``s0^2`` is the median of the
    logarithms of the other groups' variances, and its uncertainty reduces the prior degrees of freedom ``d0``. A few
    groups do not determine how similar the variances of groups are; the p-value is the mean over `RULES.alike_dof`,
    weighted by the likelihood of the other groups' variances, each of which may contain an outlier. Groups of very
    different variances thus get few prior degrees of freedom. The level is divided by the number of blocks
    (Bonferroni). That holds for one step; for a single group from which two or more may be removed (five repeats or
    more), any step is significant up to twice as often.

    Parameters
    ----------
    blocks : ndarray (n_repeats, n_groups, n_entries), real or complex
        NaN where unknown.
    resolution : float or ndarray (n_groups,)
        Standard deviation that rounding alone gives.
    level : float
        Significance level of the whole table.

    Returns
    -------
    tuple of Outlying
        Most distant first.

    References
    ----------
    Rosner 1983, Technometrics 25; Smyth 2004, Statistical Applications in Genetics and Molecular Biology 3.
    """
    n_repeats, n_groups, _ = blocks.shape
    if n_repeats < RULES.outlier_repeats or not n_groups:
        return ()
    parts = 2 if np.iscomplexobj(blocks) and np.any(np.nan_to_num(blocks).imag != 0) else 1
    kept = np.isfinite(blocks)
    # as differences from one of the repeats, so that squares do not cancel
    values = np.where(kept, blocks - _some(blocks), 0.0)
    start = kept.any(axis=2).sum(axis=0)
    floor = np.broadcast_to(np.asarray(resolution, dtype=float) ** 2, (n_groups,))
    least = level / max(int(start.sum()), 1)
    found: list[Outlying] = []
    while more := _outlying(values, kept, start, floor, parts, least):
        found += more
        for one in more:
            kept[one.repeat, one.group] = False
            values[one.repeat, one.group] = 0.0
    return tuple(sorted(found, key=lambda one: -one.times))


def _outlying(
    values: np.ndarray, kept: np.ndarray, start: np.ndarray, floor: np.ndarray, parts: int, least: float
) -> list[Outlying]:
    """Blocks with a p-value below ``least``; of each group fewer than half of those it had at the ``start``."""
    from scipy import special

    n_groups = len(start)
    count = kept.any(axis=2).sum(axis=0)
    prior = _variance_prior(_variance(values, kept, floor), parts * (count - 1.0), count > 1)
    values, kept = values.copy(), kept.copy()
    removed: list[list[Outlying]] = [[] for _ in range(n_groups)]
    last = np.zeros(n_groups, dtype=int)
    for _ in range(min(RULES.outliers_most, (len(values) - 1) // 2)):
        count = kept.any(axis=2).sum(axis=0)
        active = (count >= RULES.outlier_repeats) & (2 * (start - count + 1) < start)
        if not active.any():
            break
        distance, excess, others = _leave_one_out(values, kept)
        dof = parts * (count - 2.0)
        total = np.maximum(prior.dof + dof, 1e-9)
        own, given = dof / total, prior.dof / total * prior.variance
        others = np.maximum(others, floor)
        mean = (prior.weight * given).sum(axis=0) + (prior.weight * own).sum(axis=0) * others
        worst = np.argmax(np.where(kept.any(axis=2), _ratio(distance, mean), -1.0), axis=0)
        at = (worst, np.arange(n_groups))
        times = np.sqrt(_ratio(distance[at], mean[at]))
        ratio = _ratio(distance[at], given + own * others[at])
        chance = (prior.weight * special.fdtrc(parts, total, ratio)).sum(axis=0)
        for g in np.flatnonzero(active).tolist():
            k = int(worst[g])
            removed[g].append(Outlying(k, g, float(times[g]), float(excess[k, g])))
            kept[k, g] = False
            values[k, g] = 0.0
            if chance[g] < least:
                last[g] = len(removed[g])
    return [one for g in range(n_groups) for one in removed[g][: last[g]]]


def _ratio(distance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Distance over scale; infinite for a zero scale, unless the distance is zero too."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(scale > 0, distance / scale, np.where(distance > 0, np.inf, 0.0)))


def _some(blocks: np.ndarray) -> np.ndarray:
    """Reference value of every entry (n_groups, n_entries): the median of the real parts, and of the imaginary ones."""
    known = np.isfinite(blocks)
    filled = np.where(known.any(axis=0), blocks, 0.0)
    middle = median_of_known(filled.real)
    return middle + 1j * median_of_known(filled.imag) if np.iscomplexobj(blocks) else middle


def median_of_known(table: np.ndarray) -> np.ndarray:
    """Median over the first axis without NaN; without any NaN by `numpy.median`, ten times as fast."""
    return np.asarray(np.nanmedian(table, axis=0) if np.isnan(table).any() else np.median(table, axis=0))


def _leave_one_out(values: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance of every block (n_repeats, n_groups) from the others, and the variance of the others.

    Mean square distance from the mean of the others, scaled to the variance of one repeat; sum of squared distances;
    variance of the others. Variances of complex numbers are over both parts.
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
    """Variance of one repeat, (n_groups,); of complex numbers over both parts."""
    n = kept.sum(axis=0)
    mean = values.sum(axis=0) / np.maximum(n, 1)
    square = np.where(kept, np.abs(values - mean) ** 2, 0.0).sum(axis=0)
    known = n > 1
    each = np.where(known, square / np.maximum(n - 1, 1), 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.asarray(np.maximum(each, floor))


@dataclass(frozen=True)
class _VariancePrior:
    """Prior of each group's variance from the other groups: hypotheses (n_hypotheses, n_groups) with their weights."""

    weight: np.ndarray
    dof: np.ndarray
    variance: np.ndarray


def _variance_prior(variance: np.ndarray, dof: np.ndarray, known: np.ndarray) -> _VariancePrior:
    """Prior degrees of freedom of each group's variance, and the common variance of the other groups."""
    from scipy import special

    n_groups = len(variance)
    used = np.flatnonzero(known & (variance > 0))
    if len(used) < RULES.outlier_groups:
        nothing = np.zeros((1, n_groups))
        return _VariancePrior(nothing + 1.0, nothing, nothing)
    half = dof[used] / 2.0
    # of a chi square, so that the mean is the logarithm of the variance
    logs = np.log(variance[used]) - special.digamma(half) + np.log(half)
    others = np.full(n_groups, len(used))
    others[used] -= 1
    middle = np.full(n_groups, np.median(logs))
    middle[used] = _median_of_others(logs)
    half_prior = np.array(RULES.alike_dof)[:, None] / 2.0
    within = float(np.mean(_trigamma(half)))
    # the median of Gaussian numbers has the efficiency 2/pi of their mean
    between = _trigamma(half_prior)
    uncertainty = between + np.pi / 2.0 * (between + within) / others
    prior_dof = 2.0 * _inverse_trigamma(uncertainty)
    common = np.exp(middle + special.digamma(prior_dof / 2.0) - np.log(prior_dof / 2.0))
    scale = np.median(logs) + special.digamma(half_prior) - np.log(half_prior)
    z = np.log(variance[used]) - scale
    density = np.exp(
        half * (np.log(half / half_prior) + z)
        - (half + half_prior) * np.log1p(half / half_prior * np.exp(z))
        - special.betaln(half, half_prior)
    )
    likelihood = np.log((1.0 - RULES.spoilt) * density + RULES.spoilt / RULES.spoilt_width)
    log_weight = np.repeat(likelihood.sum(axis=1, keepdims=True), n_groups, axis=1)
    log_weight[:, used] -= likelihood
    weight = np.exp(log_weight - log_weight.max(axis=0))
    return _VariancePrior(weight / weight.sum(axis=0), prior_dof, common)


def _median_of_others(values: np.ndarray) -> np.ndarray:
    """Median of all values (n,) but one, for each of them; n > 1."""
    order = np.argsort(values, kind="stable")
    rank = np.empty(len(values), dtype=int)
    rank[order] = np.arange(len(values))
    ordered, rest = values[order], len(values) - 1
    low, high = (rest - 1) // 2, rest // 2
    return np.asarray((ordered[low + (rank <= low)] + ordered[high + (rank <= high)]) / 2.0)


def _trigamma(value: np.ndarray) -> np.ndarray:
    """Second derivative of the log gamma function, as Hurwitz's zeta function (Abramowitz and Stegun 1964, 6.4.10)."""
    from scipy import special

    return np.asarray(special.zeta(2.0, value))


def _inverse_trigamma(value: np.ndarray) -> np.ndarray:
    """Argument at which the trigamma function has a value > 0, by Newton's method on its reciprocal (Smyth 2004)."""
    from scipy import special

    x = 0.5 + 1.0 / value
    for _ in range(50):
        first, second = _trigamma(x), -2.0 * special.zeta(3.0, x)
        step = first * (1.0 - first / value) / second
        x = x + step
        if np.all(np.abs(step) < 1e-8 * x):
            break
    return np.asarray(x)


def far_values(table: np.ndarray, columns: np.ndarray, level: float) -> list[Outlying]:
    """Single values that are outliers among the repeats.

    Parameters
    ----------
    table : ndarray (n_repeats, n_values)
        NaN where unknown.
    columns : ndarray of int
        Values whose relative standard deviations are assumed to be similar; the others are not tested.
    level : float
        Significance level of these values together.
    """
    own = table[:, columns]
    known = np.isfinite(own)
    size = np.array([np.abs(np.median(c[k])) if k.any() else 0.0 for c, k in zip(own.T, known.T, strict=True)])
    usable = size > 0
    divisor = np.where(usable, size, 1.0)
    rounding = np.where(usable, _quantum(own) / divisor, 0.0) / np.sqrt(12.0)
    relative = np.where(usable, own / divisor, np.nan)
    found = find_outlying(relative[:, :, None], np.maximum(rounding, RULES.value_resolution), level)
    return [replace(one, group=int(columns[one.group])) for one in found]


def emptied(table: np.ndarray, found: Sequence[Outlying]) -> np.ndarray:
    """A table (n_repeats, n_values) with NaN in place of the outliers."""
    out = table.copy()
    for one in found:
        out[one.repeat, one.group] = np.nan
    return out


def _quantum(table: np.ndarray) -> float:
    """Smallest nonzero difference between repeats (n_repeats, n_groups), the rounding step; 0 if all are equal."""
    ordered = np.sort(table, axis=0)
    steps = np.diff(ordered, axis=0)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return float(steps.min()) if steps.size else 0.0
