"""Measured scalar responses of a study, and the problem of a function, or of the modes of a model, against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from calib.correlation.frf.nuisance import Nuisance
from calib.correlation.modal.responses import response_problem
from calib.correlation.response.problem import FunctionProblem, Targets
from calib.correlation.response.residual import ResponseResidual, response_std
from calib.errors.errors import InputError
from calib.experiment.held_out import UnseenResponses, unseen_responses
from calib.experiment.tested import Tested
from calib.measurement.responses import MeasuredResponses
from calib.structure.function_model import FunctionModel
from calib.structure.modal_model import ModalModel


@dataclass(frozen=True, eq=False)
class TestedResponses(Tested):
    """Measured scalar responses of a study.

    Attributes
    ----------
    given : MeasuredResponses
    """

    given: MeasuredResponses

    words = "scalar responses"
    can_hold_out = ("responses",)

    @property
    def responses(self) -> MeasuredResponses:
        """All of them."""
        return self.given

    @property
    def repeats(self) -> int | None:
        """Those that the file shows, else those that the study states."""
        counted = self.given.repeats
        return self.study.settings.measurement.repeats if counted is None else counted

    @cached_property
    def targets(self) -> Targets:
        """The scalar responses that are not held out."""
        study, whole = self.study, self.given.targets
        names = study.settings.held_out.responses
        for k, name in enumerate(names):
            if name not in whole:
                place = study.place("held_out", "responses", k)
                remedy = f"the measured responses are {', '.join(whole)}"
                raise InputError(f"held-out response {name!r} was not measured", place=place, remedy=remedy)
        targets = {name: target for name, target in whole.items() if name not in names}
        if not targets:
            raise InputError(
                "every measured response is held out",
                place=study.place("held_out", "responses"),
                remedy="leave some to fit",
            )
        return targets

    def unseen(self, nuisances: Sequence[Nuisance]) -> dict[str, UnseenResponses]:
        """Held-out responses, in one group."""
        return unseen_responses(self.given.targets, self.study.settings.held_out.responses)

    def problem(self, model: FunctionModel | ModalModel, base: Any) -> FunctionProblem:
        """The problem over the responses in use; ``repeats`` is the number equivalent to the pooled ones."""
        pooled, place = self.given.pooled_repeats, self.study.place("measurement", "responses")
        repeats = self.study.settings.measurement.repeats if pooled is None else pooled
        return response_problem(model, self.given, self.targets, repeats, place)

    def pair(self, problem: FunctionProblem) -> ResponseResidual:
        """See `Tested`."""
        return ResponseResidual(problem)

    def table(self) -> pd.DataFrame:
        """``response, held_out, value, std, repeats, std_used``."""
        held, whole = self.study.settings.held_out, self.given
        rows = [
            (name, name in held.responses, value, np.nan if std is None else std, whole.counts.get(name, np.nan), taken)
            for (name, (value, std)), taken in zip(whole.targets.items(), response_std(whole.targets), strict=True)
        ]
        return pd.DataFrame(rows, columns=["response", "held_out", "value", "std", "repeats", "std_used"])
