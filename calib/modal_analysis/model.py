"""Modal models of measured FRFs: residues of known poles by linear least squares, poles refined by nonlinear ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from calib.measurement.frf import MeasuredFRFs, MeasuredFunction
from calib.structure.frf import motion_factor

ROUNDS = 50
"""Alternations of `rank_one`; two agree to 1e-6 after about ten where one mode dominates its residues."""
EVALUATIONS = 30
"""Most evaluations of `most_likely_model`; from stable poles it takes five to ten."""
SMALLEST_STEP = 1e-8
"""Relative change of poles and of the sum of squares at which `most_likely_model` ends."""


BEYOND = (1.001, 1.005, 1.02, 1.1)
"""Where the poles outside the band may start: over its ends."""
BEYOND_DAMPING = 0.05
"""Their damping ratio, or that of the modes inside."""
BEYOND_LINES = 300
"""Lines by which the start is chosen, at least."""
FARTHEST = 1.0
"""Farthest that they go, as a logarithm: e times the highest line; a series describes what lies beyond."""


@dataclass(frozen=True, eq=False)
class ModalFRFModel:
    """A modal model of FRFs.

    Attributes
    ----------
    poles : ndarray (n_modes,), complex
        rad/s, imaginary parts positive.
    residues : ndarray (n_modes, n_responses, n_references), complex
        Of receptances, in SI; NaN where a function was not measured.
    synthesised : ndarray (n_freq, n_responses, n_references), complex
        Functions of this model, in the measured quantity.
    """

    poles: np.ndarray
    residues: np.ndarray
    synthesised: np.ndarray

    def reordered(self, order: np.ndarray) -> ModalFRFModel:
        """The same model with its poles in another order."""
        return ModalFRFModel(self.poles[order], self.residues[order], self.synthesised)


def fit_residues(frfs: MeasuredFRFs, poles: np.ndarray) -> ModalFRFModel:
    """Residues that describe the functions best, each function for itself.

    A receptance is ``sum_r R_r/(i omega - s_r) + R_r*/(i omega - s_r*)`` (Maia and Silva 1997, section 4.4), and modes
    outside the band contribute ``U + U' omega^2 - L/omega^2 - L'/omega^4`` with complex coefficients, the first two
    terms of their series above and below. Errors are weighed by the standard deviations of the FRFs where these are
    known and positive on all lines of a function, and equally otherwise.

    Parameters
    ----------
    frfs : MeasuredFRFs
        Without a line at 0 Hz.
    poles : ndarray (n_modes,), complex
        rad/s, imaginary parts positive.
    """
    n = len(poles)
    residues = np.full((n, *frfs.values.shape[1:]), complex(np.nan, np.nan))
    synthesised = np.full(frfs.values.shape, complex(np.nan, np.nan))
    basis = _basis(frfs, poles)
    for one, weight, right in weighed(frfs):
        rows = basis[one.lines]
        system = _stacked(rows, weight)
        size = np.linalg.norm(system, axis=0)
        found = np.linalg.lstsq(system / size, right, rcond=None)[0] / size
        parts = found[: 2 * n].reshape(-1, 2)
        residues[:, one.i, one.j] = parts[:, 0] + 1j * parts[:, 1]
        synthesised[one.index] = rows @ found
    return ModalFRFModel(poles, residues, synthesised)


def most_likely_model(frfs: MeasuredFRFs, poles: np.ndarray) -> ModalFRFModel:
    """Modal model of largest likelihood near stable poles: all lines and functions, weighed as in `fit_residues`.

    Residues are eliminated (variable projection, Golub and Pereyra 1973, with the derivative of Kaufman 1975). Stable
    poles of a linear method are biased by noise: damping ratios of heavily damped modes by tens of percent. Two further
    poles, one below and one above the band, stand for what lies there: a series alone would bend the modes beside it.

    Parameters
    ----------
    frfs : MeasuredFRFs
        Without a line at 0 Hz.
    poles : ndarray (n_modes,), complex
        rad/s, imaginary parts positive.

    Returns
    -------
    ModalModel
        With the poles in the same order, then the two outside the band.
    """
    return _refined_model(frfs, np.concatenate([poles, _beyond(frfs, poles)]), free=len(poles))


def _beyond(frfs: MeasuredFRFs, poles: np.ndarray) -> np.ndarray:
    """The start of the poles outside the band, one below and one above: those that describe the FRFs best.

    A resonance that lies just outside has a start near it, from which alone it is found.
    """
    few = slice(None, None, max(len(frfs.freq) // BEYOND_LINES, 1))
    behind = None if frfs.behind is None else frfs.behind[few]
    thin = replace(frfs, freq=frfs.freq[few], values=frfs.values[few], std=frfs.std[few], behind=behind)
    functions = weighed(thin)
    inside = float(np.median(-poles.real / np.abs(poles))) if len(poles) else BEYOND_DAMPING
    tried = [(share, ratio) for share in BEYOND[::-1] for ratio in {BEYOND_DAMPING, inside}]
    ends = 2 * np.pi * np.array([frfs.freq[0] / BEYOND[-1], frfs.freq[-1] * BEYOND[-1]]) * (1j - BEYOND_DAMPING)
    for k, (line, sign) in enumerate(((frfs.freq[0], -1), (frfs.freq[-1], 1))):
        each = [2 * np.pi * line * share**sign * (1j - ratio) for share, ratio in tried]
        squares = []
        for one in each:
            residual, _ = projected(thin, np.concatenate([poles, np.where(np.arange(2) == k, one, ends)]), functions)
            squares.append(float(residual @ residual))
        ends[k] = each[int(np.argmin(squares))]
    return ends


def refined_again(frfs: MeasuredFRFs, model: ModalFRFModel, further: complex) -> ModalFRFModel:
    """The model with one more pole, before the others, all refined from where they are."""
    return _refined_model(frfs, np.concatenate([[further], model.poles]), free=len(model.poles) - 1)


def _refined_model(frfs: MeasuredFRFs, poles: np.ndarray, free: int) -> ModalFRFModel:
    """Refine all poles; the first ``free`` belong in the band, the last two stay outside."""
    start = np.concatenate([np.log(np.abs(poles)), np.log(-poles.real / np.abs(poles))])
    n, ratio = len(poles), -poles.real / np.abs(poles)
    solved = _Solved(frfs)
    # A mode stays within its half-power width, one outside the band on its side.
    reach = np.concatenate([np.clip(2 * ratio, 1e-3, 0.5), np.full(n, np.log(4.0))])
    lower, upper = start - reach, start + reach
    low, high = np.log(2 * np.pi * frfs.freq[[0, -1]])
    lower[free], upper[free] = low - FARTHEST, low
    lower[free + 1], upper[free + 1] = high, high + FARTHEST
    upper[n:] = np.minimum(upper[n:], np.log(0.99))
    start = np.clip(start, lower + 1e-9, upper - 1e-9)
    found = least_squares(
        solved.residual, start, jac=solved.jacobian, bounds=(lower, upper), x_scale=reach,
        ftol=SMALLEST_STEP, xtol=SMALLEST_STEP, gtol=None, max_nfev=EVALUATIONS,
    )  # fmt: skip
    return fit_residues(frfs, poles_of(found.x))


class _Solved:
    """Residuals and derivatives of `projected`, of the last point together."""

    def __init__(self, frfs: MeasuredFRFs) -> None:
        self._frfs, self._weighed = frfs, weighed(frfs)
        self._at, self._found = np.empty(0), (np.empty(0), np.empty(0))

    def residual(self, x: np.ndarray) -> np.ndarray:
        return self._both(x)[0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return self._both(x)[1]

    def _both(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not np.array_equal(x, self._at):
            self._at, self._found = x.copy(), projected(self._frfs, poles_of(x), self._weighed)
        return self._found


def poles_of(x: np.ndarray) -> np.ndarray:
    """Poles from the logarithms of their natural circular frequencies and damping ratios."""
    size, ratio = np.exp(np.split(x, 2))
    return np.asarray(size * (-ratio + 1j * np.sqrt(1 - ratio**2)))


def projected(frfs: MeasuredFRFs, poles: np.ndarray, functions: Sequence[Weighed]) -> tuple[np.ndarray, np.ndarray]:
    """Weighed residuals after the best residues, and their derivatives by the logarithms in `_poles`."""
    n = len(poles)
    basis, slopes = _basis(frfs, poles), _slopes(frfs, poles)
    by_log = np.stack([poles, _by_damping(poles)])  # d pole / d ln of natural frequency and damping ratio
    residuals, jacobian = [], []
    for one, weight, right in functions:
        system = _stacked(basis[one.lines], weight)
        size = np.linalg.norm(system, axis=0)
        q, r = np.linalg.qr(system / size)
        along = q.T @ right
        found = np.linalg.solve(r, along) / size
        residue = found[: 2 * n : 2] + 1j * found[1 : 2 * n : 2]
        direct, conjugate = (part[one.lines] for part in slopes)
        change = [direct * (residue * d) + conjugate * (residue * d).conj() for d in by_log]
        moved = _stacked(np.concatenate(change, axis=1), weight)
        residuals.append(right - q @ along)
        jacobian.append(q @ (q.T @ moved) - moved)
    return np.concatenate(residuals), np.concatenate(jacobian)


def _by_damping(poles: np.ndarray) -> np.ndarray:
    size, ratio = np.abs(poles), -poles.real / np.abs(poles)
    return np.asarray(size * (-ratio - 1j * ratio**2 / np.sqrt(1 - ratio**2)))


class Weighed(NamedTuple):
    """A function, weights (n_lines,), and weighed values: real, then imaginary parts (2 n_lines,)."""

    function: MeasuredFunction
    weight: np.ndarray
    values: np.ndarray


def weighed(frfs: MeasuredFRFs) -> list[Weighed]:
    """Functions by their standard deviations, each equally where these are not known on all lines."""
    std = frfs.total_std
    out = []
    for one in frfs.functions:
        own, measured = std[one.index], frfs.values[one.index]
        weight = 1.0 / own if np.all(own > 0) else np.ones(len(own))
        out.append(Weighed(one, weight, np.concatenate([measured.real * weight, measured.imag * weight])))
    return out


def _stacked(columns: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighed real and imaginary parts of complex columns (n_lines, n), one below the other."""
    return np.concatenate([columns.real * weight[:, None], columns.imag * weight[:, None]])


def _basis(frfs: MeasuredFRFs, poles: np.ndarray) -> np.ndarray:
    """Functions of unit real and imaginary parts of each residue and term outside the band: (n_freq, 2 n_modes + 8)."""
    s = 2j * np.pi * frfs.freq[:, None]
    direct, conjugate = 1 / (s - poles), 1 / (s - poles.conj())
    pairs = np.stack([direct + conjugate, 1j * (direct - conjugate)], axis=2).reshape(len(frfs.freq), -1)
    relative = (frfs.freq / frfs.freq[-1])[:, None] ** np.array([0.0, 2.0, -2.0, -4.0])
    whole = np.concatenate([pairs, relative, 1j * relative], axis=1)
    return np.asarray(whole * motion_factor(frfs.quantity, frfs.freq)[:, None])


def _slopes(frfs: MeasuredFRFs, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of ``1/(i omega - s)`` by s and of ``1/(i omega - s*)`` by s*, each (n_freq, n_modes)."""
    s, factor = 2j * np.pi * frfs.freq[:, None], motion_factor(frfs.quantity, frfs.freq)[:, None]
    return factor / (s - poles) ** 2, factor / (s - poles.conj()) ** 2


def rank_one(residues: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Mode shape and participation of one mode: the outer product that is closest to its residues.

    Parameters
    ----------
    residues : ndarray (n_responses, n_references), complex
        NaN where not measured; at least one entry in every row and column.

    Returns
    -------
    shape : ndarray (n_responses,), complex
    participation : ndarray (n_references,), complex
    share : float
        Of the squared moduli of the residues that the product describes: 1 for a single mode under any number of
        references, less where poles of several modes were taken for one.
    """
    known = np.isfinite(residues)
    given = np.where(known, residues, 0.0)
    start = given[np.argmax(np.sum(np.abs(given) ** 2, axis=1))]
    participation = np.where(start == 0, 1e-3 * np.max(np.abs(start)), start)
    for _ in range(ROUNDS):
        shape = (given @ participation.conj()) / np.maximum(known @ np.abs(participation) ** 2, 1e-300)
        participation = (shape.conj() @ given) / np.maximum(np.abs(shape) ** 2 @ known, 1e-300)
    rest = np.where(known, given - np.outer(shape, participation), 0.0)
    return shape, participation, 1.0 - float(np.sum(np.abs(rest) ** 2) / np.sum(np.abs(given) ** 2))
