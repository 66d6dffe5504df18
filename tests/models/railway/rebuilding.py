"""The vehicle with its parts changed: more springs, bodies, masses and matrices."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from calib import StructuralModel
from calib.structure import AffineMatrix, Term
from models.fem.discrete import PointMass, Spring
from models.fem.member import Member, Point
from models.railway.bogie import BOX_ARM
from models.railway.parameters import BOGIE, CAR
from models.railway.vehicle import Assembly, vehicle

Values = Mapping[str, float]
Change = Callable[[Assembly], Assembly]

RIGID, RIGID_TURN = 1e10, 1e9
"""Stiffness in N/m and Nm/rad of connections between two bodies where the real parts are one."""
SI = {p.name: p.value * 1e3 for p in (*CAR, *BOGIE) if p.unit in ("kN/m", "kNs/m")}
MODULE = sys.modules["models.railway.vehicle"]


def rebuilt(change: Change | None = None, refine: int = 1, distributed: bool = False) -> StructuralModel:
    """The vehicle on rigid seats with its parts changed."""
    whole = MODULE.assembly
    with pytest.MonkeyPatch.context() as patch:
        if change is not None:
            patch.setattr(MODULE, "assembly", lambda *given: change(whole(*given)))
        return vehicle(refine, distributed, seats="rigid")


def with_matrix(model: StructuralModel, kind: str, name: str, full: sp.csr_array) -> StructuralModel:
    """The model with a constant matrix over all nodal motions added to its K, C or M."""
    own: AffineMatrix = getattr(model, kind)
    term = Term(name, sp.csr_array(model.dofs.expansion.T @ full @ model.dofs.expansion))
    return replace(model, **{kind: AffineMatrix(own.n_dof, (*own.terms, term), own.selected)})


def with_springs(whole: Assembly, springs: Sequence[Spring] = (), dampers: Sequence[Spring] = ()) -> Assembly:
    """More springs, and dampers whose weight is in Ns/m while the yaw dampers are at their nominal values."""
    fixed = whole.springs | {"floor_fixed": (*whole.springs["floor_fixed"], *springs)}
    more = tuple(replace(d, weight=d.weight / SI["c_yaw"]) for d in dampers)
    return replace(whole, springs=fixed, dampers=whole.dampers | {"c_yaw": (*whole.dampers["c_yaw"], *more)})


def with_bodies(whole: Assembly, members: Sequence[Member] = (), masses: Sequence[PointMass] = ()) -> Assembly:
    """More members and masses."""
    structure = replace(whole.structure, members=(*whole.structure.members, *members))
    return replace(whole, structure=structure, masses=(*whole.masses, *masses))


def stub(body: str, at: Point) -> Member:
    """A massless rigid body that stands on one place."""
    return Member(body, "front_box", BOX_ARM, at, (at[0] + 0.05, at[1], at[2]), 1.0)


def held(body: str, other: str, at: Point, free: Sequence[int] = ()) -> list[Spring]:
    """Springs that hold two bodies together at a place, but for the directions that are free."""
    units = np.eye(3).tolist()
    return [
        Spring((body, at), (other, at), tuple(units[d % 3]), d >= 3, RIGID_TURN if d >= 3 else RIGID)
        for d in range(6)
        if d not in free
    ]
