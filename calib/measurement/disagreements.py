"""Disagreements between repeats: dead or turned channels, bad shapes, single values, and their effect on the mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Literal

import numpy as np

from calib.measurement.alignment import aligned_repeats, mean_and_std, median_of_repeats, scaled
from calib.measurement.mac import mac
from calib.measurement.outliers import emptied, far_values, find_outlying
from calib.measurement.rules import RULES
from calib.results.answer import with_std

Pooling = Literal["robust", "plain"]
Kind = Literal["frequency", "damping", "shape", "sensor", "entry", "response"]


@dataclass(frozen=True)
class Disagreement:
    """One repeat that disagrees with the others at one place.

    Attributes
    ----------
    kind : {"frequency", "damping", "shape", "sensor", "entry", "response"}
        ``shape`` is a whole mode shape, ``sensor`` a channel in all modes, ``entry`` one sensor in one mode.
    repeat : str
        Its file or label; with only two repeats, where the wrong one is unknown, both.
    mode, sensor : str
        Empty where not applicable; for a response ``mode`` is its name.
    times : float
        Distance from the mean of the others over the standard deviation of one repeat; NaN where not tested.
    value : float
        The frequency (Hz), ratio or response; the gain of a channel against the others; the MAC of a shape.
    mean_with, mean_without : float
        Of a frequency, damping ratio or response; NaN for shapes.
    std_with, std_without : float
        Standard deviation of the mean with and without it; for shapes the root mean square over the block.
    left_out : bool
        Whether mean and standard deviation are without it. A single value that is distant but not significantly so is
        reported and kept.
    sentence : str
    """

    kind: Kind
    repeat: str
    mode: str
    sensor: str
    times: float
    value: float
    mean_with: float
    mean_without: float
    std_with: float
    std_without: float
    left_out: bool
    sentence: str
    index: tuple[int, int, int] = (-1, -1, -1)
    """Repeat, sensor and mode in the tables it was found in; -1 for all of them, or none."""


COLUMNS = (
    "kind", "repeat", "mode", "sensor", "times", "value", "mean_with", "mean_without", "std_with", "std_without",
    "left_out", "sentence",
)  # fmt: skip
"""Columns of the table of disagreements."""


def disagreeing(
    repeats: Sequence[str],
    modes: Sequence[str],
    freq: np.ndarray,
    damping: np.ndarray,
    sensors: Sequence[tuple[int, str]],
    stack: np.ndarray,
    pooling: Pooling,
) -> list[Disagreement]:
    """Disagreements of single repeats with the others.

    Parameters
    ----------
    repeats, modes : sequence of str
    freq, damping : ndarray (n_repeats, n_modes)
        NaN where unknown.
    sensors : sequence of (int, str)
    stack : ndarray (n_repeats, n_sensors, n_modes)
        Shapes of any scale and phase; NaN where unknown.
    pooling : {"robust", "plain"}
        Whether disagreeing values are left out of mean and standard deviation.
    """
    robust = pooling == "robust"
    found = value_disagreements("frequency", repeats, modes, freq, robust)
    found += value_disagreements("damping", repeats, modes, damping, robust)
    held = np.isfinite(stack).any(axis=(1, 2))
    if held.sum() < 2:
        return found
    names = [f"{node}{direction}" for node, direction in sensors]
    if held.sum() == 2:
        return found + _two_repeats(repeats, names, stack)
    return found + _shape_disagreements(repeats, modes, names, stack, robust)


def leave_out(
    found: Sequence[Disagreement], freq: np.ndarray, damping: np.ndarray, stack: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, damping ratios and shapes with NaN in place of what is left out."""
    freq, damping, stack = freq.copy(), damping.copy(), stack.copy()
    for one in found:
        if not one.left_out or one.index[0] < 0:
            continue
        k, _, m = one.index
        if one.kind == "frequency":
            freq[k, m] = np.nan
        elif one.kind == "damping":
            damping[k, m] = np.nan
        else:
            # the imaginary part too: a zero there would count as a value
            stack[_place(one.index)] = complex(np.nan, np.nan)
    return freq, damping, stack


def _place(index: tuple[int, int, int]) -> tuple[int, int | slice, int | slice]:
    """Index of a block in shapes (n_repeats, n_sensors, n_modes); -1 stands for all."""
    k, i, m = index
    return k, slice(None) if i < 0 else i, slice(None) if m < 0 else m


def bad_shape(repeat: str, freq: float, mode: str, agreement: float) -> Disagreement:
    """A mode that was set aside because its shape differs from that of the other repeats at that frequency."""
    sentence = (
        f"{repeat}: its mode at {freq:.4g} Hz is near mode {mode} but has a MAC of only {agreement:.2f} with the other "
        "repeats; it is set aside"
    )
    return Disagreement("shape", repeat, mode, "", nan, agreement, nan, nan, nan, nan, True, sentence)


def value_disagreements(
    kind: Kind,
    repeats: Sequence[str],
    names: Sequence[str],
    table: np.ndarray,
    robust: bool,
    kinds: Sequence[str] | None = None,
) -> list[Disagreement]:
    """Single values (n_repeats, n_values) that disagree with the other repeats, relative to their size.

    Outliers at `RULES.value_level` are left out if ``robust``; further ones at `RULES.named_level` are reported and
    kept.

    Parameters
    ----------
    kind, repeats, names
    table : ndarray (n_repeats, n_values)
        NaN where unknown.
    robust : bool
        Whether outliers are left out of mean and standard deviation.
    kinds : sequence of str, length n_values, optional
        Kind of each value; values of one kind are assumed to have similar relative standard deviations. One kind by
        default.
    """
    groups = np.array(kinds if kinds is not None else [""] * len(names))
    places = [np.flatnonzero(groups == own) for own in dict.fromkeys(groups.tolist())]
    far = [one for columns in places for one in far_values(table, columns, RULES.value_level / len(places))]
    rest = emptied(table, far)
    near = [one for columns in places for one in far_values(rest, columns, RULES.named_level / len(places))]
    out = []
    for found, before in ((far, table), (near, rest if robust else table)):
        (mean, std), (clean_mean, clean_std) = mean_and_std(before), mean_and_std(emptied(before, found))
        for one in sorted(found, key=lambda one: -one.times):
            k, g = one.repeat, one.group
            disagreement = Disagreement(
                kind, repeats[k], names[g], "", one.times, float(table[k, g]),
                float(mean[g]), float(clean_mean[g]), float(std[g]), float(clean_std[g]),
                robust and found is far, "", (k, -1, g),
            )  # fmt: skip
            too_few = 0 if found is far else int(np.isfinite(table[:, g]).sum())
            out.append(replace(disagreement, sentence=_value_sentence(disagreement, too_few)))
    return out


def _value_sentence(one: Disagreement, too_few: int) -> str:
    """Sentence on a single value; ``too_few`` is the number of repeats if it is too small to leave it out, else 0."""
    unit = " Hz" if one.kind == "frequency" else ""
    label = f"response {one.mode}" if one.kind == "response" else f"{one.kind} of mode {one.mode}"
    with_ = with_std(one.mean_with, one.std_with, unit)
    rest = with_std(one.mean_without, one.std_without, unit)
    off = one.value - one.mean_without
    share = 100.0 * abs(off / one.mean_without) if one.mean_without else float("inf")
    done = f"left out: the mean is {rest}, with it {with_}" if one.left_out else f"kept: {with_}, without it {rest}"
    if too_few:
        done = f"kept, as {too_few} repeats are too few to leave it out safely: the mean is {with_}, without it {rest}"
    return (
        f"{one.repeat}: the {label}, {one.value:.5g}{unit}, is {share:.2g} % from the mean of the others, "
        f"{one.times:.3g} standard deviations of a repeat; {done}"
    )


# -- shapes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Block:
    repeat: int
    sensor: int
    mode: int
    times: float
    excess: float

    @property
    def place(self) -> tuple[int, int | slice, int | slice]:
        return _place((self.repeat, self.sensor, self.mode))


def _shape_disagreements(
    repeats: Sequence[str], modes: Sequence[str], sensors: Sequence[str], stack: np.ndarray, robust: bool
) -> list[Disagreement]:
    """Channels, whole shapes and single entries, found one after the other, largest excess first."""
    given = np.stack([scaled(shapes)[0] for shapes in stack])
    cleaned = given.copy()
    found: list[_Block] = []
    while len(found) < RULES.found_most:
        worst = _worst(aligned_repeats(cleaned))
        if worst is None:
            break
        cleaned[worst.place] = complex(np.nan, np.nan)
        found.append(worst)
    if not found:
        return []
    aligned = aligned_repeats(given, np.isfinite(cleaned))
    (_, before), (_, after) = (
        mean_and_std(np.abs(a - median_of_repeats(aligned))) for a in (aligned, _keep(aligned, cleaned))
    )
    return [_reported(one, repeats, modes, sensors, aligned, cleaned, before, after, robust) for one in found]


def _worst(stack: np.ndarray) -> _Block | None:
    """The outlying channel, shape or entry of the largest excess."""
    n_repeats, n_sensors, n_modes = stack.shape
    entries = find_outlying(stack.reshape(n_repeats, -1, 1), RULES.shape_resolution)
    single = [_Block(o.repeat, o.group // n_modes, o.group % n_modes, o.times, o.excess) for o in entries]
    blocks = list(single)
    if n_modes > 1:
        blocks += [
            _Block(o.repeat, o.group, -1, o.times, o.excess) for o in find_outlying(stack, RULES.shape_resolution)
        ]
    if n_sensors > 1:
        turned = stack.transpose(0, 2, 1)
        blocks += [
            _Block(o.repeat, -1, o.group, o.times, o.excess) for o in find_outlying(turned, RULES.shape_resolution)
        ]
    if not blocks:
        return None
    best = max(blocks, key=lambda b: b.excess)
    inside = [
        b
        for b in single
        if b.repeat == best.repeat and (b.sensor == best.sensor or b.mode == best.mode)
        and b.excess >= RULES.entry_share * best.excess
    ]  # fmt: skip
    return max(inside, key=lambda b: b.excess) if inside else best


def _reported(
    one: _Block,
    repeats: Sequence[str],
    modes: Sequence[str],
    sensors: Sequence[str],
    aligned: np.ndarray,
    cleaned: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    robust: bool,
) -> Disagreement:
    others = median_of_repeats(_keep(aligned, cleaned))
    mine, rest = aligned[one.place], others[one.place[1:]]
    both = np.isfinite(mine) & np.isfinite(rest)
    a, b = np.atleast_1d(mine)[np.atleast_1d(both)], np.atleast_1d(rest)[np.atleast_1d(both)]
    size = float(np.vdot(b, b).real)
    gain = float(np.vdot(b, a).real) / size if size > 0 else nan
    share = float(np.sqrt(np.vdot(a, a).real / size)) if size > 0 else nan
    sensor = sensors[one.sensor] if one.sensor >= 0 else ""
    mode = modes[one.mode] if one.mode >= 0 else ""
    kind: Kind = "entry" if sensor and mode else "sensor" if sensor else "shape"
    value = gain
    if kind == "sensor" and share < RULES.dead_below:
        what = f"sensor {sensor} looks dead (it moves {100 * share:.0f} % of what it does in the other repeats)"
    elif kind == "sensor" and gain < RULES.turned_below:
        what = f"sensor {sensor} looks turned round (gain {gain:.2f} against the other repeats)"
    elif kind == "sensor":
        what = f"sensor {sensor} differs from the other repeats (gain {gain:.2f})"
    elif kind == "entry":
        what = f"sensor {sensor} in mode {mode} differs from the other repeats (gain {gain:.2f})"
    else:
        value = float(mac(others[:, [one.mode]], aligned[one.repeat][:, [one.mode]])[0, 0])
        what = f"the shape of mode {mode} has a MAC of {value:.2f} with the other repeats"
    with_, rest_ = (float(np.sqrt(np.nanmean(s[one.place[1:]] ** 2))) for s in (before, after))
    done = "left out; with it" if robust else "kept; with it"
    sentence = (
        f"{repeats[one.repeat]}: {what}, {one.times:.3g} standard deviations of a repeat away; {done} the standard "
        f"deviation of the mean there is {100 * with_:.2g} % of the largest entry, without it {100 * rest_:.2g} %"
    )
    return Disagreement(
        kind, repeats[one.repeat], mode, sensor, one.times, value, nan, nan, with_, rest_, robust, sentence,
        (one.repeat, one.sensor, one.mode),
    )  # fmt: skip


def _two_repeats(repeats: Sequence[str], sensors: Sequence[str], stack: np.ndarray) -> list[Disagreement]:
    """Channels that are turned round or dead in one of two repeats; which one is turned round is unknown."""
    held = np.flatnonzero(np.isfinite(stack).any(axis=(1, 2)))
    one, two = aligned_repeats(np.stack([scaled(stack[k])[0] for k in held]))
    both = np.isfinite(one) & np.isfinite(two)
    one, two = np.where(both, one, 0.0), np.where(both, two, 0.0)
    modes = np.maximum(both.sum(axis=1), 1)
    sizes = np.stack([np.sqrt((np.abs(x) ** 2).sum(axis=1) / modes) for x in (one, two)])
    product = (one.conj() * two).sum(axis=1)
    small = sizes.min(axis=0)
    collinear = np.abs(product) ** 2 > RULES.collinear_above * np.prod(sizes**2, axis=0) * modes**2
    names = f"{repeats[held[0]]} and {repeats[held[1]]}"
    out = []
    for i in np.flatnonzero(modes > 1).tolist():
        large = float(sizes[:, i].max())
        if large <= RULES.moves_above:
            continue
        gain = float(product[i].real / (modes[i] * large**2))
        if small[i] < RULES.dead_below / 2 * large:
            which = repeats[held[int(np.argmin(sizes[:, i]))]]
            share = small[i] / large
            sentence = (
                f"{which}: sensor {sensors[i]} looks dead (it moves {100 * share:.0f} % of what it does in the other "
                "repeat); kept: with two repeats, none is left out"
            )
            out.append(Disagreement("sensor", which, "", sensors[i], nan, share, nan, nan, nan, nan, False, sentence))
        elif gain < RULES.turned_below and collinear[i]:
            sentence = (
                f"sensor {sensors[i]} has opposite signs in {names}; it is turned round in one of them, and both "
                "are kept"
            )
            out.append(Disagreement("sensor", names, "", sensors[i], nan, gain, nan, nan, nan, nan, False, sentence))
    return out


def _keep(aligned: np.ndarray, cleaned: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(cleaned), aligned, complex(np.nan, np.nan))
