"""Measured time records of responses, perhaps of the force of a hammer beside them, and their units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.frf import Quantity
from calib.measurement.frf_units import GRAVITY, LENGTHS
from calib.measurement.modal import Sensor
from calib.measurement.places import Misplaced
from calib.results.in_short import Short, marked, names_in_line

Motion = Literal["displacement", "velocity", "acceleration"]
UNITS: Mapping[Motion, str] = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}
"""Motions of a record, with their unit."""

MOTION_OF: Mapping[Quantity, Motion] = {
    "receptance": "displacement", "mobility": "velocity", "accelerance": "acceleration",
}  # fmt: skip
"""Motion in the numerator of an FRF."""
QUANTITY_OF: Mapping[str, Quantity] = {motion: quantity for quantity, motion in MOTION_OF.items()}
"""Quantity of a motion over a force."""

_POWERS: Mapping[Motion, tuple[str, ...]] = {
    "displacement": ("",), "velocity": ("/s",), "acceleration": ("/s2", "/ss"),
}  # fmt: skip

SAMPLES_FEWEST = 1000
"""Fewest samples of a record of responses alone."""
HIT_SAMPLES_FEWEST = 64
"""The same with a force."""


@dataclass(frozen=True, eq=False)
class MeasuredRecord(Short):
    """Responses of a structure over time, under forces that were not measured or under those of a hammer.

    Attributes
    ----------
    rate : float
        Samples a second, Hz.
    values : ndarray (n_samples, n_sensors)
        SI, rotations in rad.
    sensors : tuple of Sensor
    motion : {"displacement", "velocity", "acceleration"} or None
        Of all sensors; None where it is not stated.
    synthetic : bool
        True when no structure was measured.
    source : str
    notes : tuple of str
        Assumptions made on reading.
    misplaced : tuple of Misplaced
        Nodes whose places in two files contradict each other.
    references : tuple of Sensor
        Places and directions of the measured forces; none in an ambient record.
    forces : ndarray (n_samples, n_references), optional
        N, or Nm.
    """

    rate: float
    values: np.ndarray
    sensors: tuple[Sensor, ...]
    motion: Motion | None = None
    synthetic: bool = False
    source: str = ""
    notes: tuple[str, ...] = ()
    misplaced: tuple[Misplaced, ...] = ()
    references: tuple[Sensor, ...] = ()
    forces: np.ndarray | None = None

    def __str__(self) -> str:
        """Length, rate and channels."""
        motion = self.motion or "motion not stated"
        head = f"{len(self.values) / self.rate:.4g} s at {self.rate:.6g} Hz, {motion}{marked(self.synthetic)}"
        both = (("sensors", self.sensors), ("forces", self.references))
        return "\n".join([head, *(f"{what}: {names_in_line([one.name for one in own])}" for what, own in both if own)])

    def __post_init__(self) -> None:
        place = self.source or "record"
        forces = np.zeros((len(self.values), 0)) if self.forces is None else self.forces
        if forces.shape != (len(self.values), len(self.references)):
            words = f"its forces are {forces.shape}, not samples by {len(self.references)} references"
            raise InputError(words, place=place)
        if self.values.ndim != 2 or self.values.shape[1] != len(self.sensors):
            words = f"its values are {self.values.shape}, not samples by {len(self.sensors)} sensors"
            raise InputError(words, place=place)
        if not self.rate > 0:
            raise InputError(f"its rate is {self.rate:g} Hz", place=place, remedy="give a positive one")
        least = HIT_SAMPLES_FEWEST if self.references else SAMPLES_FEWEST
        if len(self.values) < least:
            better = "" if self.references else ", and better a thousand periods of the first mode"
            raise InputError(
                f"{len(self.values)} samples are too few to identify modes", place=place,
                remedy=f"give at least {least}{better}",
            )  # fmt: skip
        every = [*zip(self.sensors, self.values.T, strict=True), *zip(self.references, forces.T, strict=True)]
        for sensor, own in every:
            if not np.all(np.isfinite(own)):
                at = int(np.argmax(~np.isfinite(own))) / self.rate
                raise InputError(
                    f"{sensor.name} has no value {at:.6g} s after the begin", place=place,
                    remedy="give a part of the record without gaps, or leave the sensor out",
                )  # fmt: skip
            if np.ptp(own) == 0:
                raise InputError(f"{sensor.name} is constant: a dead channel", place=place, remedy="leave it out")

    @property
    def duration(self) -> float:
        """Length, s."""
        return len(self.values) / self.rate

    @property
    def unit(self) -> str:
        """Of translations; empty where it is not known."""
        return "" if self.motion is None else UNITS[self.motion]

    def in_order(self, sensors: tuple[Sensor, ...]) -> MeasuredRecord:
        """The record with its sensors in another order; InputError where it has not exactly these."""
        names, wanted = [own.name for own in self.sensors], [one.name for one in sensors]
        for lacks, has, words in ((names, wanted, "lacks"), (wanted, names, "alone has")):
            if other := [name for name in has if name not in lacks]:
                raise InputError(
                    f"it {words} {', '.join(other[:3])}", place=self.source or "record",
                    remedy="give the same sensors in every record",
                )  # fmt: skip
        return replace(self, values=self.values[:, [names.index(name) for name in wanted]], sensors=sensors)


def parse_motion_unit(text: str, place: str | Path | Place) -> tuple[Motion, float]:
    """Motion and SI value of a unit such as ``m/s2``, ``mm/s^2``, ``g``, ``mm/s`` or ``um``.

    Raises InputError for a text that is no such unit.
    """
    bare = "".join(c for c in text.replace("²", "2").replace("μ", "µ") if c not in " ()^*·")
    if bare in ("g", "gn"):
        return "acceleration", GRAVITY
    for length, metres in LENGTHS.items():
        for motion, powers in _POWERS.items():
            if bare in [length + power for power in powers]:
                return motion, metres
    raise InputError(
        f"the unit {text[:40]!r} is unknown", place=place,
        remedy="write that of a motion, such as m/s2, g, mm/s or mm",
    )  # fmt: skip


def even_rate(time: np.ndarray, place: str) -> float:
    """Samples a second of equally spaced instants in s, perhaps rounded; InputError where they are not."""
    if len(time) < 2:
        raise InputError("it has a single sample", place=place, remedy="give a whole record")
    step = float(time[-1] - time[0]) / (len(time) - 1)
    if step > 0:
        off = np.abs(time - time[0] - step * np.arange(len(time)))
        if off.max() <= UNEVEN * step:
            return 1 / step
        if (rounded := _rounding(time)) > 0:
            fitted, _ = np.polyfit(np.arange(len(time)), time, 1)
            off = np.abs(time - time.mean() - fitted * (np.arange(len(time)) - (len(time) - 1) / 2))
            if off.max() <= 1.01 * rounded <= GAP * fitted:
                return float(1 / fitted)
        jumps = np.abs(np.diff(time) - np.median(np.diff(time)))
        at = int(np.argmax(jumps))
        words = f"its samples are not equally spaced: {time[at]:.9g} s is followed by {time[at + 1]:.9g} s"
    else:
        words = "its time does not increase"
    remedy = "export it with one sampling rate, without gaps"
    if step > 0 and rounded > GAP * step:
        remedy += f", and with more digits than {DIGITS}, which are too few {time[-1]:.6g} s into a record"
    raise InputError(words, place=place, remedy=remedy)


def _rounding(time: np.ndarray) -> float:
    """By how much instants are rounded whose files give them `DIGITS` digits, s; 0 where some have more."""
    last = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(time), 1e-9))) - DIGITS + 1)
    exact = np.abs(time / last - np.rint(time / last)) < 1e-3
    return float(last.max() / 2) if exact.all() else 0.0


DIGITS = 6
"""Significant digits that many programs write of a number unless told otherwise (C's ``%g``)."""
GAP = 0.25
"""Largest rounding of instants, over their distance: a missing sample moves some by half of it."""
UNEVEN = 0.1
"""Largest deviation of an instant from equal spacing, over the spacing: files round their times."""
SAME_RATE = 1e-5
"""Relative difference of equal rates; universal files round them."""
