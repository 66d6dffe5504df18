"""Three masses on a line, given as matrices without elements; half of a matrix may be missing, or one place empty."""

import numpy as np
import scipy.sparse as sp

from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import AffineMatrix, Term, parameter
from calib.structure.geometry import DofMap, Mesh
from calib.structure.model import StructuralModel

K = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]]) * 1e4
M = np.eye(3)


class Nodes:
    def row(self, point, direction, on=None):
        node = round(point[0])
        out = np.zeros(3)
        if direction == 1:
            out[node] = 1.0
        return out, 0.0


def chain(half="", empty=False, shape=(0, 2)):
    k, m = K.copy(), M.copy()
    if empty:
        k[1] = k[:, 1] = m[1] = m[:, 1] = 0.0
    k = {"upper": np.triu(k), "lower": np.tril(k), "": k, "skew": k + np.triu(k, 1)}[half]
    rows = np.array([1, 7, 13])
    expansion = sp.csr_array((np.ones(3), (rows, np.arange(3))), shape=(18, 3))
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    return StructuralModel(
        name="chain",
        space=ParameterSpace((Parameter("k", 1.0, 0.5, 2.0), Parameter("m", 1.0, 0.5, 2.0))),
        stiffness=AffineMatrix(3, (Term("springs", sp.csr_array(k), parameter("k")),)),
        damping=AffineMatrix(3, ()),
        mass=AffineMatrix(3, (Term("masses", sp.csr_array(m), parameter("m")),)),
        mesh=Mesh(points, np.zeros(shape, dtype=int), ()),
        dofs=DofMap(expansion, np.arange(3), np.ones(3, dtype=int)),
        clusters={},
        locator=Nodes(),
    )
