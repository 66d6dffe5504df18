"""What questions ask of a problem and of a fit; `calib.front.problem` holds both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import pandas as pd

from calib.front.test import Model, Test
from calib.joint import JointProblem
from calib.problem import Problem as Posed
from calib.questions.judge import Judgement, Terms
from calib.space import ParameterSpace


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

    def with_effects(self, effects: Any) -> Any:
        """The same problem with effects in its models."""
        ...


class Solved(Protocol):
    """A problem solved; see `calib.front.problem.Fit`."""

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
