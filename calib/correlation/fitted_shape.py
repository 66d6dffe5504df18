"""A model shape fitted to a measured one by a factor, with the derivative of what is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class FittedShape:
    """One model shape fitted to a measured one; only the entries that were measured.

    Attributes
    ----------
    residual : ndarray (n_known,)
        Measured less fitted shape, whitened; complex.
    shape : ndarray (n_known,)
        Of the model, whitened, before the factor.
    factor : complex
        Scale and phase of least squares.
    power : float
        Sum of squares of ``shape`` at the entries used to fit the factor.
    std : ndarray (n_known,)
    known : ndarray (n_sensors,), bool
        Measured entries.
    on : ndarray (n_known,), bool
        Entries used to fit factor and phase.
    turn : complex or None
        Phase factor of the model shape in a real comparison.
    raw : ndarray (n_known,)
        Model shape as solved.
    """

    residual: np.ndarray
    shape: np.ndarray
    factor: complex
    power: float
    std: np.ndarray
    known: np.ndarray
    on: np.ndarray
    turn: complex | None
    raw: np.ndarray

    @classmethod
    def of(
        cls, target: np.ndarray, raw: np.ndarray, std: np.ndarray, known: np.ndarray, on: np.ndarray, as_real: bool
    ) -> FittedShape:
        """Fit a model shape ``raw`` to a measured one, ``target`` (n_known,), with standard deviations ``std``.

        With ``as_real`` both are turned to their main phase and compared by their real parts.
        """
        turn, shape = None, raw
        size = float(np.max(np.abs(raw[on]), initial=0.0))
        if as_real:
            target = np.real(target * np.exp(-0.5j * np.angle(np.sum(target**2)))).astype(complex)
            turn = np.exp(-0.5j * np.angle(np.sum((raw[on] / (size or 1.0)) ** 2)))
            shape = np.real(raw * turn).astype(complex)
        u, v = target / std, shape / std
        power = float(np.vdot(v[on], v[on]).real)
        factor = complex(np.vdot(v[on], u[on]) / power) if size > 0 and power > 0 else 0j
        return cls(u - factor * v, v, factor, power, std, known, on, turn, raw)

    def slope(self, shapes: np.ndarray) -> np.ndarray:
        """Projected derivative of the residual, (n_known, n_params), from that of the shapes at all sensors."""
        if not self.power > 0:
            return np.zeros((len(self.residual), shapes.shape[1]))
        change, on = shapes[self.known], self.on
        if self.turn is not None:
            phase = np.imag(self.raw[on] @ change[on] / (self.raw[on] @ self.raw[on]))
            change = np.real(self.turn * (change - 1j * np.outer(self.raw, phase))).astype(complex)
        change = change / self.std[:, None]
        along = np.outer(self.shape, self.shape[on].conj() @ change[on]) / self.power
        return -self.factor * (change - along)
