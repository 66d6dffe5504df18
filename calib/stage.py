"""Stage: how far a long computation is, told to whoever shows it."""

from __future__ import annotations

import math
from typing import Protocol


class Progress(Protocol):
    """Receives the present stage of a computation.

    Called often; it must return quickly and change nothing.
    """

    def __call__(self, stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        """Tell the stage.

        Parameters
        ----------
        stage : str
            In words, such as ``sampling``.
        done, total : float
            Completed part and whole in the same unit; a total of 0 where it is unknown.
        best : float
            Lowest misfit so far; NaN where there is none.
        """
        ...


def unheard(stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
    """Nobody listens."""
