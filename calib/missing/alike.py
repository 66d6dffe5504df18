"""Candidates that no such data can tell apart are tested as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calib.effect import Effect
from calib.missing.score import Scores, correlation


@dataclass(frozen=True)
class Group:
    """Effects with the same fingerprint, once the parameters have absorbed what they can.

    Attributes
    ----------
    effect : Effect
        The one that is tested and named.
    others : tuple of Effect
        Those that it stands for.
    """

    effect: Effect
    others: tuple[Effect, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return (self.effect.name, *(e.name for e in self.others))


def grouped(effects: Sequence[Effect], found: Scores, threshold: float) -> tuple[Group, ...]:
    """Join effects whose fingerprints correlate beyond a threshold; the first of them in the library stands for all.

    A negative correlation joins only effects whose strength may have either sign: otherwise the sign tells them apart.
    Effects that depend on nuisance parameters are never joined, since their fingerprint is no single direction.
    """
    usable = [e for e in effects if not e.nuisance]
    columns = [found.best(e.name) for e in usable]
    alike = correlation(found, columns)
    taken: dict[str, str] = {}
    for a, first in enumerate(usable):
        if first.name in taken:
            continue
        for b in range(a + 1, len(usable)):
            other = usable[b]
            rho = float(alike[a, b])
            same = rho > threshold or (rho < -threshold and first.signed and other.signed)
            if same and other.name not in taken:
                taken[other.name] = first.name
    return tuple(
        Group(e, tuple(o for o in effects if taken.get(o.name) == e.name)) for e in effects if e.name not in taken
    )
