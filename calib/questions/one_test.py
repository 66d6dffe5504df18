"""What an explanation needs of one test beyond the decision itself, whatever the test is of."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from calib.missing.advice import Prospects
from calib.missing.findings import Findings, Trial
from calib.missing.refits import DEFAULT
from calib.outcome import Outcome
from calib.questions.budget import Budget
from calib.questions.explanation import Told
from calib.questions.hypotheses import Failure, ModelHypotheses
from calib.structure.atoms import Atom


@dataclass(frozen=True, eq=False)
class OneTest(ABC):
    """One test against one model; see `calib.questions.explain.Side`.

    Attributes
    ----------
    hypotheses : ModelHypotheses
    atoms : tuple of Atom
        Its local changes.
    told : Told
    """

    hypotheses: ModelHypotheses[Any]
    atoms: tuple[Atom, ...]
    told: Told

    @property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over its value, of shapes over the largest entry, (n_rows,)."""
        return self.hypotheses.relative_std

    @property
    def budget_of_fits(self) -> float:
        """Model evaluations after which no further effect is fitted.

        A function pays for its derivatives in calls; there is no bound that fits them all.
        """
        return DEFAULT.budget if self.hypotheses.variants.calls is None else math.inf

    def notes(self) -> list[str]:
        """What scatter is claimed or had to be assumed."""
        return list(self.told.notes)

    def errors(self, stages: Mapping[str, Trial], scale: float) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data; what to note, such as points that failed, and figures for the summary."""
        table = pd.concat([self.errors_of(t, scale).assign(stage=s) for s, t in stages.items()], ignore_index=True)
        failures = self.hypotheses.failures
        notes = []
        if failures:
            points = f"{len(failures)} point{'s' * (len(failures) > 1)} failed"
            notes = [f"{points}; the first{_with(failures[0])}: {failures[0].outcome.error}."]
        return table, notes, {} if self.hypotheses.variants.calls is None else {"failed": len(failures)}

    @abstractmethod
    def errors_of(self, trial: Trial, scale: float) -> pd.DataFrame:
        """Errors of one fit by group of data, in units of the scatter times ``scale``."""

    @abstractmethod
    def tables(self, stages: Mapping[str, Trial]) -> dict[str, pd.DataFrame]:
        """Further tables by name."""

    def failing(self) -> set[str]:
        """Effects of all points at which a function failed."""
        return {name for failure in self.hypotheses.failures for name in failure.effects}

    def failed(self) -> list[Outcome]:
        """All points at which a function failed."""
        return [failure.outcome for failure in self.hypotheses.failures]

    def prospects(self, found: Findings) -> Prospects | None:
        """None: nobody knows what else could be measured."""
        return None

    def budget(self, found: Findings) -> Budget | None:
        """None: there is no mesh."""
        return None

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Kind, place and sensor of every local change."""
        return {a.effect.name: (a.kind, a.place, a.sensor) for a in self.atoms}


def _with(failure: Failure) -> str:
    return f" (with {', '.join(failure.effects)})" if failure.effects else ""
