"""Protocols of a problem and of a fit, as the analyses use them; see `calib.api.problem` and `calib.api.fit`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self, TypeAlias, TypeVar

import pandas as pd

from calib.analyses.fit_statistics import FitStatistics, Terms
from calib.api.display import Compared
from calib.experiment.modal import Model, Test
from calib.inference.agreement import Agreement
from calib.problem.effect import Effect
from calib.problem.joint import JointProblem
from calib.problem.problem import Problem as Posed
from calib.problem.space import ParameterSpace
from calib.structure.model import StructuralModel

Effects: TypeAlias = Sequence[Effect] | Mapping[str, Sequence[Effect]]
"""Effects that models may lack: of the first model, or by the name of the model."""
Finer: TypeAlias = StructuralModel | Mapping[str, StructuralModel] | None
"""The same on a finer mesh: of the first model, or by the name of the model."""


class PosedProblem(Protocol):
    """Models and their tests over one parameter space; see `calib.api.problem.Problem`."""

    @property
    def pairs(self) -> tuple[tuple[Model, Test], ...]:
        """Every test with its model under its condition."""
        ...

    @property
    def by_model(self) -> tuple[tuple[Model, tuple[Test, ...]], ...]:
        """Every model, no condition applied, with all of its tests."""
        ...

    @property
    def space(self) -> ParameterSpace:
        """All parameters except those that a test's condition sets."""
        ...

    @property
    def posed(self) -> Posed[Any] | JointProblem:
        """Rows, responses, residual and Jacobian."""
        ...

    @property
    def ledger(self) -> Any:
        """The `calib.results.ledger.Ledger` that keeps its points; None without one."""
        ...

    @property
    def unselected(self) -> tuple[str, ...]:
        """Parameters that a selection holds at their nominal values."""
        ...

    @property
    def terms(self) -> Terms:
        """Inputs of the fit statistics besides the rows."""
        ...

    def compare(self, values: Mapping[str, float] | None = None) -> Compared:
        """Models against tests at named values, or at the nominal ones."""
        ...

    def with_effects(self, effects: Effects) -> Self:
        """The same problem with effects in its models."""
        ...


P = TypeVar("P", bound=PosedProblem)


class Solved(Protocol):
    """A fitted problem; see `calib.api.fit.Fit`."""

    @property
    def problem(self) -> PosedProblem:
        """The problem; its free parameters are the fitted ones."""
        ...

    @property
    def statistics(self) -> FitStatistics:
        """Fit statistics and identifiability of the parameters."""
        ...

    @property
    def agreement(self) -> Agreement | None:
        """Whether starts that fit equally well ended in one solution; None for fewer than two of them."""
        ...

    @property
    def parameters(self) -> pd.DataFrame:
        """Verdicts on the fitted parameters; the index is the parameter."""
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
        """Summary of the fit."""
        ...
