"""Measured FRFs of response channels that read a share of another channel.

Such a channel reads ``r + s q``, with r and q the rows of both sensors (see `calib.correlation.frf.rows`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.frf.rows import RowError, in_test, require_positive_std
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel


@dataclass(frozen=True)
class CrossTalkError(RowError):
    """Share of the motion at another sensor that a response channel reads beside its own.

    Attributes
    ----------
    sensor : Sensor
        Whose channel reads it.
    source : Sensor
        Of the other channel, which may be held out.
    prior_sd : float
        Of the share; 0.1 is 10 %.
    test : str
        As of `ChannelError`.

    Raises
    ------
    InputError
        When both are the same sensor, or for a standard deviation that is not positive.

    Examples
    --------
    >>> import calib
    >>> calib.CrossTalkError(calib.Sensor(12, "z"), calib.Sensor(11, "z"), 0.02).parameter.name
    'cross_talk_11z_12z'
    """

    sensor: Sensor
    source: Sensor
    prior_sd: float
    test: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if self.sensor.name == self.source.name:
            raise InputError("both are the same sensor", place=self.place, remedy="give another source")
        require_positive_std(self.prior_sd, self.place)

    @property
    def place(self) -> str:
        """As messages name it."""
        return f"cross-talk of {self.source.name} into {self.name}"

    @property
    def parameter(self) -> Parameter:
        """Such as ``cross_talk_11z_12z``, of 11z into 12z."""
        reach, end = min(RULES.limit * self.prior_sd, 1.0), in_test(self.test)
        return Parameter(
            f"cross_talk_{self.source.name}_{self.name}{end}", 0.0, -reach, reach, "-", prior_sd=self.prior_sd,
            description=f"share of the motion at {self.source.name} that the channel of {self.name} reads{end}",
        )  # fmt: skip

    def changed(self, measured: MeasuredFRFs) -> tuple[tuple[Sensor, ...], tuple[Sensor, ...]]:
        """All responses."""
        return measured.responses, ()

    def other(self, model: StructuralModel | ReducedModel) -> np.ndarray:
        """Motion at the other sensor, (n_dof,); InputError where the model cannot place it."""
        return np.asarray(model.sensor_rows([self.source])[0])
