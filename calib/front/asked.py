"""What questions ask of a problem and of a fit; see `calib.front.problem` and `calib.front.fit`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self, TypeAlias, TypeVar

import pandas as pd

from calib.effect import Effect
from calib.front.shown import Compared
from calib.front.test import Model, Test
from calib.joint import JointProblem
from calib.problem import Problem as Posed
from calib.questions.judge import Judgement, Terms
from calib.space import ParameterSpace

Effects: TypeAlias = Sequence[Effect] | Mapping[str, Sequence[Effect]]
"""What models may lack: of the first model, or by the name of the model."""


class Asked(Protocol):
    """Models and what the real things did, over one parameter space; see `calib.front.problem.Problem`."""

    @property
    def pairs(self) -> tuple[tuple[Model, Test], ...]:
        """Every test with its model under its condition."""
        ...

    @property
    def by_model(self) -> tuple[tuple[Model, tuple[Test, ...]], ...]:
        """Every model with all of its tests, as it is under no condition."""
        ...

    @property
    def space(self) -> ParameterSpace:
        """All parameters that no test's condition holds."""
        ...

    @property
    def posed(self) -> Posed[Any] | JointProblem:
        """Rows, responses, residual and Jacobian."""
        ...

    @property
    def terms(self) -> Terms:
        """What fits are judged by, beside the rows."""
        ...

    def compare(self, values: Mapping[str, float] | None = None) -> Compared:
        """Models against tests at named values, or at the adopted ones."""
        ...

    def with_effects(self, effects: Effects) -> Self:
        """The same problem with effects in its models."""
        ...


P = TypeVar("P", bound=Asked)


class Solved(Protocol):
    """A problem solved; see `calib.front.fit.Fit`."""

    @property
    def problem(self) -> Asked:
        """With the fitted parameters free."""
        ...

    @property
    def judgement(self) -> Judgement:
        """What is known of the parameters there."""
        ...

    @property
    def values(self) -> Mapping[str, float]:
        """All parameters, each in its own unit."""
        ...

    @property
    def errors(self) -> pd.DataFrame:
        """Errors by test and group of data."""
        ...

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found."""
        ...
