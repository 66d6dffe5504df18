"""One thread for the numerical libraries while small matrices are computed with."""

from __future__ import annotations

import sys
from functools import lru_cache

from threadpoolctl import ThreadpoolController, threadpool_limits


def one_thread() -> threadpool_limits:
    """Context in which numerical libraries use one thread: sums depend on their number, and small products wait."""
    return _libraries(len(sys.modules)).limit(limits=1)


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """What is loaded along with so many modules: the search takes longer than a small model's evaluation."""
    return ThreadpoolController()
