"""An error of a test, or of a model at a resonance, that multiplies measured FRFs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from calib.correlation.frf.rows import RowError
from calib.measurement.frf import MeasuredFRFs
from calib.problem.space import Parameter
from calib.structure.effects.loaded import Load
from calib.structure.model import StructuralModel


class FactorError(ABC):
    """What multiplies some functions by a factor of each line; 1 at the value 0."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Of what it concerns: a transducer or a resonance."""

    @property
    @abstractmethod
    def place(self) -> str:
        """As messages name it."""

    @property
    @abstractmethod
    def side_words(self) -> str:
        """What a message names before its name."""

    @property
    @abstractmethod
    def key(self) -> tuple[str, str, str]:
        """What it is, for a fingerprint."""

    @property
    @abstractmethod
    def parameter(self) -> Parameter:
        """Its value."""

    @abstractmethod
    def among(self, measured: MeasuredFRFs) -> tuple[str, ...]:
        """Names of those that were measured."""

    @abstractmethod
    def functions_of(self, measured: MeasuredFRFs) -> tuple[slice | int, ...]:
        """Functions that it multiplies, as an index of (n_freq, n_responses, n_references)."""

    @abstractmethod
    def factor(self, value: float, freq: np.ndarray) -> np.ndarray:
        """Factor of the functions at a value in SI, (n_freq,), complex."""

    @abstractmethod
    def log_slope(self, value: float, freq: np.ndarray) -> np.ndarray:
        """Derivative of the logarithm of the factor at a value in SI, (n_freq,), complex."""

    @property
    def of_channel(self) -> tuple[Self, ...]:
        """Itself: it is a factor of measured functions."""
        return (self,)

    @property
    def of_rows(self) -> tuple[RowError, ...]:
        """None: it changes no motion of a transducer."""
        return ()

    def loads(self, model: StructuralModel) -> tuple[Load, ...]:
        """None: it changes no matrix."""
        return ()

    def concerns(self, measured: MeasuredFRFs) -> bool:
        """Whether it concerns something that was measured."""
        return self.name in self.among(measured)


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
