"""A physical effect that a model may lack: what it is, how strong it can be, and how it is added."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from calib.errors import InputError
from calib.space import Parameter, ParameterSpace


@dataclass(frozen=True)
class Effect:
    """One physical effect that the base model leaves out.

    Attributes
    ----------
    name : str
        Identifier used in tables, files and on the command line; also the name of its strength.
    title : str
        What an engineer calls it.
    lacks : str
        What the base model does instead, one sentence.
    look_for : str
        What to look for on the real structure, one sentence.
    strength : Parameter
        Named as the effect. Its ``prior_sd`` is what would be a large but plausible strength (the evidence depends on
        it), its limits are physical. It may be negative only if its lower limit is. Its value, the base model's, is 0,
        or a lower limit of next to nothing where the matrices have no derivative at 0.
    build : callable
        Takes the model and returns what is added: an `calib.structure.extend.Addition` for a structural model, the
        function of the extended parameters for a model that is a function, of responses or of modes.
    nuisance : tuple of Parameter
        What else must be known once the strength is not 0, such as the frequency of a hung mass; physical limits.
    grid : tuple of mapping from str to float
        Strength and nuisance parameters at which the effect's fingerprint is taken by difference; needed with nuisance
        parameters, which have no meaning at strength 0 (Davies 1987). Without a grid the fingerprint is the
        derivative at the base model.
    part : str
        What of the model the strength scales, as one more than it; empty for an effect that adds something.
    of_measurement : bool
        Whether it is a fault of the measurement, and nothing that the model lacks.

    Raises
    ------
    InputError
        When these do not fit together.
    """

    name: str
    title: str
    lacks: str
    look_for: str
    strength: Parameter
    build: Callable[[Any], Any]
    nuisance: tuple[Parameter, ...] = ()
    grid: tuple[Mapping[str, float], ...] = ()
    part: str = ""
    of_measurement: bool = False

    def __post_init__(self) -> None:
        place, p = f"effect {self.name}", self.strength
        if p.name != self.name:
            raise InputError(f"its strength is named {p.name!r}", place=place, remedy=f"name it {self.name!r}")
        if p.prior_sd is None:
            raise InputError("no plausible size is given", place=place, remedy="give its strength a prior_sd")
        if not p.lower <= p.value <= p.upper or abs(p.value) > 0.01 * p.prior_sd or p.distribution == "fixed":
            raise InputError(
                f"its strength of {p.value:g} {p.unit} is not that of the base model",
                place=place,
                remedy="give it the value 0 within its limits",
            )
        if self.nuisance and not self.grid:
            raise InputError(
                "its nuisance parameters have no meaning at strength 0", place=place, remedy="give a grid of values"
            )
        names = {q.name for q in self.parameters}
        for point in self.grid:
            if set(point) != names or not all(math.isfinite(v) for v in point.values()):
                raise InputError(
                    f"its grid has a point {dict(point)}", place=place, remedy=f"give {', '.join(sorted(names))}"
                )
            if point[p.name] == 0:
                raise InputError("its grid has a point of strength 0", place=place, remedy="give it a strength")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Strength first, then nuisance parameters."""
        return (self.strength, *self.nuisance)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(p.name for p in self.parameters)

    @property
    def signed(self) -> bool:
        """Whether the strength may be negative."""
        return self.strength.lower < 0

    @property
    def plausible(self) -> float:
        """A large but plausible strength, in its own unit."""
        return self.strength.prior_width

    def require_new(self, space: ParameterSpace, model: str) -> None:
        """InputError when a model of that name and space has one of its parameters already."""
        for p in self.parameters:
            if p.name in space:
                raise InputError(
                    f"the model {model} has {p.name!r} already", place=f"effect {self.name}", remedy="leave it out"
                )
