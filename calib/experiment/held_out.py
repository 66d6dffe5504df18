"""Held-out data that are compared entry by entry: scalar responses and FRFs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from calib.correlation.frf.nuisance import Nuisance, concerned
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.response.problem import FunctionProblem, Targets
from calib.correlation.response.residual import ResponseResidual
from calib.measurement.frf import MeasuredFRFs
from calib.problem.problem import Pair


class HeldOutResidual(Pair, Protocol):
    """A pair whose rows compare one measured value each."""

    @property
    def measured_values(self) -> np.ndarray:
        """What was measured in every row, (n_rows,)."""
        ...

    @property
    def std(self) -> np.ndarray:
        """Its standard deviation, (n_rows,)."""
        ...


class HeldOutData(Protocol):
    """Held-out data that are compared entry by entry: scalar responses or FRFs."""

    def pair(self, problem: Any) -> HeldOutResidual:
        """Their whitened residual for the model of the fitted problem."""

    def unfitted(self, values: Mapping[str, float]) -> dict[str, float]:
        """Prior standard deviations of parameters of the data themselves that have no fitted value."""


@dataclass(frozen=True, eq=False)
class HeldOutResponses:
    """Held-out scalar responses.

    Attributes
    ----------
    targets : mapping from response name to (value, standard deviation or None)
    """

    targets: Targets

    def pair(self, problem: FunctionProblem) -> ResponseResidual:
        """See `HeldOutData`."""
        return ResponseResidual(replace(problem, targets=self.targets))

    def unfitted(self, values: Mapping[str, float]) -> dict[str, float]:
        """Empty: they have no parameters of their own."""
        return {}


@dataclass(frozen=True, eq=False)
class HeldOutFRFData:
    """Held-out FRFs.

    Attributes
    ----------
    measured : MeasuredFRFs
    nuisances : tuple of Nuisance
        All that concern them, those that no fit determines included.
    """

    measured: MeasuredFRFs
    nuisances: tuple[Nuisance, ...]

    def pair(self, problem: FRFProblem) -> FRFResidual:
        """See `HeldOutData`."""
        return FRFResidual(replace(problem, measured=self.measured, nuisances=self.nuisances))

    def unfitted(self, values: Mapping[str, float]) -> dict[str, float]:
        """Such as the gain of a held-out channel; see `HeldOutData`."""
        own = (nuisance.parameter for nuisance in self.nuisances)
        return {p.name: p.prior_width for p in own if p.name not in values}


HeldOutGroups = Mapping[str, HeldOutData]
"""Held-out scalar responses or FRFs, by group; only groups that hold something."""
HELD_OUT_RESPONSES = "held_out_responses"
"""Group of held-out responses, as tables name it."""


def held_out_responses(whole: Targets, names: Sequence[str]) -> dict[str, HeldOutResponses]:
    """The named scalar responses as a group of held-out data; empty for none."""
    return {HELD_OUT_RESPONSES: HeldOutResponses({name: whole[name] for name in names})} if names else {}


def held_out_frfs(groups: Mapping[str, MeasuredFRFs], nuisances: Sequence[Nuisance]) -> dict[str, HeldOutFRFData]:
    """Held-out FRFs by group with the nuisances of their test that concern them."""
    return {group: HeldOutFRFData(own, concerned(nuisances, own)) for group, own in groups.items()}
