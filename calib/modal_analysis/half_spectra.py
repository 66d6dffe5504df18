"""Half-spectra of ambient records: what modes are checked by, as FRFs are by their synthesis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.measurement.frf import MeasuredFRFs
from calib.measurement.record import MeasuredRecord
from calib.modal_analysis.rules import RULES


def window_rate(rate: float) -> float:
    """By how much the window moves every pole to the left, rad/s, at a sampling rate in Hz."""
    return float(-np.log(RULES.window_end) * rate / RULES.lags)


def half_spectra(records: Sequence[MeasuredRecord], n_parts: int, band: tuple[float, float]) -> MeasuredFRFs:
    """Fourier transforms of the correlations at positive lags, with standard deviations over parts of the records.

    Under white forces a correlation at positive lags is a sum of decaying modes, ``phi_r g_r^T exp(s_r t)`` and its
    conjugate (Peeters and De Roeck 1999; Cauberghe 2004), so that its transform has the form of a receptance with
    residues of rank one. An exponential window moves the poles by `window_rate`.

    Returns
    -------
    MeasuredFRFs
        In the squared unit of the records a Hz; responses and references are the sensors. Noise that all lags share,
        which fills the whole band evenly, is part of the series that stands for modes outside it.
    """
    rate, n = records[0].rate, len(records[0].sensors)
    each = max(-(-n_parts // len(records)), 1)
    parts = []
    for one in records:
        length = len(one.values) // each
        lags = min(RULES.lags, length)
        size = 1 << int(2 * length - 1).bit_length()
        for k in range(each):
            own = np.fft.rfft(one.values[k * length : (k + 1) * length], size, axis=0)
            table = np.zeros((RULES.lags, n, n))
            for i in range(n):
                whole = np.fft.irfft(own[:, [i]] * own.conj(), size, axis=0)[:lags]
                table[:lags, i] = whole / (length - np.arange(lags))[:, None]
            parts.append(table)
    decay = np.exp(-window_rate(rate) * np.arange(RULES.lags) / rate)
    spectra = np.array([np.fft.rfft(part * decay[:, None, None], 2 * RULES.lags, axis=0) / rate for part in parts])
    freq = np.fft.rfftfreq(2 * RULES.lags, 1 / rate)
    used = (freq > 0) & (freq >= band[0]) & (freq <= band[1])
    spectra = spectra[:, used]
    spread = (spectra.real.var(axis=0, ddof=1) + spectra.imag.var(axis=0, ddof=1)) / 2
    return MeasuredFRFs(
        freq[used], records[0].sensors, records[0].sensors, "receptance", spectra.mean(axis=0),
        np.sqrt(spread / len(parts)), n_repeats=len(parts), synthetic=records[0].synthetic,
        source=", ".join(one.source for one in records),
    )  # fmt: skip
