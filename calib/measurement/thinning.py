"""Many frequency lines as fewer ones that tell as much: means over lines that are close for what the poles do there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.measurement.frf import MeasuredFRFs, MeasuredFunction
from calib.measurement.frf_lines import Resonance, resonances
from calib.measurement.rules import RULES

DEGREE, NEIGHBOURS = 4, 2
"""Of the polynomial, and groups to both sides through which it goes."""
SMOOTHED, QUIET = 9, 31
"""Lines over which the power is averaged before resonances are sought in it, and over which that of the noise is: among
thousands of lines noise has peaks of its own."""
_POWER = {"receptance": 0, "mobility": 1, "accelerance": 2}


def thinned(frfs: MeasuredFRFs, most: int = RULES.lines_most, like: MeasuredFRFs | None = None) -> MeasuredFRFs:
    """FRFs with more lines than ``most`` as means over groups of lines; others as they are.

    A group is as wide as `RULES.group_width` of the distance from its first line to the nearest pole: resonances of any
    function (see `calib.measurement.frf_lines.resonances`), ``hypot(f - f_r, w/2)`` with the half-power width w, and
    the ends of the lines, beyond which may be others. Within it each value is divided by
    ``(i omega)^n / (i omega - s)`` of that pole; what is left bends little, and a polynomial through the neighbouring
    groups takes that off the mean. Errors of lines count as independent: standard deviations, stated, claimed and
    assumed, are those of what is entered. Parameters are then known to within 5 % of the standard deviations that all
    lines give.

    Parameters
    ----------
    frfs : MeasuredFRFs
    most : int
    like : MeasuredFRFs, optional
        Mean over the repeats on the same lines, whose resonances set the groups of each repeat; default the FRFs.

    Returns
    -------
    MeasuredFRFs
        With ``behind``, the number of lines of each entry, and a note.
    """
    if len(frfs.freq) <= most:
        return frfs
    poles = _poles(like or frfs)
    starts = _starts(frfs.freq, poles)
    ends = np.append(starts, len(frfs.freq))
    freq = np.add.reduceat(frfs.freq, starts) / np.diff(ends)
    nearest = poles[np.argmin(np.abs(1j * freq[:, None] - poles), axis=1)]
    shape = (len(freq), *frfs.values.shape[1:])
    values, std = np.full(shape, complex(np.nan, np.nan)), np.full(shape, np.nan)
    for k in range(len(freq)):
        _enter(frfs, k, ends, freq[k], nearest[k], values[k], std[k])
    count = np.add.reduceat(np.isfinite(frfs.values).astype(int), starts, axis=0)
    note = f"{len(frfs.freq)} lines count as {len(freq)}, each the mean of what lies close for the nearest resonance"
    return replace(frfs, freq=freq, values=values, std=std, behind=count, notes=(*frfs.notes, note))


def _enter(
    frfs: MeasuredFRFs, k: int, ends: np.ndarray, centre: float, pole: complex, values: np.ndarray, std: np.ndarray
) -> None:
    """Enter what group k tells of its mean frequency, and its standard deviation, (n_responses, n_references) each."""
    around = np.arange(ends[max(0, k - NEIGHBOURS)], ends[min(len(ends) - 1, k + 1 + NEIGHBOURS)])
    inside = (around >= ends[k]) & (around < ends[k + 1])
    measured, freq = frfs.values[around], frfs.freq[around]
    known = np.isfinite(measured)
    mean = inside[:, None, None] * known / np.maximum((inside[:, None, None] * known).sum(axis=0), 1)
    if inside.sum() > 1 and len(around) > DEGREE + 1:
        bend = _bend(freq, inside / inside.sum(), centre)
        mean = np.where(known.all(axis=0), mean - bend[:, None, None], mean)  # with a gap the mean alone
    weight = mean * (_shape(frfs, np.array([centre]), pole) / _shape(frfs, freq, pole))[:, None, None]
    there = known[inside].any(axis=0)
    values[there] = np.sum(np.where(known, measured, 0.0) * weight, axis=0)[there]
    std[there] = np.sqrt(np.sum(np.where(known, np.abs(weight) * frfs.std[around], 0.0) ** 2, axis=0))[there]


def _bend(freq: np.ndarray, weight: np.ndarray, centre: float) -> np.ndarray:
    """Weights (n_lines,) of the difference between a mean and the value at its centre.

    It is that of a polynomial through the lines of the group and of its neighbours, without its first two terms.
    """
    powers = np.vander((freq - centre) / np.ptp(freq), DEGREE + 1, increasing=True)
    moments = weight @ powers
    return np.asarray(moments[2:] @ np.linalg.pinv(powers)[2:])


def resonances_of_many(frfs: MeasuredFRFs) -> tuple[Resonance, ...]:
    """Resonances in the power of all functions, of so many lines that some of noise look like them."""
    power, noise = _sums(frfs)
    return resonances(frfs.freq, power, RULES.prominence, noise, SMOOTHED)


def _sums(frfs: MeasuredFRFs) -> np.ndarray:
    """Power of all functions and of their noise, (2, n_lines)."""
    both = np.zeros((2, len(frfs.freq)))
    for one in frfs.functions:
        both += [np.interp(frfs.freq, frfs.freq[one.lines], own) for own in _power_and_noise(frfs, one)]
    return both


def _power_and_noise(frfs: MeasuredFRFs, one: MeasuredFunction) -> tuple[np.ndarray, np.ndarray]:
    """Power of a function and mean power of its noise, both (n_lines,)."""
    own = frfs.values[one.index]
    return np.abs(own) ** 2, _noise(own, frfs.std[one.index])


def _poles(frfs: MeasuredFRFs) -> np.ndarray:
    """Resonances of single functions and of all, and the ends of the lines, as ``i f - w/2``, Hz."""
    found = _peaks(frfs.freq, *_sums(frfs))
    for one in frfs.functions:
        found += _peaks(frfs.freq[one.lines], *_power_and_noise(frfs, one))
    widths = [one.width for one in found]
    end = float(np.median(widths)) if widths else float(frfs.freq[-1] - frfs.freq[0]) / len(frfs.freq)
    ends = [complex(-end / 2, f) for f in (frfs.freq[0], frfs.freq[-1])]
    return np.array([complex(-one.width / 2, one.freq) for one in found] + ends)


def _peaks(freq: np.ndarray, power: np.ndarray, noise: np.ndarray) -> list[Resonance]:
    """Resonances, also those of which an end of the lines cuts a flank off: beyond the ends the power counts as 0."""
    steps = np.arange(1, SMOOTHED + 1)
    low, high = freq[0] - steps[::-1] * (freq[1] - freq[0]), freq[-1] + steps * (freq[-1] - freq[-2])
    around, noise = np.concatenate([low, freq, high]), np.pad(noise, SMOOTHED, mode="edge")
    return list(resonances(around, np.pad(power, SMOOTHED), RULES.prominence, noise, SMOOTHED))


def _noise(values: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Mean power of the noise around each line, (n_lines,): by standard deviations, or how far lines leave a parabola.

    Second differences of independent errors have 3/2 of their power, whose median is ln 2 of its mean.
    """
    from scipy.ndimage import median_filter, uniform_filter1d

    if np.all(std > 0) or len(values) <= QUIET:
        return np.asarray(uniform_filter1d(2 * np.nan_to_num(std) ** 2, QUIET, mode="nearest"))
    bent = np.abs(values[1:-1] - (values[:-2] + values[2:]) / 2) ** 2
    return np.asarray(median_filter(np.pad(bent, 1, mode="edge"), QUIET, mode="nearest") / (1.5 * np.log(2)))


def _starts(freq: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """First line of every group."""
    reach = freq + RULES.group_width * np.min(np.abs(1j * freq[:, None] - poles), axis=1)
    after = np.maximum(np.searchsorted(freq, reach), np.arange(1, len(freq) + 1))
    starts = [0]
    while after[starts[-1]] < len(freq):
        starts.append(int(after[starts[-1]]))
    return np.array(starts)


def _shape(frfs: MeasuredFRFs, freq: np.ndarray, pole: complex) -> np.ndarray:
    """What one pole alone does, (n_freq,)."""
    return np.asarray((1j * freq) ** _POWER[frfs.quantity] / (1j * freq - pole))
