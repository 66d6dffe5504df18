"""Protocols of a problem and of a fit, as the analyses use them; see `calib.api.problem` and `calib.api.fit`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self, TypeAlias, TypeVar

from calib.problem.effect import Effect
from calib.structure.model import StructuralModel

if TYPE_CHECKING:
    import pandas as pd

    from calib.analyses.calibration import Fitted
    from calib.analyses.fit_statistics import FitStatistics
    from calib.experiment import Test
    from calib.experiment.test import Model
    from calib.problem.space import ParameterSpace
    from calib.study.in_memory import TestedModel
    from calib.study.settings import StudySettings
    from calib.study.several import AnyStudy

Effects: TypeAlias = Sequence[Effect] | Mapping[str, Sequence[Effect]]
"""Effects that models may lack: of the first model, or by the name of the model."""
Candidates: TypeAlias = Effects | Literal["generic"]
"""The same, or ``"generic"``: effects composed of each model's own parts, joints, supports and points."""
Finer: TypeAlias = StructuralModel | Mapping[str, StructuralModel] | None
"""The same on a finer mesh: of the first model, or by the name of the model."""


class ProblemLike(Protocol):
    """Models and their tests over one parameter space; see `calib.api.problem.Problem`."""

    @property
    def tested(self) -> tuple[TestedModel, ...]:
        """Every test with its model."""
        ...

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
    def ledger(self) -> Any:
        """The `calib.results.ledger.Ledger` that keeps its points; None without one."""
        ...

    @property
    def settings(self) -> StudySettings:
        """Keys of the analyses that no argument gives."""
        ...

    def study(
        self,
        settings: StudySettings | None = None,
        effects: Mapping[str, tuple[Effect, ...]] | None = None,
        finer: Mapping[str, Model] | None = None,
    ) -> AnyStudy:
        """The problem as the analyses take it."""
        ...

    def with_effects(self, effects: Effects) -> Self:
        """The same problem with effects in its models."""
        ...


P = TypeVar("P", bound=ProblemLike)


class Solved(Protocol):
    """A fitted problem; see `calib.api.fit.Fit`."""

    @property
    def problem(self) -> ProblemLike:
        """The problem; its free parameters are the fitted ones."""
        ...

    @property
    def statistics(self) -> FitStatistics:
        """Fit statistics and identifiability of the parameters."""
        ...

    @property
    def calibration(self) -> Fitted | None:
        """The calibration behind it; None for statistics at given values."""
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
