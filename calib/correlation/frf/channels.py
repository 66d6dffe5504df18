"""Factors of measured FRFs by errors of channels and at resonances, and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.correlation.frf.factor import FactorError
from calib.measurement.frf import MeasuredFRFs


@dataclass(frozen=True)
class Channels:
    """Channel errors of measured FRFs, and errors at resonances, which all channels share.

    Attributes
    ----------
    errors : tuple of FactorError
        Of sensors and lines that were measured; see `require_channels`.
    measured : MeasuredFRFs
    """

    errors: tuple[FactorError, ...]
    measured: MeasuredFRFs

    def factors(self, si: Mapping[str, float]) -> np.ndarray:
        """Factors of all functions at values in SI, (n_freq, n_responses, n_references), complex."""
        out = np.ones(self.measured.values.shape, dtype=complex)
        for error in self.errors:
            here = error.functions_of(self.measured)
            out[here] *= _along(error.factor(si[error.parameter.name], self.measured.freq), out[here])
        return out

    def slope(self, name: str, si: Mapping[str, float], functions: np.ndarray) -> np.ndarray:
        """Derivatives of the functions with factors, per unit of one parameter, in their shape."""
        error = next(e for e in self.errors if e.parameter.name == name)
        out, here = np.zeros_like(functions), error.functions_of(self.measured)
        slope = error.log_slope(si[name], self.measured.freq) * error.parameter.si_factor
        out[here] = functions[here] * _along(slope, functions[here])
        return out


def _along(lines: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """Values (n_freq,) in as many dimensions as some functions, whose lines are the first one."""
    return lines.reshape(-1, *(1,) * (functions.ndim - 1))
