"""Parameter: one named number of a model with its limits, unit, scale, distribution and prior."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from calib.errors.arguments import number
from calib.errors.errors import InputError
from calib.problem.prior import Density

_INCH, _POUND, _FORCE = 0.0254, 0.45359237, 0.45359237 * 9.80665
"""m, kg and N (NIST SP 811); the force is the weight of a pound."""
SI_FACTORS: Mapping[str, float] = {
    "-": 1.0,
    "%": 0.01,
    "m": 1.0,
    "mm": 1e-3,
    "kg": 1.0,
    "g": 1e-3,
    "t": 1e3,
    "kg/m": 1.0,
    "kg/m2": 1.0,
    "kg/m3": 1.0,
    "t/mm3": 1e12,
    "kgm2": 1.0,
    "m2": 1.0,
    "mm2": 1e-6,
    "m4": 1.0,
    "mm4": 1e-12,
    "N": 1.0,
    "kN": 1e3,
    "MN": 1e6,
    "Nm2": 1.0,
    "kNm2": 1e3,
    "MNm2": 1e6,
    "N/m": 1.0,
    "N/mm": 1e3,
    "kN/m": 1e3,
    "MN/m": 1e6,
    "mm/kN": 1e-6,
    "mm/MN": 1e-9,
    "Nm/rad": 1.0,
    "kNm/rad": 1e3,
    "MNm/rad": 1e6,
    "rad/kNm": 1e-3,
    "Nms/rad": 1.0,
    "Ns/m": 1.0,
    "kNs/m": 1e3,
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "GPa": 1e9,
    "mm/MPa": 1e-9,
    "Hz": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180,
    "s": 1.0,
    "ms": 1e-3,
    "in": _INCH, "ft": 12 * _INCH, "in2": _INCH**2, "in4": _INCH**4, "lb": _POUND, "lb/in3": _POUND / _INCH**3,
    "lbf": _FORCE, "kip": 1e3 * _FORCE, "lbf/in": _FORCE / _INCH, "kip/in": 1e3 * _FORCE / _INCH,
    "lbfs/in": _FORCE / _INCH, "lbfs2/in": _FORCE / _INCH, "lbfs2/in4": _FORCE / _INCH**4,
    "psi": _FORCE / _INCH**2, "ksi": 1e3 * _FORCE / _INCH**2,
}  # fmt: skip
"""Factor from the named unit to SI."""

Distribution = Literal["uniform", "fixed"]
Scale = Literal["linear", "log"]
PriorKind = Literal["normal", "log-normal", "heavy-tailed", "uniform"]
_KINDS = ("normal", "log-normal", "heavy-tailed", "uniform")
_MOST_EXPONENT = 230.0
"""Largest natural logarithm of a value, about that of `MOST`."""
MOST = 1e100
"""Largest absolute value of a value or limit; squares of larger ones overflow."""
FINEST_PRIOR = 1e-9
"""Least prior standard deviation over a parameter's range or value, and the inverse of the largest: beyond, sums of
squares lose every digit of the data or of the prior."""


@dataclass(frozen=True)
class Parameter:
    """One named number of a model, in its own unit.

    Attributes
    ----------
    name : str
        Identifier used in tables and files.
    value : float
        Nominal (initial) value, in ``unit``.
    lower, upper : float
        Limits, in ``unit``.
    unit : str
        One of `calib.problem.parameter.SI_FACTORS`.
    distribution : {"uniform", "fixed"}
        A fixed parameter is never sampled or searched.
    integer : bool
        Takes integers only.
    prior_sd : float or None
        Prior standard deviation in ``unit``; of a log-normal prior ``value`` times that of the logarithm. Default is
        that of the uniform distribution between the limits, ``(upper - lower)/sqrt(12)``, of logarithms on a log scale.
        Of a heavy-tailed prior that of the normal one which has the same density at ``value``.
    scale : {"linear", "log"}
        With ``"log"`` samples, searches, steps of fits, intervals and figures take the logarithm of the value.
    prior : {"normal", "log-normal", "heavy-tailed", "uniform"} or sequence of (value, density) or None
        What is known before the test: a normal distribution about ``value``; a log-normal one with the median
        ``value``; a Cauchy distribution about ``value``, which hardly draws a value that is far off (Jeffreys 1961,
        sec. 5.2); every value within the limits alike along the scale, which pulls to none; or a density tabulated
        over values in ``unit``, straight between them, whatever the factor. Default is ``"normal"`` on a linear and
        ``"log-normal"`` on a logarithmic scale.
    prior_correlation : tuple of (str, float)
        Correlation of its prior with those of other parameters, as `ParameterSpace.correlated` states it.
    needed : float or None
        Largest standard deviation in ``unit`` with which the parameter counts as identified; see
        `calib.inference.identify.needed_std` for the default.
    description, symbol, source : str
        Description, symbol in the literature, and source of the numbers.
    assumed : str
        States what is an engineering assumption, not published data; empty when nothing is.

    Examples
    --------
    >>> import calib
    >>> stiffness = calib.Parameter("k", 30.0, 1.0, 100.0, "kN/m", prior_sd=5.0)
    >>> stiffness.value * stiffness.si_factor
    30000.0
    >>> stiffness.limit_at(99.95)
    'upper'
    >>> soil = calib.Parameter("k_soil", 1e6, 1e3, 1e9, "N/m", scale="log")
    >>> round(soil.at(0.5)), round(soil.position(1e8), 3)
    (1000000, 0.833)
    """

    name: str
    value: float
    lower: float
    upper: float
    unit: str = "-"
    distribution: Distribution = "uniform"
    integer: bool = False
    prior_sd: float | None = None
    description: str = ""
    symbol: str = ""
    source: str = ""
    assumed: str = ""
    needed: float | None = None
    scale: Scale = "linear"
    prior: PriorKind | Density | tuple[tuple[float, float], ...] | None = None
    prior_correlation: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        place = f"parameter {self.name}"
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"its name is {self.name!r}", place=place, remedy="give it one")
        if self.distribution not in ("uniform", "fixed"):
            raise InputError(
                f"unknown distribution {self.distribution!r}", place=place, remedy="use 'uniform' or 'fixed'"
            )
        if self.unit not in tuple(SI_FACTORS):
            raise InputError(f"unknown unit {self.unit!r}", place=place, remedy=f"use one of {', '.join(SI_FACTORS)}")
        for label in ("value", "lower", "upper", "prior_sd", "needed"):
            if label not in ("prior_sd", "needed") or getattr(self, label) is not None:
                number(getattr(self, label), f"{place}, {label}")
        for label in ("value", "lower", "upper"):
            if not math.isfinite(getattr(self, label)):
                raise InputError(f"{label} is {getattr(self, label)}", place=place, remedy="give a finite number")
            if abs(getattr(self, label)) > MOST:
                raise InputError(
                    f"{label} is {getattr(self, label):g}", place=place, remedy=f"give a number within {MOST:g}"
                )
        if self.lower > self.upper or (self.lower == self.upper and self.distribution != "fixed"):
            raise InputError(
                f"lower limit {self.lower:g} is not below upper limit {self.upper:g} {self.unit}",
                place=place,
                remedy="write limits as [lower, upper]",
            )
        if self.prior_sd is not None:
            size = max(self.upper - self.lower, abs(self.value)) or 1.0
            least, most = FINEST_PRIOR * size, size / FINEST_PRIOR
            if not least <= self.prior_sd <= most:
                raise InputError(
                    f"prior_sd is {self.prior_sd}",
                    place=place,
                    remedy=f"give a positive number from {least:g} to {most:g} {self.unit}",
                )
        if self.needed is not None and not 0 < self.needed <= MOST:
            raise InputError(
                f"needed is {self.needed}",
                place=place,
                remedy=f"give the standard deviation that you need, a positive number of {self.unit}",
            )
        if self.integer and any(v != round(v) for v in (self.value, self.lower, self.upper)):
            raise InputError("an integer parameter has a fractional value or limit", place=place)
        self._check_scale(place)
        self._check_prior(place)

    def _check_scale(self, place: str) -> None:
        if self.scale not in ("linear", "log"):
            raise InputError(f"unknown scale {self.scale!r}", place=place, remedy="use 'linear' or 'log'")
        if self.is_log and (self.integer or not min(self.lower, self.value) > 0):
            what = "an integer" if self.integer else f"{min(self.lower, self.value):g} {self.unit}"
            remedy = 'use scale = "linear", or give a value and limits above 0'
            raise InputError(f"{what} has no place on a logarithmic scale", place=place, remedy=remedy)

    def _check_prior(self, place: str) -> None:
        if self.prior_correlation and (self.integer or self.prior == "uniform"):
            what = "an integer" if self.integer else "a uniform prior, which draws a fit to no value,"
            raise InputError(f"{what} cannot be correlated", place=place, remedy="leave it out of the matrix")
        if self.prior is None or self.prior == "normal":
            return
        if self.integer:
            raise InputError("an integer has a prior other than a normal one", place=place, remedy="leave prior out")
        if isinstance(self.prior, str):
            if self.prior not in _KINDS:
                remedy = f"use {', '.join(map(repr, _KINDS))}, or pairs of a value and its density"
                raise InputError(f"unknown prior {self.prior!r}", place=place, remedy=remedy)
            if self.prior == "log-normal" and not self.value > 0:
                remedy = "give a value above 0, which is its median"
                raise InputError(f"a log-normal prior has the value {self.value:g}", place=place, remedy=remedy)
            if self.prior == "log-normal" and self.prior_sd is None and not self.lower > 0:
                raise InputError("a log-normal prior has no standard deviation", place=place, remedy="give prior_sd")
        elif not isinstance(self.prior, Density):
            object.__setattr__(self, "prior", Density.of(self.prior, place))
        if self.prior_sd is not None and self.prior not in ("log-normal", "heavy-tailed"):
            remedy = "leave prior_sd out: it follows from the prior"
            raise InputError("both a prior and its standard deviation are given", place=place, remedy=remedy)
        if isinstance(self.prior, Density) and not self.distribution == "fixed":
            self.prior.require(self.lower, self.upper, place)

    @property
    def si_factor(self) -> float:
        """Factor from ``unit`` to SI."""
        return SI_FACTORS[self.unit]

    # -- scale -------------------------------------------------------------------------------------------------------

    @property
    def is_log(self) -> bool:
        """Whether its scale is logarithmic."""
        return self.scale == "log"

    def coordinate(self, value: float) -> float:
        """The value along the scale: its natural logarithm on a logarithmic one."""
        return math.log(value) if self.is_log else value

    def of_coordinate(self, coordinate: float) -> float:
        """The value with this `coordinate`."""
        return math.exp(min(coordinate, _MOST_EXPONENT)) if self.is_log else coordinate

    def position(self, value: float) -> float:
        """Place between the limits along the scale: 0 at the lower one, 1 at the upper one."""
        low, high = self.coordinate(self.lower), self.coordinate(self.upper)
        return (self.coordinate(value) - low) / (high - low)

    def at(self, position: float) -> float:
        """The value at a place between the limits; see `position`."""
        low, high = self.coordinate(self.lower), self.coordinate(self.upper)
        return self.of_coordinate(low + position * (high - low))

    def span_at(self, value: float) -> float:
        """Change of the value for the way from limit to limit, in ``unit``, to first order at a value."""
        return value * math.log(self.upper / self.lower) if self.is_log else self.upper - self.lower

    def moved(self, value: float, change: float) -> float:
        """The value after a change that is known to first order there, in ``unit``: on a log scale by a factor."""
        return self.of_coordinate(self.coordinate(value) + (change / value if self.is_log else change))

    def limit_at(
        self, value: float, std: float | None = None, searched: bool = False
    ) -> Literal["lower", "upper"] | None:
        """The limit that a value is on, see `calib.problem.parameter.limit_at`; None between the limits."""
        if self.is_log and value > 0:
            known = None if std is None else std / value
            return limit_at(math.log(value), math.log(self.lower), math.log(self.upper), known, searched)
        return limit_at(value, self.lower, self.upper, std, searched)

    # -- prior -------------------------------------------------------------------------------------------------------

    @property
    def prior_kind(self) -> PriorKind | Density:
        """Its prior, or the one of its scale."""
        if self.prior is None:
            return "log-normal" if self.is_log else "normal"
        assert isinstance(self.prior, str | Density)
        return self.prior

    @property
    def prior_width(self) -> float:
        """Prior standard deviation in ``unit``, to first order at the nominal value."""
        kind = self.prior_kind
        if self.prior_sd is not None:
            return self.prior_sd
        if isinstance(kind, Density):
            return kind.std
        if kind == "log-normal" and not self.is_log:
            return self.value * math.log(self.upper / self.lower) / math.sqrt(12.0)
        return self.span_at(self.value) / math.sqrt(12.0)

    def prior_width_at(self, value: float) -> float:
        """Prior standard deviation in ``unit`` to first order at a value: one over the slope of `pull` there.

        That of a uniform prior, which does not pull, is `prior_width` along the scale: how little is known before.
        """
        kind = self.prior_kind
        if isinstance(kind, Density):
            return kind.width(value)
        if kind == "heavy-tailed":
            far = (value - self.value) / self.prior_width
            return self.prior_width * (1 + math.pi / 2 * far**2) * math.exp(-(self.pull(value) ** 2) / 2)
        log = kind == "log-normal" or (kind == "uniform" and self.is_log)
        return self.prior_width * (value / self.value) if log else self.prior_width

    def pull(self, value: float) -> float:
        """What the prior adds to a residual at a value: its distance from the median in standard deviations.

        ``-pull^2/2`` is the logarithm of the prior's density over the value, of a log-normal one over its logarithm;
        of a tabulated and of a heavy-tailed one the value is turned into a standard normal one. 0 for a uniform prior.
        """
        kind = self.prior_kind
        if isinstance(kind, Density):
            return kind.score(value)
        if kind == "log-normal":
            return math.log(value / self.value) * self.value / self.prior_width
        if kind == "heavy-tailed":
            from scipy import special

            far = (value - self.value) / self.prior_width
            beyond = math.atan2(1.0, math.sqrt(math.pi / 2) * abs(far)) / math.pi
            return math.copysign(float(special.ndtri(beyond)), far)
        return 0.0 if kind == "uniform" else (value - self.value) / self.prior_width

    @property
    def pulls(self) -> bool:
        """Whether its prior draws a fit to some value."""
        return self.prior_kind != "uniform"

    def log_prior(self, value: float) -> float:
        """Logarithm of the prior's density along the scale, but for a constant."""
        own = -0.5 * self.pull(value) ** 2
        return own if self.prior_kind == "normal" else own + math.log(self.span_at(value) / self.prior_width_at(value))

    def within(self, lower: float, upper: float, **changes: Any) -> Parameter:
        """The parameter with other limits and the same prior, whose width they do not change."""
        follows = self.prior_kind == "uniform" or isinstance(self.prior_kind, Density)
        width = None if follows else self.prior_width
        return replace(self, lower=lower, upper=upper, prior_sd=width, **changes)


@dataclass(frozen=True)
class LimitRules:
    """Distances at which a value is on its limit; `record.json` holds those of a result.

    Attributes
    ----------
    of_range : float
        Largest distance over the range between the limits.
    of_std : float
        The same over the posterior standard deviation, where it is known: the smaller distance counts.
    searched : float
        Distance over the range at the end of a genetic search: random steps approach a limit without reaching it, and
        a standard deviation says nothing of how near they came.
    """

    of_range: float = 1e-3
    of_std: float = 0.05
    searched: float = 0.01


RULES = LimitRules()
"""Distances in force."""


def unit_words(unit: str) -> str:
    """A unit behind a number; empty for a dimensionless one."""
    return "" if unit == "-" else f" {unit}"


def limit_at(
    value: float, lower: float, upper: float, std: float | None = None, searched: bool = False
) -> Literal["lower", "upper"] | None:
    """The limit that a value is on or beyond; None between the limits.

    Parameters
    ----------
    value, lower, upper : float
        In one unit; one of the limits may be infinite.
    std : float, optional
        Posterior standard deviation, in the same unit; NaN where unknown. Beside an infinite limit it alone tells what
        is near.
    searched : bool
        Whether a genetic search ended there, without least squares.
    """
    near = (RULES.searched if searched else RULES.of_range) * (upper - lower)
    if std is not None and (not searched or math.isinf(near)):
        near = min(near, RULES.of_std * std)
    near = 0.0 if math.isinf(near) else near
    if upper - value <= near:
        return "upper"
    return "lower" if value - lower <= near else None
