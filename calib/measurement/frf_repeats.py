"""Repeats of measured FRFs, and their mean with its standard deviation from repeats or coherence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import minimize

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs, Quantity
from calib.measurement.modal import Sensor
from calib.measurement.places import Point

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
    """A repeat without its line at 0 Hz, unless it holds receptances: mobility and accelerance are zero there."""
    kept = axis >= 0 if quantity == "receptance" else axis > 0
    return FRFRepeat(
        source, axis[kept], quantity, {key: values[kept] for key, values in functions.items()},
        {key: values[kept] for key, values in coherence.items()}, tuple(notes), points or {},
    )  # fmt: skip


def combine_frfs(repeats: Sequence[FRFRepeat], averages: int | None = None, synthetic: bool = False) -> MeasuredFRFs:
    """Mean of repeats, with its standard deviation from them, or from the coherence of a single one.

    The standard deviation of two or more repeats of a function is smoothed over its lines as ``sqrt((a |H|)^2 +
    b^2)``, a share of the value and a floor, both of largest likelihood for the variances of all lines: a single line
    has too few repeats. With the coherence and the number of averages n of a single repeat the standard deviation is
    ``|H| sqrt((1 - gamma^2)/(2 n gamma^2))`` (Bendat and Piersol 2010, section 9.2.2).

    Parameters
    ----------
    repeats : sequence of FRFRepeat
    averages : int, optional
        Averages behind each FRF of a single repeat, with which its coherence gives a standard deviation.
    synthetic : bool

    Raises
    ------
    InputError
        When files differ in frequencies, quantity or functions.
    """
    if not repeats:
        raise InputError("there are none", place="FRFs", remedy="name at least one file")
    first, *others = repeats
    for other in others:
        _require_alike(first, other)
    responses = list(dict.fromkeys(response for response, _ in first.functions))
    references = list(dict.fromkeys(reference for _, reference in first.functions))
    values = np.full((len(first.freq), len(responses), len(references)), complex(np.nan, np.nan))
    std = np.full(values.shape, np.nan)
    for response, reference in first.functions:
        here = np.s_[:, responses.index(response), references.index(reference)]
        every = np.array([repeat.functions[response, reference] for repeat in repeats])
        values[here] = every.mean(axis=0)
        if len(repeats) > 1:
            std[here] = repeatability(every) / np.sqrt(len(repeats))
        elif averages is not None and (response, reference) in first.coherence:
            gamma = np.clip(first.coherence[response, reference], 1e-6, 1.0)  # of coherence gamma^2
            std[here] = np.abs(values[here]) * np.sqrt((1 - gamma) / (2 * averages * gamma))
    return MeasuredFRFs(
        first.freq, tuple(Sensor(*s) for s in responses), tuple(Sensor(*s) for s in references), first.quantity, values,
        std, len(repeats), synthetic, ", ".join(r.source for r in repeats), tuple(n for r in repeats for n in r.notes),
    )  # fmt: skip


def _require_alike(first: FRFRepeat, other: FRFRepeat) -> None:
    if off_axis(other.freq, first.freq).any():
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
        At least two repeats.

    Returns
    -------
    ndarray (n_freq,)
    """
    mean = every.mean(axis=0)
    variance = np.sum(np.abs(every - mean) ** 2, axis=0) / (2 * (len(every) - 1))
    parts = np.column_stack([np.abs(mean) ** 2, np.ones(len(mean))])
    level = float(np.mean(variance))
    if not level > 0:
        return np.zeros(len(mean))
    start = np.log(0.5 * level / np.maximum(parts.mean(axis=0), 1e-300))

    def unlikely(logs: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log likelihood of variances that are chi-square distributed, and its gradient."""
        each = parts * np.exp(logs)
        smooth = each.sum(axis=1)
        ratio = variance / smooth
        return float(np.mean(np.log(smooth) + ratio)), ((1 - ratio) / smooth) @ each / len(mean)

    found = minimize(unlikely, start, jac=True, method="L-BFGS-B", bounds=[(s - _RANGE, s + _RANGE) for s in start])
    return np.asarray(np.sqrt(parts @ np.exp(found.x)))
