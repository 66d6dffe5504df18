"""Unnamed local changes of a function: of what goes in, of parts of its answer, of what is told of these."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib.effect import Effect
from calib.function import FunctionModel
from calib.measurement.modal import Sensor
from calib.measurement.responses import response_kinds
from calib.space import Parameter, ParameterSpace
from calib.structure.atoms import RELATIVE, Atom
from calib.structure.followed import successors
from calib.structure.modal_answer import modes_of
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.modes import Modes

FAULT = 0.1
"""Plausible error of a part of the answer: of its scale, and of all alike over the mean size of its values."""

_NOWHERE = (math.nan, math.nan, math.nan)

Model = FunctionModel | ModalFunctionModel
Read = Callable[[Any, Mapping[str, float]], Any]
"""What a model's function answers at all of its values, checked."""
Mix = Callable[[Any, Any], Any]
"""An answer with a part of it taken from another."""
Alter = Callable[[Any, float], Any]
"""An answer of which a part is told wrongly by a strength."""


def blocks_of(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Responses that may be off together: those of one kind, or each by itself where all are of one kind."""
    kinds = response_kinds(names)
    if len(set(kinds.values())) == 1:
        return {name: (name,) for name in names}
    return {kind: tuple(n for n in names if kinds[n] == kind) for kind in dict.fromkeys(kinds.values())}


def response_atoms(
    space: ParameterSpace, measured: Mapping[str, float], test: str = "", held: Collection[str] = ()
) -> tuple[Atom, ...]:
    """What may be off in a function of plain responses by itself, whole numbers aside.

    Every parameter that is held, changed; every parameter that is fitted, changed for one block of responses only,
    where that differs from a fault of the measurement; and of every block an offset and an error of scale (an offset
    alone where all its values are the same).

    Parameters
    ----------
    space : ParameterSpace
        Free are the parameters that a calibration would fit.
    measured : mapping
        Measured value of every response.
    test : str
        Where there are several, the one that was measured: told with what is of it only.
    held : collection of str
        Parameters that are held for this test only.
    """
    blocks = blocks_of(list(measured))
    parts: dict[str, Mix] = {}
    if len(blocks) < len(measured):
        parts = {block: _chosen(own) for block, own in blocks.items()}
    found = [*_changed(space, _responses, parts, _of(test), held)]
    for block, own in blocks.items():
        size = float(np.mean([abs(measured[name]) for name in own])) or 1.0
        found.append(_misread(f"offset of {block}{_of(test)}", block, _responses, _offset(own, size), f"{size:.3g}"))
        if len({measured[name] for name in own}) > 1:
            found.append(_misread(f"scale of {block}{_of(test)}", block, _responses, _scale(own)))
    return tuple(found)


def modal_function_atoms(
    model: ModalFunctionModel,
    space: ParameterSpace,
    sensors: Sequence[Sensor],
    test: str = "",
    held: Collection[str] = (),
) -> tuple[Atom, ...]:
    """What may be off in a function of modes by itself, whole numbers aside.

    Every parameter that is held, changed; every parameter that is fitted, changed for frequencies, damping ratios or
    shapes only; and as faults of the measurement the scale of all frequencies and damping ratios, and the gain of every
    sensor.

    Parameters
    ----------
    model : ModalFunctionModel
    space, test, held
        As of `response_atoms`.
    sensors : sequence of Sensor
        Of the measured shapes.
    """
    parts = {"frequency": _frequencies_of, "damping": _damping_of, "shape": _shapes_of}
    scales: dict[str, Alter] = {"frequency": _higher, "damping": _more_damped}
    if not model.damped:
        del parts["damping"], scales["damping"]
    found = [*_changed(space, _modes, parts, _of(test), held)]
    found += [
        _misread(f"scale of {kind}{_of(test)}", kind, _modes, scale, lower=-0.5) for kind, scale in scales.items()
    ]
    for sensor in sensors:
        row = int(np.argmax(model.sensor_rows([sensor])[0]))
        found.append(_gain(sensor, row, _of(test)))
    return tuple(found)


def _of(test: str) -> str:
    return f" in test {test}" if test else ""


# -- what goes in ------------------------------------------------------------------------------------------------------


def _changed(
    space: ParameterSpace, read: Read, parts: Mapping[str, Mix], of_test: str, held: Collection[str]
) -> list[Atom]:
    """Every parameter that is held, changed; every one that is fitted, changed for one part of the answer.

    What is held for one test only bears its name. None are whole numbers, and parameters that are 0 without a range.
    """
    moving = [p for p in space.parameters if not p.integer and (p.value != 0 or p.upper > p.lower)]
    fixed = [p for p in moving if p.distribution == "fixed"]
    found = [_change(p, f"change of {p.name}{of_test if p.name in held else ''}", read) for p in fixed]
    for p in moving:
        if p not in fixed:
            found += [_change(p, f"change of {p.name} in {part}", read, mix) for part, mix in parts.items()]
    return found


def _change(p: Parameter, name: str, read: Read, mix: Mix | None = None) -> Atom:
    """A parameter changed by a share of its value, or of its range where that is 0; for a part of the answer or all.

    Where it is changed for all, what the function answers is passed on as it is.
    """
    span = 0.0 if p.value != 0 else p.upper - p.lower
    strength = Parameter(name, 0.0, -1.0 if span else -0.9, 1.0 if span else 9.0, "-", prior_sd=RELATIVE)

    def build(model: Model) -> Callable[[Mapping[str, float]], Any]:
        def changed(values: Mapping[str, float]) -> Any:
            rest = {n: v for n, v in values.items() if n != name}
            moved = rest | {p.name: rest[p.name] + values[name] * (span or rest[p.name])}
            if mix is None or values[name] == 0:
                return model.function(moved)
            return mix(read(model, rest), read(model, moved))

        return changed

    lacks = f"{p.name} is held at {p.value:g} {p.unit}" if mix is None else f"{p.name} is one for all that is told"
    part = "" if p.value == 0 else name.removeprefix("change of ")
    return Atom(Effect(name, name, lacks, "its true value", strength, build, part=part), "parameter", _NOWHERE)


# -- what is told of the answer ----------------------------------------------------------------------------------------


def _misread(name: str, what: str, read: Read, alter: Alter, size: str = "each value", lower: float = -1.0) -> Atom:
    """A part of the answer read too high."""
    lacks, look_for = f"What is said of {what} has no such error.", f"How {what} was measured."
    strength = Parameter(name, 0.0, lower, 1.0, "-", prior_sd=FAULT)
    return Atom(_fault(f"{name}, in parts of {size}", lacks, look_for, strength, read, alter), "response", _NOWHERE)


def _gain(sensor: Sensor, row: int, of_test: str) -> Atom:
    """One sensor that tells too much by a share."""

    def alter(modes: Modes, by: float) -> Modes:
        shapes = modes.shapes.copy()
        shapes[row] *= 1 + by
        return replace(modes, shapes=shapes)

    name = f"gain of sensor {sensor.name}{of_test}"
    strength = Parameter(name, 0.0, -0.9, 9.0, "-", prior_sd=RELATIVE)
    lacks, look_for = "All sensors tell the same motion alike.", "Its calibration and its mounting."
    return Atom(
        _fault(name, lacks, look_for, strength, _modes, alter), "response", sensor.point or _NOWHERE, sensor.name
    )


def _fault(title: str, lacks: str, look_for: str, strength: Parameter, read: Read, alter: Alter) -> Effect:
    name = strength.name

    def build(model: Model) -> Callable[[Mapping[str, float]], Any]:
        return lambda values: alter(read(model, {n: v for n, v in values.items() if n != name}), values[name])

    return Effect(name, title, lacks, look_for, strength, build, of_measurement=True)


# -- answers of plain responses ----------------------------------------------------------------------------------------


def _responses(model: FunctionModel, values: Mapping[str, float]) -> Mapping[str, float]:
    return model.function(values)


def _chosen(own: Collection[str]) -> Mix:
    return lambda base, other: {n: other[n] if n in own else r for n, r in base.items()}


def _offset(own: Collection[str], size: float) -> Alter:
    return lambda answer, by: {n: r + by * size if n in own else r for n, r in answer.items()}


def _scale(own: Collection[str]) -> Alter:
    return lambda answer, by: {n: r + by * r if n in own else r for n, r in answer.items()}


# -- answers of modes --------------------------------------------------------------------------------------------------


def _modes(model: ModalFunctionModel, values: Mapping[str, float]) -> Modes:
    return modes_of(model.function(values), model.sensors, model.n_modes, model.damped)


def _followed(base: Modes, other: Modes) -> Modes:
    """The modes that some have become, in the order of those."""
    return other.subset(successors(base.shapes, base.natural_freq, other)[0])


def _frequencies_of(base: Modes, other: Modes) -> Modes:
    mixed = replace(base, natural_freq=_followed(base, other).natural_freq)
    return mixed.subset(np.argsort(mixed.natural_freq, kind="stable"))


def _damping_of(base: Modes, other: Modes) -> Modes:
    return replace(base, damping_ratio=_followed(base, other).damping_ratio)


def _shapes_of(base: Modes, other: Modes) -> Modes:
    return replace(base, shapes=_followed(base, other).shapes)


def _higher(modes: Modes, by: float) -> Modes:
    return replace(modes, natural_freq=modes.natural_freq * (1 + by))


def _more_damped(modes: Modes, by: float) -> Modes:
    return replace(modes, damping_ratio=modes.damping_ratio * (1 + by))
