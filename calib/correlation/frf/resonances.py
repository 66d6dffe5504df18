"""What a model may be off by at its resonances: an error that all lines and all functions there share.

A mesh and idealised fittings shift a resonance and change its damping. Beside a light resonance a claimed share of the
modulus says little of that: counted at each line by itself it averages out over all of them, and a shift does not.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.frf.factor import FactorError
from calib.correlation.frf.rows import in_test, require_positive_std
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.problem.space import Parameter

ResonanceKind = Literal["frequency", "damping"]


@dataclass(frozen=True)
class ResonanceError(FactorError):
    """Relative error of the natural frequency or of the damping ratio of one resonance of the model.

    A mode with natural frequency f_r and damping ratio z has functions proportional to ``1/D`` with
    ``D = f_r^2 - f^2 + 2i z f_r f``. To first order a relative error e of f_r changes them by the factor
    ``1 - 2 f_r^2 e/D``, one of z by ``1 - 2i z f_r f e/D`` (Ewins 2000, single mode). Far from the resonance the factor
    is 1.

    Attributes
    ----------
    kind : {"frequency", "damping"}
    freq, width : float
        Of the measured resonance: Hz, and its half-power width, Hz.
    share : float
        Standard deviation of the change that it makes to the functions at the peak, % of the modulus. That of the
        frequency is z times as large, that of the damping ratio the same.
    test : str
        Name of its test, where there are several.

    Raises
    ------
    InputError
        For an unknown kind, or a number that is not positive.
    """

    kind: ResonanceKind
    freq: float
    width: float
    share: float
    test: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if self.kind not in ("frequency", "damping"):
            raise InputError(f"its kind is {self.kind!r}", place=self.place, remedy="give frequency or damping")
        if not (0 < self.freq < np.inf and 0 < self.width < np.inf):
            raise InputError(
                f"it is at {self.freq:g} Hz and {self.width:g} Hz wide", place=self.place,
                remedy="give positive numbers in Hz",
            )  # fmt: skip
        require_positive_std(self.share, self.place)
        if self.share > RULES.resonance_most:
            raise InputError(
                f"the model may be off by {self.share:g} % at it, where its factor is no longer linear",
                place=self.place, remedy=f"give {RULES.resonance_most:g} % or less, and fit the rest as a parameter",
            )  # fmt: skip

    @property
    def name(self) -> str:
        """Of its resonance."""
        return f"{self.freq:.6g} Hz"

    @property
    def place(self) -> str:
        """As messages name it."""
        return f"error of resonance {self.freq:.6g} Hz"

    @property
    def key(self) -> tuple[str, str, str]:
        """What it is, for a fingerprint."""
        return self.kind, f"{self.freq!r} {self.width!r}", "resonance"

    @property
    def ratio(self) -> float:
        """Damping ratio of the measured resonance."""
        return self.width / (2 * self.freq)

    def among(self, measured: MeasuredFRFs) -> tuple[str, ...]:
        """Its own name where a line is within its half-power band; else nothing."""
        near = np.abs(measured.freq - self.freq) <= self.width / 2
        return (self.name,) if near.any() else ()

    def functions_of(self, measured: MeasuredFRFs) -> tuple[slice | int, ...]:
        """All, as an index."""
        return (slice(None),)

    @property
    def side_words(self) -> str:
        """What a message names before it."""
        return "resonance at "

    @property
    def sd(self) -> float:
        """Standard deviation of the relative error, %."""
        return self.share * (self.ratio if self.kind == "frequency" else 1.0)

    @property
    def parameter(self) -> Parameter:
        """Such as ``frequency_at_2.709_Hz``, in %."""
        most = RULES.limit * self.sd
        return Parameter(
            f"{self.kind}_at_{self.freq:.6g}_Hz{in_test(self.test)}", 0.0, -most, most, "%", prior_sd=self.sd,
            description=f"error of the model's {self.kind} at {self.freq:.4g} Hz{in_test(self.test)}",
        )  # fmt: skip

    def factor(self, value: float, freq: np.ndarray) -> np.ndarray:
        """Factor of the functions at a value in SI, (n_freq,), complex."""
        return 1 + value * self._pattern(freq)

    def log_slope(self, value: float, freq: np.ndarray) -> np.ndarray:
        """Derivative of the logarithm of the factor at a value in SI, (n_freq,), complex."""
        return np.asarray(self._pattern(freq) / self.factor(value, freq))

    def _pattern(self, freq: np.ndarray) -> np.ndarray:
        loss = 2j * self.ratio * self.freq * freq
        change = 2 * self.freq**2 if self.kind == "frequency" else loss
        return np.asarray(-change / (self.freq**2 - freq**2 + loss))


def of_every_resonance(measured: MeasuredFRFs, share: float) -> tuple[ResonanceError, ...]:
    """Errors of the frequency and of the damping of every measured resonance; none where there is no resonance.

    Parameters
    ----------
    measured : MeasuredFRFs
    share : float
        Standard deviation of the change of the functions at the peak, % of the modulus.
    """
    return tuple(ResonanceError(k, r.freq, r.width, share) for r in measured.resonances() for k in _KINDS)


_KINDS: tuple[ResonanceKind, ...] = ("frequency", "damping")


def claimed_at_resonances(measured: MeasuredFRFs, fitted: Collection[str] = ()) -> np.ndarray:
    """Changes of measured functions by what their claimed accuracy leaves open at every resonance.

    A share of the modulus that is claimed because the model is not exact is no independent error of every line: at a
    resonance it is a shift or another damping, which all lines and all functions there share. Each is one standard
    deviation of `ResonanceError` for the claimed share, to first order.

    Parameters
    ----------
    measured : MeasuredFRFs
    fitted : collection of str
        Names of resonances whose errors are fitted; they are left out.

    Returns
    -------
    ndarray (n_errors, n_freq, n_responses, n_references), complex
        In the unit of the quantity; none without a claimed share.
    """
    claimed = measured.accuracy.share
    errors = of_every_resonance(measured, 1.0) if claimed > 0 else ()
    changes = [
        claimed * error.sd * error.log_slope(0.0, measured.freq)[:, None, None] * measured.values
        for error in errors
        if error.name not in fitted
    ]
    return np.array(changes, dtype=complex).reshape(len(changes), *measured.values.shape)
