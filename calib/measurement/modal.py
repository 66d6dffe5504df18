"""Measured modes and the sensors they were measured with."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.errors.arguments import names, numbers, objects
from calib.errors.errors import InputError
from calib.measurement.accuracy import NONE_CLAIMED, Accuracy
from calib.measurement.disagreements import Disagreement
from calib.measurement.places import Misplaced
from calib.results.in_short import Short, aligned_lines, marked

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
"""Direction names; index + 1 is the direction code of the universal file format."""


@dataclass(frozen=True)
class Sensor:
    """One measured direction at one point of the geometry.

    Attributes
    ----------
    node : int
        Node label of the measurement.
    direction : str
        One of `DIRECTIONS`; the sign of a sensor mounted the other way round is reversed on reading.
    point : tuple of float or None
        Nominal place (x, y, z) in metres; None while it is not known.
    on : str or None
        Name of the model's part that carries it; None lets the model take the nearest part.

    Examples
    --------
    >>> import calib
    >>> calib.Sensor(12, "y", point=(0.0, 1.5, 0.3), on="girder").name
    '12y'
    """

    node: int
    direction: str
    point: tuple[float, float, float] | None = None
    on: str | None = None

    def __post_init__(self) -> None:
        if self.point is not None and len(self.point) != 3:
            raise InputError(
                f"its place is {self.point!r:.40}", place=f"sensor {self.name}", remedy="give x, y, z in m"
            )

    @property
    def name(self) -> str:
        """Label such as ``12y``."""
        return f"{self.node}{self.direction}"


@dataclass(frozen=True)
class MeasuredModes(Short):
    """Measured modes of one structure: means over repeats with the standard deviations of the means.

    Attributes
    ----------
    names : tuple of str
        Mode names, length n_modes.
    natural_freq, damped_freq : ndarray (n_modes,)
        Hz; ``natural = |lambda|/2pi``, ``damped = Im(lambda)/2pi``.
    freq_std : ndarray (n_modes,)
        Standard deviation of the mean natural frequency, Hz; NaN where unknown.
    damping_ratio, damping_std : ndarray (n_modes,)
        Ratio and the standard deviation of its mean; NaN where unknown.
    sensors : tuple of Sensor
        Length n_sensors; empty for a measurement of frequencies alone.
    shapes : ndarray (n_sensors, n_modes), complex
        Scaled to a largest modulus of 1; NaN where a sensor was not measured in a mode.
    shape_std : ndarray (n_sensors, n_modes)
        Standard deviation of the mean of the real and of the imaginary part each; NaN where unknown.
    n_repeats : int
    synthetic : bool
        True when no structure was measured.
    source : str
        Files it was read from.
    notes : tuple of str
        Assumptions made on reading, such as "damping unknown: damped frequencies taken as natural".
    freq_count, damping_count : ndarray (n_modes,), int, or None
        Repeats behind each value, where not all repeats hold it; None for `n_repeats` everywhere.
    shape_count : ndarray (n_sensors, n_modes), int, or None
        Likewise.
    disagreements : tuple of Disagreement
        Repeats that disagree with the others at one place.
    misplaced : tuple of Misplaced
        Nodes whose places in two files contradict each other.
    accuracy : Accuracy
        Claimed accuracy in addition to the repeatability; not in the standard deviations above.

    Examples
    --------
    Two modes at two sensors; damping and the standard deviations of the shapes are unknown:

    >>> import numpy as np
    >>> import calib
    >>> freq, unknown = np.array([8.32, 27.23]), np.full(2, np.nan)
    >>> modes = calib.MeasuredModes(
    ...     ("1", "2"), freq, freq, 0.002 * freq, unknown, unknown, (calib.Sensor(1, "x"), calib.Sensor(2, "x")),
    ...     shapes=np.array([[0.8, 1.0], [1.0, -0.6]]), shape_std=np.full((2, 2), np.nan),
    ... )
    >>> modes.without(modes=["2"]).natural_freq
    array([8.32])
    """

    names: tuple[str, ...]
    natural_freq: np.ndarray
    damped_freq: np.ndarray
    freq_std: np.ndarray
    damping_ratio: np.ndarray
    damping_std: np.ndarray
    sensors: tuple[Sensor, ...]
    shapes: np.ndarray
    shape_std: np.ndarray
    n_repeats: int = 1
    synthetic: bool = False
    source: str = ""
    notes: tuple[str, ...] = ()
    freq_count: np.ndarray | None = None
    damping_count: np.ndarray | None = None
    shape_count: np.ndarray | None = None
    disagreements: tuple[Disagreement, ...] = ()
    misplaced: tuple[Misplaced, ...] = ()
    accuracy: Accuracy = NONE_CLAIMED

    def __post_init__(self) -> None:
        place = self.source or "measurement"
        object.__setattr__(self, "names", names(self.names, f"{place}, names"))
        object.__setattr__(self, "sensors", objects(self.sensors, Sensor, f"{place}, sensors"))
        for label in ("natural_freq", "damped_freq", "freq_std", "damping_ratio", "damping_std", "shapes", "shape_std"):
            object.__setattr__(self, label, numbers(getattr(self, label), f"{place}, {label}"))
        for label in ("freq_std", "damping_std", "shape_std"):
            if np.any(getattr(self, label) < 0):
                raise InputError(f"{label} has a negative value", place=place, remedy="give NaN where it is unknown")
        n = len(self.names)
        if len(set(self.names)) != n:
            raise InputError("two measured modes share a name", place=self.source or "measurement")
        for label in ("natural_freq", "damped_freq", "freq_std", "damping_ratio", "damping_std"):
            if getattr(self, label).shape != (n,):
                raise InputError(f"{label} has not {n} values", place=self.source or "measurement")
        for label in ("shapes", "shape_std"):
            if getattr(self, label).shape != (len(self.sensors), n):
                words = f"{label} is not {len(self.sensors)} sensors by {n} modes"
                raise InputError(words, place=self.source or "measurement")
        if not (np.all(np.isfinite(self.natural_freq)) and np.all(self.natural_freq > 0)):
            raise InputError("a frequency is not a positive number", place=self.source or "measurement")

    @property
    def n_modes(self) -> int:
        """Number of measured modes."""
        return len(self.names)

    @property
    def content(self) -> str:
        """The fingerprint, as a digest of the measurement takes it."""
        return self.fingerprint

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequencies, Hz, (n_modes,)."""
        return self.natural_freq

    @property
    def lowest_freq(self) -> float:
        """Lowest natural frequency, Hz."""
        return float(self.natural_freq.min())

    @property
    def claimed(self) -> str:
        """The claimed accuracy in words; empty without."""
        return self.accuracy.words

    @property
    def sensor_std(self) -> np.ndarray:
        """Root mean square over the modes of the standard deviation of each sensor's entries, (n_sensors,).

        NaN where unknown. The largest entry of each mode is 1.
        """
        known = [std[np.isfinite(std)] for std in self.shape_std]
        return np.array([float(np.sqrt(np.mean(own**2))) if len(own) else np.nan for own in known])

    @property
    def has_shapes(self) -> bool:
        """Whether any mode shape was measured."""
        return len(self.sensors) > 0

    def counts(self, kind: Literal["freq", "damping", "shape"]) -> np.ndarray:
        """Repeats behind every frequency or damping ratio (n_modes,), or shape entry (n_sensors, n_modes)."""
        given = {"freq": self.freq_count, "damping": self.damping_count, "shape": self.shape_count}[kind]
        shape = self.shapes.shape if kind == "shape" else (self.n_modes,)
        return np.full(shape, self.n_repeats) if given is None else given

    def __str__(self) -> str:
        """A short table: frequencies with their standard deviations, and damping."""
        sensors = f" at {len(self.sensors)} sensors" if self.has_shapes else ""
        repeats = f", {self.n_repeats} repeats" if self.n_repeats > 1 else ""
        head = f"{self.n_modes} modes{sensors}{repeats}{marked(self.synthetic)}"
        rows: list[tuple[str, ...]] = [("mode", "natural Hz", "std Hz", "damping %")]
        for mode in zip(self.names, self.natural_freq, self.freq_std, 100 * self.damping_ratio, strict=True):
            rows.append((mode[0], *("" if np.isnan(value) else f"{value:.4g}" for value in mode[1:])))
        return "\n".join([head, *aligned_lines(rows)])

    @property
    def fingerprint(self) -> str:
        """Hash over everything an evaluation may depend on."""
        digest = hashlib.sha256()
        digest.update(repr((self.names, self.sensors, self.n_repeats)).encode())
        digest.update(repr(self.accuracy).encode() if self.accuracy.given else b"")
        for array in (self.natural_freq, self.damped_freq, self.freq_std, self.damping_ratio, self.damping_std):
            digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
        digest.update(np.ascontiguousarray(self.shapes, dtype=complex).tobytes())
        digest.update(np.ascontiguousarray(self.shape_std, dtype=float).tobytes())
        for counts in (self.freq_count, self.damping_count, self.shape_count):
            if counts is not None:
                digest.update(np.ascontiguousarray(counts, dtype=np.int64).tobytes())
        return digest.hexdigest()[:16]

    def without(self, modes: Iterable[str] = (), sensors: Iterable[str] = ()) -> MeasuredModes:
        """All but some modes and sensors (named like ``12y``); unknown names raise InputError."""
        drop_modes, drop_sensors = tuple(modes), tuple(sensors)
        sensor_names = tuple(s.name for s in self.sensors)
        for kind, given, known in (("mode", drop_modes, self.names), ("sensor", drop_sensors, sensor_names)):
            for name in given:
                if name not in known:
                    raise InputError(
                        f"held-out {kind} {name!r} was not measured",
                        place=self.source or "measurement",
                        remedy=f"the measured {kind}s are {', '.join(known) or 'none'}",
                    )
        i = [k for k, name in enumerate(self.names) if name not in drop_modes]
        j = [k for k, name in enumerate(sensor_names) if name not in drop_sensors]
        return replace(
            self,
            names=tuple(self.names[k] for k in i),
            natural_freq=self.natural_freq[i],
            damped_freq=self.damped_freq[i],
            freq_std=self.freq_std[i],
            damping_ratio=self.damping_ratio[i],
            damping_std=self.damping_std[i],
            sensors=tuple(self.sensors[k] for k in j),
            shapes=self.shapes[np.ix_(j, i)],
            shape_std=self.shape_std[np.ix_(j, i)],
            freq_count=None if self.freq_count is None else self.freq_count[i],
            damping_count=None if self.damping_count is None else self.damping_count[i],
            shape_count=None if self.shape_count is None else self.shape_count[np.ix_(j, i)],
        )
