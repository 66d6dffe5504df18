"""Parts of a model for local perturbations, and affine terms of shells."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np
import scipy.sparse as sp

from calib import InputError
from calib.structure import Monomial, Part, Term
from models.fem.discrete import PointMass, Spring, mass_matrix, spring_matrix
from models.fem.frame import Frame
from models.fem.sheet import Sheet
from models.fem.structure import ShellMatrices, Structure

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
    """One part for every name among the springs (or dampers)."""
    named: dict[str, list[Spring]] = {}
    for spring in springs:
        named.setdefault(spring.name, []).append(spring)
    return [
        Part(name, kind, reduced(spring_matrix(frame, own)), coefficient, _middle([s.end[1] for s in own]))
        for name, own in named.items()
    ]


def mass_parts(frame: Frame, reduced: Reduced, masses: Iterable[PointMass]) -> list[Part]:
    """One part for every name among the point masses."""
    named: dict[str, list[PointMass]] = {}
    for mass in masses:
        named.setdefault(mass.name, []).append(mass)
    return [
        Part(name, "mass", reduced(mass_matrix(frame, own)), Monomial(), _middle([m.at[1] for m in own]))
        for name, own in named.items()
    ]


class ShellCoefficients(NamedTuple):
    """Coefficients of the contributions in `ShellMatrices`, in their order."""

    membrane: Monomial
    bending: Monomial
    shear: Monomial
    drilling: Monomial
    mass: Monomial
    rotary: Monomial


def shell_coefficients(
    sheet: Sheet,
    modulus: str | None = None,
    thickness: str | None = None,
    rmi: str | None = None,
    shear_modulus: str | None = None,
    density: str | None = None,
) -> ShellCoefficients:
    """Coefficients that replace values of a sheet by parameters.

    Parameters
    ----------
    sheet : Sheet
        The sheet that the matrices were assembled with.
    modulus : str, optional
        Parameter that replaces ``young_modulus``; all other moduli keep their ratio to it.
    thickness, rmi : str, optional
        Parameters that replace these values.
    shear_modulus : str, optional
        Parameter that replaces the shear modulus through the thickness (of the plane along; that across keeps its
        ratio to it); by default ``modulus`` scales transverse shear as well.
    density : str, optional
        Parameter that replaces the density.
    """

    def of(*given: tuple[str | None, float, float]) -> Monomial:
        known = [(name, power, own) for name, power, own in given if name is not None]
        factor = float(np.prod([own**-power for _, power, own in known]))
        return Monomial(factor, tuple((name, power) for name, power, _ in known))

    stiff = (modulus, 1.0, sheet.young_modulus)
    through = stiff if shear_modulus is None else (shear_modulus, 1.0, sheet.through_shear[0])
    thin, thick = (thickness, 1.0, sheet.thickness), (thickness, 3.0, sheet.thickness)
    heavy = (density, 1.0, sheet.density)
    membrane = of(stiff, thin)
    return ShellCoefficients(
        membrane,
        of(stiff, thick, (rmi, 1.0, sheet.rmi)),
        of(through, thin),
        membrane,
        of(heavy, thin),
        of(heavy, thick),
    )


def shell_terms(
    structure: Structure,
    reduced: Reduced,
    group: str,
    modulus: str | None = None,
    thickness: str | None = None,
    rmi: str | None = None,
    shear_modulus: str | None = None,
    density: str | None = None,
) -> tuple[list[Term], list[Term]]:
    """Stiffness and mass of a group of panels as affine terms; contributions with equal coefficients are one term.

    Raises InputError when a parameter would replace a value in which the group's panels differ. For the parameters see
    `shell_coefficients`.
    """
    sheets = [p.sheet for p in structure.panels if p.group == group]
    matrices = structure.shells((group,))
    coefficients = shell_coefficients(sheets[0], modulus, thickness, rmi, shear_modulus, density)
    if any(
        shell_coefficients(sheet, modulus, thickness, rmi, shear_modulus, density) != coefficients for sheet in sheets
    ):
        raise InputError(
            "its panels differ in a value that a parameter would replace",
            place=f"group {group!r}",
            remedy="give them different groups",
        )
    return _terms(group, matrices, coefficients, reduced, 0, 4), _terms(group, matrices, coefficients, reduced, 4, 6)


def _terms(
    group: str, matrices: ShellMatrices, coefficients: ShellCoefficients, reduced: Reduced, first: int, last: int
) -> list[Term]:
    names: dict[Monomial, list[str]] = {}
    sums: dict[Monomial, sp.csr_array] = {}
    for name in ShellMatrices._fields[first:last]:
        coefficient, matrix = getattr(coefficients, name), getattr(matrices, name)
        names.setdefault(coefficient, []).append(name)
        sums[coefficient] = sums[coefficient] + matrix if coefficient in sums else matrix
    return [Term(f"{group}: {', '.join(names[c])}", reduced(sums[c]), c) for c in sums]


def shell_parts(structure: Structure, reduced: Reduced, coefficients: Mapping[str, ShellCoefficients]) -> list[Part]:
    """Membrane, bending and shear stiffness, each as a part, and own mass of every named part of the panels.

    ``coefficients`` of groups that carry a parameter.
    """
    out = []
    for name in dict.fromkeys(panel.part or panel.group for panel in structure.panels):
        own = np.array([(panel.part or panel.group) == name for panel in structure.panels])
        chosen = own[structure.panel_of]
        group = structure.panels[int(np.flatnonzero(own)[0])].group
        shares = structure.shells((group,), chosen)
        its = coefficients.get(group, ShellCoefficients(*[Monomial()] * 6))
        place = _middle(structure.points[structure.corners[chosen]].reshape(-1, 3))
        flat = shares.membrane + shares.drilling
        pieces = [(name, flat, its.membrane), (f"{name}, bending", shares.bending, its.bending)]
        pieces.append((f"{name}, transverse shear", shares.shear, its.shear))
        out += [Part(called, "stiffness", reduced(matrix), c, place) for called, matrix, c in pieces]
        if shares.mass.nnz:
            out.append(Part(name, "mass", reduced(shares.mass), its.mass, place))
    return out


def _middle(points: object) -> tuple[float, float, float]:
    x, y, z = np.mean(np.asarray(points, dtype=float), axis=0)
    return (float(x), float(y), float(z))
