"""Parameter: one named number of a model with its limits, unit, distribution and prior."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from calib.errors.arguments import number
from calib.errors.errors import InputError

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
}
"""Factor from the named unit to SI."""


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
        One of `calib.problem.parameter.SI_FACTORS`.
    distribution : {"uniform", "fixed"}
        A fixed parameter is never sampled or searched.
    integer : bool
        Takes integers only.
    prior_sd : float or None
        Prior standard deviation in ``unit``; default ``(upper - lower)/sqrt(12)``, that of the uniform distribution.
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

    @property
    def si_factor(self) -> float:
        """Factor from ``unit`` to SI."""
        return SI_FACTORS[self.unit]

    def limit_at(
        self, value: float, std: float | None = None, searched: bool = False
    ) -> Literal["lower", "upper"] | None:
        """The limit that a value is on, see `calib.problem.parameter.limit_at`; None between the limits."""
        return limit_at(value, self.lower, self.upper, std, searched)

    @property
    def prior_width(self) -> float:
        """Prior standard deviation in ``unit``."""
        return self.prior_sd if self.prior_sd is not None else (self.upper - self.lower) / math.sqrt(12.0)


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
