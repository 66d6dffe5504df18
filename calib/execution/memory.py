"""Memory that was freed, given back to the machine."""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable
from functools import lru_cache

from calib.execution.stage import Progress

_PAUSE = 1.0
"""Seconds after which memory is given back again: what is needed anew costs time."""


class FreedMemory:
    """Gives freed memory back to the machine, at most once in a while.

    The C library of Linux keeps freed arrays of up to 32 MB on its heap, between others that are in use: at the end of
    a decision on pairs of effects of the vehicle 0.9 of 2.3 GB. Elsewhere nothing is done.
    """

    def __init__(self) -> None:
        self._last = -math.inf

    def give_back(self) -> bool:
        """Give it back; whether that was done."""
        trim, now = _trim(), time.monotonic()
        if trim is None or now - self._last < _PAUSE:
            return False
        trim(0)
        self._last = now
        return True


def giving_back(progress: Progress) -> Progress:
    """Tells the stages, and gives back what was freed in each."""
    memory = FreedMemory()

    def tell(stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        if stage:
            memory.give_back()
        progress(stage, done, total, best)

    return tell


@lru_cache(maxsize=1)
def _trim() -> Callable[[int], int] | None:
    """``malloc_trim`` of the GNU C library; None where there is none."""
    try:
        found: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
    return found
