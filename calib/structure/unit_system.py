"""Unit systems of finite-element codes: factors of matrices, coordinates and parameters to SI."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.problem.parameter import SI_FACTORS, Parameter

_TOKENS: Mapping[str, tuple[int, int, int, int]] = {
    **dict.fromkeys(("GPa", "MPa", "kPa", "Pa", "psi", "ksi"), (1, -2, 0, 0)),
    **dict.fromkeys(("MN", "kN", "N", "lbf", "kip"), (1, 0, 0, 0)),
    **dict.fromkeys(("mm", "m", "in", "ft"), (0, 1, 0, 0)),
    **dict.fromkeys(("kg", "g", "t", "lb"), (0, 0, 1, 0)),
    "Hz": (0, 0, 0, -1),
    **dict.fromkeys(("rad", "deg", "-", "%"), (0, 0, 0, 0)),
    "s": (0, 0, 0, 1),
}
"""Powers of force, length, mass and time in the parts of a unit's name; longer parts first."""
_PART = re.compile("(" + "|".join(re.escape(one) for one in _TOKENS) + r")(\d?)")


@dataclass(frozen=True)
class UnitSystem:
    """Units of length and force of a code; seconds are its unit of time, and mass follows from force.

    Attributes
    ----------
    name : str
    length : float
        m.
    force : float
        N.
    """

    name: str
    length: float
    force: float

    @property
    def mass(self) -> float:
        """Unit of mass in kg, ``force s^2/length``."""
        return self.force / self.length

    def matrix_scale(self, rotational: np.ndarray) -> sp.dia_array:
        """Diagonal S, of which ``S A S`` is a stiffness, damping or mass matrix A in SI, (n_dof, n_dof).

        The work of a motion, ``u^T K u``, is force times length; a translation of 1 m is ``1/length`` units, an angle
        stays a radian. Seconds do not change, so that one factor holds for all three matrices.

        Parameters
        ----------
        rotational : ndarray (n_dof,), bool
            Which rows are rotations.
        """
        work = np.sqrt(self.force * self.length)
        return sp.diags_array(np.where(rotational, work, work / self.length))

    def unit_of(self, parameter: Parameter) -> float:
        """The system's unit of a parameter's quantity in SI, such as 1e6 for a modulus of elasticity in N/mm2."""
        force, length, mass, time = _dimension(parameter.unit)
        return float(self.force**force * self.length**length * self.mass**mass * 1.0**time)


SYSTEMS: Mapping[str, UnitSystem] = {
    one.name: one
    for one in (
        UnitSystem("m-kg-N", 1.0, 1.0),
        UnitSystem("mm-t-N", 1e-3, 1.0),
        UnitSystem("mm-kg-mN", 1e-3, 1e-3),
        UnitSystem("in-lbf", SI_FACTORS["in"], SI_FACTORS["lbf"]),
        UnitSystem("in-kip", SI_FACTORS["in"], SI_FACTORS["kip"]),
        UnitSystem("ft-lbf", SI_FACTORS["ft"], SI_FACTORS["lbf"]),
    )
}
"""Known systems; their mass is kg, t, kg, lbf s2/in, kip s2/in and slug."""


def unit_system(name: str, place: str) -> UnitSystem:
    """A system by its name; InputError for an unknown one."""
    if name not in SYSTEMS:
        known = ", ".join(f"{s.name} (mass in {s.mass:.4g} kg)" for s in SYSTEMS.values())
        raise InputError(f"it is {name!r:.40}", place=place, remedy=f"one of {known}; all have seconds")
    return SYSTEMS[name]


def _dimension(unit: str) -> tuple[int, int, int, int]:
    """Powers of force, length, mass and time in a unit of `calib.problem.parameter.SI_FACTORS`."""
    if unit == "ms":
        return _TOKENS["s"]
    powers = np.zeros(4, dtype=int)
    above, _, below = unit.partition("/")
    for text, sign in ((above, 1), (below, -1)):
        for part, power in _PART.findall(text):
            powers += sign * int(power or 1) * np.array(_TOKENS[part])
    force, length, mass, time = powers.tolist()
    return force, length, mass, time
