"""What a test of FRFs may get wrong, as parameters with priors: of channels, transducers, added masses, stingers.

Beside these stands what a model may be off by at its resonances (`calib.correlation.frf.resonances`).

A measured function is modelled as ``H c_response / c_reference`` with the factor ``c = (1 + gain) exp(i phase - i omega
delay)`` of each channel. Masses and stingers change the model; wrong places, turned axes and cross-talk change which
of its motions is asked for (see `calib.correlation.frf.rows`). At zero nothing changes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.frf.cross_talk import CrossTalkError
from calib.correlation.frf.factor import FactorError
from calib.correlation.frf.places import PlaceError
from calib.correlation.frf.resonances import ResonanceError, of_every_resonance
from calib.correlation.frf.rotation import RotationError
from calib.correlation.frf.rows import RowError, Side, in_test, require_positive_std
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.space import Parameter
from calib.structure.effects.loaded import Load
from calib.structure.model import StructuralModel

CHANNEL_SD: Mapping[str, float] = {"gain": RULES.gain_sd, "phase": RULES.phase_sd}
"""Default prior standard deviations, in % and degrees."""


_UNITS = {"gain": "%", "phase": "deg", "delay": "s"}

ChannelKind = Literal["gain", "phase", "delay"]


@dataclass(frozen=True)
class ChannelError(FactorError):
    """Gain, phase or delay of one channel, the same on all lines.

    Attributes
    ----------
    kind : {"gain", "phase", "delay"}
        Relative gain, phase lead of the channel, or its delay.
    sensor : str
        Name of a response or reference, such as ``12z``.
    side : {"response", "reference"}
        The channel of a reference measures the force, by which the motion is divided.
    prior_sd : float, optional
        In %, degrees or s; `CHANNEL_SD` by default, a delay has none.
    of_functions : bool
        Whether a gain multiplies the functions of the channel; by default it is that of the channel, by which the
        functions of a reference are divided.
    test : str
        Name of its test, where there are several; see `belonging_to`.

    Raises
    ------
    InputError
        For an unknown kind or side, or a standard deviation that is missing or not positive.
    """

    kind: ChannelKind
    sensor: str
    side: Side = "response"
    prior_sd: float | None = None
    of_functions: bool = field(default=False, kw_only=True)
    test: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        place = self.place
        if self.kind not in _UNITS or self.side not in ("response", "reference"):
            raise InputError(
                f"it is a {self.kind!r} of a {self.side!r}", place=place,
                remedy="give gain, phase or delay of a response or reference",
            )  # fmt: skip
        if self.prior_sd is None and self.kind not in CHANNEL_SD:
            raise InputError(f"its {self.kind} has no standard deviation", place=place, remedy="give prior_sd in s")
        require_positive_std(self.prior_sd, place)

    @property
    def name(self) -> str:
        """Of its transducer."""
        return self.sensor

    @property
    def place(self) -> str:
        """As messages name it."""
        return f"error of channel {self.sensor}"

    @property
    def key(self) -> tuple[str, str, str]:
        """What it is, for a fingerprint."""
        return f"{self.kind}{' of functions' * self.multiplies}", self.sensor, self.side

    @property
    def multiplies(self) -> bool:
        """Whether its value multiplies functions of a reference, which another one divides."""
        return self.of_functions and self.side == "reference"

    def among(self, measured: MeasuredFRFs) -> tuple[str, ...]:
        """Names of all channels of its side."""
        return channel_names(measured, self.side)

    def functions_of(self, measured: MeasuredFRFs) -> tuple[slice | int, ...]:
        """Those of its channel, as an index that leaves (n_freq, n_others)."""
        index = self.among(measured).index(self.sensor)
        return (slice(None), index) if self.side == "response" else (slice(None), slice(None), index)

    @property
    def side_words(self) -> str:
        """Its side, as a message names it before the channel."""
        return f"{self.side} "

    @property
    def parameter(self) -> Parameter:
        """Such as ``gain_12z``, ``gain_force_3z`` of a reference, or of one of several tests ``gain_12z in test A``."""
        sd = CHANNEL_SD[self.kind] if self.prior_sd is None else self.prior_sd
        force, lower = "force_" if self.side == "reference" else "", -RULES.limit * sd
        of = "functions" if self.multiplies else "channel"
        return Parameter(
            f"{self.kind}_{force}{self.sensor}{in_test(self.test)}", 0.0,
            max(lower, RULES.gain_weakest) if self.kind == "gain" else lower, RULES.limit * sd, _UNITS[self.kind],
            prior_sd=sd,
            description=f"{self.kind} of the {of} of {self.side} {self.sensor}{in_test(self.test)}",
        )  # fmt: skip

    def factor(self, value: float, freq: np.ndarray) -> np.ndarray:
        """Factor of the measured functions at a value in SI, (n_freq,), complex."""
        own = np.full(len(freq), 1 + value, dtype=complex)
        if self.kind != "gain":
            own = np.exp(1j * value * (np.ones(len(freq)) if self.kind == "phase" else -2 * np.pi * freq))
        return own if self.side == "response" or self.multiplies else 1 / own

    def log_slope(self, value: float, freq: np.ndarray) -> np.ndarray:
        """Derivative of the logarithm of the factor at a value in SI, (n_freq,), complex."""
        own = np.full(len(freq), 1 / (1 + value), dtype=complex)
        if self.kind != "gain":
            own = 1j * (np.ones(len(freq)) if self.kind == "phase" else -2 * np.pi * freq)
        return own if self.side == "response" or self.multiplies else -own


class Loading(ABC):
    """What changes the matrices of the model during the whole test, whichever functions were measured."""

    of_channel: ClassVar[tuple[FactorError, ...]] = ()
    of_rows: ClassVar[tuple[RowError, ...]] = ()

    @abstractmethod
    def load(self, model: StructuralModel) -> Load:
        """Its term in the model."""

    def loads(self, model: StructuralModel) -> tuple[Load, ...]:
        """Its only term."""
        return (self.load(model),)

    def concerns(self, measured: MeasuredFRFs) -> bool:
        """True: it is there whatever is measured."""
        return True


@dataclass(frozen=True)
class AccelerometerMass(Loading):
    """Mass of an accelerometer at its place, in all three translations; it is there during the whole test.

    Attributes
    ----------
    sensor : Sensor
        With its place.
    mass : float
        kg, of the data sheet: the nominal value.
    prior_sd : float, optional
        kg; `RULES.mass_sd` of the mass by default.
    test : str
        As of `ChannelError`.

    Raises
    ------
    InputError
        For a negative mass, or a standard deviation that is not positive.
    """

    sensor: Sensor
    mass: float
    prior_sd: float | None = None
    test: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        place = f"added mass at {self.sensor.name}"
        if not 0 <= self.mass < np.inf:
            raise InputError(f"it is {self.mass:g} kg", place=place, remedy="give that of the data sheet, in kg")
        if self.mass == 0 and self.prior_sd is None:
            raise InputError("it has no standard deviation", place=place, remedy="give mass or prior_sd in kg")
        require_positive_std(self.prior_sd, place)

    @property
    def parameter(self) -> Parameter:
        """Such as ``mass_12``."""
        sd = RULES.mass_sd * self.mass if self.prior_sd is None else self.prior_sd
        return Parameter(
            f"mass_{self.sensor.node}{in_test(self.test)}", self.mass,
            max(0.0, self.mass - RULES.limit * sd), self.mass + RULES.limit * sd, "kg", prior_sd=sd,
            description=f"mass of the accelerometer at node {self.sensor.node}{in_test(self.test)}",
        )  # fmt: skip

    def load(self, model: StructuralModel) -> Load:
        """Its term in the model; its rotary inertia and the offset of its centre are neglected."""
        return Load(self.parameter, "mass", model.translations(self.sensor))


@dataclass(frozen=True)
class Stinger(Loading):
    """Stiffness of an exciter's stinger, to the ground at a reference.

    Attributes
    ----------
    sensor : Sensor
        The reference with its place.
    prior_sd : float
        N/m.
    directions : tuple of str
        Of x, y, z; by default the two across the reference. The force along it is measured, so that a stiffness there
        is no error unless the force gauge sits at the exciter's end.
    test : str
        As of `ChannelError`.

    Raises
    ------
    InputError
        For other directions, a reference that is a moment, or a standard deviation that is not positive.
    """

    sensor: Sensor
    prior_sd: float
    directions: tuple[str, ...] = ()
    test: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        place = f"stinger at {self.sensor.name}"
        if self.sensor.direction not in DIRECTIONS[:3] or not set(self.directions) <= set(DIRECTIONS[:3]):
            raise InputError("it does not act along x, y or z", place=place, remedy="give translations")
        require_positive_std(self.prior_sd, place)

    @property
    def parameter(self) -> Parameter:
        """Such as ``stinger_3z``."""
        return Parameter(
            f"stinger_{self.sensor.name}{in_test(self.test)}", 0.0, 0.0, RULES.limit * self.prior_sd, "N/m",
            prior_sd=self.prior_sd,
            description=f"stiffness of the stinger at {self.sensor.name}{in_test(self.test)}",
        )  # fmt: skip

    def load(self, model: StructuralModel) -> Load:
        """Its term in the model; InputError where the model suppresses all its motions."""
        across = tuple(d for d in DIRECTIONS[:3] if d != self.sensor.direction)
        rows = model.translations(self.sensor)[[DIRECTIONS.index(d) for d in self.directions or across]]
        if not np.any(rows):
            raise InputError(
                f"the model suppresses {', '.join(self.directions or across)} there, so that it has no effect",
                place=f"stinger at {self.sensor.name}", remedy="leave it out, or give the directions in which it acts",
            )  # fmt: skip
        return Load(self.parameter, "stiffness", rows)


Nuisance = ChannelError | PlaceError | RotationError | CrossTalkError | AccelerometerMass | Stinger | ResonanceError
NUISANCES = get_args(Nuisance)
"""All kinds."""


def channel_nuisances(
    measured: MeasuredFRFs,
    gain: float | None = None,
    phase: float | None = None,
    delay: float | None = None,
    accelerometer: float | None = None,
    stinger: float | None = None,
    resonance: float | None = None,
) -> tuple[Nuisance, ...]:
    r"""The same nuisances for all channels, and at all resonances; without a number there is none of that kind.

    Parameters
    ----------
    measured : MeasuredFRFs
    gain, phase, delay : float, optional
        Prior standard deviations, in %, degrees and s, of the channels of all responses and references.
    accelerometer : float, optional
        Mass at every node with a response, kg.
    stinger : float, optional
        Prior standard deviation of the stiffness at every reference, N/m.
    resonance : float, optional
        Standard deviation of what the model is off by at the peak of every resonance, % of the modulus; see
        `calib.correlation.frf.resonances.ResonanceError`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = Path(folder, "hammer.csv")
    ...     _ = table.write_text("freq,response,reference,re,im\n10,12z,3z,0.2,-0.01\n11,12z,3z,0.3,-0.02")
    ...     frfs = calib.read_frfs(table, unit="m/s2/N")
    >>> [error.parameter.name for error in calib.channel_nuisances(frfs, gain=1.0)]
    ['gain_12z', 'gain_force_3z']
    """
    out: list[Nuisance] = []
    sds: dict[ChannelKind, float | None] = {"gain": gain, "phase": phase, "delay": delay}
    for kind, sd in sds.items():
        if sd is not None:
            out += [ChannelError(kind, s.name, "response", sd) for s in measured.responses]
            out += [ChannelError(kind, s.name, "reference", sd) for s in measured.references]
    if accelerometer is not None:
        nodes = {s.node: s for s in reversed(measured.responses)}
        out += [AccelerometerMass(sensor, accelerometer) for sensor in reversed(nodes.values())]
    if stinger is not None:
        out += [Stinger(sensor, stinger) for sensor in measured.references]
    if resonance is not None:
        out += of_every_resonance(measured, resonance)
    return tuple(out)


def belonging_to(test: str, nuisances: Sequence[Nuisance]) -> tuple[Nuisance, ...]:
    """The same nuisances as those of one of several tests, whose name their parameters bear.

    Another test has its own cables, amplifiers and mountings: even a channel of the same name is another one there.
    """
    return tuple(replace(nuisance, test=test) for nuisance in nuisances)


def concerned(nuisances: Sequence[Nuisance], measured: MeasuredFRFs) -> tuple[Nuisance, ...]:
    """Those that concern some of the data: of its channels, transducers and lines, and all that load a model."""
    return tuple(n for n in nuisances if n.concerns(measured))


def require_channels(nuisances: Sequence[Nuisance], measured: MeasuredFRFs) -> None:
    """InputError for the error of a channel, of a transducer or of a resonance that was not measured."""
    found: list[Any] = [own for n in nuisances for own in (*n.of_channel, *n.of_rows)]
    for error in found:
        if not error.concerns(measured):
            names = error.among(measured)
            there = f"there {'are' if len(names) > 1 else 'is'} {', '.join(names)}"
            raise InputError(
                f"{error.side_words}{error.name!r} was not measured", place=error.place,
                remedy=there if names else "give one that was measured",
            )  # fmt: skip


def channel_names(measured: MeasuredFRFs, side: str) -> tuple[str, ...]:
    """Names of all channels of responses or of references."""
    return tuple(s.name for s in (measured.responses if side == "response" else measured.references))
