"""What tests of every kind do alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

import pandas as pd

from calib.analyses.fit_statistics import FitStatistics
from calib.experiment import Unseen
from calib.hypotheses.verify import errors_of
from calib.missing.facts import MeasurementFacts
from calib.missing.test import Adapter
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.effects.perturbations import Perturbation


class BaseTest(ABC):
    """A test of one condition; subclasses say what was measured, and how a model is compared with it."""

    name: str
    condition: Mapping[str, float]

    @abstractmethod
    def problem(self, model: Any) -> Any:
        """The forward problem of a model, without held-out data."""

    @abstractmethod
    def pair(self, model: Any) -> Any:
        """The whitened residual of a model, without held-out data."""

    def whole_problem(self, model: Any) -> Any:
        """The forward problem with held-out modes, for verification; None where none are held out."""
        return None

    @property
    def unseen(self) -> Unseen:
        """Held-out data by their group, other than modes."""
        return {}

    @property
    def sensed(self) -> tuple[Any, ...]:
        """The data in use whose sensors are places of local perturbations; empty for data without sensors."""
        return ()

    @property
    def beside(self) -> Self:
        """The test as one of several; parameters of its own, where it has some, then bear its name."""
        return self

    def space(self, model: Any) -> ParameterSpace:
        """Parameters of a model, and those of the test itself where it has some."""
        space: ParameterSpace = self.problem(model).space
        return space

    def errors(self, model: Any, values: Mapping[str, float], fit: FitStatistics) -> pd.DataFrame:
        """Errors on fitted, left-one-out and held-out data; see `calib.hypotheses.verify.errors_of`."""
        joint, whole = fit.parts.get(self.name), self.whole_problem(model)
        return errors_of(
            self.pair(model), whole, self.unseen, self.space(model), values, joint=joint, active=fit.active
        )

    @abstractmethod
    def adapter(
        self,
        model: Any,
        effects: tuple[Effect, ...],
        local: tuple[Perturbation, ...],
        facts: MeasurementFacts,
        name: str,
    ) -> Adapter:
        """The adapter of this test to an explanation.

        Parameters
        ----------
        model : StructuralModel, ModalFunctionModel or FunctionModel
            Under the condition of the test.
        effects : tuple of Effect
        local : tuple of Perturbation
            Local perturbations that all tests of a model of matrices share.
        facts : MeasurementFacts
        name : str
            Name of the test where there are several; what concerns this one alone bears it.
        """
