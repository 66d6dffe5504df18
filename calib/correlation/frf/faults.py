"""Faults that a test of FRFs may have: of its channels, and of places, axes and cables of its transducers."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.frf.cross_talk import CrossTalkError, ExchangeError
from calib.correlation.frf.nuisance import ChannelError, ChannelKind, Nuisance
from calib.correlation.frf.places import PlaceError
from calib.correlation.frf.rotation import RotationError
from calib.correlation.frf.rows import Side
from calib.correlation.modal.fault_library import (
    LACKS,
    LOOK_FOR,
    adjacent_channels,
    cross_talk_words,
    delay_words,
    far_channels,
    gain_words,
    place_error_words,
    rotation_words,
    shift_size,
    turned_sensors,
    ways,
)
from calib.correlation.modal.pair_faults import CHECK_ORDER, EXCHANGED, exchange_words
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.problem.candidate import NOWHERE, Fault
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel

_LOOK: Mapping[str, str] = {
    **LOOK_FOR, "phase": "Check its filter and its conditioning.", "exchange": CHECK_ORDER
}  # fmt: skip

Model = StructuralModel | ReducedModel
Suspect = ChannelError | PlaceError | RotationError | CrossTalkError
"""An exchange of channels is a `CrossTalkError` of two rows."""


@dataclass(frozen=True)
class FRFFault(Fault):
    """An error of one channel or transducer; its magnitude is the parameter of the error.

    Attributes
    ----------
    error : ChannelError, PlaceError, RotationError or CrossTalkError
    """

    error: Suspect = field(kw_only=True)

    def as_told(self, magnitude: float) -> float:
        """The number that is stated of a magnitude: of the gain of functions of a force how far the force is off.

        The functions are divided by the force.
        """
        if not (isinstance(self.error, ChannelError) and self.error.multiplies):
            return magnitude
        factor = 1 + magnitude / 100
        return 100 * (1 / factor - 1) if factor else np.inf


def frf_faults(
    model: Model, measured: MeasuredFRFs, nuisances: Sequence[Nuisance] = (), test: str = ""
) -> tuple[FRFFault, ...]:
    """Faults that a test of a model's FRFs may have, without errors that its fits determine anyway.

    Of every response and reference gain, phase and delay, the misalignment towards every other axis along which the
    model moves there, and the place along each axis in which the mesh runs there. Of every response also the share it
    reads of the channels before and after it among those that are fitted; of pairs of responses the exchange of any
    two, and the share that one reads of any other one. Gain, phase and delay of the only reference
    are the same as those of all responses. The gain of a reference is that of its functions, which has no pole on the
    way to a swapped sign.

    At a drive point the place is that of both: exciter and accelerometer are mounted at one point, so that the fault
    moves the force too. Their axes are turned each for itself.

    Parameters
    ----------
    model : StructuralModel or ReducedModel
        Without places of its nodes, or for a sensor without one, there is no fault of a place.
    measured : MeasuredFRFs
        The fitted data.
    nuisances : sequence of Nuisance
        Those that are fitted; such an error of another prior, or of another name of the test, is the same.
    test : str
        Name of the test, where there are several; appended to every name.

    Raises
    ------
    InputError
        For a transducer that the model cannot place.
    """
    known = {_name(nuisance) for nuisance in nuisances}
    found = (*_of_channels(measured), *_of_transducers(model, measured), *_of_pairs(measured))
    return tuple(_named(fault, test) for fault in found if fault.name not in known)


def _name(error: Nuisance) -> str:
    """Name of its parameter in a single test, which tells kind, transducer and axis."""
    return replace(error, test="").parameter.name


def _named(fault: FRFFault, test: str) -> FRFFault:
    """The same as one of a test among several."""
    if not test:
        return fault
    error = replace(fault.error, test=test)
    magnitude = replace(fault.magnitude, name=error.parameter.name, description=error.parameter.description)
    return replace(fault, magnitude=magnitude, title=f"{fault.title} in test {test}", error=error)


def _what(side: Side, sensor: Sensor) -> str:
    return f"{'force at' if side == 'reference' else 'sensor'} {sensor.name}"


def _fault(
    error: Suspect,
    kind: str,
    of: str,
    lacks: str,
    told: Callable[[float], str],
    sensor: Sensor,
    magnitude: Parameter | None = None,
) -> FRFFault:
    return FRFFault(
        magnitude or error.parameter, f"{kind} of {of}", lacks, _LOOK[kind], told, kind, sensor.name,
        sensor.point or NOWHERE, error=error,
    )  # fmt: skip


# -- channels ----------------------------------------------------------------------------------------------------------


def _of_channels(measured: MeasuredFRFs) -> Iterator[FRFFault]:
    sizes: dict[ChannelKind, float] = {
        "gain": RULES.frf_gain,
        "phase": RULES.frf_phase,
        "delay": RULES.phase / (2 * np.pi * float(measured.freq.max())),
    }
    words = {"gain": _gain, "phase": _phase, "delay": _delay}
    for side, sensor in _transducers(measured):
        what = _what(side, sensor)
        for kind, size in sizes.items():
            error = ChannelError(kind, sensor.name, side, size, of_functions=kind == "gain")
            magnitude = replace(error.parameter, lower=RULES.frf_gain_lower) if kind == "gain" else None
            lacks, told = "Every channel reads as it is calibrated.", words[kind]
            yield _fault(error, kind, what, lacks, partial(told, what), sensor, magnitude)


def _transducers(measured: MeasuredFRFs) -> Iterator[tuple[Side, Sensor]]:
    for sensor in measured.responses:
        yield "response", sensor
    for sensor in measured.references:
        yield "reference", sensor


def _gain(what: str, percent: float) -> str:
    return gain_words(what, percent / 100) if np.isfinite(percent) else f"{what} reads without limit"


def _phase(what: str, angle: float) -> str:
    return f"{what} {'leads' if angle > 0 else 'lags'} by {abs(angle):.2g} deg"


def _delay(what: str, seconds: float) -> str:
    return delay_words(what, 1e3 * seconds)


# -- transducers -------------------------------------------------------------------------------------------------------


def _of_transducers(model: Model, measured: MeasuredFRFs) -> Iterator[FRFFault]:
    for side, sensor in _transducers(measured):
        yield from _rotations(model, side, sensor)
    responses, references = ({s.name for s in some} for some in (measured.responses, measured.references))
    for sensor in measured.sensors:
        sides = [word for word, names in (("sensor", responses), ("force", references)) if sensor.name in names]
        yield from _places(model, sensor, " and ".join(sides))
    for k, sensor in enumerate(measured.responses):
        yield from (_cross_talk(sensor, source) for source in adjacent_channels(measured.responses, k))


def _cross_talk(sensor: Sensor, source: Sensor) -> FRFFault:
    told = partial(cross_talk_words, sensor.name, source.name)
    error = CrossTalkError(sensor, source, RULES.cross_talk)
    of = f"sensor {source.name} into {sensor.name}"
    return _fault(error, "cross-talk", of, LACKS["cross-talk"], told, sensor)


def _of_pairs(measured: MeasuredFRFs) -> Iterator[FRFFault]:
    responses = measured.responses
    for a, b in itertools.combinations(responses, 2):
        error, told = ExchangeError(a, b, 1.0), partial(exchange_words, a.name, b.name)
        fault = _fault(error, "exchange", f"sensors {a.name} and {b.name}", EXCHANGED, told, a)
        yield replace(fault, sensor=f"{a.name} {b.name}", of_pair=True, whole=True)
    for k, sensor in enumerate(responses):
        yield from (replace(_cross_talk(sensor, source), of_pair=True) for source in far_channels(responses, k))


def _rotations(model: Model, side: Side, sensor: Sensor) -> Iterator[FRFFault]:
    (row,) = model.sensor_rows([sensor])
    what = _what(side, sensor)
    for source in turned_sensors(model, sensor, row):
        axis = source.direction
        error, told = RotationError(sensor, axis, RULES.rotation, side), partial(rotation_words, what, axis)
        lacks = f"The {'force' if side == 'reference' else 'sensor'}'s axis is {sensor.direction}."
        yield _fault(error, "rotation", f"{what} towards {axis}", lacks, told, sensor)


def _places(model: Model, sensor: Sensor, what: str) -> Iterator[FRFFault]:
    """Along the axes x, y, z, each once: where two members go along one, the longer way gives the plausible size."""
    sizes: dict[str, float] = {}
    for way, before, after in ways(model, sensor):
        sizes[way[0]] = max(shift_size(before, after), sizes.get(way[0], 0.0))
    for axis, size in sizes.items():
        of = f"{what} {sensor.name}" if what == "sensor" else f"{what} at {sensor.name}"
        error, told = PlaceError(sensor, axis, size), partial(place_error_words, of, axis)
        if not _matters(error, model):
            continue
        reach = RULES.shift_most * size
        magnitude = replace(error.parameter, lower=-reach, upper=reach)
        yield _fault(error, "place", f"{of} along {axis}", LACKS["place"], told, sensor, magnitude)


def _matters(error: PlaceError, model: Model) -> bool:
    """Whether the model moves differently beside the sensor."""
    try:
        return error.matters(model)
    except InputError:
        return False
