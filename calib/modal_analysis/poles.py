"""Poles of measured FRFs at ascending model orders, by a least-squares complex frequency method over their band."""

from __future__ import annotations

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.modal_analysis.rules import RULES
from calib.structure.frf import motion_factor


def poles_by_order(frfs: MeasuredFRFs, highest: int | None = None) -> tuple[np.ndarray, ...]:
    """Stable poles within the band of the lines at model orders 1, 2, ... poles.

    The least-squares complex frequency method (Guillaume et al. 1998; Verboven 2002, section 5.3) fits all functions by
    rational functions in ``z = exp(-(s - s_0) T)`` with one common denominator. ``s_0`` is the first line, and ``T``
    lays the band over half of the unit circle, wherever it begins: laid out from 0 Hz, a narrow band far above would be
    a short arc, on which powers of z are hardly different. Coefficients are therefore complex, and poles have no
    conjugates. The highest coefficient of the denominator is 1, by which poles of noise have positive real parts and
    drop out (Cauberghe et al. 2005). Functions enter as mobilities, whose resonances have more even heights than those
    of receptances or accelerances. Lines may be unevenly spaced, and differ between functions.

    Parameters
    ----------
    frfs : MeasuredFRFs
        Without a line at 0 Hz.
    highest : int, optional
        Highest order; default the lines over `RULES.lines_per_order`, at most `RULES.frf_order_most`.

    Returns
    -------
    tuple of ndarray (n_poles,), complex
        rad/s, by order; imaginary parts positive, ascending natural frequency.

    Raises
    ------
    InputError
        For lines that are too few or begin at 0 Hz.
    """
    _require_lines(frfs)
    order = min(RULES.frf_order_most, len(frfs.freq) // RULES.lines_per_order) if highest is None else highest
    omega = 2 * np.pi * frfs.freq
    period = np.pi / float(omega[-1] - omega[0])
    powers = np.exp(-1j * period * (omega - omega[0]))[:, None] ** np.arange(order + 1)
    whole, along = _normal(frfs, powers)
    out = []
    for n in range(1, order + 1):
        matrix = whole[: n + 1, : n + 1] - np.einsum("fij,fik->jk", (own := along[:, : n + 1, : n + 1]).conj(), own)
        lower = np.linalg.lstsq(matrix[:n, :n], -matrix[:n, n], rcond=None)[0]
        with np.errstate(divide="ignore", invalid="ignore"):  # a root of 0 is no pole
            found = -np.log(np.roots(np.append(lower, 1.0)[::-1])) / period
        # the logarithm is one of many: the one nearest to the middle of the band
        middle, turn = 0.5 * float(omega[-1] - omega[0]), 2 * np.pi / period
        imag = (found.imag - middle + turn / 2) % turn - turn / 2 + middle
        out.append(_physical(found.real + 1j * (imag + omega[0]), frfs.freq))
    return tuple(out)


def _normal(frfs: MeasuredFRFs, powers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the denominator: all of them, and of each function what its numerator takes away.

    Returns
    -------
    whole : ndarray (n_powers, n_powers), complex
    along : ndarray (n_functions, n_powers, n_powers), complex
        Rows along the orthonormal columns of the powers, so that a lower order has the first of them.
    """
    factor = motion_factor("mobility", frfs.freq) / motion_factor(frfs.quantity, frfs.freq)
    n = powers.shape[1]
    whole, along, bases = np.zeros((n, n), complex), np.zeros((len(frfs.functions), n, n), complex), {}
    for k, one in enumerate(frfs.functions):
        key = one.lines.tobytes()
        if key not in bases:
            bases[key] = np.linalg.qr(powers[one.lines])[0]
        own = (frfs.values[one.index] * factor[one.lines])[:, None] * powers[one.lines]
        whole += own.conj().T @ own
        along[k, : bases[key].shape[1]] = bases[key].conj().T @ own
    return whole, along


def _physical(poles: np.ndarray, freq: np.ndarray) -> np.ndarray:
    size = np.abs(poles) / (2 * np.pi)
    kept = np.isfinite(poles) & (poles.real < 0) & (poles.imag > 0) & (size >= freq[0]) & (size <= freq[-1])
    return np.asarray(poles[kept][np.argsort(size[kept])])


def _require_lines(frfs: MeasuredFRFs) -> None:
    place = frfs.source or "FRFs"
    if len(frfs.freq) < RULES.lines_least:
        raise InputError(
            f"{len(frfs.freq)} lines are too few to identify modes", place=place,
            remedy=f"give at least {RULES.lines_least}, in a wider band, or fit the FRFs themselves",
        )  # fmt: skip
    if frfs.freq[0] == 0:
        raise InputError("its lines begin at 0 Hz", place=place, remedy="give a band that begins above")
