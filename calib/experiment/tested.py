"""What was measured in one test of a study, of whatever kind, and the forward problem of a model against it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import pandas as pd

from calib.correlation.frf.nuisance import Nuisance
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.response.problem import FunctionProblem, Targets
from calib.correlation.response.residual import ResponseResidual
from calib.errors.errors import InputError
from calib.experiment.held_out import Unseen
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes
from calib.measurement.responses import MeasuredResponses
from calib.study.study_file import Measured, StudyFile

ForwardProblem = ModalProblem | FunctionProblem | FRFProblem
AnyPair = ModalResidual | ResponseResidual | FRFResidual


@dataclass(frozen=True, eq=False)
class Tested(ABC):
    """What was measured in one test of a study; subclasses say of which kind.

    Attributes
    ----------
    study : StudyFile
        With the settings of the test.
    given : MeasuredModes, MeasuredResponses or MeasuredFRFs
        Everything that was measured, held-out data included.
    """

    study: StudyFile
    given: Measured

    words: ClassVar[str]
    """The kind in words."""
    can_hold_out: ClassVar[tuple[str, ...]]
    """Keys under ``[held_out]`` that it has."""

    @abstractmethod
    def problem(self, model: Any, base: Any) -> ForwardProblem:
        """The problem of a model over the data in use; ``base`` is the model without effects."""

    @abstractmethod
    def pair(self, problem: Any) -> AnyPair:
        """The whitened residual of a problem over such data."""

    @abstractmethod
    def table(self) -> pd.DataFrame:
        """All data with their standard deviations, held-out data included and marked."""

    @property
    def modes(self) -> MeasuredModes | None:
        """All modes; None of another kind."""
        return None

    @property
    def used_modes(self) -> MeasuredModes | None:
        """Modes that are not held out; None of another kind."""
        return None

    @property
    def responses(self) -> MeasuredResponses | None:
        """All scalar responses and their repeats; None of another kind."""
        return None

    @property
    def targets(self) -> Targets:
        """Scalar responses that are not held out; empty of another kind."""
        return {}

    @property
    def frfs(self) -> MeasuredFRFs | None:
        """All FRFs; None of another kind."""
        return None

    @property
    @abstractmethod
    def repeats(self) -> int | None:
        """Repeats behind the measured values; None where they are not stated."""

    @property
    def sensed(self) -> Sequence[Any]:
        """Data in use whose sensors are places of local perturbations; empty for data without sensors."""
        return ()

    def nuisances(self, model: Any) -> tuple[Nuisance, ...]:
        """Errors of the test that a fit may find, those of held-out channels included; none but of FRFs."""
        return ()

    def unseen(self, nuisances: Sequence[Nuisance]) -> Unseen:
        """Held-out data by group, other than modes."""
        return {}

    def whole_problem(self, problem: Any) -> ModalProblem | None:
        """The modal problem over everything measured; None where no mode and no sensor is held out.

        See `calib.correlation.modal.problem.ModalProblem.over`.

        Raises
        ------
        InputError
            When a held-out sensor has no place on the model, or a held-out mode an impossible pair.
        """
        return None

    def require_own(self) -> None:
        """InputError where something is held out that this kind of measurement does not have."""
        for key, names in self.study.settings.held_out.model_dump().items():
            if names and key not in self.can_hold_out:
                raise InputError(
                    f"{key} are held out, but the study measures {self.words}",
                    place=self.study.place("held_out", key),
                    remedy=f"name {' or '.join(self.can_hold_out)} under [held_out]",
                )
