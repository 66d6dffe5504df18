"""Supports that matrices hold without naming them: where they resist motions of the whole as a rigid body."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from calib.errors.errors import InputError
from calib.structure.affine import Monomial, SeriesLoss, Term, parameter
from calib.structure.effects.extend import Addition
from calib.structure.model import StructuralModel

_HELD = 1e-6
"""Force on a degree of freedom, over that of its entries without their signs, from which it is held by a support:
exports have 7 digits or more."""
_SKEW = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)
"""Matrices of the products ``e_k x``, for each axis k."""


@dataclass(frozen=True, eq=False)
class Footing:
    """A place where something outside of the matrices holds a model.

    Attributes
    ----------
    nodes : tuple of int
        Nodes that it holds, by index: those next to a clamped one, whose rows the matrices lack.
    place : (3,) float
        M.
    directions : tuple of int
        Motions that it resists: 0..5 for x, y, z and rotations about them at its place.
    forces : ndarray (n_dof, 6)
        On the degrees of freedom, by a unit of each motion of the model as a rigid body against it, SI.
    stiffness : ndarray (6,)
        Force or moment in the direction of each of these motions, N/m or Nm/rad.
    coefficient : Monomial
        Of the term of stiffness that holds most, over its value.
    """

    nodes: tuple[int, ...]
    place: tuple[float, float, float]
    directions: tuple[int, ...]
    forces: np.ndarray
    stiffness: np.ndarray
    coefficient: Monomial

    def softened(self, direction: int, flexibility: str) -> Term:
        """Change of the stiffness where the footing gives way in one direction, by the name of its flexibility.

        A support that moves by x gets the force ``k x`` of the model and loads it with ``-b x``, b and k as above. On
        a spring of the flexibility f it moves by ``f b^T u/(1 + k f)`` for the motion u of the model.
        """
        k, powers = float(self.stiffness[direction]), self.coefficient.powers
        b = sp.csr_array(self.forces[:, direction][None] / k)
        series = SeriesLoss(Monomial(k * self.coefficient.factor, powers), parameter(flexibility))
        return Term(f"{flexibility}: footing", sp.csr_array(b.T @ b), series)


def footings(model: StructuralModel, values: Mapping[str, float]) -> Iterator[Footing]:
    """Footings of a model at named values; none of one whose degrees of freedom are no motions of placed nodes.

    A row of K without supports gives no force where the whole moves as a rigid body; next to a support it does,
    whatever its own rows were. Neighbouring rows that do belong to one footing. Its place is that of nodes of which
    some motions are suppressed, else as far beyond the point where it resists translations without a moment as that
    lies from its nodes: the end of a clamped beam, the node of a spring to the ground.
    """
    points, si = model.mesh.points, model.space.si(model.space.complete(values))
    terms = [t for t in model.stiffness.terms if isinstance(t.coefficient, Monomial) and t.coefficient(si)]
    if not model.mesh.placed.all() or not len(points) or not terms or model.stiffness.selected:
        return
    rigid = _rigid(model, points.mean(axis=0))
    if rigid is None:
        return
    stiffness = _sum(terms, si)
    rows = np.flatnonzero(_resisted(stiffness, rigid).any(axis=1))
    of_node = sp.csr_array(
        (np.ones(len(rows)), (np.arange(len(rows)), model.dofs.node[rows])), (len(rows), len(points))
    )
    joined = sp.csr_array((stiffness[rows][:, rows] != 0).astype(float)) + of_node @ of_node.T
    count, group = connected_components(joined, directed=False) if len(rows) else (0, np.zeros(0))
    for k in range(count):
        yield _footing(model, stiffness, rows[group == k], terms, si)


def softened_footing(
    model: StructuralModel, place: tuple[float, float, float], direction: int, flexibility: str
) -> Addition:
    """A flexibility in series with the support of a model that is nearest to a place.

    Parameters
    ----------
    model : StructuralModel
        Its nominal values decide what is a support, see `footings`.
    place : (3,) float
        M.
    direction : int
        0..5 for x, y, z and rotations about them.
    flexibility : str
        Name of the parameter, in m/N or rad/Nm.

    Raises
    ------
    InputError
        Where no support resists that motion.
    """
    found = [one for one in footings(model, model.space.values) if direction in one.directions]
    if not found:
        raise InputError(f"no support of the model {model.name} resists motion {direction}", place="effect")
    nearest = min(found, key=lambda one: math.dist(one.place, place))
    return Addition(stiffness=(nearest.softened(direction, flexibility),))


def _footing(
    model: StructuralModel, stiffness: sp.csr_array, rows: np.ndarray, terms: Sequence[Term], si: Mapping[str, float]
) -> Footing:
    """The footing that holds these rows."""
    nodes = np.unique(model.dofs.node[rows])
    per_node = np.bincount(model.dofs.node[model.dofs.node >= 0])[nodes]
    points = model.mesh.points[nodes]
    kept = np.zeros((model.n_dof, 1))
    kept[rows] = 1.0
    if per_node.min() < per_node.max():
        place = points[per_node == per_node.min()].mean(axis=0)
    else:
        rigid = _rigid(model, points.mean(axis=0))
        assert rigid is not None
        whole = (kept * (stiffness @ rigid)).T @ rigid
        moments = np.stack([whole[:3, :3] @ skew for skew in _SKEW], axis=-1).reshape(9, 3)
        centre = np.linalg.lstsq(moments, -whole[:3, 3:].ravel(), rcond=1e-9)[0]
        place = points.mean(axis=0) + 2 * centre
    rigid = _rigid(model, place)
    assert rigid is not None
    forces = kept * (stiffness @ rigid)
    resisted = (kept * _resisted(stiffness, rigid)).any(axis=0)
    size = np.einsum("ij,ij->j", forces, rigid)
    share = [float(np.abs(t.coefficient(si) * (t.matrix @ rigid)[rows]).sum()) for t in terms]
    most = terms[int(np.argmax(share))].coefficient
    assert isinstance(most, Monomial)
    x, y, z = place.tolist()
    directions = tuple(int(d) for d in np.flatnonzero(resisted & (size > 0)))
    relative = replace(most, factor=most.factor / most(si))
    return Footing(tuple(nodes.tolist()), (x, y, z), directions, forces, size, relative)


def _sum(terms: Sequence[Term], si: Mapping[str, float]) -> sp.csr_array:
    first, *more = (t.coefficient(si) * sp.csr_array(t.matrix) for t in terms)
    return sp.csr_array(sum(more, first))


def _resisted(stiffness: sp.csr_array, rigid: np.ndarray) -> np.ndarray:
    """Where a motion of the whole as a rigid body meets a force, (n_dof, 6), bool."""
    return np.asarray(np.abs(stiffness @ rigid) > _HELD * np.maximum(abs(stiffness) @ np.abs(rigid), 1e-300))


def _rigid(model: StructuralModel, about: np.ndarray) -> np.ndarray | None:
    """Motions of the degrees of freedom as a rigid body, translations and rotations about a place, (n_dof, 6).

    None where they are not the motions of nodes by which they are named.
    """
    node, direction = model.dofs.node, model.dofs.direction
    expansion = sp.csr_array(model.dofs.expansion)
    if (node < 0).any() or expansion.nnz != model.n_dof or not np.all(expansion.data == 1):
        return None
    away = model.mesh.points[node] - about
    out = np.zeros((model.n_dof, 6))
    turned = np.einsum("kij,nj->nik", _SKEW, away)  # e_k x (point - place), (n_dof, 3, axis)
    moves = direction < 3
    out[moves, direction[moves]] = 1.0
    out[moves, 3:] = turned[moves, direction[moves]]
    out[~moves, direction[~moves]] = 1.0
    return out
