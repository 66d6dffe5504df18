"""The pieces of a frame model, each by itself: what a map of where a model is off can point at."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Literal

import numpy as np
import scipy.sparse as sp

from calib.structure.affine import Monomial
from calib.structure.model import Part
from models.fem.discrete import PointMass, Spring, mass_matrix, spring_matrix
from models.fem.frame import Frame

Reduced = Callable[[sp.csr_array], sp.csr_array]
"""From all nodal motions (n_full, n_full) to the free degrees of freedom."""


def beam_parts(frame: Frame, reduced: Reduced, coefficients: Mapping[str, Monomial]) -> list[Part]:
    """Stiffness and own mass of every named part of the members; ``coefficients`` of groups that carry a parameter."""
    out = []
    for name in dict.fromkeys(member.part or member.group for member in frame.members):
        chosen = np.array([(frame.members[m].part or frame.members[m].group) == name for m in frame.member_of])
        group = frame.members[frame.member_of[np.flatnonzero(chosen)[0]]].group
        stiffness, mass = frame.beams((group,), chosen)
        place = _middle(frame.points[frame.ends[chosen]].reshape(-1, 3))
        out.append(Part(name, "stiffness", reduced(stiffness), coefficients.get(group, Monomial()), place))
        if mass.nnz and abs(mass).max() > 0:
            out.append(Part(name, "mass", reduced(mass), Monomial(), place))
    return out


def spring_parts(
    frame: Frame,
    reduced: Reduced,
    springs: Iterable[Spring],
    coefficient: Monomial,
    kind: Literal["stiffness", "damping"] = "stiffness",
) -> list[Part]:
    """Every name among the springs (or dampers) as one part."""
    named: dict[str, list[Spring]] = {}
    for spring in springs:
        named.setdefault(spring.name, []).append(spring)
    return [
        Part(name, kind, reduced(spring_matrix(frame, own)), coefficient, _middle([s.end[1] for s in own]))
        for name, own in named.items()
    ]


def mass_parts(frame: Frame, reduced: Reduced, masses: Iterable[PointMass]) -> list[Part]:
    """Every name among the point masses as one part."""
    named: dict[str, list[PointMass]] = {}
    for mass in masses:
        named.setdefault(mass.name, []).append(mass)
    return [
        Part(name, "mass", reduced(mass_matrix(frame, own)), Monomial(), _middle([m.at[1] for m in own]))
        for name, own in named.items()
    ]


def _middle(points: object) -> tuple[float, float, float]:
    x, y, z = np.mean(np.asarray(points, dtype=float), axis=0)
    return (float(x), float(y), float(z))
