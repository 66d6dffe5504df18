"""Candidate: what may explain a misfit, an effect that a model lacks or a fault of the measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from calib.problem.space import Parameter


class Candidate(Protocol):
    """What ranking, fits and words need of a candidate; see `Effect` and `Fault`.

    Its column, the change of the data per unit of its magnitude, comes from the fit problem that has its parameters.
    """

    @property
    def name(self) -> str:
        """Identifier, also of its magnitude."""
        ...

    @property
    def title(self) -> str:
        """Common engineering name."""
        ...

    @property
    def lacks(self) -> str:
        """What is assumed without it, one sentence."""
        ...

    @property
    def look_for(self) -> str:
        """What to look for, one sentence."""
        ...

    @property
    def magnitude(self) -> Parameter:
        """Its ``prior_sd`` is a large but plausible magnitude, on which the evidence depends."""
        ...

    @property
    def nuisance(self) -> tuple[Parameter, ...]:
        """Further parameters at nonzero magnitude."""
        ...

    @property
    def grid(self) -> tuple[Mapping[str, float], ...]:
        """Points at which its column is taken by difference; empty for a derivative."""
        ...

    @property
    def part(self) -> str:
        """Part of the model that is scaled by 1 + magnitude; empty for all others."""
        ...

    @property
    def of_measurement(self) -> bool:
        """Whether it is an error of the measurement."""
        ...

    @property
    def of_pair(self) -> bool:
        """Whether it is an error of a pair of channels or modes, one of so many that they are a family of their own."""
        ...

    @property
    def generic(self) -> bool:
        """Whether it was composed of the model's own parts and points, listed by nobody."""
        ...

    @property
    def whole(self) -> bool:
        """Whether it is there wholly, at magnitude 1, or not at all."""
        ...

    @property
    def told(self) -> Callable[[float], str] | None:
        """What such an error means, in words, of the number that is stated of it; see `as_told`."""
        ...

    def as_told(self, magnitude: float) -> float:
        """The number that is stated of a magnitude, in its unit."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Magnitude first, then nuisance parameters."""
        ...

    @property
    def in_words(self) -> str:
        """The candidate as part of a sentence."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        ...

    @property
    def signed(self) -> bool:
        """Whether the magnitude may be negative."""
        ...

    @property
    def plausible(self) -> float:
        """A large but plausible magnitude, in its own unit."""
        ...


class WithMagnitude:
    """What a candidate's magnitude, a `calib.problem.space.Parameter`, tells of it."""

    magnitude: Parameter
    of_pair: bool = False
    generic: bool = False
    whole: bool = False

    @property
    def signed(self) -> bool:
        """Whether the magnitude may be negative."""
        return self.magnitude.lower < 0

    @property
    def plausible(self) -> float:
        """A large but plausible magnitude, in its own unit."""
        return self.magnitude.prior_width

    def as_told(self, magnitude: float) -> float:
        """The number that is stated of a magnitude, in its unit: itself."""
        return magnitude


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
        What the number that is stated of a magnitude (`as_told`) means, such as ``sensor 12y reads 10 % low``.
    kind : str
        Such as ``gain``, ``delay``, ``rotation``, ``place``, ``cross-talk``, ``exchange``, ``axes``, ``mixed``,
        ``set-up``, ``damping``, ``modulus``.
    sensor : str
        Sensor that reads wrongly, or both with a space between; empty for a fault of all.
    place : (3,) float
        Of that sensor, m; NaN where it is unknown.
    of_pair : bool
        Whether it is one of the faults of pairs of channels or modes, which are a family of their own.
    whole : bool
        Whether it is there wholly, at magnitude 1, or not at all.
    """

    magnitude: Parameter
    title: str
    lacks: str
    look_for: str
    told: Callable[[float], str]
    kind: str
    sensor: str = ""
    place: tuple[float, float, float] = NOWHERE
    of_pair: bool = False
    whole: bool = False

    @property
    def subjects(self) -> tuple[str, ...]:
        """Names of what it makes wrong: of sensors, or of a mode; empty for a fault of all."""
        return tuple(self.sensor.split())

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
