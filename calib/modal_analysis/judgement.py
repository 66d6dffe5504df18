"""Why an identified mode does not count, which refused ones are accepted all the same, and what is told beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.modal_analysis.identification import INSTEAD, hz
from calib.modal_analysis.rules import RULES

PAIR = "it differs between functions as a mixture of two modes does, which lie closer than their widths"
"""Why a pole is refused that stands for two modes."""

WINDOW = "the damping of the exponential window is all it has"
"""Why a pole is refused that an exponential window alone damps."""


def window_words(rate: float, taken: np.ndarray) -> str:
    """That the damping of an exponential window was taken off: its rate, 1/s, and that of modes, ratios."""
    return (
        f"the damping of an exponential window of {1 / rate:.3g} s is taken off: {100 * taken.min():.2g} to "
        f"{100 * taken.max():.2g} % of critical damping"
    )


def complex_shape(collinearity: float, deviation: float, n_references: int) -> str:
    """Why a shape cannot be told from that of a computational pole; empty where it can.

    Damping that is not proportional makes shapes complex, and so do noise and modes outside the band, for which a pole
    stands that is no mode. Several references show by their common shape which of the two it is; one does not.
    """
    if n_references > 1 or not collinearity < RULES.mpc_least:
        return ""
    return (
        f"its shape is complex (MPC {collinearity:.2f}; MPD {deviation:.0f} degrees), which under one reference may be "
        "that of a computational pole"
    )


def accepted_modes(
    accept: Sequence[float], freq: np.ndarray, damping: np.ndarray, why: Sequence[str], place: str
) -> dict[int, str]:
    """Refused modes that the user keeps, with the note that they bear.

    Parameters
    ----------
    accept : sequence of float
        Natural frequencies, Hz; each is that of the nearest refused mode within its half-power width, or
        `RULES.accepted_reach` of it. FRFs then also hold poles that are stable at few orders.
    freq, damping : ndarray (n_modes,)
        Hz and ratios of all stable modes.
    why : sequence of str
        Why each is refused; empty where it counts.

    Raises
    ------
    InputError
        For a frequency without a refused mode.
    """
    refused = [k for k, own in enumerate(why) if own]
    out: dict[int, str] = {}
    for wanted in accept:
        away = {k: abs(wanted - freq[k]) for k in refused if k not in out}
        best = min(away, key=lambda k: away[k], default=None)
        if best is None or away[best] > max(2 * damping[best], RULES.accepted_reach) * freq[best]:
            if any(abs(wanted - f) <= RULES.accepted_reach * f for k, f in enumerate(freq) if k not in refused):
                continue  # it counts already
            these = f"those refused are at {hz([freq[k] for k in refused])}" if refused else "none is refused"
            raise InputError(f"no refused mode is near the accepted {wanted:g} Hz", place=place, remedy=these)
        out[best] = f"accepted although refused: {why[best]}"
    return out


def scatter_words(between: float) -> str:
    """What is said of a resonance that differs between functions, by its relative standard deviation."""
    return f"its resonances differ between functions by {_relative(between)}: drift or mass loading"


def scatter_of_modes(between: Mapping[str, float]) -> str:
    """The same of all modes by their names; empty where functions agree."""
    differ = {name: own for name, own in between.items() if own > 0}
    if not differ:
        return ""
    smallest, largest = _relative(min(differ.values())), _relative(max(differ.values()))
    size = largest if smallest == largest else f"{smallest} to {largest}"
    which = f"mode{'s' * (len(differ) > 1)} {', '.join(differ)}"
    return (
        f"resonances differ between functions by {size} ({which}): drift or mass loading; frequency and damping are "
        "means over the functions"
    )


def _relative(value: float) -> str:
    return f"{100 * value:.2g} %" if value > 1e-4 else f"{1e6 * value:.2g} ppm"


def none_counts(frfs: MeasuredFRFs, reasons: Sequence[tuple[float, str]]) -> InputError:
    """The error where no mode counts, with the remedy that fits these lines.

    Parameters
    ----------
    frfs : MeasuredFRFs
    reasons : sequence of (float, str)
        Frequency, Hz, of each stable pole, and why it is refused.
    """
    place = frfs.source or "FRFs"
    if reasons:
        words = "; ".join(f"{freq:.4g} Hz: {why}" for freq, why in reasons)
        n = len(reasons)
        which = "the stable pole does" if n == 1 else f"the {n} stable poles do"
        keep = f"keep one with --accept {reasons[0][0]:.4g} (accept=[{reasons[0][0]:.4g}] in Python), or {INSTEAD}"
        return InputError(f"{which} not describe it ({words})", place=place, remedy=keep)
    return InputError("no pole is stable over the model orders", place=place, remedy=_finer(frfs))


def _finer(frfs: MeasuredFRFs) -> str:
    """What a measurement needs in which no pole is stable."""
    found, spacing = frfs.resonances(), float(np.median(np.diff(frfs.freq)))
    coarse = [one for one in found if one.width < RULES.width_lines * spacing]
    if coarse:
        return (
            f"measure with finer lines: at {hz([one.freq for one in coarse])} fewer than {RULES.width_lines} lie "
            f"within a half-power width; or {INSTEAD}"
        )
    if len(frfs.freq) < RULES.mode_lines * len(found):
        return (
            f"give a wider band or finer lines: {len(frfs.freq)} lines hold {len(found)} resonances, and each needs "
            f"{RULES.mode_lines}; or {INSTEAD}"
        )
    return INSTEAD


def residual_words(freq: np.ndarray, residual_std: Sequence[float], excess: Sequence[float]) -> str:
    """That modes which count leave errors far above the noise; empty where none does."""
    far = [k for k, one in enumerate(residual_std) if one > RULES.residual_told]
    if not far:
        return ""
    worst = max(far, key=lambda k: residual_std[k])
    return (
        f"around {hz([freq[k] for k in far])} the modes miss the FRFs by up to {residual_std[worst]:.0f} of their "
        f"standard deviations ({100 * excess[worst]:.1g} % of the FRFs)"
    )
