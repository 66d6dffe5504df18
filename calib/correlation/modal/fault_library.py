"""Faults that any modal test may have: of its channels, of the places of its sensors, of its analysis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.modal.faults import Contribution, ModalFault
from calib.correlation.modal.pair_faults import exchanged_axes, exchanges, mixed_modes
from calib.errors.errors import InputError
from calib.measurement.mac import is_real
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.problem.candidate import NOWHERE
from calib.problem.space import Parameter
from calib.results.answer import hertz
from calib.structure.geometry import Mesh
from calib.structure.modal_model import ModalModel
from calib.structure.places import along_mesh

At = tuple[str, tuple[float, float, float]]
"""Name of a sensor and its place."""
NEGLIGIBLE = 1e-9
"""Motion of a source, over that of the sensor, below which the model suppresses it."""
LACKS: Mapping[str, str] = {
    "gain": "The sensor reads the motion as it is.",
    "delay": "All channels are sampled at the same time.",
    "place": "The sensor is where the table says.",
    "cross-talk": "Every channel reads its own sensor only.",
}
"""What is assumed without a fault, by its kind."""
LOOK_FOR: Mapping[str, str] = {
    "gain": "Check its calibration, its mounting and its sign.",
    "delay": "Check its filter and its sampling.",
    "rotation": "Check how it is mounted.",
    "place": "Measure where it sits.",
    "cross-talk": "Check cables and the order of the channels.",
}
"""What to check, by the kind of a fault of a sensor."""


def modal_faults(
    model: ModalModel, measured: MeasuredModes, set_ups: Mapping[str, Sequence[str]] | None = None, test: str = ""
) -> tuple[ModalFault, ...]:
    """Faults that a modal test of a model may have.

    Of every sensor its gain; with complex shapes its delay; misalignment towards every other axis along which the model
    moves at its node; its place along the mesh; the share it reads of the channels before and after it. Of every set-up
    its factor. Of the analysis damping added to all modes: equal, falling with the frequency (as damping in proportion
    to M) or rising with it (to K); and, where shapes are real and the model dissipates, moduli with a sign. Of pairs
    the exchange of any two channels, that of two axes at one node, the share that a channel reads of any
    other one, and the share of a neighbouring mode in a shape (see `calib.correlation.modal.pair_faults`).

    Parameters
    ----------
    model : ModalModel
    measured : MeasuredModes
        The fitted data.
    set_ups : mapping from str to sequence of str, optional
        Names of the sensors of each set-up.
    test : str
        Name of the test, where there are several; appended to every name.
    """
    suffix = f" in test {test}" if test else ""
    found = [*_of_sensors(model, measured), *_of_set_ups(measured, set_ups or {})] if measured.has_shapes else []
    found += _of_analysis(model, measured)
    if measured.has_shapes:
        found += [*exchanges(measured.sensors), *exchanged_axes(measured.sensors), *_far_cross_talk(measured.sensors)]
        found += mixed_modes(measured)
    return tuple(_named(fault, suffix) for fault in found) if suffix else tuple(found)


def _named(fault: ModalFault, suffix: str) -> ModalFault:
    """The same with a suffix to its name."""
    name = f"{fault.name}{suffix}"
    return replace(fault, magnitude=replace(fault.magnitude, name=name), title=name)


def _sized(name: str, size: float, lower: float, upper: float, unit: str = "-") -> Parameter:
    return Parameter(name, 0.0, lower, upper, unit, prior_sd=size)


# -- sensors -----------------------------------------------------------------------------------------------------------


def _of_sensors(model: ModalModel, measured: MeasuredModes) -> Iterator[ModalFault]:
    sensors = measured.sensors
    rows = model.sensor_rows(sensors)
    complex_shapes = bool(np.any(~is_real(measured.shapes)))
    for k, sensor in enumerate(sensors):
        at = (sensor.name, sensor.point or NOWHERE)
        yield _gain(k, sensor, at)
        if complex_shapes:
            yield _delay(k, sensor, float(measured.natural_freq.max()), at)
        for source in turned_sensors(model, sensor, rows[k]):
            yield _rotation(k, sensor, source, at)
        yield from _shifts(model, k, sensor, at)
        for source in adjacent_channels(sensors, k):
            yield _cross_talk(k, sensor, source, at)


def turned_sensors(model: ModalModel, sensor: Sensor, row: np.ndarray) -> Iterator[Sensor]:
    """The sensor along each other axis of x, y, z along which the model moves there, and not only as along its own.

    ``row`` is its motion over the degrees of freedom of the model, (n_dof,). A sensor of a rotation has none.
    """
    for other in (d for d in DIRECTIONS[:3] if sensor.direction in DIRECTIONS[:3] and d != sensor.direction):
        source = replace(sensor, direction=other)
        if _moves(model, source, row):
            yield source


def adjacent_channels(sensors: Sequence[Sensor], k: int) -> tuple[Sensor, ...]:
    """Sensors of the channels before and after one in the list."""
    return tuple(sensors[i] for i in (k - 1, k + 1) if 0 <= i < len(sensors))


def ways(model: ModalModel, sensor: Sensor) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Where a sensor may sit instead, as of `along_mesh`; empty where sensor or mesh have no coordinates."""
    mesh = getattr(model, "mesh", None)
    if sensor.point is None or not isinstance(mesh, Mesh) or not mesh.placed.all():
        return []
    return along_mesh(mesh, sensor.point)


def shift_size(before: np.ndarray, after: np.ndarray) -> float:
    """Plausible error of a place between two points, m, in mm."""
    return min(RULES.shift, 1e3 * RULES.shift_part * float(np.linalg.norm(after - before)))


def _gain(k: int, sensor: Sensor, at: At) -> ModalFault:
    name = f"gain of sensor {sensor.name}"
    return ModalFault(
        _sized(name, RULES.gain, RULES.gain_lower, RULES.gain_upper), name, LACKS["gain"], LOOK_FOR["gain"],
        partial(gain_words, f"sensor {sensor.name}"), "gain", *at, shares=(Contribution(k, sensor),),
    )  # fmt: skip


def gain_words(what: str, by: float) -> str:
    """A gain error in words, such as ``sensor 12y reads 10 % low``."""
    if by < -1.5:
        more = f", and {100 * abs(by + 2):.0f} % {'high' if by < -2 else 'low'}" if abs(by + 2) > 0.1 else ""
        return f"{what} has the wrong sign{more}"
    if abs(by + 1) < 0.2:
        return f"{what} reads next to nothing"
    return f"{what} reads {100 * abs(by):.2g} % {'low' if by < 0 else 'high'}"


def _delay(k: int, sensor: Sensor, highest: float, at: At) -> ModalFault:
    name = f"delay of sensor {sensor.name}"
    size = 1e3 * RULES.phase / (2 * np.pi * highest)
    reach = RULES.limit * size
    return ModalFault(
        _sized(name, size, -reach, reach, "ms"), name, LACKS["delay"], LOOK_FOR["delay"],
        partial(delay_words, f"sensor {sensor.name}"), "delay", *at, shares=(Contribution(k, sensor, "delay"),),
    )  # fmt: skip


def _rotation(k: int, sensor: Sensor, source: Sensor, at: At) -> ModalFault:
    name = f"rotation of sensor {sensor.name} towards {source.direction}"
    shares = (Contribution(k, sensor, "cosine"), Contribution(k, source, "sine"))
    most = RULES.rotation_most
    return ModalFault(
        _sized(name, RULES.rotation, -most, most, "deg"), name, f"The sensor's axis is {sensor.direction}.",
        LOOK_FOR["rotation"], partial(rotation_words, f"sensor {sensor.name}", source.direction),
        "rotation", *at, shares=shares,
    )  # fmt: skip


def _shifts(model: ModalModel, k: int, sensor: Sensor, at: At) -> Iterator[ModalFault]:
    """Shifts of a sensor along the mesh, by the gradient of the shape between the nodes before and after it."""
    for axis, before, after in ways(model, sensor):
        first, last = (replace(sensor, point=(float(p[0]), float(p[1]), float(p[2]))) for p in (before, after))
        length = float(np.linalg.norm(after - before))
        try:
            rows = model.sensor_rows([first, last])
        except InputError:
            continue
        if np.array_equal(*rows):  # a function gives no motion between its sensors
            continue
        name = f"place of sensor {sensor.name} along {axis}"
        size = shift_size(before, after)
        reach = RULES.shift_most * size
        shares = (Contribution(k, last, factor=1 / length), Contribution(k, first, factor=-1 / length))
        yield ModalFault(
            _sized(name, size, -reach, reach, "mm"), name, LACKS["place"], LOOK_FOR["place"],
            partial(place_error_words, f"sensor {sensor.name}", axis), "place", *at, shares=shares,
        )  # fmt: skip


def delay_words(what: str, by: float) -> str:
    """A delay in ms in words, such as ``sensor 12y is late by 0.5 ms``."""
    return f"{what} is {'late' if by > 0 else 'early'} by {abs(by):.2g} ms"


def rotation_words(what: str, axis: str, by: float) -> str:
    """A misalignment in deg in words, such as ``sensor 12y is turned by 9 deg towards x``."""
    return f"{what} is turned by {abs(by):.2g} deg {'towards' if by > 0 else 'away from'} {axis}"


def cross_talk_words(name: str, source: str, by: float) -> str:
    """A share of another channel in words, such as ``sensor 12y reads 9 % of sensor 11y beside its own motion``."""
    return f"sensor {name} reads {100 * by:.2g} % of sensor {source} beside its own motion"


def place_error_words(what: str, axis: str, by: float) -> str:
    """An error of a place in mm in words, such as ``sensor 12y sits 2.4 cm off along +x``."""
    return (
        f"{what} {'sit' if ' and ' in what else 'sits'} {abs(by) / 10:.2g} cm off along {'+' if by > 0 else '-'}{axis}"
    )


def _moves(model: ModalModel, source: Sensor, own: np.ndarray) -> bool:
    """Whether the model moves along a source, and not only as the sensor does."""
    try:
        (row,) = model.sensor_rows([source])
    except InputError:
        return False
    size = float(np.linalg.norm(row))
    along = float(row @ own) / float(own @ own) * own
    return float(np.linalg.norm(row - along)) > NEGLIGIBLE * max(size, 1e-300) and size > 0


def far_channels(sensors: Sequence[Sensor], k: int) -> tuple[Sensor, ...]:
    """Sensors of all channels but one and those before and after it in the list."""
    return tuple(sensor for i, sensor in enumerate(sensors) if abs(i - k) > 1)


def _far_cross_talk(sensors: Sequence[Sensor]) -> Iterator[ModalFault]:
    for k, sensor in enumerate(sensors):
        at = (sensor.name, sensor.point or NOWHERE)
        yield from (replace(_cross_talk(k, sensor, source, at), of_pair=True) for source in far_channels(sensors, k))


def _cross_talk(k: int, sensor: Sensor, source: Sensor, at: At) -> ModalFault:
    name = f"cross-talk of sensor {source.name} into {sensor.name}"
    return ModalFault(
        _sized(name, RULES.cross_talk, -1.0, 1.0), name, LACKS["cross-talk"], LOOK_FOR["cross-talk"],
        partial(cross_talk_words, sensor.name, source.name), "cross-talk", *at, shares=(Contribution(k, source),),
    )  # fmt: skip


# -- set-ups and analysis ----------------------------------------------------------------------------------------------


def _of_set_ups(measured: MeasuredModes, set_ups: Mapping[str, Sequence[str]]) -> Iterator[ModalFault]:
    """A common factor of each group of at least two sensors, and not of all."""
    index = {sensor.name: k for k, sensor in enumerate(measured.sensors)}
    for label, members in set_ups.items():
        own = [index[name] for name in members if name in index]
        if not 2 <= len(own) < len(index):
            continue
        name = f"factor of set-up {label}"
        yield ModalFault(
            _sized(name, RULES.set_up, RULES.gain_lower, RULES.gain_upper), name, "All set-ups are scaled alike.",
            "Check how the set-ups were joined, and the reference sensors.",
            partial(gain_words, f"set-up {label}"),
            "set-up", shares=tuple(Contribution(k, measured.sensors[k]) for k in own),
        )  # fmt: skip


def _of_analysis(model: ModalModel, measured: MeasuredModes) -> Iterator[ModalFault]:
    """Damping added to all modes, and real shapes that are moduli with a sign."""
    freq, damped = measured.natural_freq, measured.damping_ratio > 0
    if not model.dissipates:
        return
    if damped.sum() > 1:
        middle = float(np.exp(np.mean(np.log(freq[damped]))))
        patterns = {
            "damping added to all modes": (np.ones(len(freq)), "and as much to all modes"),
            "damping added in proportion to M": (middle / freq, "less to higher modes and more to lower ones"),
            "damping added in proportion to K": (freq / middle, "more to higher modes and less to lower ones"),
        }
        for name, (pattern, words) in patterns.items():
            yield ModalFault(
                _sized(name, RULES.damping, 0.0, RULES.damping_most * RULES.damping), name,
                "The analysis adds no damping of its own.",
                "Check the window, the frequency resolution and what else dissipated in the test.",
                partial(_damping_words, words, middle),
                "damping", damping=tuple(pattern.tolist()),
            )  # fmt: skip
    real = is_real(measured.shapes) if measured.has_shapes else np.zeros(0, dtype=bool)
    if real.any():
        name = "shapes given as amplitude and sign"
        yield ModalFault(
            _sized(name, 1.0, 0.0, 2.0), name, "Real shapes are the parts in phase.",
            "Ask for complex shapes, or for the parts in phase.",
            _modulus_words,
            "modulus", modulus=True,
        )  # fmt: skip


def _damping_words(how: str, middle: float, by: float) -> str:
    return f"the analysis or its background adds {100 * by:.2g} % of damping at {hertz(middle)}, {how}"


def _modulus_words(by: float) -> str:
    return "the real shapes are amplitudes with a sign, not the parts in phase"
