"""An error of a test, or of a model at a resonance, that multiplies measured FRFs."""

from __future__ import annotations

from abc import ABC, abstractmethod
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
