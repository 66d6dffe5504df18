"""Elastic constants of a ply of parallel cords in rubber."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib import InputError

RULES = ("gough_tangorra", "akasaka_hirano", "halpin_tsai")


class Orthotropic(NamedTuple):
    """Plane-stress constants of a ply: moduli along and across the cords and in shear, Pa; Poisson's ratio."""

    e1: float
    e2: float
    g12: float
    nu12: float


@dataclass(frozen=True)
class CordRubber:
    """Cords in rubber.

    Attributes
    ----------
    cord_modulus, rubber_modulus : float
        Young's moduli, Pa.
    cord_fraction : float
        Volume of cords over that of the ply.
    cord_poisson, rubber_poisson : float
        Assumed.
    """

    cord_modulus: float
    rubber_modulus: float
    cord_fraction: float
    cord_poisson: float = 0.4
    rubber_poisson: float = 0.49

    def __post_init__(self) -> None:
        for name, value in (("cords", self.cord_modulus), ("rubber", self.rubber_modulus)):
            if not 0.0 < value < np.inf:
                raise InputError(f"the modulus of the {name} is {value:g} Pa, but must be positive")
        for name, value in (("cords", self.cord_poisson), ("rubber", self.rubber_poisson)):
            if not -1.0 < value <= 0.5:
                raise InputError(f"Poisson's ratio of the {name} is {value:g}, allowed is above -1 to 0.5")
        if not 0.0 < self.cord_fraction < 1.0:
            raise InputError(f"the cord fraction is {self.cord_fraction:g}, allowed is between 0 and 1")

    def ply(self, rule: str = RULES[0]) -> Orthotropic:
        """Constants by a rule: Gough and Tangorra, Akasaka and Hirano (1972), or Halpin and Tsai (1969).

        Raises
        ------
        InputError
            For an unknown rule.
        """
        ec, er, vf, vr = self.cord_modulus, self.rubber_modulus, self.cord_fraction, 1 - self.cord_fraction
        gc, gr = ec / (2 * (1 + self.cord_poisson)), er / (2 * (1 + self.rubber_poisson))
        mixed = ec * vf + er * vr
        if rule == "gough_tangorra":
            return Orthotropic(mixed, 4 * er * vr * mixed / (3 * ec * vf + 4 * er * vr), gr * vr, 0.5)
        if rule == "akasaka_hirano":
            return Orthotropic(ec * vf, 4 * er / 3, er / 3, 0.5)
        if rule == "halpin_tsai":
            shear = gr * (gc + gr + (gc - gr) * vf) / (gc + gr - (gc - gr) * vf)
            return Orthotropic(mixed, er * (1 + 2 * vf) / vr, shear, self.cord_poisson * vf + self.rubber_poisson * vr)
        raise InputError(f"unknown rule of micromechanics '{rule}'", remedy=f"take one of {', '.join(RULES)}")


def isotropic(modulus: float, poisson: float) -> Orthotropic:
    """Constants of a layer without cords; modulus in Pa.

    Raises
    ------
    InputError
        For a modulus that is not positive or a Poisson's ratio outside -1 to 0.5.
    """
    if not 0.0 < modulus < np.inf:
        raise InputError(f"the modulus of a layer is {modulus:g} Pa, but must be positive")
    if not -1.0 < poisson <= 0.5:
        raise InputError(f"Poisson's ratio of a layer is {poisson:g}, allowed is above -1 to 0.5")
    return Orthotropic(modulus, modulus, modulus / (2 * (1 + poisson)), poisson)
