"""Unnamed local changes of a plain function: of what goes in, of how groups of responses feel it, of what comes out."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.effect import Effect
from calib.function import FunctionModel
from calib.measurement.responses import response_kinds
from calib.space import Parameter, ParameterSpace

RELATIVE = 0.3
"""Plausible relative change of a parameter."""
FAULT = 0.1
"""Plausible error of a group of responses: of their scale, and of all alike over the mean size of their values."""

Function = Callable[[Mapping[str, float]], Mapping[str, float]]


def blocks_of(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Responses that may be off together: those of one kind, or each by itself where all are of one kind."""
    kinds = response_kinds(names)
    if len(set(kinds.values())) == 1:
        return {name: (name,) for name in names}
    return {kind: tuple(n for n in names if kinds[n] == kind) for kind in dict.fromkeys(kinds.values())}


def function_atoms(
    space: ParameterSpace, measured: Mapping[str, float], test: str = "", held: Collection[str] = ()
) -> tuple[Effect, ...]:
    """What may be off in a function by itself, whole numbers aside.

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
    of_test = f" in test {test}" if test else ""
    blocks = blocks_of(list(measured))
    out = changes_of_held(space, of_test, held)
    if len(blocks) < len(measured):
        out += [
            _change(p, f"change of {p.name} in {block}", own)
            for p in moving(space)
            if p.distribution != "fixed"
            for block, own in blocks.items()
        ]
    for block, own in blocks.items():
        size = float(np.mean([abs(measured[name]) for name in own])) or 1.0
        out.append(_misread(f"offset of {block}{of_test}", block, own, size))
        if len({measured[name] for name in own}) > 1:
            out.append(_misread(f"scale of {block}{of_test}", block, own))
    return tuple(out)


def moving(space: ParameterSpace) -> list[Parameter]:
    """Parameters that may change: no whole numbers, and none that is 0 and has no range."""
    return [p for p in space.parameters if not p.integer and (p.value != 0 or p.upper > p.lower)]


def changes_of_held(space: ParameterSpace, of_test: str = "", held: Collection[str] = ()) -> list[Effect]:
    """Every parameter that is held, changed; what the function answers is passed on as it is.

    What is held for one test only bears its name.
    """
    return [
        _change(p, f"change of {p.name}{of_test if p.name in held else ''}", None)
        for p in moving(space)
        if p.distribution == "fixed"
    ]


def moved_parameter(p: Parameter, name: str) -> tuple[Parameter, Callable[[float, float], float]]:
    """Strength of a change of a parameter, and its value from the one it has and that strength.

    A share of its value, or of its range where that is 0.
    """
    span = 0.0 if p.value != 0 else p.upper - p.lower
    strength = Parameter(name, 0.0, -1.0 if span else -0.9, 1.0 if span else 9.0, "-", prior_sd=RELATIVE)
    return strength, lambda own, by: own + by * (span or own)


def _change(p: Parameter, name: str, block: Collection[str] | None) -> Effect:
    """A parameter changed by a share of its value, or of its range where that is 0; for some responses or for all."""
    strength, moved_by = moved_parameter(p, name)

    def build(model: FunctionModel) -> Function:
        def changed(values: Mapping[str, float]) -> Mapping[str, float]:
            rest = {n: v for n, v in values.items() if n != name}
            moved = model.function(rest | {p.name: moved_by(values[p.name], values[name])})
            if block is None or values[name] == 0:
                return moved
            return {n: moved[n] if n in block else v for n, v in model.function(rest).items()}

        return changed

    held = f"{p.name} is held at {p.value:g} {p.unit}" if block is None else f"{p.name} is one for all responses"
    part = "" if p.value == 0 else name.removeprefix("change of ")
    return Effect(name, name, held, "its true value", strength, build, part=part)


def _misread(name: str, block: str, own: Collection[str], size: float | None = None) -> Effect:
    """The responses of a block read too high, at strength 1 by a size, or else by their own value."""

    def build(model: FunctionModel) -> Function:
        def read(values: Mapping[str, float]) -> Mapping[str, float]:
            rest = {n: v for n, v in values.items() if n != name}
            right = model.function(rest)
            by = values[name]
            return {n: r + by * (r if size is None else size) if n in own else r for n, r in right.items()}

        return read

    strength = Parameter(name, 0.0, -1.0, 1.0, "-", prior_sd=FAULT)
    title = f"{name}, in parts of {'each value' if size is None else f'{size:.3g}'}"
    lacks, look_for = f"What is said of {block} has no such error.", f"How {block} was measured."
    return Effect(name, title, lacks, look_for, strength, build, of_measurement=True)


@dataclass(frozen=True, eq=False)
class Remembered:
    """A function whose answers are kept: local changes ask for the same points again and again.

    Attributes
    ----------
    function : callable
    """

    function: Function
    _found: dict[tuple[tuple[str, float], ...], Mapping[str, float] | Exception] = field(
        init=False, repr=False, default_factory=dict
    )

    @property
    def calls(self) -> int:
        """Calls so far, failed ones included."""
        return len(self._found)

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """The function's answer; what it raised, it raises again."""
        key = tuple(sorted((n, float(v)) for n, v in values.items()))
        if key not in self._found:
            try:
                self._found[key] = dict(self.function(dict(values)))
            except Exception as fault:
                self._found[key] = fault
        found = self._found[key]
        if isinstance(found, Exception):
            raise found
        return dict(found)
