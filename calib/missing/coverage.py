"""How often 95 % intervals held the true magnitude in computed tests; ``docs/error_rates.md`` has the counts."""

from __future__ import annotations

from dataclasses import dataclass

from calib.missing.explanation import Explanation

_MODAL = {"frequency", "damping", "shape"}


@dataclass(frozen=True)
class Coverage:
    """Counted coverage of 95 % intervals of magnitudes.

    Attributes
    ----------
    held, of : int
        Intervals that held the true magnitude, of so many.
    tests : str
        What was counted, in words.
    """

    held: int
    of: int
    tests: str

    @property
    def percent(self) -> int:
        """Share of intervals that held the truth, in whole percent."""
        return round(100 * self.held / self.of)

    @property
    def sentence(self) -> str:
        """How a stated interval is to be read."""
        return f"95 % intervals held the true magnitude in {self.held} of {self.of} {self.tests} ({self.percent} %)."


MODES = Coverage(81, 95, "computed tests of bogies")
"""Of modal tests, counted on blind cases; the counts stand in the page on error rates."""


def coverage_sentence(found: Explanation) -> str:
    """How the interval of a named magnitude is to be read; empty where nothing was counted for such data."""
    kinds = set(found.base_adequacy.kinds["kind"])
    return MODES.sentence if found.names_something and kinds and kinds <= _MODAL else ""
