"""Strains, curvature changes and rotations of a thin shell of revolution as rows over the degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from models.tire.grid import Grid


@dataclass(frozen=True)
class StrainRows:
    """Linear rows of Sanders (1959) and Koiter (1960), each (n_places, n_dof).

    Attributes
    ----------
    e1, e2, c1, c2 : sparse array
        Strains (1) and curvature changes (1/m) of meridian and hoop, at nodes.
    g12, t12 : sparse array
        Shear strain (1) and twist (1/m), engineering measures, at the corners midway between four nodes.
    b1, b2 : sparse array
        Rotations, rad, at the places of u and v.
    """

    e1: sparse.csr_array
    e2: sparse.csr_array
    c1: sparse.csr_array
    c2: sparse.csr_array
    g12: sparse.csr_array
    t12: sparse.csr_array
    b1: sparse.csr_array
    b2: sparse.csr_array


def strain_rows(grid: Grid) -> StrainRows:
    """Compose the rows from 1-D differences and averages.

    With the twist's last term the six rigid motions strain nothing, and the equilibrium is the adjoint of these rows.

    Parameters
    ----------
    grid : Grid

    Returns
    -------
    StrainRows
    """
    p, both = grid.profile, grid.both
    u, v, w = grid.take

    def times(function, s: np.ndarray) -> sparse.csr_array:
        return both(sparse.diags_array(np.asarray(function(s), float)))

    node, half = grid.s_node, grid.s_half
    per_r = times(lambda s: 1 / p.r(s), node), times(lambda s: 1 / p.r(s), half)
    slope = times(lambda s: p.dr(s) / p.r(s), node), times(lambda s: p.dr(s) / p.r(s), half)
    ds_up, as_up, ds_down, as_down = both(grid.ds_up), both(grid.as_up), both(grid.ds_down), both(grid.as_down)
    around_node = per_r[0] @ both(None, grid.dt_down)
    around_half = both(sparse.diags_array(1 / p.r(half)), grid.dt_up)

    b1 = -ds_up @ w + times(p.k1, half) @ u
    b2 = -per_r[0] @ both(None, grid.dt_up) @ w + times(p.k2, node) @ v
    along_v, mean_v, around_u = ds_up @ v, slope[1] @ as_up @ v, around_half @ u
    return StrainRows(
        e1=(ds_down @ u + times(p.k1, node) @ w).tocsr(),
        e2=(around_node @ v + slope[0] @ as_down @ u + times(p.k2, node) @ w).tocsr(),
        c1=(ds_down @ b1).tocsr(),
        c2=(around_node @ b2 + slope[0] @ as_down @ b1).tocsr(),
        g12=(along_v - mean_v + around_u).tocsr(),
        t12=(
            ds_up @ b2
            - slope[1] @ as_up @ b2
            + around_half @ b1
            + times(lambda s: (p.k2(s) - p.k1(s)) / 2, half) @ (along_v + mean_v - around_u)
        ).tocsr(),
        b1=b1.tocsr(),
        b2=b2.tocsr(),
    )
