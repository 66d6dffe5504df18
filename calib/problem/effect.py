"""Effect: a physical effect that a model may lack, with its magnitude, nuisance parameters and construction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from calib.errors.errors import InputError
from calib.problem.candidate import WithMagnitude
from calib.problem.space import Parameter, ParameterSpace


@dataclass(frozen=True)
class Effect(WithMagnitude):
    """One physical effect that the base model leaves out.

    Attributes
    ----------
    name : str
        Identifier used in tables, files and on the command line; also the name of its magnitude.
    title : str
        Common engineering name.
    lacks : str
        What the base model does instead, one sentence.
    look_for : str
        What to look for on the real structure, one sentence.
    magnitude : Parameter
        Named as the effect. Its ``prior_sd`` is a large but plausible magnitude (the evidence depends on it), its
        limits are physical. It may be negative only if its lower limit is. Its value is that of the base model: 0, or a
        small lower limit where the matrices have no derivative at 0.
    build : callable
        Takes the model and returns the addition: a `calib.structure.effects.extend.Addition` for a structural model,
        the function of the extended parameters for a function model, of responses or of modes.
    nuisance : tuple of Parameter
        Further parameters of an effect of nonzero magnitude, such as the frequency of a hung mass, with physical
        limits.
    grid : tuple of mapping from str to float
        Magnitude and nuisance parameters at which the effect's signature is taken by difference; required with nuisance
        parameters, which have no meaning at magnitude 0 (Davies 1987). Without a grid the signature is the derivative
        at the base model.
    part : str
        Part of the model that is scaled by 1 + magnitude; empty for an added one.
    of_measurement : bool
        Whether it is a measurement error, not an effect missing in the model.
    told : callable, optional
        What a fitted magnitude of a measurement error means, such as ``sensor 12y reads 10 % low``.
    richer : Effect, optional
        The same physics in more detail, with more parameters, such as a body that also rocks on its mounts. It is no
        candidate of the first question: it is fitted after the decision where this effect is like what is missing, but
        not exactly. It has a name of its own; nuisance parameters that mean the same may be shared. A chain is allowed.
    places : tuple of str
        Names of the places at one of which it acts, such as ``("floor 1", "floor 2")``; see
        `calib.structure.anywhere.at_one_of`. It then has the nuisance parameter ``<name>_place``, an integer that
        counts them from 1, and a grid with a point for each. All of them count in the search.
    generic : bool
        Whether it was composed of the model's own parts and points instead of listed by somebody who knows what may be
        missing. Of several effects that are named together at most one is.
    phrase : str
        Completes "The model lacks ...", such as ``a brake unit hung on the crossbar``; by default the title, quoted.

    Raises
    ------
    InputError
        When the attributes are inconsistent.

    Examples
    --------
    A spring that hardens; its model has one stiffness only. Deflections are in mm, loads in N:

    >>> import calib
    >>> space = calib.ParameterSpace((calib.Parameter("k", 10.0, 5.0, 20.0, "kN/m"),))
    >>> model = calib.FunctionModel("spring", space, lambda v: {f"load_{d}": v["k"] * d for d in (1, 2, 3, 4)})
    >>> hardening = calib.Effect(
    ...     "cubic", "hardening", "Its stiffness is constant.", "Coils that touch.",
    ...     calib.Parameter("cubic", 0.0, -1.0, 1.0, prior_sd=0.2),
    ...     lambda model: lambda v: {f"load_{d}": v["k"] * d + v["cubic"] * d**3 for d in (1, 2, 3, 4)},
    ... )
    >>> test = calib.ResponseTest({"load_1": 10.3, "load_2": 21.2, "load_3": 33.3, "load_4": 47.2})
    >>> fit = calib.Problem(model, test).with_effects([hardening]).calibrate()
    >>> round(fit.values["k"], 1), round(fit.values["cubic"], 1)
    (10.2, 0.1)
    """

    name: str
    title: str
    lacks: str
    look_for: str
    magnitude: Parameter
    build: Callable[[Any], Any]
    nuisance: tuple[Parameter, ...] = ()
    grid: tuple[Mapping[str, float], ...] = ()
    part: str = ""
    of_measurement: bool = False
    phrase: str = ""
    told: Callable[[float], str] | None = None
    richer: Effect | None = None
    places: tuple[str, ...] = ()
    generic: bool = False

    def __post_init__(self) -> None:
        place, p = f"effect {self.name}", self.magnitude
        if p.name != self.name:
            raise InputError(f"its magnitude is named {p.name!r}", place=place, remedy=f"name it {self.name!r}")
        if p.prior_sd is None:
            raise InputError("no plausible size is given", place=place, remedy="give its magnitude a prior_sd")
        if not p.lower <= p.value <= p.upper or abs(p.value) > 0.01 * p.prior_sd or p.distribution == "fixed":
            raise InputError(
                f"its magnitude of {p.value:g} {p.unit} is not that of the base model",
                place=place,
                remedy="give it the value 0 within its limits",
            )
        if self.nuisance and not self.grid:
            raise InputError(
                "its nuisance parameters have no meaning at magnitude 0", place=place, remedy="give a grid of values"
            )
        names = {q.name for q in self.parameters}
        for point in self.grid:
            if set(point) != names or not all(math.isfinite(v) for v in point.values()):
                raise InputError(
                    f"its grid has a point {dict(point)}", place=place, remedy=f"give {', '.join(sorted(names))}"
                )
            if point[p.name] == 0:
                raise InputError("its grid has a point of magnitude 0", place=place, remedy="give it a magnitude")
        self._require_family()
        if self.places:
            self._require_places()

    def _require_family(self) -> None:
        """InputError where two members of the family have one name, or mean different things by one parameter."""
        known: dict[str, Parameter] = {}
        for one in self.family:
            if one.name in known:
                words = f"its family has the parameter {one.name!r} twice"
                raise InputError(words, place=f"effect {self.name}", remedy="give each member a name of its own")
            known[one.name] = one.magnitude
            for p in one.nuisance:
                if known.setdefault(p.name, p) != p:
                    raise InputError(
                        f"its family has different parameters {p.name!r}", place=f"effect {self.name}",
                        remedy="give one of them another name, or both the same values",
                    )  # fmt: skip

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Magnitude first, then nuisance parameters."""
        return (self.magnitude, *self.nuisance)

    def _require_places(self) -> None:
        """InputError where the parameter that chooses the place is missing, or the grid lacks a place."""
        place, count = f"effect {self.name}", len(self.places)
        known = [p for p in self.nuisance if p.name == self.place_name and p.integer]
        if not known or (known[0].lower, known[0].upper) != (1, count):
            raise InputError(
                f"nothing chooses among its {count} places", place=place,
                remedy=f"give it the integer nuisance parameter {self.place_name!r} from 1 to {count}",
            )  # fmt: skip
        if {round(point[self.place_name]) for point in self.grid} != set(range(1, count + 1)):
            raise InputError("its grid lacks a place", place=place, remedy="give a point for each place")

    @property
    def place_name(self) -> str:
        """Name of the parameter that chooses among its places."""
        return f"{self.name}_place"

    @property
    def family(self) -> tuple[Effect, ...]:
        """The effect and its richer members, from simple to rich; a model has at most one of them."""
        return (self, *(() if self.richer is None else self.richer.family))

    @property
    def in_words(self) -> str:
        """The effect as part of a sentence; see ``phrase``."""
        return self.phrase or f"the effect {self.title!r}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    def require_new(self, space: ParameterSpace, model: str) -> None:
        """InputError when a model of that name and space already has one of its parameters."""
        for p in self.parameters:
            if p.name in space:
                raise InputError(
                    f"the model {model} has {p.name!r} already", place=f"effect {self.name}", remedy="leave it out"
                )
