"""Matching of modes between repeats, by shape and frequency and not by their order in a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.mac import best_pairs, mac
from calib.measurement.rules import RULES


@dataclass(frozen=True, eq=False)
class Matching:
    """Modes of all repeats as the columns of one table.

    Attributes
    ----------
    index : ndarray (n_repeats, n_modes), int
        Place of every mode in each file, -1 where the repeat lacks it. Modes of the first repeat come first, in its
        order; then those that it lacks, by frequency.
    set_aside : tuple of (repeat, place, column, MAC)
        Modes whose shape differs from that of the others at that frequency; they are in no column.
    """

    index: np.ndarray
    set_aside: tuple[tuple[int, int, int, float], ...] = ()


def match_modes(sources: Sequence[str], freqs: Sequence[np.ndarray], shapes: Sequence[np.ndarray]) -> Matching:
    """Match the modes of repeats one to one.

    Repeats are taken in turn. Each mode is scored against the modes found so far with ``MAC (1 - (df/(0.1 f))^2)``,
    averaged over the repeats that hold them; without shapes the MAC counts as 1. Pairs with a MAC below 0.5, a
    frequency more than 10 % off or a score below 0.25 are forbidden. The assignment with the largest sum of scores is
    taken; an unmatched mode becomes a new one, so that repeats may lack modes. Finally, a mode in a minority of the
    repeats, within 2 % of one that these lack, counts as that mode with a bad shape: it is matched where the shapes
    agree but for one sensor (a MAC of 0.9 without it), and set aside otherwise.

    Parameters
    ----------
    sources : sequence of str, length n_repeats
    freqs : sequence of ndarray (n_modes of that repeat,)
        Hz.
    shapes : sequence of ndarray (n_sensors, n_modes of that repeat)
        Rows common to all; NaN where not measured; no rows without shapes.

    Raises
    ------
    InputError
        When another assignment is as good: the matching is ambiguous.
    """
    columns: list[dict[int, int]] = [{0: k} for k in range(len(freqs[0]))]
    for r in range(1, len(freqs)):
        score = _mean_scores(columns, freqs, shapes, r)
        score[score < RULES.same_score] = 0.0
        rows, cols = best_pairs(score)
        chosen = {int(i): int(c) for i, c in zip(rows, cols, strict=True) if score[i, c] > 0}
        _refuse_ambiguous(sources[r], freqs[r], score, chosen, by_shape=shapes[r].shape[0] >= RULES.sensors_for_mac)
        for i in range(len(freqs[r])):
            if i in chosen:
                columns[chosen[i]][r] = i
            else:
                columns.append({r: i})
    columns, aside = _bad_shapes(columns, freqs, shapes)
    first = len(freqs[0])

    def place(column: dict[int, int]) -> tuple[int, float]:
        mean = float(np.mean([freqs[j][k] for j, k in column.items()]))
        return (column[0], 0.0) if 0 in column else (first, mean)

    order = sorted(range(len(columns)), key=lambda c: place(columns[c]))
    index = np.full((len(freqs), len(order)), -1)
    for new, c in enumerate(order):
        for j, k in columns[c].items():
            index[j, new] = k
    return Matching(index, tuple((r, k, order.index(c), agreement) for r, k, c, agreement in aside))


def _mean_scores(
    columns: Sequence[dict[int, int]], freqs: Sequence[np.ndarray], shapes: Sequence[np.ndarray], repeat: int
) -> np.ndarray:
    """Scores of the modes of one repeat with the columns found so far, (n_modes, n_columns)."""
    known = [(j, k) for members in columns for j, k in members.items()]
    if not known:
        return np.zeros((len(freqs[repeat]), 0))
    # All members at once, those of one column side by side: there may be hundreds of repeats.
    others = np.stack([shapes[j][:, k] for j, k in known], axis=1)
    scores = _scores(freqs[repeat], shapes[repeat], np.array([freqs[j][k] for j, k in known]), others)
    sizes = np.array([len(members) for members in columns])
    return np.asarray(np.add.reduceat(scores, np.cumsum(sizes) - sizes, axis=1) / sizes)


def _scores(freq: np.ndarray, shapes: np.ndarray, other_freq: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Scores of the modes of one repeat with modes of other repeats, (n_modes, n_others)."""
    closeness = 1.0 - ((freq[:, None] / other_freq - 1.0) / RULES.farthest_freq) ** 2
    agreement = mac(shapes, others)
    shared = np.isfinite(shapes).astype(float).T @ np.isfinite(others).astype(float)
    agreement = np.where(shared < RULES.sensors_for_mac, 1.0, np.where(agreement < RULES.same_mac, 0.0, agreement))
    return np.asarray(np.maximum(closeness, 0.0) * agreement)


def _refuse_ambiguous(
    source: str, freq: np.ndarray, score: np.ndarray, chosen: dict[int, int], *, by_shape: bool
) -> None:
    best = sum(score[i, c] for i, c in chosen.items())
    for i, c in chosen.items():
        other = score.copy()
        other[i, c] = 0.0
        if best - np.max(other, axis=1, initial=0.0).sum() >= RULES.ambiguous:
            continue  # no assignment has more than the largest score of every mode
        rows, cols = best_pairs(other)
        again = {int(a): int(b) for a, b in zip(rows, cols, strict=True) if other[a, b] > 0}
        # frequencies alone never cross
        crossed = not by_shape and set(again) == set(chosen) and set(again.values()) == set(chosen.values())
        if crossed or best - sum(other[a, b] for a, b in again.items()) >= RULES.ambiguous:
            continue
        doubtful = sorted({a for a in {*again, *chosen} if again.get(a) != chosen.get(a)})
        named = ", ".join(f"{a + 1} ({freq[a]:.4g} Hz)" for a in doubtful)
        raise InputError(
            f"its modes {named} cannot be matched to those of the other repeats: shapes and frequencies are ambiguous",
            place=source,
            remedy="name the modes in every file (an ID line 'mode NAME', or CSV), or leave this repeat out",
        )


def _bad_shapes(
    columns: list[dict[int, int]], freqs: Sequence[np.ndarray], shapes: Sequence[np.ndarray]
) -> tuple[list[dict[int, int]], list[tuple[int, int, int, float]]]:
    """Columns without those that repeat another one with a bad shape, and the modes set aside with their column."""
    mean = [float(np.median([freqs[j][k] for j, k in column.items()])) for column in columns]
    owner: dict[int, int] = {}
    for c, column in enumerate(columns):
        near = [
            d
            for d, other in enumerate(columns)
            if len(other) > max(len(column), len(freqs) / 2)
            and not column.keys() & other.keys()
            and abs(mean[c] / mean[d] - 1.0) <= RULES.same_freq
        ]
        if near:
            owner[c] = min(near, key=lambda d: abs(mean[c] / mean[d] - 1.0))
    kept = [c for c in range(len(columns)) if c not in owner]
    aside = []
    for c, d in owner.items():
        pairs = [(shapes[r][:, k], shapes[j][:, m]) for r, k in columns[c].items() for j, m in columns[d].items()]
        if np.median([_mac_but_one(a, b) for a, b in pairs]) >= RULES.mac_but_one:
            columns[d].update(columns[c])
            continue
        for r, k in columns[c].items():
            others = [mac(shapes[r][:, [k]], shapes[j][:, [m]])[0, 0] for j, m in columns[d].items()]
            aside.append((r, k, kept.index(d), float(np.median(others))))
    return [columns[c] for c in kept], sorted(aside)


def _mac_but_one(one: np.ndarray, other: np.ndarray) -> float:
    """Largest MAC of two shapes without one sensor; 0 with too few sensors."""
    shared = np.flatnonzero(np.isfinite(one) & np.isfinite(other))
    if len(shared) < RULES.sensors_but_one:
        return 0.0
    rest = np.where(np.eye(len(shared), dtype=bool), complex(np.nan, np.nan), one[shared][:, None])
    return float(mac(rest, other[shared][:, None]).max())
