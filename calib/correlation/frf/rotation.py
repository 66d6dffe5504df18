"""Measured FRFs of transducers whose axis is not the stated one.

A transducer that is turned by an angle a towards another axis measures, or drives, the motion ``cos a r + sin a q``
instead of r, with r and q the rows along both axes (see `calib.correlation.frf.rows`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.frf.rows import RowError, Side, in_test, require_positive_std
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel


@dataclass(frozen=True)
class RotationError(RowError):
    """Misalignment of a response sensor, or of a force, towards one other axis.

    An accelerometer and a force of the same name are mounted each for itself, so that they are two errors.

    Attributes
    ----------
    sensor : Sensor
        Along x, y or z.
    towards : {"x", "y", "z"}
        Another axis.
    prior_sd : float
        deg.
    side : {"response", "reference"}
    test : str
        As of `ChannelError`.

    Raises
    ------
    InputError
        For a sensor of a rotation, its own axis, an unknown side, or a standard deviation that is not positive.

    Examples
    --------
    >>> import calib
    >>> calib.RotationError(calib.Sensor(12, "z"), "x", 3.0).parameter.name
    'rotation_12z_x'
    """

    sensor: Sensor
    towards: str
    prior_sd: float
    side: Side = "response"
    test: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        own, axes = self.sensor.direction, DIRECTIONS[:3]
        if own not in axes or self.towards not in axes or own == self.towards:
            raise InputError(
                f"{own!r} is turned towards {self.towards!r}", place=self.place, remedy="give two of x, y and z"
            )
        if self.side not in ("response", "reference"):
            raise InputError(f"it is of a {self.side!r}", place=self.place, remedy="give response or reference")
        require_positive_std(self.prior_sd, self.place)

    @property
    def side_words(self) -> str:
        """Such as ``response``, before the name of the transducer."""
        return f"{self.side} "

    @property
    def place(self) -> str:
        """As messages name it."""
        return f"rotation of {self.name}"

    @property
    def parameter(self) -> Parameter:
        """Such as ``rotation_12z_x``, or ``rotation_force_3z_x`` of a reference."""
        force, end = "force_" if self.side == "reference" else "", in_test(self.test)
        reach = min(RULES.limit * self.prior_sd, RULES.rotation_most)
        return Parameter(
            f"rotation_{force}{self.name}_{self.towards}{end}", 0.0, -reach, reach, "deg",
            prior_sd=self.prior_sd,
            description=f"rotation of {self.side} {self.name} towards {self.towards}{end}",
        )  # fmt: skip

    def changed(self, measured: MeasuredFRFs) -> tuple[tuple[Sensor, ...], tuple[Sensor, ...]]:
        """All transducers of its side."""
        return (measured.responses, ()) if self.side == "response" else ((), measured.references)

    def other(self, model: StructuralModel | ReducedModel) -> np.ndarray:
        """Motion along the other axis, (n_dof,); InputError where the model has none."""
        try:
            (row,) = model.sensor_rows([replace(self.sensor, direction=self.towards)])
        except InputError as fault:
            raise InputError(
                f"along {self.towards} {fault.problem}", place=self.place, remedy="leave it out of the nuisances"
            ) from None
        return np.asarray(row)

    def weights(self, value: float) -> tuple[float, float]:
        """Of both axes, that of its own beside 1, at an angle in rad; see `calib.correlation.frf.rows`."""
        return float(np.cos(value)) - 1, float(np.sin(value))

    def slopes(self, value: float) -> tuple[float, float]:
        """Their derivatives, 1/rad."""
        return -float(np.sin(value)), float(np.cos(value))
