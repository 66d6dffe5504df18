"""Stage: how far a long computation is, told to whoever shows it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
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
            In words, such as ``sampling``; empty where the stage told before goes on.
        done, total : float
            Completed part and whole in the same unit, such as points; with a whole of 1 the part is a share. A total of
            0 where it is unknown.
        best : float
            Lowest misfit so far; NaN where there is none.
        """
        ...


def with_prefix(progress: Progress, name: str) -> Progress:
    """Tells the stages of a part with its name in front."""

    def tell(stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        progress(f"{name}, {stage}" if stage else stage, done, total, best)

    return tell


def silent(stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
    """Nobody listens."""


Tell = Callable[[str], None]
"""Receives a sentence that the user should read at once."""


def warned(sentence: str) -> None:
    """A sentence as a warning."""
    warnings.warn(sentence, stacklevel=2)
