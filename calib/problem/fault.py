"""Fault: an error of the measurement itself, as a candidate beside effects that a model may lack."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from calib.problem.candidate import WithMagnitude
from calib.problem.space import Parameter

NOWHERE = (math.nan, math.nan, math.nan)
"""Place of a fault that concerns the whole measurement."""


@dataclass(frozen=True)
class Fault(WithMagnitude):
    """An error of a measurement; a `calib.problem.candidate.Candidate`.

    Attributes
    ----------
    magnitude : Parameter
        Named as the fault; 0 without it. Its ``prior_sd`` is a large but plausible magnitude.
    title : str
        Common engineering name.
    lacks : str
        What is assumed without it, one sentence.
    look_for : str
        What to check, one sentence.
    told : callable
        What a fitted magnitude means, such as ``sensor 12y reads 10 % low``.
    kind : str
        Such as ``gain``, ``delay``, ``rotation``, ``place``, ``cross-talk``, ``set-up``, ``damping``, ``modulus``.
    sensor : str
        Sensor that reads wrongly, empty for a fault of all.
    place : (3,) float
        Of that sensor, m; NaN where it is unknown.
    """

    magnitude: Parameter
    title: str
    lacks: str
    look_for: str
    told: Callable[[float], str]
    kind: str
    sensor: str = ""
    place: tuple[float, float, float] = NOWHERE

    @property
    def name(self) -> str:
        """That of its magnitude."""
        return self.magnitude.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its magnitude."""
        return (self.magnitude,)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of its magnitude."""
        return (self.magnitude.name,)

    @property
    def nuisance(self) -> tuple[Parameter, ...]:
        """None."""
        return ()

    @property
    def grid(self) -> tuple[Mapping[str, float], ...]:
        """None: its column is a derivative."""
        return ()

    @property
    def part(self) -> str:
        """None."""
        return ""

    @property
    def of_measurement(self) -> bool:
        """True."""
        return True

    @property
    def in_words(self) -> str:
        """The fault as part of a sentence."""
        return f"the fault {self.title!r}"
