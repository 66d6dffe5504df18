"""The unnamed local change that fits best: how large it is, and in words."""

from __future__ import annotations

from dataclasses import dataclass

from calib.effect import Effect
from calib.missing.findings import Trial

WIDE = 1.96
"""Half a 95 % interval, in standard deviations."""


def unit_words(unit: str) -> str:
    """A unit behind a number; nothing for a number alone."""
    return "" if unit == "-" else f" {unit}"


@dataclass(frozen=True)
class LocalChange:
    """A local change with its 95 % interval, linearised and cut off at the limits; all in the unit of its strength.

    Attributes
    ----------
    effect : Effect
    value, low, high : float
    """

    effect: Effect
    value: float
    low: float
    high: float

    @property
    def told(self) -> str:
        """Such as ``damping of the rear right damper, about 60 % lost [45, 72]``."""
        if not self.effect.part:
            unit = unit_words(self.effect.strength.unit)
            return f"{self.effect.title}, about {self.value:.2g}{unit} [{self.low:.2g}, {self.high:.2g}]"
        sign, word = (-1, "lost") if self.value < 0 else (1, "more")
        low, high = sorted((100 * sign * self.low, 100 * sign * self.high))
        return f"{self.effect.part}, about {100 * abs(self.value):.0f} % {word} [{low:.0f}, {high:.0f}]"


def local_change(trial: Trial) -> LocalChange:
    """What a fit with one local change says of it."""
    (effect,) = trial.effects
    p, (value, std) = effect.strength, trial.strength(effect.name)
    return LocalChange(effect, value, max(value - WIDE * std, p.lower), min(value + WIDE * std, p.upper))
