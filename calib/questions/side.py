"""What an explanation needs of a test beyond the decision itself."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pandas as pd

from calib.missing.advice import Prospects
from calib.missing.findings import Findings, Trial
from calib.missing.hypotheses import Hypotheses
from calib.outcome import Outcome
from calib.questions.budget import Budget
from calib.questions.explanation import Told


class Side(Protocol):
    """What each kind of test answers in its own way: `ModalSide`, `PlainSide` and, of several, `JointSide`."""

    @property
    def told(self) -> Told:
        """What must be known of the measurement beside its rows."""
        ...

    @property
    def hypotheses(self) -> Hypotheses:
        """What the decision asks."""
        ...

    @property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over its value, of shapes over the largest entry, (n_rows,)."""
        ...

    @property
    def budget_of_fits(self) -> float:
        """Model evaluations after which no further effect is fitted."""
        ...

    def notes(self) -> list[str]:
        """What a reader must know beforehand."""
        ...

    def errors(self, stages: dict[str, Trial], scale: float) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data, notes, and figures for the summary."""
        ...

    def failing(self) -> set[str]:
        """Effects with which the model failed somewhere."""
        ...

    def failed(self) -> list[Outcome]:
        """Points at which the user's code failed."""
        ...

    def prospects(self, found: Findings) -> Prospects | None:
        """What else could be measured."""
        ...

    def budget(self, found: Findings) -> Budget | None:
        """What the discretisation alone would look like."""
        ...

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Kind, place and sensor of every local change."""
        ...

    def tables(self, stages: dict[str, Trial]) -> dict[str, pd.DataFrame]:
        """Further tables by name."""
        ...
