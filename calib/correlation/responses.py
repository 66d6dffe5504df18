"""Rows of a residual of plain responses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from calib.freedom import repeats_freedom


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


def response_freedom(names: Iterable[str], repeats: float | None, shares: Mapping[str, float]) -> dict[str, float]:
    """Degrees of freedom behind the standard deviations of each kind of some plain responses.

    Parameters
    ----------
    names : iterable of str
    repeats : float or None
        Behind the standard deviations; None takes them for known.
    shares : mapping from response name to float
        Part of each variance that the repeats tell; 1 for one left out.
    """
    rows = response_rows(names)
    return repeats_freedom((row.kind for row in rows), repeats, [shares.get(row.sensor, 1.0) for row in rows])
