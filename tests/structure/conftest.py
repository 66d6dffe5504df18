"""Models small enough to be solved many times, with every feature that a reduced model must reproduce."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial, SelectedTerm, Term, parameter
from calib.structure.geometry import DofMap, Mesh
from calib.structure.model import StructuralModel


def springs(n: int, pairs: list[tuple[int, int]]) -> sp.csr_array:
    """Unit springs between neighbours; a node of -1 is the ground."""
    rows = np.zeros((len(pairs), n))
    for row, (a, b) in zip(rows, pairs, strict=True):
        for node, sign in ((a, 1.0), (b, -1.0)):
            if node >= 0:
                row[node] += sign
    return sp.csr_array(rows.T @ rows)


@pytest.fixture(scope="session")
def ladder() -> Callable[..., StructuralModel]:
    """Two coupled chains of n/2 masses with soft and stiff halves, dampers at two points and a movable support."""

    def make(n: int = 60, damped: bool = True, grounded: bool = True) -> StructuralModel:
        h = n // 2
        upper = [(k, k + 1) for k in range(h - 1)]
        lower = [(h + k, h + k + 1) for k in range(h - 1)]
        rungs = [(k, h + k) for k in range(0, h, 3)]
        ends = [(-1, 0), (-1, n - 1)] if grounded else []
        space = ParameterSpace(
            (
                Parameter("k_upper", 40.0, 20.0, 80.0, "kN/m"),
                Parameter("k_lower", 11.0, 5.0, 30.0, "kN/m"),
                Parameter("k_rung", 2.0, 0.5, 6.0, "kN/m"),
                Parameter("c_end", 20.0, 5.0, 60.0, "Ns/m"),
                Parameter("mass", 1.0, 0.5, 2.0, "kg"),
                Parameter("place", 3.0, 1.0, 5.0, integer=True),
                Parameter("k_ground", 30.0, 10.0, 60.0, "kN/m", distribution="fixed"),
            ),
            (LinearConstraint("sum", (("k_upper", 1.0), ("k_lower", 1.0)), 35.0, 90.0, "kN/m"),),
        )
        stiffness = [
            Term("upper", springs(n, upper), parameter("k_upper")),
            Term("lower", springs(n, lower), parameter("k_lower")),
            Term("rungs", springs(n, rungs), parameter("k_rung")),
        ]
        supports: tuple[SelectedTerm, ...] = ()
        if grounded:
            stiffness.append(Term("ends", springs(n, ends), parameter("k_ground")))
            vectors = {(p,): np.eye(n)[h // 3 + p] for p in range(1, 6)}
            supports = (SelectedTerm("support", Monomial(2e5), ("place",), vectors),)
        across = springs(n, [(2, h + 2), (h - 2, n - 2)])
        damping = (Term("ends", across, parameter("c_end")),) if damped else ()
        mass = (
            Term("fixed", sp.csr_array(np.diag(0.2 + 0.01 * np.arange(n)))),
            Term("mass", sp.csr_array(np.diag([1.0] * h + [0.0] * (n - h))), parameter("mass", 0.3)),
        )
        expansion = sp.csr_array((np.ones(n), (6 * np.arange(n), np.arange(n))), shape=(6 * n, n))
        points = np.column_stack([np.arange(n, dtype=float), np.zeros(n), np.zeros(n)])
        return StructuralModel(
            name="ladder",
            space=space,
            stiffness=AffineMatrix(n, tuple(stiffness), supports),
            damping=AffineMatrix(n, damping),
            mass=AffineMatrix(n, mass),
            mesh=Mesh(points, np.array(upper + lower), ("chain",) * (n - 2)),
            dofs=DofMap(expansion, np.arange(n), np.zeros(n, dtype=int)),
            clusters={"upper": np.arange(h), "lower": np.arange(h, n - 3), "tip": np.arange(n - 3, n)},
            locator=Nodes(n),
        )

    return make


class Nodes:
    """Sensors are at the nodes (k, 0, 0), in direction x."""

    def __init__(self, n: int):
        self.n = n

    def row(self, point, direction, on=None):
        node = round(point[0])
        return np.eye(self.n)[node] * (direction == 0), abs(point[0] - node)


@pytest.fixture(scope="session")
def turned() -> Callable[[StructuralModel], StructuralModel]:
    """The same model with every motion declared as a rotation."""
    return lambda model: replace(model, dofs=replace(model.dofs, direction=np.full(model.n_dof, 3)))
