"""Repeats of measured FRFs, and their mean with its standard deviation from repeats or coherence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs, Quantity
from calib.measurement.modal import Sensor
from calib.measurement.places import Doubt, Point
from calib.measurement.rules import RULES

Key = tuple[tuple[int, str], tuple[int, str]]
"""Node and direction of a response and of a reference."""

_AXIS = 1e-6
"""Largest difference of two frequencies of one line over the highest frequency: above the rounding of single
precision (6e-8), and far below the distance of two lines."""

_RANGE = 30.0
"""Of the logarithms of the two parts of the noise, about half the mean variance: 13 decades up and down."""


def function_name(key: Key) -> str:
    """Label such as ``12z/3z``; see `MeasuredFunction`."""
    return "/".join(Sensor(*end).name for end in key)


def off_axis(freq: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Which lines of a function are not those of an axis, (n_freq,), bool; all where the numbers of lines differ."""
    if freq.shape != axis.shape:
        return np.ones(max(len(freq), 1), dtype=bool)
    return np.asarray(np.abs(freq - axis) > _AXIS * np.abs(axis).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class FRFRepeat:
    """Frequency response functions of one file.

    Attributes
    ----------
    source : str
    freq : ndarray (n_freq,)
        Hz.
    quantity : Quantity
    functions : mapping from Key to ndarray (n_freq,), complex
        By response and reference; SI.
    coherence : mapping from Key to ndarray (n_freq,)
        Where the file has it.
    notes : tuple of str
    points : mapping from node to (x, y, z)
        Places of nodes in m, where the file has them.
    """

    source: str
    freq: np.ndarray
    quantity: Quantity
    functions: Mapping[Key, np.ndarray]
    coherence: Mapping[Key, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    points: Mapping[int, Point] = field(default_factory=dict)


def repeat_of(
    source: str,
    axis: np.ndarray,
    quantity: Quantity,
    functions: Mapping[Key, np.ndarray],
    coherence: Mapping[Key, np.ndarray],
    notes: Sequence[str],
    points: Mapping[int, Point] | None = None,
) -> FRFRepeat:
    """A repeat without what was not measured.

    Mobility and accelerance are zero at 0 Hz: only receptances keep that line. An entry that is exactly 0 is one that a
    writer put there, for NaN or above the range of an integration: it becomes NaN, as entries that are not finite are,
    and the notes name the lines.

    Raises
    ------
    InputError
        For a function of which nothing is left.
    """
    kept = axis >= 0 if quantity == "receptance" else axis > 0
    said, own = list(notes), {}
    lines: dict[str, list[str]] = {}
    for key, values in functions.items():
        here = np.array(values[kept], dtype=complex)
        for lost, words in ((~np.isfinite(here), "no value"), (here == 0, "exactly 0")):
            if lost.any():
                lines.setdefault(f"{words} at {hertz_of(axis[kept][lost])}", []).append(function_name(key))
        here[~np.isfinite(here) | (here == 0)] = complex(np.nan, np.nan)
        if not np.isfinite(here).any():
            words = f"the function {function_name(key)} has no value on any line: a dead channel"
            raise InputError(words, place=source, remedy="leave it out")
        own[key] = here
    said += [Doubt(f"{source}: {few(names)}: {words}, left out there") for words, names in lines.items()]
    return FRFRepeat(
        source, axis[kept], quantity, own, {key: values[kept] for key, values in coherence.items()}, tuple(said),
        points or {},
    )  # fmt: skip


def few(names: Sequence[str]) -> str:
    """Some names in words, such as ``1x/4x, 2x/4x and 3 more``."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def hertz_of(freq: np.ndarray) -> str:
    """Some lines in words, such as ``1.5, 2 Hz`` or ``120 lines from 0.5 to 60 Hz``."""
    if len(freq) > _NAMED:
        return f"{len(freq)} lines from {freq[0]:.6g} to {freq[-1]:.6g} Hz"
    return f"{', '.join(f'{one:.6g}' for one in freq)} Hz"


_NAMED = 4
"""Largest number of lines or functions that are named one by one."""


def common_axis(axes: Sequence[np.ndarray]) -> np.ndarray | None:
    """All lines of several functions, Hz, ascending; None where one of them has too few of them.

    A function may leave out lines at which it has no value, up to a quarter (`RULES.absent_lines`).
    """
    first = axes[0]
    if all(not off_axis(other, first).any() for other in axes[1:]):
        return first
    every = np.sort(np.concatenate(axes))
    apart = np.diff(every) > _AXIS * np.abs(every).max(initial=0.0)
    union = every[np.concatenate([[True], apart])]
    return union if min(map(len, axes)) >= (1 - RULES.absent_lines) * len(union) else None


def on_axis(values: np.ndarray, freq: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Values (n_lines,) at the lines of a common axis, (n_freq,); NaN where they have none."""
    if not off_axis(freq, axis).any():
        return values
    out = np.full(len(axis), np.nan, dtype=values.dtype)
    near = np.clip(np.searchsorted(axis, freq), 1, len(axis) - 1)
    near -= freq - axis[near - 1] < axis[near] - freq
    out[near] = values
    return out


def combine_frfs(repeats: Sequence[FRFRepeat], averages: int | None = None, synthetic: bool = False) -> MeasuredFRFs:
    """Mean of repeats, with its standard deviation from them, or from the coherence of a single one.

    The standard deviation of two or more repeats of a function is smoothed over its lines as ``sqrt((a |H|)^2 +
    b^2)``, a share of the value and a floor, both of largest likelihood for the variances of all lines: a single line
    has too few repeats. Each line counts the repeats that have a value there; one on which all of them agree exactly
    was held or clipped, and is left out. With the coherence and the number of averages n of a single repeat the
    standard deviation is ``|H| sqrt((1 - gamma^2)/(2 n gamma^2))`` (Bendat and Piersol 2010, section 9.2.2); where the
    coherence is 1 it is unknown.

    Parameters
    ----------
    repeats : sequence of FRFRepeat
    averages : int, optional
        Averages behind each FRF of a single repeat, with which its coherence gives a standard deviation.
    synthetic : bool

    Raises
    ------
    InputError
        When files differ in frequencies, quantity or functions, one is a copy of another, or a coherence that is used
        is none.
    """
    if not repeats:
        raise InputError("there are none", place="FRFs", remedy="name at least one file")
    first, *others = repeats
    if averages is not None and others:
        raise InputError(
            f"averages are given beside {len(repeats)} repeats", place=first.source,
            remedy="leave them out: the repeats give the standard deviations",
        )  # fmt: skip
    axis = common_axis([repeat.freq for repeat in repeats])
    for k, other in enumerate(others, start=1):
        _require_alike(first, other, axis is None)
        for earlier in repeats[:k]:
            if all(np.array_equal(own, other.functions[key], equal_nan=True) for key, own in earlier.functions.items()):
                words = f"it holds the same functions as {earlier.source}, to the last digit: a copy is no repeat"
                raise InputError(words, place=other.source, remedy="leave it out")
    axis = first.freq if axis is None else axis
    responses = list(dict.fromkeys(response for response, _ in first.functions))
    references = list(dict.fromkeys(reference for _, reference in first.functions))
    values = np.full((len(axis), len(responses), len(references)), complex(np.nan, np.nan))
    std = np.full(values.shape, np.nan)
    notes = [note for repeat in repeats for note in repeat.notes]
    for key in first.functions:
        here = np.s_[:, responses.index(key[0]), references.index(key[1])]
        every = np.array([on_axis(repeat.functions[key], repeat.freq, axis) for repeat in repeats])
        if len(repeats) > 1:
            values[here], std[here], held = _of_repeats(every)
            if held.any():
                words = f"all repeats of {function_name(key)} agree to the last digit at {hertz_of(axis[held])}"
                what = "" if held.sum() > 1 else f" ({every[np.isfinite(every[:, held][:, 0]), held][0]:.4g})"
                notes.append(Doubt(f"{first.source}: {words}{what}: held or clipped, left out there"))
            if not np.isfinite(values[here]).any():
                words = f"all repeats of the function {function_name(key)} agree to the last digit on every line"
                raise InputError(words, place=first.source, remedy="give files that were measured one by one")
        else:
            values[here] = every[0]
            if averages is not None and key in first.coherence:
                std[here] = _by_coherence(first, key, averages, notes)
    return MeasuredFRFs(
        axis, tuple(Sensor(*s) for s in responses), tuple(Sensor(*s) for s in references), first.quantity, values,
        std, len(repeats), synthetic, ", ".join(r.source for r in repeats), tuple(notes),
    )  # fmt: skip


def _of_repeats(every: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, its standard deviation, and where all repeats agree exactly, (n_freq,) each, of (n_repeats, n_freq)."""
    known = np.isfinite(every)
    count = known.sum(axis=0)
    total = np.where(known, every, 0.0).sum(axis=0)
    mean = np.divide(total, count, out=np.full(len(total), complex(np.nan, np.nan)), where=count > 0)
    lowest = np.where(known, every.real, np.inf).min(axis=0), np.where(known, every.imag, np.inf).min(axis=0)
    highest = np.where(known, every.real, -np.inf).max(axis=0), np.where(known, every.imag, -np.inf).max(axis=0)
    held = (count > 1) & (lowest[0] == highest[0]) & (lowest[1] == highest[1])
    mean[held] = complex(np.nan, np.nan)
    if not np.isfinite(mean).any():
        return mean, np.full(len(mean), np.nan), held
    std = np.full(len(mean), np.nan)
    measured = np.isfinite(mean)
    std[measured] = repeatability(every[:, measured]) / np.sqrt(count[measured])
    return mean, std, held


def _by_coherence(repeat: FRFRepeat, key: Key, averages: int, notes: list[str]) -> np.ndarray:
    """Standard deviation of a function by its coherence, (n_freq,); NaN where that is 1 or unknown."""
    gamma, known = repeat.coherence[key], np.isfinite(repeat.functions[key])
    wrong = known & ((gamma < 0) | (gamma > 1 + _ROUNDED))
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(
            f"the coherence of {function_name(key)} is {gamma[at]:g} at {repeat.freq[at]:.6g} Hz, outside [0, 1]",
            place=repeat.source, remedy="leave the line out, or leave out the averages",
        )  # fmt: skip
    if (full := known & (gamma >= 1)).any():
        words = f"the coherence of {function_name(key)} is 1 at {hertz_of(repeat.freq[full])}"
        above = ", above it by rounding" if gamma[full].max() > 1 else ""
        notes.append(f"{repeat.source}: {words}{above}: the standard deviation is unknown there")
    below = np.clip(gamma, 1e-6, 1.0)  # of coherence gamma^2
    found = np.abs(repeat.functions[key]) * np.sqrt((1 - below) / (2 * averages * below))
    return np.where(full, np.nan, found)


_ROUNDED = 1e-4
"""Largest excess of a coherence over 1 that counts as rounding."""


def _require_alike(first: FRFRepeat, other: FRFRepeat, apart: bool) -> None:
    if apart and off_axis(other.freq, first.freq).any():
        raise InputError(
            f"its frequencies are not those of {first.source}", place=other.source, remedy="measure on common lines"
        )
    if other.quantity != first.quantity:
        raise InputError(
            f"it holds {other.quantity}, but {first.source} {first.quantity}", place=other.source,
            remedy="export the same quantity",
        )  # fmt: skip
    if odd := sorted(set(other.functions) ^ set(first.functions)):
        raise InputError(
            f"the function {function_name(odd[0])} is not in both it and {first.source}", place=other.source,
            remedy="export the same functions in every repeat",
        )  # fmt: skip


def repeatability(every: np.ndarray) -> np.ndarray:
    """Standard deviation of one repeat of a function, of its real and imaginary part each; see `combine_frfs`.

    Parameters
    ----------
    every : ndarray (n_repeats, n_freq), complex
        At least two repeats; NaN where one has no value.

    Returns
    -------
    ndarray (n_freq,)
    """
    from scipy.optimize import minimize

    known = np.isfinite(every)
    count = known.sum(axis=0)
    mean = np.where(known, every, 0.0).sum(axis=0) / np.maximum(count, 1)
    squares = np.sum(np.where(known, np.abs(every - mean) ** 2, 0.0), axis=0)
    several = count > 1
    variance = squares[several] / (2 * (count[several] - 1))
    every_part = np.column_stack([np.abs(mean) ** 2, np.ones(len(mean))])
    parts = every_part[several]
    # a line counts by the degrees of freedom of its variance
    weight = (count[several] - 1) / np.mean(count[several] - 1)
    level = float(np.mean(variance)) if several.any() else 0.0
    if not level > 0:
        return np.zeros(len(mean))
    start = np.log(0.5 * level / np.maximum(parts.mean(axis=0), 1e-300))

    def unlikely(logs: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log likelihood of variances that are chi-square distributed, and its gradient."""
        each = parts * np.exp(logs)
        smooth = each.sum(axis=1)
        ratio = variance / smooth
        likely = float(np.mean(weight * (np.log(smooth) + ratio)))
        return likely, (weight * (1 - ratio) / smooth) @ each / len(smooth)

    found = minimize(unlikely, start, jac=True, method="L-BFGS-B", bounds=[(s - _RANGE, s + _RANGE) for s in start])
    return np.asarray(np.sqrt(every_part @ np.exp(found.x)))
