"""Faults that a measurement may have, as candidates: single ones, and those of pairs, a family of their own."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.missing.screened import Screened, screened_candidates
from calib.problem.candidate import Candidate


@dataclass(frozen=True, eq=False)
class FaultFamily:
    """Faults of one measurement, or of several.

    Attributes
    ----------
    faults : tuple of Candidate
    """

    faults: tuple[Candidate, ...]

    @cached_property
    def single(self) -> tuple[Candidate, ...]:
        """All but those of pairs."""
        return tuple(e for e in self.faults if not e.of_pair)

    @cached_property
    def pairs(self) -> Mapping[str, Candidate]:
        """Those of pairs of channels or modes, by name."""
        return {e.name: e for e in self.faults if e.of_pair}

    @property
    def choice(self) -> float:
        """Logarithm of the number of single ones: what the evidence of any fault must outweigh."""
        return math.log(max(len(self.single), 1))

    def price(self, names: Collection[str]) -> float:
        """What faults of pairs among some candidates cost: the logarithm of how much rarer one is than a single one.

        Together they have `DecisionRules.pairs_share` of the probability of any fault. The price is taken off their log
        evidence, as that of a choice among places. All faults then compare alike, at the price of a single one.
        """
        number = sum(name in self.pairs for name in names)
        rarer = math.log(1.0 / RULES.pairs_share - 1.0) + math.log(max(len(self.pairs), 1)) - self.choice
        return number * max(rarer, 0.0)

    def screened(self, fit: LinearisedFit, without: Collection[str], also: Collection[str] = ()) -> Screened | None:
        """The largest scores of the faults of pairs but some, and those ``also`` named; None where there are none."""
        lacking = [e for name, e in self.pairs.items() if name not in without]
        return screened_candidates(fit, lacking, also) if lacking else None

    def predicted(self, found: Scores) -> np.ndarray:
        """Log evidence that one step predicts for each column, less the price of a fault of a pair, (m,)."""
        price = np.array([self.price((name,)) for name in found.owners])
        return np.asarray(np.maximum(found.magnitude, 0.0) ** 2 / 2 - price)

    def promising(self, found: Scores) -> Sequence[int]:
        """Columns of the faults that are fitted, those predicted to explain most first.

        Of a pair only one whose signature is not that of another that is fitted: a channel reads many others, which
        move alike.
        """
        order: list[int] = []
        for k in np.argsort(-self.predicted(found), kind="stable").tolist():
            like = np.abs(found.unit[:, order].T @ found.unit[:, k]).max(initial=0.0)
            if not (found.owners[k] in self.pairs and like > RULES.same):
                order.append(k)
            if len(order) == RULES.blamed:
                break
        return order
