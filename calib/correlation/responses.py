"""Rows of a residual of plain responses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple


class ResponseRow(NamedTuple):
    """What one entry of the residual compares.

    Attributes
    ----------
    mode : str
        Empty.
    kind : str
        Beginning of the name up to the first underscore where several responses share it, else ``response``.
    sensor : str
        Name of the response.
    """

    mode: str
    kind: str
    sensor: str


def response_rows(names: Iterable[str]) -> tuple[ResponseRow, ...]:
    """Rows of the residual of some plain responses, in their order."""
    names = tuple(names)
    heads = {name: name.split("_", 1)[0] for name in names if "_" in name}
    shared = Counter(heads.values())
    kinds = {name: head for name, head in heads.items() if head and shared[head] > 1}
    return tuple(ResponseRow("", kinds.get(name, "response"), name) for name in names)
