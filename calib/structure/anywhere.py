"""Effects at one of several places, and masses that sit anywhere along a line."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.affine import Grown, Monomial, StretchPower, Term, parameter
from calib.structure.effects.attach import moved_masses
from calib.structure.effects.extend import Addition
from calib.structure.effects.products import Product


@dataclass(frozen=True)
class Chosen:
    """1 where an integer parameter has a given value, else 0; it counts as fixed in derivatives.

    Attributes
    ----------
    parameter : str
    number : int
    """

    parameter: str
    number: int

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return frozenset((self.parameter,))

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI."""
        return float(round(values[self.parameter]) == self.number)

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """0."""
        return 0.0


def at_one_of(additions: Sequence[Addition], place: str) -> Addition:
    """One of several additions, chosen by an integer parameter that counts them from 1.

    All use the same added degrees of freedom, such as those of a mass that hangs at one of several places.

    Parameters
    ----------
    additions : sequence of Addition
        The effect at each place.
    place : str
        Name of the parameter.

    Raises
    ------
    InputError
        Without places, when they add different numbers of degrees of freedom, or when one selects by itself.
    """
    counts = {addition.n_added for addition in additions}
    if len(counts) != 1 or any(addition.selected for addition in additions):
        raise InputError(
            "its places add different degrees of freedom, or select by themselves", place="places",
            remedy="build the same addition at every place, without selected terms",
        )  # fmt: skip

    def chosen(kind: str) -> tuple[Term, ...]:
        return tuple(
            replace(term, name=f"{term.name}, place {k}", coefficient=Product(term.coefficient, Chosen(place, k)))
            for k, addition in enumerate(additions, 1)
            for term in getattr(addition, kind)
        )

    assumptions = tuple(dict.fromkeys(a for addition in additions for a in addition.assumptions))
    return Addition(chosen("stiffness"), chosen("damping"), chosen("mass"), (), counts.pop(), assumptions)


def sliding_mass(
    motions: Callable[[float], np.ndarray], mass: str, position: str, ends: tuple[float, float], stretches: int
) -> Addition:
    """A mass at any position along a carrier, such as a girder.

    Between the ends of a stretch the motion of the carrier is a cubic polynomial of the position, like that of a beam
    between its nodes, through four positions of each stretch: the mass is nowhere negative and does not jump where
    stretches meet.

    Parameters
    ----------
    motions : callable
        From a position in SI to the motions of the mass there, (n_motions, n_dof), such as the three translations.
    mass, position : str
        Names of the parameters.
    ends : (float, float)
        First and last position, SI.
    stretches : int
        One for each element of the carrier is enough.
    """
    places = (1 - np.cos(np.linspace(0, np.pi, 4))) / 2
    weights, terms = np.linalg.inv(np.vander(places, increasing=True)), []
    cuts = np.linspace(*ends, stretches + 1).tolist()
    for k, (start, end) in enumerate(pairwise(cuts)):
        at = np.array([motions(start + float(share) * (end - start)) for share in places])
        powers = np.einsum("pk,kmn->pmn", weights, at)
        for power in range(7):
            pairs = [(p, power - p) for p in range(4) if 0 <= power - p < 4]
            one, other = (sp.csr_array(np.vstack([powers[pair[i]] for pair in pairs])) for i in (0, 1))
            along = StretchPower(position, start, end, power, k == stretches - 1)
            name = f"{mass}: stretch {k + 1}, power {power}"
            terms.append(Term(name, sp.csr_array(one.T @ other), Product(parameter(mass), along)))
    return Addition(mass=tuple(terms))


def leaning_masses(
    motions: Callable[[float], np.ndarray], arms: Callable[[float], np.ndarray], shift: str, arm: str, reach: float,
    stretches: int, grown: float,
) -> tuple[Term, ...]:  # fmt: skip
    """Mass terms of masses that are shifted and then stand off their carrier by an arm.

    With v the motions at the carrier and w those per unit of the arm d, such as rotations, the kinetic energy is
    ``(v' + d w')^2/2``. At shift 0 the masses are the model's own: of the arm d counts ``s^2/(s^2 + grown^2)``.

    Parameters
    ----------
    motions, shift, reach, stretches
        As in `calib.structure.effects.attach.moved_masses`, which gives the terms without d.
    arms : callable
        From a shift to w, (n_motions, n_dof), each times the square root of its mass.
    arm : str
        Name of the parameter d.
    grown : float
        Shift at which the arm is half of its own, SI.
    """
    places = (1 - np.cos(np.linspace(0, np.pi, 4))) / 2
    weights, terms = np.linalg.inv(np.vander(places, increasing=True)), []
    for side in (1, -1):
        for k in range(stretches):
            start, end = (side * reach * j / stretches for j in (k, k + 1))
            at = [start + float(place) * (end - start) for place in places]
            own, off = (
                [sp.csr_array(p) for p in np.einsum("pk,kmn->pmn", weights, np.array([made(s) for s in at]))]
                for made in (motions, arms)
            )
            for power in range(7):
                pairs = [(p, power - p) for p in range(4) if 0 <= power - p < 4]
                one, other, far, farther = (
                    sp.csr_array(sp.vstack([powers[pair[i]] for pair in pairs]))
                    for powers, i in ((own, 0), (off, 1), (off, 0), (off, 1))
                )
                mixed = one.T @ other
                for order, matrix in ((1, mixed + mixed.T), (2, far.T @ farther)):
                    along = StretchPower(shift, start, end, power, k == stretches - 1)
                    size = Grown(Monomial(1.0, ((arm, float(order)),)), shift, grown, order)
                    name = f"{arm}: stretch {side * (k + 1)}, power {power}, order {order}"
                    terms.append(Term(name, sp.csr_array(matrix), Product(along, size)))
    return (*moved_masses(motions, shift, reach, stretches), *terms)
