"""Fault: an error of the measurement itself, as a candidate beside effects that a model may lack."""

from __future__ import annotations

import math
from dataclasses import dataclass

from calib.effect import Effect

NOWHERE = (math.nan, math.nan, math.nan)
"""Place of a fault that concerns the whole measurement."""


@dataclass(frozen=True)
class Fault:
    """An error of a measurement.

    Attributes
    ----------
    effect : Effect
        Its magnitude is that of the fault; `Effect.of_measurement` is true.
    kind : str
        Such as ``gain``, ``delay``, ``rotation``, ``place``, ``cross-talk``, ``set-up``, ``damping``, ``modulus``.
    sensor : str
        Sensor that reads wrongly, empty for a fault of all.
    place : (3,) float
        Of that sensor, m; NaN where it is unknown.
    """

    effect: Effect
    kind: str
    sensor: str = ""
    place: tuple[float, float, float] = NOWHERE
