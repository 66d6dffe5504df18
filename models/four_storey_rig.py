"""A laboratory rig of four storeys: equal masses in a chain, each storey on two clamped-clamped leaf springs.

Masses and leaf-spring dimensions: open data set "Experimental Model Updating Benchmark" (L. Fritsch, MIT licence).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from calib import Parameter, ParameterSpace, StructuralModel
from calib.structure import AffineMatrix, DofMap, Mesh, Monomial, NodeLocator, Term, parameter

STOREYS = 4
MASS = 0.1122
YOUNG_MODULUS = 210e9
LEAF_LENGTH, LEAF_THICKNESS, LEAF_WIDTH = 47.5e-3, 0.45e-3, 25.5e-3

_SOURCE = "Experimental Model Updating Benchmark, L. Fritsch"


def storey_stiffness() -> float:
    """Nominal stiffness of one storey, N/m: two clamped-clamped leaf springs of ``12 E I / L^3`` each."""
    inertia = LEAF_WIDTH * LEAF_THICKNESS**3 / 12
    return 2 * 12 * YOUNG_MODULUS * inertia / LEAF_LENGTH**3


def storey_drift(storey: int) -> np.ndarray:
    """Elongation of a storey, counted from 1 at the ground, by the motions of the masses, (4,)."""
    drift = np.zeros(STOREYS)
    drift[storey - 1] = 1.0
    if storey > 1:
        drift[storey - 2] = -1.0
    return drift


def four_storey_rig(masses_known: bool = True, damped: bool = False) -> StructuralModel:
    """Chain of four masses; every storey's stiffness is a factor of its nominal value (storey 1 on the ground).

    Parameters
    ----------
    masses_known : bool
        False makes every mass a factor of its nominal value too.
    damped : bool
        True gives every storey the same dashpot, a parameter.
    """
    nominal = storey_stiffness()
    parameters, terms, dashpots = [], [], []
    for storey in range(1, STOREYS + 1):
        name = f"k{storey}"
        parameters.append(
            Parameter(
                name, 1.0, 0.7, 1.4, description=f"stiffness of storey {storey} over its nominal {nominal:.0f} N/m",
                source=_SOURCE,
            )
        )  # fmt: skip
        drift = storey_drift(storey)
        terms.append(Term(name, sp.csr_array(nominal * np.outer(drift, drift)), parameter(name)))
        dashpots.append(Term(f"c{storey}", sp.csr_array(np.outer(drift, drift)), parameter("c")))
    masses = []
    for storey in range(1, STOREYS + 1):
        here = sp.csr_array(([MASS], ([storey - 1], [storey - 1])), shape=(STOREYS, STOREYS))
        name = f"m{storey}"
        masses.append(Term(name, here, Monomial() if masses_known else parameter(name)))
        if not masses_known:
            parameters.append(
                Parameter(name, 1.0, 0.7, 1.4, description=f"mass of storey {storey} over its weighed {MASS} kg")
            )
    if damped:
        parameters.append(
            Parameter("c", 0.5, 0.0, 5.0, "Ns/m", description="dashpot of each storey (assumed)", source="assumed")
        )
    heights = LEAF_LENGTH * np.arange(STOREYS + 1)
    points = np.column_stack([np.zeros(STOREYS + 1), heights, np.zeros(STOREYS + 1)])
    rows = 6 * np.arange(1, STOREYS + 1)
    expansion = sp.csr_array((np.ones(STOREYS), (rows, np.arange(STOREYS))), shape=(6 * (STOREYS + 1), STOREYS))
    dofs = DofMap(expansion, np.arange(1, STOREYS + 1), np.zeros(STOREYS, dtype=int))
    lines = np.column_stack([np.arange(STOREYS), np.arange(1, STOREYS + 1)])
    return StructuralModel(
        name="four-storey rig",
        space=ParameterSpace(tuple(parameters)),
        stiffness=AffineMatrix(STOREYS, tuple(terms)),
        damping=AffineMatrix(STOREYS, tuple(dashpots) if damped else ()),
        mass=AffineMatrix(STOREYS, tuple(masses)),
        mesh=Mesh(points, lines, ("storey",) * STOREYS),
        dofs=dofs,
        clusters={"storeys.x": np.arange(STOREYS)},
        locator=NodeLocator(points, expansion),
    )
