"""Limits numerical libraries to one thread, which suits small matrices."""

from __future__ import annotations

import sys
from functools import lru_cache

from threadpoolctl import ThreadpoolController, threadpool_limits


def one_thread() -> threadpool_limits:
    """Context in which numerical libraries use one thread: rounding depends on their number, and more are slower."""
    return _libraries(len(sys.modules)).limit(limits=1)


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """Loaded libraries, cached by the number of modules: finding them takes longer than evaluating a small model."""
    return ThreadpoolController()
