"""What is wrong with the matrices of a model that came from elsewhere: half of them missing, or nothing at a place."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from calib.errors import InputError
from calib.structure.affine import AffineMatrix, Term
from calib.structure.model import StructuralModel

_ROUNDING = 1e-6
"""Difference between the two halves of a symmetric matrix, over its largest entry, that assembling may leave."""
_MOTIONS = ("ux", "uy", "uz", "rx", "ry", "rz")


def require_sound(model: StructuralModel) -> None:
    """InputError for matrices that are not symmetric, and for degrees of freedom with neither stiffness nor mass."""
    kinds = {"stiffness": model.stiffness, "damping": model.damping, "mass": model.mass}
    for kind, matrix in kinds.items():
        for term in matrix.terms:
            _require_symmetric(term, kind, model.name)
    touched = sum((_touched(matrix) for matrix in (model.stiffness, model.mass)), np.zeros(model.n_dof))
    empty = np.flatnonzero(touched == 0)
    if len(empty):
        named = ", ".join(_dof_words(model, int(k)) for k in empty[:3]) + (", ..." if len(empty) > 3 else "")
        one = len(empty) == 1
        raise InputError(
            f"{len(empty)} of {model.n_dof} degrees of freedom {'has' if one else 'have'} neither stiffness nor mass: "
            f"{named}",
            place=f"model {model.name}",
            remedy=f"leave {'it' if one else 'them'} out of the matrices, or connect {'it' if one else 'them'}",
        )


def _require_symmetric(term: Term, kind: str, name: str) -> None:
    matrix = sp.csr_array(term.matrix)
    largest = abs(matrix).max() if matrix.nnz else 0.0
    if not largest or abs(matrix - matrix.T).max() <= _ROUNDING * largest:
        return
    place = f"model {name}, term {term.name!r} of the {kind}"
    halves = {"upper": sp.triu(matrix, 1), "lower": sp.tril(matrix, -1)}
    for half, other in (("upper", "lower"), ("lower", "upper")):
        if abs(halves[other]).max() <= _ROUNDING * largest:
            raise InputError(
                f"only the {half} half of the matrix is stored, the {other} one is empty",
                place=place,
                remedy="complete it: A + A.T - diag(A), as exports of solvers store one half only",
            )
    raise InputError(
        f"the matrix is not symmetric (entries differ by up to {abs(matrix - matrix.T).max():.3g})",
        place=place,
        remedy="give a symmetric one",
    )


def _touched(matrix: AffineMatrix) -> np.ndarray:
    """Size of what stands in each row over all terms, whatever their coefficients, (n_dof,)."""
    out = np.zeros(matrix.n_dof)
    for term in matrix.terms:
        out += np.asarray(abs(sp.csr_array(term.matrix)).sum(axis=1)).ravel()
    for chosen in matrix.selected:
        for vector in chosen.vectors.values():
            out += np.abs(vector)
    return out


def _dof_words(model: StructuralModel, k: int) -> str:
    """A degree of freedom by number, node and direction."""
    node, direction = int(model.dofs.node[k]), int(model.dofs.direction[k])
    x, y, z = model.mesh.points[node]
    return f"number {k + 1} ({_MOTIONS[direction]} of node {node + 1} at ({x:g}, {y:g}, {z:g}) m)"
