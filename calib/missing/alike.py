"""Candidates that these data cannot tell apart count as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.effect import Effect
from calib.missing.evidence import expected_ln_bayes
from calib.missing.rules import RULES
from calib.missing.score import Scores, correlation


@dataclass(frozen=True)
class Group:
    """Effects that the signal at hand does not tell apart, once the parameters have absorbed what they can.

    Attributes
    ----------
    effect : Effect
        The one of the largest score of a sign that its strength may have.
    others : tuple of Effect
        Those that look the same.
    """

    effect: Effect
    others: tuple[Effect, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All of them, the one of the largest score first."""
        return (self.effect, *self.others)

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return tuple(e.name for e in self.effects)


def grouped(effects: Sequence[Effect], found: Scores, threshold: float) -> tuple[Group, ...]:
    """Join effects whose fingerprints correlate beyond a threshold and that the signal at hand does not tell apart.

    With the larger score ``z`` of two effects and the correlation ``rho`` of their fingerprints the log Bayes
    factor to expect between them is ``z^2 (1 - rho^2)/2``; below `Rules.credible` (odds of 20:1) they are joined.
    However alike they are, a signal that is strong enough tells them apart. A negative correlation joins only
    effects whose strength may have either sign: otherwise the sign tells them apart. Effects that depend on
    nuisance parameters are never joined, since their fingerprint is no single direction. Nor is one whose score has
    the sign that its strength cannot have joined to one that the signal speaks for.

    The effect of the largest score of a possible sign leads its group, of equal ones the first by name: the order of
    the library joins nothing. Groups are told in that order.
    """
    usable = [e for e in effects if not e.nuisance]
    columns = [found.best(e.name) for e in usable]
    alike, size = correlation(found, columns), np.abs(found.z[columns])
    strength = np.maximum(found.strength[columns], 0.0)
    taken: dict[str, str] = {}
    leaders: list[int] = []
    for k in sorted(range(len(usable)), key=lambda k: (-strength[k], -size[k], usable[k].name)):
        for a in leaders:
            rho = float(alike[a, k])
            same = rho > threshold or (rho < -threshold and usable[a].signed and usable[k].signed)
            # A score against the only sign that an effect may have promises nothing of what its size says.
            wrong = strength[k] < size[k] and (strength[a] ** 2 - strength[k] ** 2) / 2 >= RULES.credible
            if same and not wrong and expected_ln_bayes(float(size[a]), rho) < RULES.credible:
                taken[usable[k].name] = usable[a].name
                break
        else:
            leaders.append(k)
    return tuple(
        Group(e, tuple(o for o in effects if taken.get(o.name) == e.name)) for e in effects if e.name not in taken
    )
