"""How much the poles of single functions differ, by drift or by the mass of a roving sensor, and what modes remain.

Functions that were measured one after the other need not share their poles. One common pole then misses each of them,
two common poles imitate one that moves, and both look like what they are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2

from calib.measurement.frf import MeasuredFRFs
from calib.modal_analysis.model import ModalFRFModel, Weighed, most_likely_model, poles_of, projected, weighed
from calib.modal_analysis.rules import RULES

STEPS = 3
"""Gauss-Newton steps of a function's own poles, which lie within their half-power widths."""
PAIR_START = 0.3
"""Distance from one pole at which a pair in its place starts, in half half-power widths."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """Modes of single functions beside those of all together.

    Attributes
    ----------
    between : ndarray (n_modes,)
        Relative standard deviation of the natural frequency between functions, beyond noise; 0 where it is not sure,
        NaN where fewer than `RULES.functions_least` functions show the mode.
    possible : ndarray (n_modes,)
        What the same might be, sure or not: the estimate and the noise of one function in quadrature.
    poles : ndarray (n_modes,), complex
        rad/s: the mean over the functions where they differ, else the common pole.
    freq_std, damping_std : ndarray (n_modes,)
        Hz and ratio. Where functions differ, of their mean; else by the residuals of the fit, the largest of three: by
        their mean square, by those of each line (White 1980) and by their sums over each function, which contradict
        each other.
    synthesised : ndarray (n_freq, n_responses, n_references), complex
        Functions of the model with poles of their own where they differ.
    squares : float
        Sum of squared weighed errors of these.
    """

    between: np.ndarray
    possible: np.ndarray
    poles: np.ndarray
    freq_std: np.ndarray
    damping_std: np.ndarray
    synthesised: np.ndarray
    squares: float


def scatter(frfs: MeasuredFRFs, model: ModalFRFModel, n_modes: int) -> Scatter:
    """Fit the first ``n_modes`` poles of a model to each function, and compare them.

    The standard deviation between functions is that of a random-effects model (Paule and Mandel 1982). It is sure
    where their differences would arise once in `RULES.scatter_chance` by noise, and matters from
    `RULES.scatter_least` of half a half-power width on. Noise that lines share under an exponential window counts once.
    """
    functions = weighed(frfs)
    n, start = len(model.poles), _logs(model.poles)
    free = np.concatenate([np.arange(n_modes), n + np.arange(n_modes)])
    ratio = np.exp(start[n : n + n_modes])
    reach = np.concatenate([RULES.own_freq_reach * ratio, np.full(n_modes, RULES.own_damping_reach)])
    own = [_own_poles(frfs, one, start, free, reach) for one in functions]
    moved, variance = (np.array(part) for part in zip(*own, strict=True))
    fewer = _lines_of_one(frfs)
    variance *= fewer
    seen = variance < (RULES.own_seen * reach) ** 2
    between, possible = np.zeros(n_modes), np.zeros(n_modes)
    mean, std = np.zeros(2 * n_modes), _common_std(frfs, model, functions)[free] * np.sqrt(fewer)
    tau = np.zeros(2 * n_modes)
    for k in range(n_modes):
        here = np.flatnonzero(seen[:, k])
        if len(here) < RULES.functions_least:
            between[k] = possible[k] = np.nan
            continue
        found, q = _random_effects(moved[here, k], variance[here, k])
        possible[k] = np.sqrt(found**2 + np.median(variance[here, k]))
        sure = chi2.sf(q, len(here) - 1) * RULES.scatter_chance < 1 and found > RULES.scatter_least * ratio[k]
        if not sure:
            continue
        between[k] = found
        for j in (k, n_modes + k):
            there = np.flatnonzero(seen[:, j])
            if len(there) < RULES.functions_least:
                continue
            tau[j] = _random_effects(moved[there, j], variance[there, j])[0]
            weight = 1 / (variance[there, j] + tau[j] ** 2)
            mean[j], std[j] = weight @ moved[there, j] / weight.sum(), 1 / np.sqrt(weight.sum())
    synthesised, squares = _synthesised(frfs, functions, start, free, mean, tau)
    shifted = start.copy()
    shifted[free] += mean
    poles = poles_of(shifted)[:n_modes]
    size = np.abs(poles)
    return Scatter(
        between, possible, poles, std[:n_modes] * size / (2 * np.pi), std[n_modes:] * -poles.real / size, synthesised,
        squares,
    )  # fmt: skip


def without_split(frfs: MeasuredFRFs, poles: np.ndarray, lengths: Sequence[int]) -> np.ndarray:
    """Which stable poles remain when those that are one mode, moving between functions, are taken for one.

    Of poles in a group, each closer than a half-power width to another, those stable at most orders are kept on trial,
    first one, then more. Their number is right when they, with values of their own in each function, describe the FRFs
    as well as all of the group by the Bayesian information criterion (Schwarz 1978): poles in a function and further
    poles with their residues add about as many parameters. For small movements both describe the same; then fewer
    poles count, and `hidden_pairs` tells whether the others move as much.

    Parameters
    ----------
    frfs : MeasuredFRFs
    poles : ndarray (n_poles,), complex
        rad/s.
    lengths : sequence of int
        Orders at which each is stable.

    Returns
    -------
    ndarray of int
        Indices, ascending.
    """
    kept = list(range(len(poles)))
    if len(frfs.functions) < RULES.functions_least:
        return np.array(kept, dtype=int)
    for group in _groups(poles):
        window, near = _around(frfs, poles, group)
        ranked = sorted(group, key=lambda k: -lengths[k])
        for count in range(1, len(group)):
            single = [k for k in near if k not in ranked[count:]]
            together = _cost(window, poles[near], False, len(group) - count)
            if _cost(window, poles[single], True, count) < together + RULES.pair_surely:
                kept = [k for k in kept if k not in ranked[count:]]
                break
    return np.array(kept, dtype=int)


def hidden_pairs(frfs: MeasuredFRFs, poles: np.ndarray, found: Scatter) -> tuple[int, ...]:
    """Which poles that differ between functions stand for two modes, of which each function holds its own mixture.

    Drift and masses move all resonances. One that differs `RULES.scatter_alone` times as much as the others may in the
    median is taken for two modes unless its movement describes the FRFs clearly better than two common poles; a
    resonance without others is, where these are clearly the better description. Where one common pole describes the
    FRFs around it as well as two do, it differs by what the model lacks elsewhere in the band, and is one.

    Parameters
    ----------
    frfs : MeasuredFRFs
    poles : ndarray (n_modes,), complex
        rad/s.
    found : Scatter
        Of these poles.
    """
    pairs = []
    for k in np.flatnonzero(found.between > 0).tolist():
        others = np.delete(found.possible, k)
        others = others[np.isfinite(others)]
        if len(others) and found.between[k] <= RULES.scatter_alone * np.median(others):
            continue
        window, near = _around(frfs, poles, [k])
        pair = poles[k] + 1j * np.array([-1.0, 1.0]) * PAIR_START * abs(poles[k].real)
        both = np.append(poles[[m for m in near if m != k]], pair)
        margin = RULES.pair_surely * (-1 if len(others) else 1)
        two = _cost(window, both, False, 1)
        if two < _cost(window, poles[near], False, 0) and _cost(window, poles[near], True, 1) > two + margin:
            pairs.append(k)
    return tuple(pairs)


def _groups(poles: np.ndarray) -> list[list[int]]:
    """Indices of poles that are closer than a half-power width, of the wider, to another of their group."""
    groups: list[list[int]] = []
    for k in np.argsort(np.abs(poles)).tolist():
        near = (
            group for group in groups
            if any(abs(abs(poles[k]) - abs(poles[m])) < -2 * min(poles[k].real, poles[m].real) for m in group)
        )  # fmt: skip
        if (group := next(near, None)) is None:
            groups.append([k])
        else:
            group.append(k)
    return [group for group in groups if len(group) > 1]


def _around(frfs: MeasuredFRFs, poles: np.ndarray, group: Sequence[int]) -> tuple[MeasuredFRFs, list[int]]:
    """FRFs around a group of poles, and all poles there."""
    size, width = np.abs(poles) / (2 * np.pi), -poles.real / np.pi
    own = size[list(group)]
    lines = np.sort(np.abs(frfs.freq - own.mean()))
    reach = max(
        RULES.pair_widths * width[list(group)].max(), float(lines[min(2 * RULES.lines_least, len(lines)) - 1])
    )  # fmt: skip
    low, high = max(own.min() - reach, float(frfs.freq[0])), min(own.max() + reach, float(frfs.freq[-1]))
    return frfs.in_band(low, high), [k for k in range(len(poles)) if low <= size[k] <= high]


def _cost(frfs: MeasuredFRFs, poles: np.ndarray, moving: bool, count: int) -> float:
    """Information criterion of a model with these poles, of which ``count`` are in question.

    They move between functions, or are further common ones with their residues. Of thinned lines, which have standard
    deviations, it is that of all: what lies within their groups adds as much to every model.
    """
    model, n = most_likely_model(frfs, poles), len(frfs.functions)
    rows = 2 * sum(len(one.lines) for one in frfs.functions)
    within = 0 if frfs.behind is None else 2 * int(frfs.behind.sum()) - rows
    if moving:
        squares, parameters = scatter(frfs, model, len(poles)).squares, 2 * n * count
    else:
        residual, _ = projected(frfs, model.poles, weighed(frfs))
        squares, parameters = float(residual @ residual), (2 + 2 * n) * count
    rows += within
    return float(rows * np.log(max(squares + within, 1e-300)) + parameters * np.log(rows))


def _lines_of_one(frfs: MeasuredFRFs) -> float:
    """How many lines share their noise: 1, and more under an exponential window.

    The correlation of noise between lines ``d`` apart is ``1/(1 + i pi d / a)`` under a window of rate a, and the sum
    of its squared moduli over all lines what is returned.
    """
    reach = frfs.window_rate / float(np.min(np.diff(frfs.freq)))
    return float(reach / np.tanh(reach)) if reach > 0 else 1.0


def _logs(poles: np.ndarray) -> np.ndarray:
    return np.concatenate([np.log(np.abs(poles)), np.log(-poles.real / np.abs(poles))])


def _own_poles(
    frfs: MeasuredFRFs, one: Weighed, start: np.ndarray, free: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Changes of the free logarithms that a function asks for, and their variances, both (n_free,).

    Variances are the larger of those by the mean residual and by each line's own (White 1980): noise in proportion to
    the function is largest at its resonances.
    """
    moved, precision = np.zeros(len(free)), np.diag(1 / reach**2)
    normal, lines = precision, precision
    for _ in range(STEPS):
        x = start.copy()
        x[free] += moved
        residual, jacobian = projected(frfs, poles_of(x), [one])
        freedom = max(len(residual) - 2 * len(start) - 8 - len(free), 1)
        slope, noise = jacobian[:, free], max(float(residual @ residual) / freedom, 1e-300)
        normal, pulls = slope.T @ slope / noise + precision, slope * residual[:, None] / noise
        lines = pulls.T @ pulls * len(residual) / freedom + precision
        moved = moved - np.linalg.solve(normal, slope.T @ residual / noise + precision @ moved)
        moved = np.clip(moved, -2 * reach, 2 * reach)
    inverse = np.linalg.inv(normal)
    return moved, np.maximum(np.diag(inverse), np.diag(inverse @ lines @ inverse))


def _random_effects(values: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """Standard deviation between values beyond their variances, and their weighed sum of squares without it."""

    def squares(beyond: float) -> float:
        weight = 1 / (variance + beyond)
        return float(weight @ (values - weight @ values / weight.sum()) ** 2)

    q, wanted = squares(0.0), len(values) - 1
    if q <= wanted:
        return 0.0, q
    most = len(values) * float(np.var(values))  # here the sum is below what is wanted
    return float(np.sqrt(brentq(lambda beyond: squares(beyond) - wanted, 0.0, most, xtol=1e-6 * most))), q


def _common_std(frfs: MeasuredFRFs, model: ModalFRFModel, functions: Sequence[Weighed]) -> np.ndarray:
    """Standard deviations of the logarithms of all poles, (2 n_poles,)."""
    normal, noise, lines, apart = np.zeros((4, 2 * len(model.poles), 2 * len(model.poles)))
    for one in functions:
        residual, slope = projected(frfs, model.poles, [one])
        own, pull = slope.T @ slope, slope.T @ residual
        freedom = max(len(residual) - 2 * len(model.poles) - 8, 1)
        normal += own
        noise += own * float(residual @ residual) / freedom
        pulls = slope * residual[:, None]
        lines += pulls.T @ pulls * len(residual) / freedom
        apart += np.outer(pull, pull)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-12) / np.outer(size, size)
    several = len(functions) / max(len(functions) - 1, 1)
    each = [np.diag(inverse @ middle @ inverse) for middle in (noise, lines, several * apart)]
    return np.asarray(np.sqrt(np.max(each, axis=0)))


def _synthesised(
    frfs: MeasuredFRFs, functions: Sequence[Weighed], start: np.ndarray, free: np.ndarray, mean: np.ndarray,
    tau: np.ndarray,
) -> tuple[np.ndarray, float]:  # fmt: skip
    """Functions with poles of their own around the mean where they differ, and the sum of squared weighed errors."""
    out, squares = np.full(frfs.values.shape, complex(np.nan, np.nan)), 0.0
    moving = tau > 0
    columns, precision = free[moving], np.diag(1 / tau[moving] ** 2)
    for one in functions:
        x, moved = start.copy(), np.zeros(len(columns))
        x[free] += mean
        base = x[columns].copy()
        residual, jacobian = projected(frfs, poles_of(x), [one])
        for _ in range(STEPS if len(columns) else 0):
            freedom = max(len(residual) - 2 * len(start) - 8, 1)
            slope, noise = jacobian[:, columns], max(float(residual @ residual) / freedom, 1e-300)
            right = slope.T @ residual / noise + precision @ moved
            moved = np.clip(moved - np.linalg.solve(slope.T @ slope / noise + precision, right), -0.5, 0.5)
            x[columns] = base + moved
            residual, jacobian = projected(frfs, poles_of(x), [one])
        real, imag = np.split(one.values - residual, 2)
        out[one.function.index] = (real + 1j * imag) / one.weight
        squares += float(residual @ residual)
    return out, squares
