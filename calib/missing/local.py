"""Fitted local perturbation: its magnitude, 95 % interval and description in words."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from calib.inference.rules import WIDE
from calib.missing.candidate_fit import CandidateFit
from calib.problem.candidate import Candidate
from calib.problem.parameter import Parameter, unit_words


def magnitude_words(p: Parameter, value: float, low: float, high: float) -> str:
    """The value of a parameter with its 95 % interval, and what it is."""
    return interval_words(value, low, high, p.unit, meaning_of(p))


def meaning_of(p: Parameter) -> str:
    """What a parameter is, where it has no unit to tell that."""
    return p.description if p.unit == "-" else ""


def interval_words(value: float, low: float, high: float, unit: str, meaning: str = "") -> str:
    """A magnitude with its 95 % interval, such as ``about 64 kg (95 %: 54 to 74)``, and what it is if that is given.

    The last digit is a tenth of the leading one of the interval's width, or less.
    """
    width = high - low
    if not (math.isfinite(width) and width > 0):
        return f"about {value:.3g}{unit_words(unit)}{f' ({meaning})' if meaning else ''}"
    places = 1 - math.floor(math.log10(width))
    number, first, last = (f"{round(x, places):.{max(places, 0)}f}" for x in (value, low, high))
    return f"about {number}{unit_words(unit)} (95 %: {first} to {last}{f'; {meaning}' if meaning else ''})"


def range_words(low: float, high: float, unit: str, meaning: str = "") -> str:
    """A range of a magnitude, such as ``54 to 74 kg``, rounded as `interval_words` does, and what it is if given."""
    width = high - low
    places = 1 - math.floor(math.log10(width)) if math.isfinite(width) and width > 0 else 3
    first, last = (f"{round(x, places):.{max(places, 0)}f}" for x in (low, high))
    return f"{first} to {last}{unit_words(unit)}{f' ({meaning})' if meaning else ''}"


@dataclass(frozen=True)
class LocalPerturbation:
    """A local perturbation with its linearised 95 % interval, truncated at the limits; in the unit of its magnitude.

    Attributes
    ----------
    effect : Candidate
    value, low, high : float
    """

    effect: Candidate
    value: float
    low: float
    high: float

    @property
    def in_words(self) -> str:
        """In words, such as ``damping of the rear right damper, about 60 % lost (95 %: 45 to 72)``."""
        if not self.effect.part:
            unit = self.effect.magnitude.unit
            return f"{self.effect.title}, {interval_words(self.value, self.low, self.high, unit)}"
        sign, word = (-1, "lost") if self.value < 0 else (1, "more")
        low, high = sorted((100 * sign * self.low, 100 * sign * self.high))
        return f"{self.effect.part}, about {100 * abs(self.value):.0f} % {word} (95 %: {low:.0f} to {high:.0f})"


def local_perturbation(candidate_fit: CandidateFit, of: Candidate | None = None) -> LocalPerturbation:
    """Magnitude and interval of a fitted local perturbation: the only one of a fit, or the one that is given."""
    effect = of or candidate_fit.effects[0]
    p, (value, std) = effect.magnitude, candidate_fit.magnitude(effect.name)
    return LocalPerturbation(effect, value, max(value - WIDE * std, p.lower), min(value + WIDE * std, p.upper))


def fault_words(candidate_fit: CandidateFit, of: Candidate | None = None) -> str:
    """A fitted fault of the measurement in words, such as ``sensor 12y reads 10 % low (95 %: 8 to 12 %)``.

    The interval has the sign of the number that the words state: of what is low, late or turned away a size.
    """
    found = local_perturbation(candidate_fit, of)
    if found.effect.told is None:
        return found.in_words
    unit = found.effect.magnitude.unit
    factor, display_unit = (100.0, "%") if unit == "-" else (1.0, unit)
    value, first, last = (found.effect.as_told(number) for number in (found.value, found.low, found.high))
    low, high = sorted((first, last))
    told = found.effect.told(value)
    if not low <= value <= high:  # beyond an infinite number
        return told
    if value < 0 and _NUMBER.findall(told) == _NUMBER.findall(found.effect.told(-value)):  # a size with its sense
        low, high = -high, -low
    width = factor * (high - low)
    places = max(1 - math.floor(math.log10(width)), 0) if math.isfinite(width) and width > 0 else 2
    ends = " to ".join(f"{factor * end:.{places}f}" for end in (low, high))
    return f"{told} (95 %: {ends} {display_unit})"


_NUMBER = re.compile(r"(?<!\w)-?\d\S*")
"""Of words; what lies the other way has the same ones where they state a size with its sense, such as ``10 % low``."""
