"""Corrections of measured modes for known faults of their channels and of their analysis; files stay as they are."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.measurement.modal import MeasuredModes

_LEAST_GAIN = 0.05
"""Smallest size of a channel's gain by which its readings are divided: below, it measured nothing."""

Correct = Callable[[MeasuredModes, re.Match[str], float], MeasuredModes]


def corrected(
    measured: MeasuredModes, faults: Mapping[str, float], place: str | Place = "measurement"
) -> MeasuredModes:
    """Measured modes without faults of given magnitudes, named as an explanation names them; noted in `notes`.

    Parameters
    ----------
    measured : MeasuredModes
    faults : mapping from str to float
        Such as ``{"gain of sensor 12y": -0.1}`` (it reads 10 % low), ``{"delay of sensor 12y": 1.5}`` (ms),
        ``{"cross-talk of sensor 3x into 12y": 0.05}`` or ``{"damping added to all modes": 0.002}``.
    place : str or Place
        For errors.

    Raises
    ------
    InputError
        For a fault that cannot be corrected, a sensor that was not measured, or a magnitude that leaves nothing.
    """
    for name, magnitude in faults.items():
        for pattern, correct in _CORRECTIONS.items():
            match = re.fullmatch(pattern, name)
            if match is not None:
                try:
                    measured = correct(measured, match, float(magnitude))
                except InputError as fault:
                    raise InputError(f"{name}: {fault.problem}", place=place, remedy=fault.remedy) from None
                break
        else:
            raise InputError(
                f"there is no correction of {name!r}", place=place,
                remedy="correct the gain, delay or cross-talk of a sensor, or damping added to all modes",
            )  # fmt: skip
        note = f"corrected for {name} = {magnitude:g}; the files stay as they are"
        measured = replace(measured, notes=(*measured.notes, note))
    return measured


def correctable(name: str) -> bool:
    """Whether a fault of that name can be corrected."""
    return any(re.fullmatch(pattern, name) for pattern in _CORRECTIONS)


def _index(measured: MeasuredModes, name: str) -> int:
    names = [sensor.name for sensor in measured.sensors]
    if name not in names:
        raise InputError(
            f"sensor {name!r} was not measured", place=name, remedy=f"the sensors are {', '.join(names) or 'none'}"
        )
    return names.index(name)


def _gain(measured: MeasuredModes, match: re.Match[str], by: float) -> MeasuredModes:
    k, factor = _index(measured, match["sensor"]), 1 + by
    if abs(factor) < _LEAST_GAIN:
        raise InputError(
            f"a gain of {factor:g} leaves nothing of its motion", place=match["sensor"], remedy="leave the sensor out"
        )
    shapes, std = measured.shapes.copy(), measured.shape_std.copy()
    shapes[k] /= factor
    std[k] /= abs(factor)
    return replace(measured, shapes=shapes, shape_std=std)


def _delay(measured: MeasuredModes, match: re.Match[str], by: float) -> MeasuredModes:
    k, shapes = _index(measured, match["sensor"]), np.array(measured.shapes, dtype=complex)
    shapes[k] *= np.exp(2j * np.pi * measured.natural_freq * 1e-3 * by)
    return replace(measured, shapes=shapes)


def _cross_talk(measured: MeasuredModes, match: re.Match[str], by: float) -> MeasuredModes:
    source, k = _index(measured, match["source"]), _index(measured, match["sensor"])
    shapes = measured.shapes.copy()
    shapes[k] = shapes[k] - by * shapes[source]
    return replace(measured, shapes=shapes)


def _damping(measured: MeasuredModes, match: re.Match[str], by: float) -> MeasuredModes:
    freq, damped = measured.natural_freq, measured.damping_ratio > 0
    middle = float(np.exp(np.mean(np.log(freq[damped])))) if damped.any() else 1.0
    pattern = {"to all modes": np.ones(len(freq)), "M": middle / freq, "K": freq / middle}[match["how"]]
    ratio = measured.damping_ratio - by * pattern
    if np.any(ratio[damped] <= 0):
        raise InputError(
            f"less than nothing is left of the damping of {measured.names[int(np.nanargmin(ratio))]}",
            place="damping", remedy="give a smaller one",
        )  # fmt: skip
    return replace(measured, damping_ratio=ratio)


_SENSOR = r"(?P<sensor>\S+)"
_CORRECTIONS: Mapping[str, Correct] = {
    rf"gain of sensor {_SENSOR}": _gain,
    rf"delay of sensor {_SENSOR}": _delay,
    rf"cross-talk of sensor (?P<source>\S+) into {_SENSOR}": _cross_talk,
    r"damping added (?:in proportion to )?(?P<how>to all modes|M|K)": _damping,
}
