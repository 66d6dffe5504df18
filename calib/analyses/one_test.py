"""Base class of the adapters of a single test."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from calib.analyses.discretisation_error import DiscretisationError
from calib.analyses.explanation_result import MeasurementFacts
from calib.analyses.hypotheses import Failure, ModelHypotheses
from calib.missing.explanation import CandidateFit, Explanation
from calib.missing.recommendation import ExperimentalDesign
from calib.missing.refits import DEFAULT
from calib.outcome import Outcome
from calib.stage import Progress, unheard
from calib.structure.effect_places import effect_places
from calib.structure.model import StructuralModel
from calib.structure.perturbations import Perturbation


@dataclass(frozen=True, eq=False)
class OneTest(ABC):
    """One test against one model; see `calib.analyses.adapter.Adapter`.

    Attributes
    ----------
    hypotheses : ModelHypotheses
    perturbations : tuple of Perturbation
        Its local perturbations.
    facts : MeasurementFacts
    """

    hypotheses: ModelHypotheses[Any]
    perturbations: tuple[Perturbation, ...]
    facts: MeasurementFacts

    @property
    def budget_of_fits(self) -> float:
        """Model evaluations after which no further effect is fitted.

        Unbounded for a function, whose derivatives cost calls: their number depends on its parameters.
        """
        return DEFAULT.budget if self.hypotheses.variants.calls is None else math.inf

    def notes(self) -> list[str]:
        """Notes on claimed or assumed standard deviations, and on repeats that disagree."""
        return list(self.facts.notes)

    def errors(
        self, stages: Mapping[str, CandidateFit], scale: float
    ) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data, notes such as failed points, and entries of the summary."""
        table = pd.concat([self.errors_of(t, scale).assign(stage=s) for s, t in stages.items()], ignore_index=True)
        failures = self.hypotheses.failures
        notes = []
        if failures:
            points = f"{len(failures)} point{'s' * (len(failures) > 1)} failed"
            notes = [f"{points}; the first{_with(failures[0])}: {failures[0].outcome.error}."]
        return table, notes, {} if self.hypotheses.variants.calls is None else {"failed": len(failures)}

    @abstractmethod
    def errors_of(self, candidate_fit: CandidateFit, scale: float) -> pd.DataFrame:
        """Errors of one fit by group of data, in units of ``scale`` times the standard deviation."""

    def labels(self) -> pd.DataFrame:
        """Labels of the rows of data, without parts."""
        rows = [(row.kind, row.mode, row.sensor, "") for row in self.hypotheses.rows]
        return pd.DataFrame(rows, columns=["kind", "mode", "sensor", "part"])

    @abstractmethod
    def tables(self, stages: Mapping[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """Further tables by name."""

    def effect_places(self) -> pd.DataFrame:
        """Where each effect of the library acts on a model of matrices, m: ``effect, x, y, z``; empty for others."""
        model = self.hypotheses.variants.model
        rows: list[tuple[object, ...]] = []
        if isinstance(model, StructuralModel):
            rows = [(e.name, *place) for e in self.hypotheses.effects for place in effect_places(model, e)]
        return pd.DataFrame(rows, columns=["effect", "x", "y", "z"])

    def failing(self) -> set[str]:
        """Effects that were nonzero at any point at which a function failed."""
        return {name for failure in self.hypotheses.failures for name in failure.effects}

    def failed(self) -> list[Outcome]:
        """All points at which a function failed."""
        return [failure.outcome for failure in self.hypotheses.failures]

    def design(self, found: Explanation, progress: Progress = unheard) -> ExperimentalDesign | None:
        """None: further responses of a function are unknown."""
        return None

    def discretisation_error(self, found: Explanation) -> DiscretisationError | None:
        """None: there is no mesh."""
        return None

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Kind, location (m) and sensor of every local perturbation, by name."""
        return {a.effect.name: (a.kind, a.place, a.sensor) for a in self.perturbations}


def _with(failure: Failure) -> str:
    return f" (with {', '.join(failure.effects)})" if failure.effects else ""
