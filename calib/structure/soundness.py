"""Validation of an imported model: symmetry, empty degrees of freedom, consistency of the mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.affine import AffineMatrix, Term
from calib.structure.model import Mesh, StructuralModel

_ROUNDING = 1e-6
"""Asymmetry that assembly may leave, over the largest entry."""
_MOTIONS = ("ux", "uy", "uz", "rx", "ry", "rz")


def require_sound(model: StructuralModel) -> None:
    """InputError for a model with inconsistent parts.

    Checks the mesh as in `require_mesh`, symmetry of the matrices, and that every degree of freedom has stiffness or
    mass.
    """
    require_mesh(model.mesh, model.dofs.expansion.shape[0] // 6, f"model {model.name}, mesh")
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


def require_mesh(mesh: Mesh, n_nodes: int, place: str) -> None:
    """InputError for a mesh that is inconsistent in itself or with the nodes of the degrees of freedom.

    Points are (n_nodes, 3), finite, or all NaN where none is known; lines (n_lines, 2) and faces (n_faces, 4) hold
    point numbers, and each has one group. There may be no lines and no faces.
    """
    points = _numbers(mesh.points, 3, "points", "coordinates x, y, z in metres", place)
    if len(points) != n_nodes:
        raise InputError(
            f"it has {len(points)} points, but the degrees of freedom move {n_nodes} nodes",
            place=place,
            remedy="give one point for each node of dofs, in the same order",
        )
    unknown = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(unknown) and not np.isnan(points).all():
        raise InputError(
            f"point {unknown[0]} is {tuple(points[unknown[0]].tolist())}",
            place=place,
            remedy="give finite coordinates, or NaN for all points where none is known",
        )
    _require_elements(mesh.lines, mesh.groups, 2, ("lines", "groups"), n_nodes, place)
    _require_elements(mesh.faces, mesh.face_groups, 4, ("faces", "face_groups"), n_nodes, place)


def _require_elements(given: Any, groups: Any, width: int, names: tuple[str, str], n_nodes: int, place: str) -> None:
    what, owners = names
    nodes = _numbers(given, width, what, f"numbers of {width} points", place)
    wrong = np.argwhere(~((nodes >= 0) & (nodes < n_nodes) & (nodes == np.floor(nodes))))
    if len(wrong):
        row, column = wrong[0]
        raise InputError(
            f"row {row} of {what} names point {nodes[row, column]:g}, but points are integers from 0 to {n_nodes - 1}",
            place=place,
            remedy=f"correct {what}: numbers of points count from 0",
        )
    if not isinstance(groups, tuple | list | np.ndarray) or not all(isinstance(group, str) for group in groups):
        raise InputError(f"{owners} is {groups!r:.60}", place=place, remedy="give a tuple of names")
    if len(groups) != len(nodes):
        raise InputError(
            f"it has {len(nodes)} {what}, but {len(groups)} {owners}",
            place=place,
            remedy=f"give one of {owners} for each row of {what}",
        )


def _numbers(given: Any, width: int, what: str, columns: str, place: str) -> np.ndarray:
    """A table of numbers, (n, width); an empty table may have any shape."""
    try:
        found = np.asarray(given)
    except ValueError:  # rows of different lengths
        found = np.empty(1, dtype=object)
    if found.dtype.kind in "iuf" and found.size == 0:
        return np.zeros((0, width))
    if found.dtype.kind not in "iuf" or found.ndim != 2 or found.shape[1] != width:
        shown = f"an array of shape {found.shape}" if isinstance(given, np.ndarray) else f"{given!r:.60}"
        raise InputError(
            f"{what} is {shown}", place=place, remedy=f"give an array (n_{what}, {width}) of numbers: {columns} a row"
        )
    return found


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
    """Sum of absolute entries of each row over all terms, whatever their coefficients, (n_dof,)."""
    out = np.zeros(matrix.n_dof)
    for term in matrix.terms:
        out += np.asarray(abs(sp.csr_array(term.matrix)).sum(axis=1)).ravel()
    for chosen in matrix.selected:
        for vector in chosen.vectors.values():
            out += np.abs(vector)
    return out


def _dof_words(model: StructuralModel, k: int) -> str:
    """Name of a degree of freedom: number, node and direction."""
    node, direction = int(model.dofs.node[k]), int(model.dofs.direction[k])
    x, y, z = model.mesh.points[node]
    label = model.labels[node] if model.labels else node + 1
    return f"number {k + 1} ({_MOTIONS[direction]} of node {label} at ({x:g}, {y:g}, {z:g}) m)"
