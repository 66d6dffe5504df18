"""Answer: what an analysis found, in three sentences that the console, the report and notebooks share."""

from __future__ import annotations

from dataclasses import asdict, dataclass


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
    """

    found: str
    sure: str
    then: str

    @property
    def plain(self) -> dict[str, str]:
        """As stored in ``record.json``."""
        return asdict(self)
