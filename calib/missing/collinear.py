"""Groups of collinear effects, which these data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.missing.evidence import expected_ln_bayes
from calib.missing.rules import RULES
from calib.missing.score import Scores, correlation
from calib.problem.candidate import Candidate


@dataclass(frozen=True)
class Group:
    """Effects that these data do not tell apart, once the parameters have absorbed what they can.

    Attributes
    ----------
    effect : Candidate
        The leader: the effect with the largest score of a sign that its magnitude may have.
    others : tuple of Candidate
        Effects collinear with it.
    """

    effect: Candidate
    others: tuple[Candidate, ...] = ()

    @property
    def effects(self) -> tuple[Candidate, ...]:
        """All effects, the leader first."""
        return (self.effect, *self.others)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all effects, the leader first."""
        return tuple(e.name for e in self.effects)


def grouped(effects: Sequence[Candidate], found: Scores, threshold: float) -> tuple[Group, ...]:
    """Group effects whose signatures are collinear beyond a threshold and that these data do not tell apart.

    With the larger score ``z`` of two effects and the correlation ``rho`` of their signatures, the expected log Bayes
    factor between them is ``z^2 (1 - rho^2)/2``; below `DecisionRules.credible` (20:1) they are grouped. However
    collinear two effects are, a strong enough signal tells them apart. A negative correlation groups only effects whose
    magnitude may have either sign: otherwise the sign tells them apart. Effects with nuisance parameters are never
    grouped, since their signature is not a single direction. Nor is an effect whose score has an impossible sign
    grouped with one that the data support.

    The effect with the largest score of a possible sign leads its group; ties go to the first by name, so that the
    order of the library does not change the groups. Groups are returned in the order of the library.
    """
    usable = [e for e in effects if not e.nuisance]
    columns = [found.best(e.name) for e in usable]
    rho, size = correlation(found, columns), np.abs(found.z[columns])
    magnitude = np.maximum(found.magnitude[columns], 0.0)
    taken: dict[str, str] = {}
    leaders: list[int] = []
    for k in sorted(range(len(usable)), key=lambda k: (-magnitude[k], -size[k], usable[k].name)):
        for a in leaders:
            r = float(rho[a, k])
            same = r > threshold or (r < -threshold and usable[a].signed and usable[k].signed)
            # The size of a score of the impossible sign says nothing about the effect.
            wrong = magnitude[k] < size[k] and (magnitude[a] ** 2 - magnitude[k] ** 2) / 2 >= RULES.credible
            if same and not wrong and expected_ln_bayes(float(size[a]), r) < RULES.credible:
                taken[usable[k].name] = usable[a].name
                break
        else:
            leaders.append(k)
    return tuple(
        Group(e, tuple(o for o in effects if taken.get(o.name) == e.name)) for e in effects if e.name not in taken
    )
