"""A function that returns modes, with any of its possible effects; what may be off in it by itself."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.function import extend_function
from calib.mac import mac
from calib.measurement.modal import Sensor
from calib.outcome import Outcome
from calib.questions.function_atoms import FAULT, RELATIVE, changes_of_held, moved_parameter, moving
from calib.questions.function_hypotheses import Failure
from calib.space import Parameter, ParameterSpace
from calib.structure.atoms import Atom
from calib.structure.followed import successors
from calib.structure.modal_answer import modes_of
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.modes import Modes

NEUTRAL = 1e-6
"""Relative change of a frequency, change of a damping ratio and loss of MAC up to which an effect of strength 0 changes
nothing."""

_NOWHERE = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class FunctionVariants:
    """A base function extended by effects and local changes; what `calib.structure.variants.Variants` is for matrices.

    All of them are parameters of one common model. An effect of strength 0 is left out when it is asked, so that all
    variants share the calls that they have in common; whether it really changes nothing is checked once.

    Attributes
    ----------
    model : ModalFunctionModel
        The base model.
    effects, atoms : tuple of Effect
        Named effects, then local changes, in the order they are built one upon the other.
    failures : list of Failure
        Points at which a function gave no answer.
    """

    model: ModalFunctionModel
    effects: tuple[Effect, ...]
    atoms: tuple[Effect, ...]
    failures: list[Failure] = field(init=False, repr=False, default_factory=list)
    _chains: dict[tuple[str, ...], ModalFunctionModel] = field(init=False, repr=False, default_factory=dict)

    @property
    def basis(self) -> None:
        """None: there is nothing to reduce."""
        return

    def added(self, names: Sequence[str]) -> int:
        """No modes: a function gives as many as it is declared to."""
        return 0

    def with_effects(self, names: Sequence[str]) -> ModalFunctionModel:
        """A model whose parameters include those of all effects and local changes; InputError for an unknown name."""
        for name in names:
            if name not in self._by_name:
                raise InputError(f"there is no effect {name!r}", place=f"model {self.model.name}")
        return self._common

    @cached_property
    def _by_name(self) -> dict[str, Effect]:
        return {e.name: e for e in (*self.effects, *self.atoms)}

    @cached_property
    def _common(self) -> ModalFunctionModel:
        further = tuple(p for e in self._by_name.values() for p in e.parameters)
        space = ParameterSpace(self.model.space.parameters + further, self.model.space.constraints)
        return _Common(
            self.model.name, space, self._ask, self.model.sensors, self.model.n_modes, self.model.damped,
            self.model.step, strengths=frozenset(self._by_name),
        )  # fmt: skip

    def _ask(self, values: Mapping[str, float]) -> Modes:
        active = tuple(name for name in self._by_name if values.get(name, 0.0) != 0)
        for name in active:
            self._require_neutral(self._by_name[name])
        return self._modes(active, values)

    def _modes(self, active: tuple[str, ...], values: Mapping[str, float]) -> Modes:
        if active not in self._chains:
            self._chains[active] = extend_function(self._base, [self._by_name[name] for name in active])
        model = self._chains[active]
        own = {name: float(values[name]) for name in model.space.names}
        try:
            return model.modes(own, model.n_modes)
        except EvaluationError as fault:
            failure = Failure(active, Outcome(own, "failed", {}, str(fault)))
            if failure not in self.failures:
                self.failures.append(failure)
            raise

    @cached_property
    def _base(self) -> ModalFunctionModel:
        return kept(self.model)

    @cached_property
    def _neutral(self) -> set[str]:
        return {a.name for a in self.atoms}

    def _require_neutral(self, effect: Effect) -> None:
        """InputError when strength 0 is not the base model: the derivative there would be that of a jump."""
        if effect.name in self._neutral or effect.strength.value != 0:
            return
        self._neutral.add(effect.name)
        adopted = self.model.space.values
        try:
            base = self._modes((), adopted)
            with_it = self._modes((effect.name,), adopted | {p.name: p.value for p in effect.parameters})
        except EvaluationError:
            return
        changes = {
            "a frequency": np.abs(with_it.natural_freq / base.natural_freq - 1).max(),
            "a damping ratio": np.abs(with_it.damping_ratio - base.damping_ratio).max(),
            "a shape, in MAC,": 1 - np.diag(mac(base.shapes, with_it.shapes)).min(),
        }
        for what, change in changes.items():
            if change > NEUTRAL:
                raise InputError(
                    f"with strength 0 it changes {what} by {100 * change:.3g} %", place=f"effect {effect.name}",
                    remedy="let what it builds give the base model's modes there",
                )  # fmt: skip


@dataclass(frozen=True)
class _Common(ModalFunctionModel):
    """A model with all effects; one with which the function fails has no derivative where it is not in the model."""

    strengths: frozenset[str] = frozenset()

    def _optional(self, values: Mapping[str, float]) -> Collection[str]:
        return {name for name in self.strengths if values[name] == self.space[name].value}


@dataclass(frozen=True, eq=False)
class Kept:
    """A function whose answers are kept: variants of a model ask for the same points again and again.

    Attributes
    ----------
    function : callable
    """

    function: Callable[[Mapping[str, float]], Any]
    _found: dict[tuple[tuple[str, float], ...], Any] = field(init=False, repr=False, default_factory=dict)

    def __call__(self, values: Mapping[str, float]) -> Any:
        """A copy of the function's answer; what it raised, it raises again."""
        key = tuple(sorted((n, float(v)) for n, v in values.items()))
        if key not in self._found:
            try:
                self._found[key] = self.function(dict(values))
            except Exception as fault:
                self._found[key] = fault
        if isinstance(self._found[key], Exception):
            raise self._found[key]
        return copy.deepcopy(self._found[key])


def kept(model: ModalFunctionModel) -> ModalFunctionModel:
    """The model with its function's answers kept."""
    return model if isinstance(model.function, Kept) else replace(model, function=Kept(model.function))


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
    space : ParameterSpace
        Free are the parameters that a calibration would fit.
    sensors : sequence of Sensor
        Of the measured shapes.
    test : str
        Where there are several, the one that was measured: told with what is of it only.
    held : collection of str
        Parameters that are held for this test only.
    """
    of_test = f" in test {test}" if test else ""
    kinds = ("frequency", "damping", "shape") if model.damped else ("frequency", "shape")
    found = [Atom(effect, "parameter", _NOWHERE) for effect in changes_of_held(space, of_test, held)]
    for p in moving(space):
        if p.distribution != "fixed":
            found += [Atom(_change_in(p, kind), "parameter", _NOWHERE) for kind in kinds]
    found += [Atom(_misread(kind, of_test), "response", _NOWHERE) for kind in kinds if kind != "shape"]
    for sensor in sensors:
        row = int(np.argmax(model.sensor_rows([sensor])[0]))
        found.append(Atom(_gain(sensor, row, of_test), "response", sensor.point or _NOWHERE, sensor.name))
    return tuple(found)


def _change_in(p: Parameter, kind: str) -> Effect:
    """A parameter changed for one kind of what the modes tell."""
    name = f"change of {p.name} in {kind}"
    strength, moved = moved_parameter(p, name)

    def build(model: ModalFunctionModel) -> Callable[[Mapping[str, float]], Modes]:
        def changed(values: Mapping[str, float]) -> Modes:
            rest = {n: v for n, v in values.items() if n != name}
            base = _modes(model, rest)
            if values[name] == 0:
                return base
            other = _modes(model, rest | {p.name: moved(rest[p.name], values[name])})
            other = other.subset(successors(base.shapes, base.natural_freq, other)[0])
            if kind == "shape":
                return replace(base, shapes=other.shapes)
            if kind == "damping":
                return replace(base, damping_ratio=other.damping_ratio)
            mixed = replace(base, natural_freq=other.natural_freq)
            return mixed.subset(np.argsort(mixed.natural_freq, kind="stable"))

        return changed

    lacks = f"{p.name} is one for frequencies, damping and shapes"
    return Effect(name, name, lacks, "its true value", strength, build, part=name.removeprefix("change of "))


def _misread(kind: str, of_test: str) -> Effect:
    """All frequencies or damping ratios read too high by a share."""
    name = f"scale of {kind}{of_test}"

    def build(model: ModalFunctionModel) -> Callable[[Mapping[str, float]], Modes]:
        def read(values: Mapping[str, float]) -> Modes:
            base, factor = _modes(model, {n: v for n, v in values.items() if n != name}), 1 + values[name]
            if kind == "frequency":
                return replace(base, natural_freq=base.natural_freq * factor)
            return replace(base, damping_ratio=base.damping_ratio * factor)

        return read

    strength = Parameter(name, 0.0, -0.5, 1.0, "-", prior_sd=FAULT)
    lacks, look_for = f"What is said of {kind} has no such error.", f"How {kind} was measured."
    return Effect(name, f"{name}, in parts of each value", lacks, look_for, strength, build, of_measurement=True)


def _gain(sensor: Sensor, row: int, of_test: str) -> Effect:
    """One sensor that tells too much by a share."""
    name = f"gain of sensor {sensor.name}{of_test}"

    def build(model: ModalFunctionModel) -> Callable[[Mapping[str, float]], Modes]:
        def read(values: Mapping[str, float]) -> Modes:
            base = _modes(model, {n: v for n, v in values.items() if n != name})
            shapes = base.shapes.copy()
            shapes[row] *= 1 + values[name]
            return replace(base, shapes=shapes)

        return read

    strength = Parameter(name, 0.0, -0.9, 9.0, "-", prior_sd=RELATIVE)
    lacks, look_for = "All sensors tell the same motion alike.", "Its calibration and its mounting."
    return Effect(name, name, lacks, look_for, strength, build, of_measurement=True)


def _modes(model: ModalFunctionModel, values: Mapping[str, float]) -> Modes:
    return modes_of(model.function(values), model.sensors, model.n_modes, model.damped)
