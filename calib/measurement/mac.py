"""Modal assurance criteria of real and complex shapes, with missing sensors and known noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors.errors import InputError

_COLLINEAR = 1e-12
"""A shape is real up to a phase when ``1 - |x^T x|/(x^H x)`` is below this (imaginary part under 1e-6 of the real)."""


def mac(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Modal assurance criterion ``|x^H y|^2 / ((x^H x)(y^H y))`` of every pair of columns.

    Where a measured column is real up to one common phase (a real-mode identification), a complex model column is first
    rotated to its most real phase, which maximises ``sum_s Re(y_s)^2``, and its real part is compared: such a
    measurement carries no phase information, so that phases of the model are not penalised. The rotation alone has no
    effect, since the Hermitian form ignores a common phase. A complex measured column is compared with the model column
    as it is.

    Parameters
    ----------
    x : ndarray (n_sensors, n_x)
        Measured shapes, real or complex; NaN marks a sensor not measured, omitted for each pair of columns separately.
    y : ndarray (n_sensors, n_y)
        Model shapes, likewise.

    Returns
    -------
    ndarray (n_x, n_y)
        Between 0 and 1; 0 where a column is zero or has no sensor in common with the other.

    Raises
    ------
    InputError
        When the numbers of sensors differ or an entry is infinite.

    References
    ----------
    Allemang and Brown 1982 (real form); its Hermitian extension is common practice.
    """
    sums = _PairSums.of(x, y)
    turn = np.exp(0.5j * (np.angle(sums.xtx) - np.angle(sums.yty)))
    real_part = 0.5 * (sums.yhy + np.abs(sums.yty))
    as_real = _ratio(np.real(turn * sums.xhy) ** 2, sums.xhx * real_part)
    hermitian = _ratio(np.abs(sums.xhy) ** 2, sums.xhx * sums.yhy)
    return np.where(sums.x_is_real, as_real, hermitian)


def best_pairs(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of pairs, one to one, whose scores (n_rows, n_columns), none below 0, have the largest sum.

    Pairs of score 0 may be left out. Where the largest scores of all rows are in different columns they are the pairs.
    """
    rows = np.flatnonzero(np.max(scores, axis=1, initial=0.0) > 0)
    columns = scores[rows].argmax(axis=1) if len(rows) else rows
    if len(np.unique(columns)) == len(rows):
        return rows, columns
    from scipy.optimize import linear_sum_assignment  # slow to import, and clear pairs need no search

    return linear_sum_assignment(scores, maximize=True)


def macx(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """MACX ``(|x^H y| + |x^T y|)^2 / ((x^H x + |x^T x|)(y^H y + |y^T y|))`` of every pair of columns.

    Not used for pairing here. It equals the MAC for real shapes, and 1 for a shape and its conjugate.

    Parameters
    ----------
    x, y : ndarray (n_sensors, n_x), (n_sensors, n_y)
        Real or complex; NaN marks a sensor not measured.

    Returns
    -------
    ndarray (n_x, n_y)

    References
    ----------
    Vacher, Jacquier and Bucharles 2010.
    """
    s = _PairSums.of(x, y)
    top = (np.abs(s.xhy) + np.abs(s.xty)) ** 2
    return _ratio(top, (s.xhx + np.abs(s.xtx)) * (s.yhy + np.abs(s.yty)))


def relative_motion(shapes: np.ndarray) -> np.ndarray:
    """How much each sensor moves: amplitude over the largest one of the mode, rms over the modes.

    Parameters
    ----------
    shapes : ndarray (n_sensors, n_modes)
        NaN where a sensor was not measured.

    Returns
    -------
    ndarray (n_sensors,)
        From 0 to 1; NaN without a value.
    """
    size = np.abs(np.asarray(shapes))
    known = np.isfinite(size)
    largest = np.where(known, size, 0.0).max(axis=0, initial=0.0)
    share = np.divide(size, largest, out=np.zeros(size.shape), where=known & (largest > 0.0))
    count = known.sum(axis=1)
    return np.sqrt(np.divide((share**2).sum(axis=1), count, out=np.full(len(size), np.nan), where=count > 0))


def comac(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Coordinate MAC of every sensor over paired columns, shape (n_sensors,).

    Each pair of columns is scaled to unit norm over its measured sensors and phase-aligned, so that every mode has the
    same weight. Then ``max(0, Re sum_m conj(x_sm) y_sm)^2 / (sum_m |x_sm|^2 sum_m |y_sm|^2)``. The original (Lieven and
    Ewins 1988) sums absolute values, which cannot detect a sensor mounted with the wrong sign; after the alignment
    signs are meaningful, and such a sensor gives 0 here.

    Parameters
    ----------
    x, y : ndarray (n_sensors, n_pairs)
        Measured and model shapes, column k of one belonging to column k of the other; NaN marks a sensor not measured.

    Returns
    -------
    ndarray (n_sensors,)
        NaN for a sensor at rest in both or never measured.
    """
    x, y = _scaled(x, "measured shapes"), _scaled(y, "model shapes")
    if x.shape != y.shape:
        raise InputError(f"measured shapes are {x.shape} and model shapes {y.shape}", place="CoMAC")
    cross, xx, yy = (np.zeros(len(x)) for _ in range(3))
    for m in range(x.shape[1]):
        both = ~(np.isnan(x[:, m]) | np.isnan(y[:, m]))
        a, b = x[both, m], y[both, m]
        if not (np.any(a) and np.any(b)):
            continue
        if is_real(a[:, None])[0]:
            a, b = (most_real(v).real.astype(complex) for v in (a, b))
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
        phase = np.angle(np.vdot(b, a))
        cross[both] += np.real(a.conj() * b * np.exp(1j * phase))
        xx[both] += np.abs(a) ** 2
        yy[both] += np.abs(b) ** 2
    out = _ratio(np.maximum(cross, 0.0) ** 2, xx * yy)
    out[(xx == 0) & (yy == 0)] = np.nan
    return out


def align(reference: np.ndarray, shape: np.ndarray) -> complex:
    """Complex factor that fits a shape to a reference in least squares, over the sensors known in both.

    Parameters
    ----------
    reference, shape : ndarray (n_sensors,)
        Real or complex; NaN marks a sensor not measured.

    Returns
    -------
    complex
        c that minimises ``|reference - c shape|``; 0 for a zero shape.
    """
    known = ~(np.isnan(reference) | np.isnan(shape))
    a, b = np.asarray(reference)[known], np.asarray(shape)[known]
    size = float(np.max(np.abs(b), initial=0.0))
    if size == 0:
        return 0j
    b = b / size  # tiny mass-normalised shapes would lose digits when squared
    return complex(np.vdot(b, a) / np.vdot(b, b).real / size)


def most_real(shape: np.ndarray) -> np.ndarray:
    """A shape rotated to the phase that maximises its real part, shape (n,), complex; NaN stay NaN."""
    return shape * np.exp(-0.5j * np.angle(np.nansum(np.asarray(shape, dtype=complex) ** 2)))


def is_real(shapes: np.ndarray) -> np.ndarray:
    """Which columns are real up to one common phase, shape (n_modes,), bool; NaN entries are left out."""
    columns = _scaled(shapes, "shapes")
    total = np.nansum(np.abs(columns) ** 2, axis=0)
    return (total > 0) & (np.abs(np.nansum(columns**2, axis=0)) >= (1 - _COLLINEAR) * total)


def phase_collinearity(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far shapes are real up to a phase: modal phase collinearity and mean phase deviation.

    The collinearity is ``|x^T x|^2 / (x^H x)^2``, that of Pappa, Elliott and Schenk (1993) without taking the mean off,
    which would throw a uniform motion away. The deviation is the mean angle of the entries from the phase that is most
    real, weighed by their moduli (Reynders, Houbrechts and De Roeck 2012).

    Parameters
    ----------
    shapes : ndarray (n_sensors, n_modes)
        NaN marks a sensor not measured.

    Returns
    -------
    collinearity : ndarray (n_modes,)
        From 0 to 1, which is real.
    deviation : ndarray (n_modes,)
        Degrees, from 0, which is real, to 90.
        Both are NaN where fewer than two sensors move, whose phase is that of the mode.
    """
    columns = _scaled(shapes, "shapes")
    known = np.where(np.isnan(columns), 0.0, columns)
    moves, total = np.abs(known) > 0, np.sum(np.abs(known) ** 2, axis=0)
    real = np.stack([most_real(one) for one in known.T], axis=1) if known.shape[1] else known
    angle = np.degrees(np.arctan2(np.abs(real.imag), np.abs(real.real)))
    enough = moves.sum(axis=0) > 1
    with np.errstate(invalid="ignore", divide="ignore"):
        collinearity = np.minimum(np.abs(np.sum(known**2, axis=0)) ** 2 / total**2, 1.0)
        deviation = np.sum(np.abs(known) * angle, axis=0) / np.sum(np.abs(known), axis=0)
    return np.where(enough, collinearity, np.nan), np.where(enough, deviation, np.nan)


def noise_mac(shapes: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Expected MAC of a correctly specified model, given the measurement noise.

    With a measured shape ``x = phi + e`` and the exact one ``phi``, ``1 - MAC = |e_p|^2/|x|^2`` exactly, e_p being the
    part of the noise perpendicular to phi. Independent noise of standard deviation s_k in real and imaginary part gives
    ``E|e_p|^2 = 2 sum_k s_k^2 (1 - |phi_k|^2/|phi|^2)``, evaluated with x for phi; half of it for real shapes. With the
    same s at n sensors this is ``1/(1 + 2 (n - 1) s^2/|phi|^2)``.

    Parameters
    ----------
    shapes : ndarray (n_sensors, n_modes)
        Measured; NaN marks a sensor not measured.
    std : ndarray (n_sensors, n_modes)
        Standard deviation of the real and of the imaginary part each, in the scale of the shape.

    Returns
    -------
    ndarray (n_modes,)
        NaN where the standard deviation of a measured sensor is unknown or nothing was measured.
    """
    columns = _columns(shapes, "measured shapes")
    known = ~np.isnan(columns)
    power = np.where(known, np.abs(columns) ** 2, 0.0)
    total = power.sum(axis=0)
    weight = power / np.where(total > 0, total, 1.0)
    parts = np.where(is_real(columns), 1.0, 2.0)
    noise = parts * np.where(known, std**2 * (1.0 - weight), 0.0).sum(axis=0)  # an unknown std makes the sum NaN
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(total > 0, 1.0 - np.minimum(noise / total, 1.0), np.nan)


# -- sums over the sensors known in both columns of a pair -------------------------------------------------------------


@dataclass(frozen=True)
class _PairSums:
    """Inner products of every pair of columns over the sensors known in both, each (n_x, n_y)."""

    xhy: np.ndarray
    xty: np.ndarray
    xhx: np.ndarray
    xtx: np.ndarray
    yhy: np.ndarray
    yty: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray) -> _PairSums:
        x, y = _scaled(x, "measured shapes"), _scaled(y, "model shapes")
        if len(x) != len(y):
            raise InputError(f"measured shapes have {len(x)} sensors and model shapes {len(y)}", place="MAC")
        in_x, in_y = (~np.isnan(v) for v in (x, y))
        x, y = np.where(in_x, x, 0.0), np.where(in_y, y, 0.0)
        wx, wy = in_x.astype(float), in_y.astype(float)
        return cls(
            xhy=x.conj().T @ y,
            xty=x.T @ y,
            xhx=(np.abs(x) ** 2).T @ wy,
            xtx=(x**2).T @ wy,
            yhy=wx.T @ np.abs(y) ** 2,
            yty=wx.T @ y**2,
        )

    @property
    def x_is_real(self) -> np.ndarray:
        return np.abs(self.xtx) >= (1 - _COLLINEAR) * self.xhx


def _columns(shapes: np.ndarray, label: str) -> np.ndarray:
    """Checked complex columns."""
    columns = np.array(shapes, dtype=complex)
    if columns.ndim == 1:
        columns = columns[:, None]
    if columns.ndim != 2:
        raise InputError(f"{label} have {columns.ndim} dimensions", place="MAC", remedy="give one mode a column")
    if np.any(np.isinf(columns)):
        raise InputError(f"{label} hold an infinite entry", place="MAC")
    return columns


def _scaled(shapes: np.ndarray, label: str) -> np.ndarray:
    """Columns scaled to a largest modulus of 1, which changes no criterion and prevents underflow of squares."""
    columns = _columns(shapes, label)
    size = np.max(np.where(np.isnan(columns), 0.0, np.abs(columns)), axis=0, initial=0.0)
    return columns / np.where(size > 0, size, 1.0)


def _ratio(top: np.ndarray, bottom: np.ndarray) -> np.ndarray:
    """Quotient, 0 where the divisor is 0, and limited to 1 against rounding error."""
    return np.minimum(np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0), 1.0)
