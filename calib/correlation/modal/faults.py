"""Faults of a modal measurement: what each does to the predicted shapes and damping ratios, with its derivative."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from calib.measurement.modal import Sensor
from calib.problem.candidate import Fault

Law = Literal["linear", "delay", "cosine", "sine"]


@dataclass(frozen=True)
class Contribution:
    """What one motion adds to the reading of a sensor.

    Attributes
    ----------
    sensor : int
        Index of the sensor that reads it.
    source : Sensor
        Motion of the structure.
    law : {"linear", "delay", "cosine", "sine"}
        Weight of the motion at magnitude s: ``s``, ``exp(-i omega s) - 1``, ``cos s - 1`` or ``sin s``, in SI.
    factor : float
        Of that weight.
    """

    sensor: int
    source: Sensor
    law: Law = "linear"
    factor: float = 1.0

    def weight(self, magnitude: float, omega: float) -> complex:
        """The weight at a magnitude (SI) and a circular frequency, rad/s."""
        if self.law == "delay":
            return complex(self.factor * (np.exp(-1j * omega * magnitude) - 1))
        weights = {"linear": magnitude, "cosine": np.cos(magnitude) - 1, "sine": np.sin(magnitude)}
        return complex(self.factor * weights[self.law])

    def slope(self, magnitude: float, omega: float) -> complex:
        """Derivative of `weight` by the magnitude."""
        if self.law == "delay":
            return complex(-1j * omega * self.factor * np.exp(-1j * omega * magnitude))
        slopes = {"linear": 1.0, "cosine": -np.sin(magnitude), "sine": np.cos(magnitude)}
        return complex(self.factor * slopes[self.law])


@dataclass(frozen=True)
class ModalFault(Fault):
    """A fault of measured modes.

    Attributes
    ----------
    shares : tuple of Share
        Motions added to readings of sensors.
    damping : tuple of float
        Damping ratio that magnitude 1 (in its own unit) adds to every measured mode; empty for none.
    modulus : bool
        Whether the magnitude, from 0 to 1, moves real shapes from the part in phase to modulus and sign.
    mixed : tuple of str
        Measured mode, the measured mode of whose shape it holds a share (the magnitude over the size of its own), and
        whether that is in quadrature: empty text for in phase. Empty for none.
    """

    shares: tuple[Contribution, ...] = ()
    damping: tuple[float, ...] = ()
    modulus: bool = False
    mixed: tuple[str, ...] = ()

    @property
    def subjects(self) -> tuple[str, ...]:
        """As of any fault; of a mixed mode that mode."""
        return (*super().subjects, *self.mixed[:1])


@dataclass(frozen=True, eq=False)
class ReadingSlopes:
    """Derivatives of readings by the magnitudes of some faults, of which each contribution is one entry.

    Attributes
    ----------
    factors : ndarray (n_faults,)
        SI over the unit of each magnitude.
    columns, sensors, sources : ndarray of int (n_entries,)
        Fault, reading sensor and motion of each contribution.
    linear : ndarray (n_entries,)
        Slope of each weight, per unit in SI, where its law is linear.
    others : tuple of (int, Contribution, float)
        Entry, contribution and magnitude in SI of each of another law.
    """

    factors: np.ndarray
    columns: np.ndarray
    sensors: np.ndarray
    sources: np.ndarray
    linear: np.ndarray
    others: tuple[tuple[int, Contribution, float], ...]

    def of_mode(self, omega: float, size: int, motions: np.ndarray) -> np.ndarray:
        """Derivatives of the reading of one mode, per unit of each magnitude, (n_sensors, n_faults).

        Parameters
        ----------
        omega : float
            Circular frequency of the mode, rad/s.
        size : int
            Number of sensors.
        motions : ndarray (n_sources,)
        """
        slopes = self.linear.astype(complex)
        for n, share, magnitude in self.others:
            slopes[n] = share.slope(magnitude, omega)
        out = np.zeros((size, len(self.factors)), dtype=complex)
        np.add.at(out, (self.sensors, self.columns), slopes * motions[self.sources])
        return out * self.factors


@dataclass(frozen=True, eq=False)
class Readings:
    """What faulty channels read of the modes of a model.

    Shapes are over all sensors, motions of sources have one row per entry of ``sources``. Faults add up, so that
    products of two magnitudes are left out.

    Attributes
    ----------
    faults : tuple of ModalFault
    omega : ndarray (n_measured,)
        Measured circular frequencies, rad/s, which set the phase of a delay.
    sources : tuple of Sensor
        Motions of which a faulty channel reads a share.
    """

    faults: tuple[ModalFault, ...]
    omega: np.ndarray
    sources: tuple[Sensor, ...] = field(init=False)
    _by_name: Mapping[str, ModalFault] = field(init=False, repr=False)
    _rows: Mapping[Sensor, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        sources = dict.fromkeys(share.source for fault in self.faults for share in fault.shares)
        object.__setattr__(self, "sources", tuple(sources))
        object.__setattr__(self, "_by_name", {fault.name: fault for fault in self.faults})
        object.__setattr__(self, "_rows", {source: k for k, source in enumerate(sources)})

    @property
    def names(self) -> Collection[str]:
        """Names of the faults."""
        return self._by_name.keys()

    def shape(self, at: Mapping[str, float], omega: float, shape: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Reading of a shape.

        Parameters
        ----------
        at : mapping from str to float
            Magnitudes in their own units; missing ones are 0.
        omega : float
            Circular frequency of the mode, rad/s.
        shape : ndarray (n_sensors, ...)
            The model's motion at the sensors, or its derivative: the reading is linear in it, but for `modulus`.
        motions : ndarray (n_sources, ...)
            The same at the sources.
        """
        out = np.array(shape, dtype=complex)
        for name, magnitude in at.items():
            fault = self._by_name[name]
            si = magnitude * fault.magnitude.si_factor
            for share in fault.shares:
                out[share.sensor] += share.weight(si, omega) * motions[self._rows[share.source]]
        return out

    def slopes(self, at: Mapping[str, float], names: Sequence[str]) -> ReadingSlopes:
        """Derivatives of `shape` by some magnitudes."""
        shares = [(k, share) for k, name in enumerate(names) for share in self._by_name[name].shares]
        factors = np.array([self._by_name[name].magnitude.si_factor for name in names])
        columns = np.array([k for k, _ in shares], dtype=int)
        return ReadingSlopes(
            factors, columns, np.array([share.sensor for _, share in shares], dtype=int),
            np.array([self._rows[share.source] for _, share in shares], dtype=int),
            np.array([share.factor for _, share in shares]),
            tuple((n, share, at.get(names[k], 0.0) * factors[k])
                  for n, (k, share) in enumerate(shares) if share.law != "linear"),
        )  # fmt: skip

    def reach_shapes(self, at: Mapping[str, float]) -> bool:
        """Whether any of these faults changes shapes, apart from moduli with a sign."""
        return any(self._by_name[name].shares for name in at)

    def modulus(self, at: Mapping[str, float]) -> float:
        """How far real shapes are moduli with a sign: 0 for the part in phase, 1 for the modulus."""
        return sum(magnitude for name, magnitude in at.items() if self._by_name[name].modulus)

    def added_damping(self, at: Mapping[str, float]) -> np.ndarray:
        """Damping ratios that the analysis adds, (n_measured,)."""
        out = np.zeros(len(self.omega))
        for name, magnitude in at.items():
            out += magnitude * self.damping_slope(name)
        return out

    def damping_slope(self, name: str) -> np.ndarray:
        """Derivative of `added_damping` by one magnitude, (n_measured,)."""
        pattern = self._by_name[name].damping
        return np.array(pattern) if pattern else np.zeros(len(self.omega))

    def turns_to_modulus(self, name: str) -> bool:
        """Whether that fault is the one of moduli with a sign."""
        return self._by_name[name].modulus

    def mixed(self, name: str) -> tuple[str, ...]:
        """Measured mode that holds a share of another one, that one, and how; empty for any other fault."""
        return self._by_name[name].mixed

    def active(self, values: Mapping[str, float]) -> dict[str, float]:
        """Magnitudes among named values that are not 0."""
        return {name: value for name, value in values.items() if value != 0 and name in self._by_name}
