"""Answer: what an analysis found, in three sentences that the console, the report and notebooks share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

LABEL = 10
"""Columns of the labels in front of an answer."""


@dataclass(frozen=True)
class Answer:
    """The result of an analysis as an engineer would tell it.

    Attributes
    ----------
    found : str
        What was found.
    sure : str
        How sure that is: probabilities, intervals, p-values.
    then : str
        What to do next.
    command : str
        Command of calib that this is, such as ``explain``; empty where it is none.
    """

    found: str
    sure: str
    then: str
    command: str = ""

    @property
    def labelled(self) -> dict[str, str]:
        """Its sentences by their labels, as the console and notebooks show them."""
        return {"Found": self.found, "How sure": self.sure, "Next": self.then}

    @property
    def plain(self) -> dict[str, str]:
        """As stored in ``record.json``."""
        return asdict(self)


def hertz(*freqs: float) -> str:
    """Frequencies in a sentence, to three digits and without an exponent, such as ``1230 Hz`` or ``3 and 1230 Hz``."""
    return f"{names_in_words([format(float(format(freq, '.3g')), '.12g') for freq in freqs])} Hz"


def signed(value: float, digits: int) -> str:
    """A number with its sign and so many digits after the point; without a sign where it rounds to zero."""
    words = f"{value:+.{digits}f}"
    return words[1:] if float(words) == 0 else words


def with_std(value: float, std: float, unit: str = "") -> str:
    """A value with its standard deviation, to the same decimal and without an exponent, such as ``90.7 ± 1.5 kg``."""
    if not (math.isfinite(std) and std > 0):
        return f"{value:.5g} ± {std:.2g}{unit}"
    spread = float(f"{std:.1e}")
    digits = 1 - math.floor(math.log10(spread))
    size = math.floor(math.log10(max(abs(value), spread)))
    if not (-4 <= size < 9 and digits <= 8):
        return f"{value:.5g} ± {std:.2g}{unit}"
    words = [f"{round(number, digits) + 0.0:.{max(0, digits)}f}" for number in (value, spread)]
    return f"{words[0]} ± {words[1]}{unit}"


def in_prose(name: str) -> str:
    """The identifier of an effect as a sentence has it, such as ``brake unit`` for ``brake_unit``."""
    return name.replace("_", " ")


def names_in_words(names: Sequence[str]) -> str:
    """Names in a sentence."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
