"""Linear constraint: limits on a weighted sum of parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from calib.errors.arguments import number, values
from calib.errors.errors import InputError


@dataclass(frozen=True)
class LinearConstraint:
    """``lower <= sum_k coefficients[k] * theta_k <= upper``, with every theta in its own unit.

    Examples
    --------
    Two masses, together 10 kg within 1 kg:

    >>> import numpy as np
    >>> import calib
    >>> masses = [calib.Parameter(name, 5.0, 1.0, 10.0, "kg") for name in ("m1", "m2")]
    >>> total = calib.LinearConstraint("total mass", (("m1", 1.0), ("m2", 1.0)), 9.0, 11.0, "kg")
    >>> space = calib.ParameterSpace(masses, (total,))
    >>> space.feasible(np.array([[4.0, 6.0], [8.0, 6.0]])).tolist()
    [True, False]
    """

    name: str
    coefficients: tuple[tuple[str, float], ...]
    lower: float
    upper: float
    unit: str = "-"

    def __post_init__(self) -> None:
        if not self.coefficients:
            raise InputError("no coefficients", place=f"constraint {self.name}")
        given = values(dict(self.coefficients), f"constraint {self.name}")
        object.__setattr__(self, "coefficients", tuple(given.items()))
        for label in ("lower", "upper"):
            number(getattr(self, label), f"constraint {self.name}, {label}")
        if math.isnan(self.lower) or math.isnan(self.upper) or self.lower > self.upper:
            raise InputError(
                f"lower limit {self.lower:g} is above upper limit {self.upper:g}", place=f"constraint {self.name}"
            )
        if not all(math.isfinite(c) for _, c in self.coefficients):
            raise InputError("a coefficient is not finite", place=f"constraint {self.name}")
