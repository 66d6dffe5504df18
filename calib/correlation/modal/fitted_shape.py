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
    modulus : float
        Of a real comparison: 0 for the part in phase, 1 for the modulus with the sign of that part, or between.
    target_turn : complex
        Phase factor of the measured shape in a real comparison, else 1.
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
    modulus: float = 0.0
    target_turn: complex = 1.0

    @classmethod
    def of(
        cls,
        target: np.ndarray,
        raw: np.ndarray,
        std: np.ndarray,
        known: np.ndarray,
        on: np.ndarray,
        as_real: bool,
        modulus: float = 0.0,
    ) -> FittedShape:
        """Fit a model shape ``raw`` to a measured one, ``target`` (n_known,), with standard deviations ``std``.

        With ``as_real`` both are turned to their main phase and compared by their real parts, or, as far as ``modulus``
        says, by the modulus of the model shape with the sign of its real part.
        """
        turn, shape, target_turn = None, raw, 1.0 + 0j
        size = float(np.max(np.abs(raw[on]), initial=0.0))
        if as_real:
            target_turn = complex(np.exp(-0.5j * np.angle(np.sum(target**2))))
            target = np.real(target * target_turn).astype(complex)
            turn = np.exp(-0.5j * np.angle(np.sum((raw[on] / (size or 1.0)) ** 2)))
            real = np.real(raw * turn)
            shape = (real + modulus * (np.copysign(np.abs(raw), real) - real)).astype(complex)
        u, v = target / std, shape / std
        power = float(np.vdot(v[on], v[on]).real)
        factor = complex(np.vdot(v[on], u[on]) / power) if size > 0 and power > 0 else 0j
        return cls(u - factor * v, v, factor, power, std, known, on, turn, raw, modulus, target_turn)

    def slope(self, shapes: np.ndarray) -> np.ndarray:
        """Projected derivative of the residual, (n_known, n_params), from that of the shapes at all sensors."""
        if not self.power > 0:
            return np.zeros((len(self.residual), shapes.shape[1]))
        change, on = shapes[self.known], self.on
        if self.turn is not None:
            phase = np.imag(self.raw[on] @ change[on] / (self.raw[on] @ self.raw[on]))
            size, own = np.abs(self.raw)[:, None], self.raw.conj()[:, None]
            longer = np.divide(np.real(own * change), size, out=np.zeros(change.shape), where=size > 0)
            change = np.real(self.turn * (change - 1j * np.outer(self.raw, phase)))
            change = change + self.modulus * (self._sign[:, None] * longer - change)
        return self._left(change)

    @property
    def modulus_slope(self) -> np.ndarray:
        """Projected derivative of the residual by ``modulus``, (n_known,); 0 in a complex comparison."""
        if self.turn is None or not self.power > 0:
            return np.zeros(len(self.residual), dtype=complex)
        return self._left((self._sign * np.abs(self.raw) - np.real(self.turn * self.raw))[:, None])[:, 0]

    def target_slope(self, taken: np.ndarray) -> np.ndarray:
        """Derivative of the residual by the share of a shape that is taken off the measured one, (n_known,).

        ``taken`` (n_sensors,) is real up to the phase of the measured one in a real comparison.
        """
        off = taken[self.known].astype(complex)
        if self.turn is not None:
            off = (off * self.target_turn).real.astype(complex)
        if not self.power > 0:
            return -off / self.std
        u, on = off / self.std, self.on
        return self.shape * (np.vdot(self.shape[on], u[on]) / self.power) - u

    @property
    def _sign(self) -> np.ndarray:
        """Sign of the part in phase of a real comparison, (n_known,)."""
        return np.copysign(1.0, np.real((self.turn or 1.0) * self.raw))

    def _left(self, change: np.ndarray) -> np.ndarray:
        """Change of the residual by one of the shape (n_known, n_params), less what the factor follows."""
        on, change = self.on, change / self.std[:, None]
        along = np.outer(self.shape, self.shape[on].conj() @ change[on]) / self.power
        return -self.factor * (change - along)
