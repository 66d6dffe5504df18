"""Parameter: one named number of a model with its limits, unit, distribution and prior."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from calib.errors.arguments import number
from calib.errors.errors import InputError
from calib.problem.on_limit import limit_at
from calib.problem.units import SI_FACTORS

Distribution = Literal["uniform", "fixed"]
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
        One of `calib.problem.units.SI_FACTORS`.
    distribution : {"uniform", "fixed"}
        A fixed parameter is never sampled or searched.
    integer : bool
        Takes integers only.
    prior_sd : float or None
        Prior standard deviation in ``unit``; default ``(upper - lower)/sqrt(12)``, that of the uniform distribution.
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
        for label in ("value", "lower", "upper", "prior_sd"):
            if label != "prior_sd" or self.prior_sd is not None:
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
        if self.integer and any(v != round(v) for v in (self.value, self.lower, self.upper)):
            raise InputError("an integer parameter has a fractional value or limit", place=place)

    @property
    def si_factor(self) -> float:
        """Factor from ``unit`` to SI."""
        return SI_FACTORS[self.unit]

    def limit_at(
        self, value: float, std: float | None = None, searched: bool = False
    ) -> Literal["lower", "upper"] | None:
        """The limit that a value is on, see `calib.problem.on_limit.limit_at`; None between the limits."""
        return limit_at(value, self.lower, self.upper, std, searched)

    @property
    def prior_width(self) -> float:
        """Prior standard deviation in ``unit``."""
        return self.prior_sd if self.prior_sd is not None else (self.upper - self.lower) / math.sqrt(12.0)
