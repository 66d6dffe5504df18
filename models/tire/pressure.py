"""Inflation pressure as the potential -pV: load and stiffness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from models.tire.grid import Grid
from models.tire.strains import StrainRows


@dataclass(frozen=True)
class EnclosedVolume:
    """Enclosed volume to second order in the displacements, V = load.q + q.curvature.q / 2.

    The second order is the pressure that follows the wall's turning and stretching (Koiter 1966; Budiansky 1968).
    Without it, the tangent of an inflated tire is that of a dead load.

    Attributes
    ----------
    load : (n_dof,) ndarray
        m2; times the pressure the force.
    curvature : (n_dof, n_dof) sparse array
        m; minus the pressure times it the pressure stiffness.
    """

    load: np.ndarray
    curvature: sparse.csr_array

    @classmethod
    def build(cls, grid: Grid, rows: StrainRows) -> EnclosedVolume:
        """Collect the volume's terms on the places of the grid.

        V2 = int ((k1 + k2) w^2 - 2 (u w' + v w,theta / r) + k1 u^2 + k2 v^2) / 2 dA; with the rotations
        b1 = k1 u - w' and b2 = k2 v - w,theta / r the mixed terms are 2 u b1 - k1 u^2 and 2 v b2 - k2 v^2 together.
        """
        u, v, w = grid.take
        p = grid.profile

        def area(place: np.ndarray, factor: np.ndarray | float = 1.0) -> sparse.dia_array:
            return sparse.diags_array((place * np.reshape(factor, (-1, 1))).ravel())

        k1, k2 = p.k1(grid.s_half), p.k2(grid.s_node)
        half = (
            w.T @ area(grid.area_node, (p.k1(grid.s_node) + k2) / 2) @ w
            + u.T @ area(grid.area_u) @ rows.b1
            - u.T @ area(grid.area_u, k1 / 2) @ u
            + v.T @ area(grid.area_v) @ rows.b2
            - v.T @ area(grid.area_v, k2 / 2) @ v
        )
        return cls(w.T @ grid.area_node.ravel(), (half + half.T).tocsr())
