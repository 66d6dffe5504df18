"""What a command tells of the cache of reduced bases."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from calib.command.terminal import say
from calib.structure.reduction.cache import basis_cache


@contextmanager
def tell_cache(notes: Sequence[str], verbose: bool) -> Iterator[None]:
    """Tell at the end what was noted on the cache; with ``verbose`` also its place and size, where it is not empty."""
    try:
        yield
    finally:
        for note in notes:
            say(f"\n{note}")
        cache = basis_cache()
        if verbose and cache is not None and (files := cache.files):
            say(f"\nReduced bases in the cache: {len(files)}, {cache.size / 1e6:.1f} MB: {cache.folder}")
