"""Poles of measured FRFs at ascending model orders, by the least-squares complex frequency method of sdypy-EMA."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.modal_analysis.rules import RULES
from calib.structure.frf import motion_factor

EXTRA = "pip install calib[modes]"
"""What installs the package that estimates the poles."""

UNEVEN = 1e-3
"""Largest deviation of a line from equal spacing, over the spacing."""


def poles_by_order(frfs: MeasuredFRFs, highest: int | None = None) -> tuple[np.ndarray, ...]:
    """Stable poles within the band of the lines at model orders 1, 2, ... pole pairs.

    The method (Guillaume et al. 1998; Verboven 2002, section 5.3) fits all functions by rational functions in
    ``exp(-i omega T)`` with one common denominator. They enter as mobilities, whose resonances have more even heights
    than those of receptances or accelerances. Poles with a positive real part are mathematical, not physical.

    Parameters
    ----------
    frfs : MeasuredFRFs
        With equally spaced lines, all functions measured on each.
    highest : int, optional
        Highest order; default the lines over `RULES.lines_per_order`, at most `RULES.frf_order_most`.

    Returns
    -------
    tuple of ndarray (n_poles,), complex
        rad/s, by order; imaginary parts positive, ascending natural frequency.

    Raises
    ------
    InputError
        When the package is not installed, and for lines that are too few, unequally spaced or incompletely measured.
    """
    first, spacing = _require_even_lines(frfs)
    ema = _require_package()
    order = min(RULES.frf_order_most, len(frfs.freq) // RULES.lines_per_order) if highest is None else highest
    mobility = _mobilities(frfs)
    # The package completes the axis from 0 Hz by itself, and trips over rounding there; it also drops the last line.
    whole = spacing * np.arange(first + len(frfs.freq) + 1)
    padded = np.zeros((len(mobility), len(whole)), dtype=complex)
    padded[:, first:-1] = mobility
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of poles that it discards itself
        model = ema.Model(padded, whole, lower=whole[first], upper=whole[-1], pol_order_high=order)
        model.get_poles(method="lscf", show_progress=False)
    shift = 2j * np.pi * (frfs.freq[0] - first * spacing)  # lines that are no multiples of their spacing
    return tuple(_physical(np.asarray(poles) + shift, frfs.freq) for poles in model.all_poles)


def _mobilities(frfs: MeasuredFRFs) -> np.ndarray:
    """Functions as mobilities, (n_functions, n_freq)."""
    factor = motion_factor("mobility", frfs.freq) / motion_factor(frfs.quantity, frfs.freq)
    return np.array([frfs.values[one.index] * factor[one.lines] for one in frfs.functions])


def _physical(poles: np.ndarray, freq: np.ndarray) -> np.ndarray:
    size = np.abs(poles) / (2 * np.pi)
    kept = np.isfinite(poles) & (poles.real < 0) & (poles.imag > 0) & (size >= freq[0]) & (size <= freq[-1])
    return np.asarray(poles[kept][np.argsort(size[kept])])


def _require_even_lines(frfs: MeasuredFRFs) -> tuple[int, float]:
    """Number of whole spacings below the first line, and the spacing, Hz."""
    place = frfs.source or "FRFs"
    if len(frfs.freq) < RULES.lines_least:
        raise InputError(
            f"{len(frfs.freq)} lines are too few to identify modes", place=place,
            remedy=f"give at least {RULES.lines_least}, or fit the FRFs themselves",
        )  # fmt: skip
    if frfs.freq[0] == 0:
        raise InputError("its lines begin at 0 Hz", place=place, remedy="give a band that begins above")
    spacing = float(frfs.freq[-1] - frfs.freq[0]) / (len(frfs.freq) - 1)
    even = frfs.freq[0] + spacing * np.arange(len(frfs.freq))
    if np.max(np.abs(frfs.freq - even)) > UNEVEN * spacing:
        raise InputError(
            "its lines are not equally spaced", place=place,
            remedy="modes are identified on equally spaced lines: export these, or fit the FRFs themselves",
        )  # fmt: skip
    for one in frfs.functions:
        if len(one.lines) < len(frfs.freq):
            raise InputError(
                f"{one.name} is not measured on every line", place=place,
                remedy="give a band in which it is, or leave it out",
            )  # fmt: skip
    return round(frfs.freq[0] / spacing - 0.5 + UNEVEN), spacing


def _require_package() -> Any:
    try:
        from sdypy import EMA
    except ImportError:
        raise InputError("sdypy-EMA, which estimates poles, is not installed", remedy=EXTRA) from None
    return EMA
