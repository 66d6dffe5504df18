"""Local perturbations of a function, of its parts, inputs, results and their measurement; hypotheses of any model."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from calib.hypotheses.function_variants import MOVES, FunctionVariants, kept
from calib.hypotheses.hypotheses import ModelHypotheses, VariantPair
from calib.hypotheses.rules import RULES
from calib.measurement.responses import response_kinds
from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from calib.structure import rules as changes
from calib.structure.effects.perturbations import Perturbation, scaling_by_function
from calib.structure.effects.variants import Variants
from calib.structure.eigenproblem.mode_tracking import Moved, successors
from calib.structure.function_model import DERIVES, FunctionModel, response_of, responses_of, slope_entry
from calib.structure.function_parts import ScaledPart
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.modal_result import modes_from_result
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.basis import Basis

_NOWHERE = (math.nan, math.nan, math.nan)

Model = FunctionModel | ModalFunctionModel
Read = Callable[[Any, Mapping[str, float]], Any]
"""Results of a model's function at given values, checked."""
Mix = Callable[[Any, Any], Any]
"""Results with a part taken from others."""
Alter = Callable[[Any, float], Any]
"""Results with a measurement error of given magnitude in a part."""

P = TypeVar("P", bound=VariantPair)


def blocks_of(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Groups of responses that may share an error: by kind, or each response alone where all are of one kind."""
    kinds = response_kinds(names)
    if len(set(kinds.values())) == 1:
        return {name: (name,) for name in names}
    return {kind: tuple(n for n in names if kinds[n] == kind) for kind in dict.fromkeys(kinds.values())}


def response_perturbations(
    space: ParameterSpace,
    measured: Mapping[str, float],
    test: str = "",
    held: Collection[str] = (),
    scaled: Sequence[ScaledPart] = (),
) -> tuple[Perturbation, ...]:
    """Local perturbations of a function of scalar responses, without integer parameters.

    A change of every part; of every held parameter; of every fitted parameter in one block of responses, where that
    differs from a measurement error; and for every block an offset and a scale error (only an offset where all its
    values are equal).

    Parameters
    ----------
    space : ParameterSpace
        Free are the parameters that a calibration would fit.
    measured : mapping
        Measured value of every response.
    test : str
        Name of the test, where there are several; appended to perturbations of this test only.
    held : collection of str
        Parameters held in this test only.
    scaled : sequence of ScaledPart
        Parts that the function scales.
    """
    blocks = blocks_of(list(measured))
    parts: dict[str, Mix] = {}
    if len(blocks) < len(measured):
        parts = {block: _chosen(own) for block, own in blocks.items()}
    found = [*_rescaled(scaled), *_changed(space, _responses, parts, _of(test), held)]
    for block, own in blocks.items():
        size = float(np.mean([abs(measured[name]) for name in own])) or 1.0
        found.append(_misread(f"offset of {block}{_of(test)}", block, _responses, _offset(own, size), f"{size:.3g}"))
        if len({measured[name] for name in own}) > 1:
            found.append(_misread(f"scale of {block}{_of(test)}", block, _responses, _scale(own)))
    return tuple(found)


def modal_function_perturbations(
    model: ModalFunctionModel,
    space: ParameterSpace,
    test: str = "",
    held: Collection[str] = (),
) -> tuple[Perturbation, ...]:
    """Local perturbations of a function of modes, without integer parameters.

    A change of every part; of every held parameter; of every fitted parameter in frequencies, damping ratios or shapes
    only; and as measurement errors the scale of all frequencies and of all damping ratios.

    Parameters
    ----------
    model : ModalFunctionModel
    space, test, held
        As in `response_perturbations`.
    """
    parts = dict(_KINDS)
    scales: dict[str, Alter] = {"frequency": _higher, "damping": _more_damped}
    if not model.damped:
        del parts["damping"], scales["damping"]
    found = [*_rescaled(model.parts), *_changed(space, _modes, parts, _of(test), held)]
    found += [
        _misread(f"scale of {kind}{_of(test)}", kind, _modes, scale, lower=-0.5) for kind, scale in scales.items()
    ]
    return tuple(found)


def _of(test: str) -> str:
    return f" in test {test}" if test else ""


def _rescaled(parts: Sequence[ScaledPart]) -> list[Perturbation]:
    """Every part scaled by the function itself: of the model, and so the same in all tests."""
    return [Perturbation(scaling_by_function(part), part.kind, _NOWHERE) for part in parts]


# -- inputs ------------------------------------------------------------------------------------------------------------


def _changed(
    space: ParameterSpace, read: Read, parts: Mapping[str, Mix], of_test: str, held: Collection[str]
) -> list[Perturbation]:
    """A change of every held parameter, and of every fitted parameter in one part of the results.

    The name of the test is appended where a parameter is held in this test only. Integers, and parameters of value 0
    without a range, are left out.
    """
    moving = [p for p in space.parameters if not p.integer and (p.value != 0 or p.upper > p.lower)]
    fixed = [p for p in moving if p.distribution == "fixed"]
    found = [_change(p, f"change of {p.name}{of_test if p.name in held else ''}", read) for p in fixed]
    for p in moving:
        if p not in fixed:
            found += [_change(p, f"change of {p.name} in {part}", read, mix, part) for part, mix in parts.items()]
    return found


def _change(p: Parameter, name: str, read: Read, mix: Mix | None = None, kind: str = "") -> Perturbation:
    """A relative change of a parameter (of its range where its value is 0), in all results or in one part.

    A change in all results returns those of the function unchecked.
    """
    span = 0.0 if p.value != 0 else p.upper - p.lower
    rules = changes.RULES
    lower, upper = (-1.0, 1.0) if span else (rules.less, rules.more)
    magnitude = Parameter(name, 0.0, lower, upper, "-", prior_sd=rules.relative)

    def build(model: Model) -> Callable[[Mapping[str, float]], Any]:
        def changed(values: Mapping[str, float]) -> Any:
            rest = {n: v for n, v in values.items() if n != name}
            by, unit = values[name], span or rest[p.name]
            moved = rest | {p.name: rest[p.name] + by * unit}
            if mix is None:
                return _chained(model.function(moved), p.name, name, 1.0 if span else 1.0 + by, unit)
            other = _chained(read(model, moved), p.name, name, 1.0 if span else 1.0 + by, unit)
            return mix(read(model, rest), other)

        if kind and mix is _KINDS.get(kind) and p.lower < p.upper:
            setattr(changed, MOVES, lambda values: Moved(p.name, kind, span or values[p.name]))
        return _deriving(changed)

    lacks = f"{p.name} is held at {p.value:g} {p.unit}" if mix is None else f"{p.name} is the same for all responses"
    part = "" if p.value == 0 else name.removeprefix("change of ")
    return Perturbation(Effect(name, name, lacks, "its true value", magnitude, build, part=part), "parameter", _NOWHERE)


# -- measurement -------------------------------------------------------------------------------------------------------


def _misread(
    name: str, what: str, read: Read, alter: Alter, size: str = "each value", lower: float = -1.0
) -> Perturbation:
    """A measurement error of a part of the results, which reads too high by ``lower`` to 1 times ``size``.

    Frequencies and damping ratios stay positive: they read no less than half.
    """
    lacks, look_for = f"The measured {what} has no such error.", f"How {what} was measured."
    magnitude = Parameter(name, 0.0, lower, 1.0, "-", prior_sd=RULES.misread)
    return Perturbation(
        _fault(f"{name}, in parts of {size}", lacks, look_for, magnitude, read, alter), "response", _NOWHERE
    )


def _fault(title: str, lacks: str, look_for: str, magnitude: Parameter, read: Read, alter: Alter) -> Effect:
    name = magnitude.name

    def build(model: Model) -> Callable[[Mapping[str, float]], Any]:
        return _deriving(
            lambda values: alter(read(model, {n: v for n, v in values.items() if n != name}), values[name])
        )

    return Effect(name, title, lacks, look_for, magnitude, build, of_measurement=True)


# -- scalar responses --------------------------------------------------------------------------------------------------


def _responses(model: FunctionModel, values: Mapping[str, float]) -> Mapping[str, float]:
    return model.function(values)


def _deriving(function: Callable[[Mapping[str, float]], Any]) -> Callable[[Mapping[str, float]], Any]:
    """The function, which returns derivatives of its own where the function below it returns any."""
    setattr(function, DERIVES, True)
    return function


def _chained(result: Any, parameter: str, magnitude: str, inner: float, outer: float) -> Any:
    """Responses at a moved parameter, with derivatives by the parameter itself and by the magnitude that moves it.

    Parameters
    ----------
    result : mapping or Modes
        At the moved value, with derivatives by that value; modes have none.
    parameter, magnitude : str
    inner, outer : float
        Derivatives of the moved value by the parameter and by the magnitude.
    """
    if not isinstance(result, Mapping):
        return result
    out = dict(result)
    for response in responses_of(result):
        slope = result.get(slope_entry(response, parameter))
        if slope is not None:
            out[slope_entry(response, parameter)] = inner * slope
            out[slope_entry(response, magnitude)] = outer * slope
    return out


def _chosen(own: Collection[str]) -> Mix:
    def mix(base: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
        return {n: r if response_of(n) in own else base.get(n, 0.0) for n, r in other.items()}

    return mix


def _offset(own: Collection[str], size: float) -> Alter:
    return lambda answer, by: {n: r + by * size if n in own else r for n, r in answer.items()}


def _scale(own: Collection[str]) -> Alter:
    return lambda answer, by: {n: r + by * r if response_of(n) in own else r for n, r in answer.items()}


# -- modes -------------------------------------------------------------------------------------------------------------


def _modes(model: ModalFunctionModel, values: Mapping[str, float]) -> Modes:
    return modes_from_result(model.function(values), model.sensors, model.n_modes, model.damped)


def _tracked(base: Modes, other: Modes) -> Modes:
    """The successors of the base modes, in their order."""
    return other.subset(successors(base, other, np.arange(base.n_modes))[0])


def _frequencies_of(base: Modes, other: Modes) -> Modes:
    mixed = replace(base, natural_freq=_tracked(base, other).natural_freq)
    return mixed.subset(np.argsort(mixed.natural_freq, kind="stable"))


def _damping_of(base: Modes, other: Modes) -> Modes:
    return replace(base, damping_ratio=_tracked(base, other).damping_ratio)


def _shapes_of(base: Modes, other: Modes) -> Modes:
    return replace(base, shapes=_tracked(base, other).shapes)


_KINDS: Mapping[str, Mix] = {"frequency": _frequencies_of, "damping": _damping_of, "shape": _shapes_of}
"""Kinds of results of a function of modes."""


def _higher(modes: Modes, by: float) -> Modes:
    return replace(modes, natural_freq=modes.natural_freq * (1 + by))


def _more_damped(modes: Modes, by: float) -> Modes:
    return replace(modes, damping_ratio=modes.damping_ratio * (1 + by))


# -- hypotheses --------------------------------------------------------------------------------------------------------


def model_hypotheses(
    model: Any,
    pair: P,
    effects: tuple[Effect, ...],
    local: tuple[Perturbation, ...],
    space: ParameterSpace,
    test: str,
    basis: Basis | None = None,
) -> tuple[ModelHypotheses[P], tuple[Perturbation, ...]]:
    """Hypotheses of a model against its test, and its local perturbations.

    Those of matrices are given as ``local``, since all tests of the model share them; a function has its own, which
    bear the name of the ``test`` where there are several.
    """
    if not isinstance(model, StructuralModel):
        return function_hypotheses(model, pair, effects, space, test)
    return ModelHypotheses(pair, Variants(model, effects, tuple(a.effect for a in local), basis), space), local


def function_hypotheses(
    model: FunctionModel | ModalFunctionModel,
    pair: P,
    effects: tuple[Effect, ...],
    space: ParameterSpace,
    test: str = "",
) -> tuple[ModelHypotheses[P], tuple[Perturbation, ...]]:
    """Hypotheses of a function against its test, and its local perturbations.

    The function is called once per point: its values are cached.

    Parameters
    ----------
    model : FunctionModel or ModalFunctionModel
    pair : ResponseResidual or ModalResidual
        The test of that model; of one of modes either.
    effects : tuple of Effect
        Named candidates.
    space : ParameterSpace
        Parameters of the model, without those that the test's condition holds; free are those that a calibration would
        fit.
    test : str
        Name of the test, where there are several; appended to perturbations of this test only.
    """
    held = [p for p in model.space.parameters if p.name not in space]
    whole = ParameterSpace((*space.parameters, *held), space.constraints)
    names, perturbations = [p.name for p in held], tuple[Perturbation, ...]()
    unheld: Any = replace(model, space=whole)
    cached = kept(unheld)
    if isinstance(model, ModalFunctionModel):
        perturbations = modal_function_perturbations(model, whole, test, names)
    else:
        measured = {name: value for name, (value, _) in pair.problem.targets.items()}
        perturbations = response_perturbations(whole, measured, test, names, model.parts)
    variants = FunctionVariants(cached, effects, tuple(a.effect for a in perturbations))
    return ModelHypotheses(pair.with_model(cached), variants, space), perturbations
