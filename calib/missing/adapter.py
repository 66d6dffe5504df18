"""Protocol of the adapter of a test to an explanation: hypotheses, errors, notes, tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, Self

import pandas as pd

from calib.execution.outcome import Outcome
from calib.execution.stage import Progress, silent
from calib.missing.between_tests import Differences
from calib.missing.candidate_fit import CandidateFit
from calib.missing.discrepancy import Discrepancy
from calib.missing.explanation import Explanation
from calib.missing.facts import DiscretisationError, MeasurementFacts, Places
from calib.missing.hypotheses import Hypotheses
from calib.missing.recommendation import ExperimentalDesign
from calib.problem.effect import Effect


class Adapter(Protocol):
    """Properties and methods in which kinds of tests differ.

    Implemented by `ModalAdapter`, `FRFAdapter`, `ScalarAdapter` (data compared value by value) and, for several tests,
    `JointAdapter`; see `calib.hypotheses`.
    """

    @property
    def facts(self) -> MeasurementFacts:
        """Facts about the measurement beside its rows."""
        ...

    @property
    def hypotheses(self) -> Hypotheses:
        """Hypotheses that the decision compares."""
        ...

    @property
    def budget_of_fits(self) -> float:
        """Model evaluations after which no further effect is fitted."""
        ...

    @property
    def on_mesh(self) -> bool:
        """Whether the error of a mesh shows in what was measured; of several tests each is asked by itself."""
        ...

    def granting(self, faults: Sequence[str]) -> Adapter:
        """The same with faults of the measurement among the parameters of its base model."""
        ...

    def covering(self, fits: Iterable[CandidateFit]) -> Adapter:
        """The same, with a reduced basis that also represents given fits; itself where its own does."""
        ...

    def with_effects(self, effects: Sequence[Effect]) -> Hypotheses:
        """Its hypotheses with further effects beside those of its library."""
        ...

    def between(self, found: Explanation) -> Differences | None:
        """Which shared parameter differs between tests, with the best explanation so far; None for a single test."""
        ...

    @property
    def left_out_std(self) -> float:
        """Degrees of freedom behind the standard deviation of each group of data that is left out."""
        ...

    def notes(self) -> list[str]:
        """Caveats that the reader needs before the results."""
        ...

    def errors(
        self, stages: dict[str, CandidateFit], scale: float
    ) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data, notes, and entries of the summary."""
        ...

    def predictions(
        self, candidate_fit: CandidateFit, wide: Discrepancy, scale: float
    ) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Predictions and errors of held-out data, with a discrepancy too; empty without such data."""
        ...

    def richer(self, name: str, progress: Progress = silent) -> Self | None:
        """The same with the next richer member in the place of an effect; None where it has none."""
        ...

    def failing(self) -> set[str]:
        """Effects with which the model failed at any point."""
        ...

    def failed(self) -> list[Outcome]:
        """Points at which the user's code failed."""
        ...

    def design(self, found: Explanation, progress: Progress = silent) -> ExperimentalDesign | None:
        """Candidate measurements; None where none can be proposed."""
        ...

    def discretisation_error(self, found: Explanation) -> DiscretisationError | None:
        """Scores that the discretisation error alone would give; None without a finer mesh."""
        ...

    def places(self) -> Places:
        """Kind, location (m) and sensor of every local perturbation and fault of a measurement, by name."""
        ...

    def labels(self) -> pd.DataFrame:
        """Labels of the rows of data, n_rows: ``kind, mode, sensor, part``, of several tests ``test`` too; text."""
        ...

    def tables(self, stages: dict[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """Further tables by name."""
        ...
