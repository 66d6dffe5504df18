"""Parameters and the space they span: limits, units, distributions and linear constraints."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.errors.arguments import number, objects
from calib.errors.errors import InputError
from calib.problem.constraint import LinearConstraint
from calib.problem.parameter import Parameter
from calib.problem.prior import PLACE, prior_correlations

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["LinearConstraint", "Parameter", "ParameterSpace", "replace_parameters"]


@dataclass(frozen=True)
class ParameterSpace:
    """Named parameters with limits and linear constraints; every change returns a new space.

    The *free* parameters (not fixed) span the arrays used by samplers and searches, in the order of `parameters`.

    Attributes
    ----------
    parameters : tuple of Parameter
    constraints : tuple of LinearConstraint

    Examples
    --------
    >>> import calib
    >>> space = calib.ParameterSpace((
    ...     calib.Parameter("k", 30.0, 1.0, 100.0, "kN/m"), calib.Parameter("m", 7.0, 1.0, 50.0, "kg"),
    ... ))
    >>> space.freeze({"m": 8.0}).free_names
    ('k',)
    >>> space.si({"k": 40.0})
    {'k': 40000.0}
    """

    parameters: tuple[Parameter, ...]
    constraints: tuple[LinearConstraint, ...] = ()
    _by_name: Mapping[str, Parameter] = field(init=False, repr=False, compare=False)
    # Cached per parameter: hundreds of parameters are completed thousands of times.
    _nominal: Mapping[str, float] = field(init=False, repr=False, compare=False)
    _factors: Mapping[str, float] = field(init=False, repr=False, compare=False)
    _integers: tuple[str, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", objects(self.parameters, Parameter, "parameter space"))
        by_name = {p.name: p for p in self.parameters}
        if len(by_name) != len(self.parameters):
            raise InputError("two parameters share a name", place="parameter space")
        object.__setattr__(self, "_by_name", by_name)
        object.__setattr__(self, "_nominal", {p.name: float(p.value) for p in self.parameters})
        object.__setattr__(self, "_factors", {p.name: p.si_factor for p in self.parameters})
        object.__setattr__(self, "_integers", tuple(p.name for p in self.parameters if p.integer))
        for constraint in self.constraints:
            for name, _ in constraint.coefficients:
                if self._require(name, f"constraint {constraint.name}").is_log:
                    raise InputError(
                        f"{name} has a logarithmic scale and is in a sum", place=f"constraint {constraint.name}",
                        remedy='give it scale = "linear", or leave it out of the constraint',
                    )  # fmt: skip

    def __getitem__(self, name: str) -> Parameter:
        return self._require(name, "parameter space")

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __str__(self) -> str:
        """A short table: values with their limits, and standard deviations of the priors."""
        if not self.parameters:
            return "no parameter"
        rows: list[tuple[str, ...]] = [("parameter", "value", "unit", "lower", "upper", "prior std")]
        for p in self.parameters:
            limits = ("fixed", "", "") if p.distribution == "fixed" else (p.lower, p.upper, p.prior_width)
            rows.append((p.name, *(x if isinstance(x, str) else f"{x:.4g}" for x in (p.value, p.unit, *limits))))
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        lines = ["  ".join(x.ljust(width) for x, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        lines += [f"{c.lower:g} <= {c.name} <= {c.upper:g} {c.unit}" for c in self.constraints]
        return "\n".join(lines)

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """As notebooks show it; ``repr`` holds everything, since digests are made of it."""
        printer.text(str(self))

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def _require(self, name: str, place: str) -> Parameter:
        if name not in self._by_name:
            known = ", ".join(self._by_name) or "none"
            near = difflib.get_close_matches(name, self._by_name, n=1)
            words = f"unknown parameter {name!r}" + (f" (did you mean {near[0]!r}?)" if near else "")
            raise InputError(words, place=place, remedy=f"the model's parameters are {known}")
        return self._by_name[name]

    # -- views -------------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(self._by_name)

    @property
    def values(self) -> dict[str, float]:
        """Nominal value of every parameter, each in its own unit."""
        return {p.name: p.value for p in self.parameters}

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Parameters that are not fixed."""
        return tuple(p for p in self.parameters if p.distribution != "fixed")

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters; the columns of every array of points."""
        return tuple(p.name for p in self.free)

    @property
    def lower(self) -> np.ndarray:
        """Lower limits of the free parameters, shape (n_free,)."""
        return np.array([p.lower for p in self.free], dtype=float)

    @property
    def upper(self) -> np.ndarray:
        """Upper limits of the free parameters, shape (n_free,)."""
        return np.array([p.upper for p in self.free], dtype=float)

    @property
    def integer(self) -> np.ndarray:
        """Which free parameters take integers only, shape (n_free,), bool."""
        return np.array([p.integer for p in self.free], dtype=bool)

    @property
    def log(self) -> np.ndarray:
        """Which free parameters have a logarithmic scale, shape (n_free,), bool."""
        return np.array([p.is_log for p in self.free], dtype=bool)

    def frame(self) -> pd.DataFrame:
        """One row per parameter: value, limits, unit, distribution, scale, prior width, description and source."""
        import pandas as pd

        return pd.DataFrame(
            [
                {
                    "parameter": p.name,
                    "symbol": p.symbol,
                    "value": p.value,
                    "lower": p.lower,
                    "upper": p.upper,
                    "unit": p.unit,
                    "distribution": p.distribution,
                    "scale": p.scale,
                    "integer": p.integer,
                    "prior_sd": p.prior_width,
                    "description": p.description,
                    "source": p.source,
                    "assumed": p.assumed,
                }
                for p in self.parameters
            ]
        )

    # -- changes -----------------------------------------------------------------------------------------------------

    def replace(self, name: str, **changes: object) -> ParameterSpace:
        """Same space with some fields of one parameter changed; raises InputError for an unknown name."""
        target = self[name]
        new = replace(target, **changes)  # type: ignore[arg-type]
        return replace_parameters(self, tuple(new if p.name == name else p for p in self.parameters))

    def widen(self, limits: Mapping[str, tuple[float, float]]) -> ParameterSpace:
        """Same space with new limits ``{name: (lower, upper)}``."""
        space = self
        for name, (low, high) in limits.items():
            space = space.replace(name, lower=float(low), upper=float(high))
        return space

    def freeze(self, values: Mapping[str, float]) -> ParameterSpace:
        """Same space with the named parameters fixed at the given values."""
        space = self
        for name, value in values.items():
            space = space.replace(name, value=number(value, name), distribution="fixed")
        return space

    def held(self, condition: Mapping[str, float]) -> ParameterSpace:
        """Same space with the parameters of a test's condition fixed; InputError for a value outside the limits."""
        for name, value in condition.items():
            p = self[name]
            if p.lower < p.upper and not p.lower <= number(value, name) <= p.upper:
                raise InputError(
                    f"{name} = {value:g} {p.unit} is outside its limits {p.lower:g} to {p.upper:g}",
                    remedy="correct the value, or widen the limits in the model",
                )
        return self.freeze(condition)

    def without(self, values: Mapping[str, float]) -> ParameterSpace:
        """Same space without the named parameters, fixed at the given values in the constraints."""
        if not values:
            return self
        self.complete(values)
        kept = []
        for c in self.constraints:
            left = tuple((name, k) for name, k in c.coefficients if name not in values)
            held = sum(k * values[name] for name, k in c.coefficients if name in values)
            if left:
                kept.append(replace(c, coefficients=left, lower=c.lower - held, upper=c.upper - held))
        return ParameterSpace(tuple(p for p in self.parameters if p.name not in values), tuple(kept))

    def correlated(self, names: Sequence[str], matrix: Sequence[Sequence[float]]) -> ParameterSpace:
        """Same space with the priors of some parameters correlated, by a matrix in the order of their names.

        The correlations are those of the standard normal values of the priors (a Gaussian copula): of the values
        themselves where priors are normal. Samples keep them too; a parameter that is held has none.

        Raises
        ------
        InputError
            For an unknown name, an integer, a uniform prior, and as `calib.problem.prior.prior_correlations`.
        """
        own, space = prior_correlations(names, matrix), self
        for name, correlation in own.items():
            self._require(name, PLACE)
            space = space.replace(name, prior_correlation=correlation)
        return space

    def keep(self, names: Iterable[str]) -> ParameterSpace:
        """Same space with every parameter outside ``names`` fixed at its nominal value."""
        kept = tuple(names)
        for name in kept:
            if self[name].distribution == "fixed":
                raise InputError(
                    f"parameter {name!r} is fixed and cannot be selected",
                    place="selection",
                    remedy=f"set fixed = false under [parameters.{name}], and limits",
                )
        return self.freeze({p.name: p.value for p in self.free if p.name not in kept})

    # -- points ------------------------------------------------------------------------------------------------------

    def complete(self, x: np.ndarray | Mapping[str, float]) -> dict[str, float]:
        """All parameters at one point.

        Parameters
        ----------
        x : ndarray (n_free,) or mapping
            Values of the free parameters, or any named values; missing ones take their nominal value.
        """
        given = (
            dict(zip(self.free_names, np.asarray(x, dtype=float).tolist(), strict=True))
            if isinstance(x, np.ndarray)
            else x
        )
        if not given.keys() <= self._nominal.keys():
            for name in given:
                self._require(name, "parameter values")
        values = {**self._nominal, **given}
        if set(map(type, values.values())) != {float}:
            try:
                values = {name: float(value) for name, value in values.items()}
            except (TypeError, ValueError):
                values = {name: number(value, f"value of {name}") for name, value in values.items()}
        if not all(map(math.isfinite, values.values())):
            name, value = next((n, v) for n, v in values.items() if not math.isfinite(v))
            raise InputError(f"value of {name!r} is {value}", place="parameter values")
        for name in self._integers:
            values[name] = float(round(values[name]))
        return values

    def from_unit(self, unit: np.ndarray) -> np.ndarray:
        """Points of the unit cube scaled to the limits; integers have equal parts of the unit interval.

        Parameters
        ----------
        unit : ndarray (n, n_free)

        Returns
        -------
        ndarray (n, n_free)
            Each column in its parameter's own unit.
        """
        lower, upper = self.lower, self.upper
        integers = np.minimum(lower + np.floor(unit * (upper - lower + 1.0)), upper)
        return np.where(self.integer, integers, self.between(unit))

    def between(self, position: np.ndarray) -> np.ndarray:
        """Points at places (n, n_free) between the limits along the scales, integers like others, (n, n_free)."""
        lower, upper = self.coordinates(self.lower), self.coordinates(self.upper)
        return self.of_coordinates(lower + position * (upper - lower))

    def position(self, points: np.ndarray) -> np.ndarray:
        """Places of points (n, n_free) between the limits along the scales, 0 to 1; see `between`."""
        lower, upper = self.coordinates(self.lower), self.coordinates(self.upper)
        return np.asarray((self.coordinates(points) - lower) / (upper - lower))

    def coordinates(self, points: np.ndarray) -> np.ndarray:
        """Points (..., n_free) along the scales: natural logarithms on logarithmic ones."""
        return np.where(self.log, np.log(np.where(self.log, points, 1.0)), points) if self.log.any() else points

    def of_coordinates(self, coordinates: np.ndarray) -> np.ndarray:
        """Points (..., n_free) with these `coordinates`; those on logarithmic scales within the limits."""
        if not (log := self.log).any():
            return np.asarray(coordinates)
        values = np.clip(np.exp(np.where(log, coordinates, 0.0)), self.lower, self.upper)
        return np.where(log, values, coordinates)

    def si(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values in SI; the only place where parameter units are converted."""
        if not values.keys() <= self._factors.keys():
            for name in values:
                self._require(name, "parameter values")
        return {name: value * self._factors[name] for name, value in values.items()}

    def constraint_rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coefficients of the free parameters (n_con, n_free), and limits less the fixed part (n_con,)."""
        names = self.free_names
        rows = np.zeros((len(self.constraints), len(names)))
        low, high = np.empty(len(self.constraints)), np.empty(len(self.constraints))
        for i, constraint in enumerate(self.constraints):
            shift = 0.0
            for name, c in constraint.coefficients:
                if name in names:
                    rows[i, names.index(name)] += c
                else:
                    shift += c * self[name].value
            low[i], high[i] = constraint.lower - shift, constraint.upper - shift
        return rows, low, high

    def violation(self, points: np.ndarray) -> np.ndarray:
        """Violation of each constraint at each point, 0 where it is satisfied.

        Parameters
        ----------
        points : ndarray (n, n_free)

        Returns
        -------
        ndarray (n, n_constraints)
            Distance outside the limits, in the constraint's own unit.
        """
        rows, low, high = self.constraint_rows()
        sums = np.atleast_2d(points) @ rows.T
        return np.maximum(0.0, np.maximum(low - sums, sums - high))

    def feasible(self, points: np.ndarray) -> np.ndarray:
        """Which points satisfy limits and constraints, shape (n,), bool, with a tolerance of 1e-9 of the range."""
        points = np.atleast_2d(points)
        slack = 1e-9 * (self.upper - self.lower)
        inside = np.all((points >= self.lower - slack) & (points <= self.upper + slack), axis=1)
        scale = np.array(
            [max(1.0, *(abs(v) for v in (c.lower, c.upper) if math.isfinite(v))) for c in self.constraints]
        )
        return inside & np.all(self.violation(points) <= 1e-9 * scale, axis=1)

    def require_feasible(self) -> None:
        """Raise InputError when no point of the space satisfies all constraints (by linear programming)."""
        rows, low, high = self.constraint_rows()
        if not len(rows):
            return
        if not len(self.free):
            broken = [c.name for c, a, b in zip(self.constraints, low, high, strict=True) if not a <= 0 <= b]
            if broken:
                raise InputError(f"the fixed values break constraint {broken[0]!r}", place="constraints")
            return
        own = np.array([parameter.value for parameter in self.free])
        if self.feasible(own).all():
            return
        from scipy.optimize import linprog  # slow to import, and most spaces hold their own values

        upper, lower = np.isfinite(high), np.isfinite(low)
        matrix = np.vstack([rows[upper], -rows[lower]])
        bound = np.concatenate([high[upper], -low[lower]])
        limits = list(zip(self.lower, self.upper, strict=True))
        solution = linprog(np.zeros(rows.shape[1]), A_ub=matrix, b_ub=bound, bounds=limits, method="highs")
        if solution.status == 2:
            names = ", ".join(c.name for c in self.constraints)
            raise InputError(
                f"no point within the limits keeps the constraints ({names})",
                place="constraints",
                remedy="widen the parameter limits or the constraint's tolerance",
            )


def replace_parameters(space: ParameterSpace, parameters: tuple[Parameter, ...]) -> ParameterSpace:
    """A space with other parameters and the same constraints."""
    return ParameterSpace(parameters, space.constraints)
