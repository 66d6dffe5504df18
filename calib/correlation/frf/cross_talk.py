"""Measured FRFs of response channels that read a share of another channel, or have taken each other's name.

Such a channel reads ``r + s q``, with r and q the rows of both sensors (see `calib.correlation.frf.rows`); of two that
are exchanged, each reads ``(1 - s) r + s q``, wholly at s = 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

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


@dataclass(frozen=True)
class ExchangeError(CrossTalkError):
    """Exchange of two response channels, by one parameter: no fit frees it, but an explanation suspects it.

    Attributes
    ----------
    sensor, source : Sensor
        Both.
    prior_sd : float
        Of the part, which is 1 where they are exchanged.
    backwards : bool
        Whether it is the row of the second one.
    """

    backwards: bool = field(default=False, kw_only=True)

    @property
    def place(self) -> str:
        """As messages name it."""
        return f"exchange of {' and '.join(self._both)}"

    @property
    def of_rows(self) -> tuple[RowError, ...]:
        """The rows of both."""
        return (self, replace(self, sensor=self.source, source=self.sensor, backwards=not self.backwards))

    @property
    def parameter(self) -> Parameter:
        """Such as ``exchange_11z_12z``, the same of both rows."""
        end = in_test(self.test)
        return Parameter(
            f"exchange_{'_'.join(self._both)}{end}", 0.0, 0.0, RULES.exchange_most, "-", prior_sd=self.prior_sd,
            description=f"exchange of the channels of {' and '.join(self._both)}{end}",
        )  # fmt: skip

    def weights(self, value: float) -> tuple[float, float]:
        """Of its own row, beside 1, and of the other one."""
        return -value, value

    def slopes(self, value: float) -> tuple[float, float]:
        """Their derivatives."""
        return -1.0, 1.0

    @property
    def _both(self) -> tuple[str, ...]:
        names = self.sensor.name, self.source.name
        return names[::-1] if self.backwards else names
