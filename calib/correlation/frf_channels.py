"""Measured FRFs of channels with errors: factors of the functions, and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.correlation.frf_nuisance import ChannelError, channel_names
from calib.measurement.frf import MeasuredFRFs


@dataclass(frozen=True)
class Channels:
    """Channel errors of measured FRFs.

    Attributes
    ----------
    errors : tuple of ChannelError
        Of sensors that were measured; see `require_channels`.
    measured : MeasuredFRFs
    """

    errors: tuple[ChannelError, ...]
    measured: MeasuredFRFs

    def factors(self, si: Mapping[str, float]) -> np.ndarray:
        """Factors of all functions at values in SI, (n_freq, n_responses, n_references), complex."""
        out = np.ones(self.measured.values.shape, dtype=complex)
        for error in self.errors:
            out[self._at(error)] *= error.factor(si[error.parameter.name], self.measured.freq)[:, None]
        return out

    def slope(self, name: str, si: Mapping[str, float], functions: np.ndarray) -> np.ndarray:
        """Derivatives of the functions with factors, per unit of one parameter, in their shape."""
        error = next(e for e in self.errors if e.parameter.name == name)
        out, here = np.zeros_like(functions), self._at(error)
        slope = error.log_slope(si[name], self.measured.freq) * error.parameter.si_factor
        out[here] = functions[here] * slope[:, None]
        return out

    def _at(self, error: ChannelError) -> tuple[slice | int, ...]:
        """Functions of a channel, as an index that leaves (n_freq, n_others)."""
        index = channel_names(self.measured, error.side).index(error.sensor)
        return (slice(None), index) if error.side == "response" else (slice(None), slice(None), index)
