"""Supports and ends of beams that matrices hold without naming them, and flexibilities in series with them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from calib.errors.errors import InputError
from calib.measurement.places import Point
from calib.structure.affine import Monomial, SeriesLoss, Term, parameter
from calib.structure.effects.extend import Addition
from calib.structure.model import StructuralModel

_HELD = 1e-6
"""Force on a degree of freedom, over that of its entries without their signs, from which it is held by a support:
exports have 7 digits or more."""
_SYMMETRIC = 1e-4
"""Asymmetry of what a beam has on the diagonal, over its entries, from which it is none."""
_TRIED = 100
"""Blocks after which a model that had no beam among them has none."""
_MOST = 0.5
"""Share of the nodes that supports may hold in a model with rows of no node."""
_ANGLE = 0.1
"""Sine of the angle from which two beams that meet at a node do not go on straight."""
_SKEW = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)
"""Matrices of the products ``e_k x``, for each axis k."""


@dataclass(frozen=True, eq=False)
class RigidJoint:
    """A rigid connection that may give way: of a model with the ground, or of a beam's end with its node.

    Attributes
    ----------
    nodes : tuple of int
        By index: of a support those next to it, whose own rows the matrices may lack; of a beam's end its node, and the
        next one of the beam.
    place : (3,) float
        M.
    directions : tuple of int
        Motions that it resists: 0..5 for x, y, z and rotations about them at its place; of a beam's end rotations.
    forces : ndarray (n_dof, 6)
        On the degrees of freedom, by a unit of each motion against it, SI.
    held : ndarray (6, 6)
        Forces and moments against each of these motions, in the direction of each, SI.
    coefficient : Monomial
        Of the term of stiffness that has the largest part in it, over its value.
    """

    nodes: tuple[int, ...]
    place: Point
    directions: tuple[int, ...]
    forces: np.ndarray
    held: np.ndarray
    coefficient: Monomial

    @property
    def stiffness(self) -> np.ndarray:
        """In the direction of each motion, (6,), N/m or Nm/rad."""
        return np.diag(self.held)

    def softened(self, direction: int, flexibility: str) -> Term:
        """Change of the stiffness where it gives way in one direction, by the name of its flexibility.

        A connection that moves by x against the model gets the force ``k x`` of it, and loads it with ``-b x``, b and k
        as above. On a spring of the flexibility f it moves by ``f b^T u/(1 + k f)`` for the motion u of the model.
        """
        k, powers = float(self.stiffness[direction]), self.coefficient.powers
        b = sp.csr_array(self.forces[:, direction][None] / k)
        series = SeriesLoss(Monomial(k * self.coefficient.factor, powers), parameter(flexibility))
        return Term(f"{flexibility}: joint", sp.csr_array(b.T @ b), series)

    def softened_in_all(self, flexibility: str) -> Term:
        """The same in all directions on springs in proportion to its stiffness, which is divided by one plus this."""
        own = list(self.directions)
        b, root = self.forces[:, own], 1 / np.sqrt(self.stiffness[own])
        together = self.held[np.ix_(own, own)] * np.outer(root, root)
        inverse = sp.csr_array(np.linalg.pinv(together, rcond=_HELD, hermitian=True) * np.outer(root, root))
        less = sp.csr_array(b)
        powers = tuple((name, -power) for name, power in self.coefficient.powers)
        series = SeriesLoss(self.coefficient, Monomial(1 / self.coefficient.factor, ((flexibility, 1.0), *powers)))
        return Term(f"{flexibility}: joint", sp.csr_array(less @ inverse @ less.T), series)


def supports(model: StructuralModel, values: Mapping[str, float]) -> Iterator[RigidJoint]:
    """Supports of a model at named values; none of one whose degrees of freedom are no motions of placed nodes.

    A row of K without supports gives no force where the whole moves as a rigid body; next to a support it does,
    whatever its own rows were. Neighbouring rows that do belong to one support. Its place is that of nodes of which
    some motions are suppressed, else as far beyond the point where it resists translations without a moment as that
    lies from its nodes: the end of a clamped beam, the node of a spring to the ground. Rows of no node, such as
    incompatible modes of solids, stay at rest where the whole moves; where that meets forces at most nodes, they are
    rows of another kind, and no support is known.
    """
    found = _stiffness(model, values)
    if found is None:
        return
    stiffness, terms, si = found
    points, node = model.mesh.points, model.dofs.node
    rigid = _rigid(model, points.mean(axis=0))
    rows = np.flatnonzero(_resisted(stiffness, rigid).any(axis=1))
    placed = np.flatnonzero(node[rows] >= 0)
    if (node < 0).any() and len(np.unique(node[rows[placed]])) > _MOST * len(points):
        return
    of_node = sp.csr_array((np.ones(len(placed)), (placed, node[rows[placed]])), (len(rows), len(points)))
    beside = sp.csr_array(stiffness[rows][:, rows])
    beside.data = np.abs(beside.data)
    beside.eliminate_zeros()
    joined = beside + of_node @ of_node.T
    count, group = connected_components(joined, directed=False) if len(rows) else (0, np.zeros(0))
    for k in range(count):
        if (node[rows[group == k]] >= 0).any():
            yield _support(model, stiffness, rows[group == k], terms, si)


def member_ends(model: StructuralModel, values: Mapping[str, float], at: Point | None = None) -> Iterator[RigidJoint]:
    """Ends of beams at nodes where three or more meet, or two at an angle; none where nodes are joined otherwise.

    The block of K that joins two nodes is that of the beams between them. What these have on the diagonal follows: a
    motion of both as a rigid body meets no force. Blocks of which that is not symmetric are those of no beam. Where a
    place is given, in m, only those at the nearest node.
    """
    found = _stiffness(model, values)
    if found is None:
        return
    stiffness, terms, si = found
    node, points = model.dofs.node, model.mesh.points
    rigid = _rigid(model, points.mean(axis=0))
    moving = np.abs(rigid).max(axis=0) > 0
    turning = tuple(d for d in (3, 4, 5) if (model.dofs.direction == d).any())
    placed = np.flatnonzero(node >= 0)
    of_node = sp.csr_array((np.ones(len(placed)), (node[placed], placed)), (len(points), len(node)))
    joined = sp.csr_array(of_node @ abs(stiffness) @ of_node.T)
    joined.eliminate_zeros()
    chosen = range(len(points)) if at is None else [int(np.argmin(np.linalg.norm(points - np.array(at), axis=1)))]
    tried = 0
    for n in chosen:
        own = of_node.indices[of_node.indptr[n] : of_node.indptr[n + 1]]
        near = [m for m in joined.indices[joined.indptr[n] : joined.indptr[n + 1]].tolist() if m != n]
        if len(own) != moving.sum() or not turning or not _meet(points, n, near) or tried > _TRIED:
            continue
        for m in near if len(near) > 2 else near[:1]:
            other = of_node.indices[of_node.indptr[m] : of_node.indptr[m + 1]]
            forces = _of_end(stiffness, own, other, rigid[:, moving])
            if forces is None:
                tried += 1
                continue
            tried = -len(node) * len(node)  # it has beams: whatever else it has, it is searched to the end
            blocks = (sp.csr_array(t.matrix)[own][:, other].toarray() for t in terms)
            share = [abs(t.coefficient(si)) * float(np.abs(b).sum()) for t, b in zip(terms, blocks, strict=True)]
            wide, size, along = np.zeros((model.n_dof, 6)), np.zeros((6, 6)), model.dofs.direction[own]
            wide[:, along], size[np.ix_(along, along)] = forces, forces[own]
            x, y, z = points[n].tolist()
            most = _over_value(terms[int(np.argmax(share))], si)
            yield RigidJoint((n, m), (x, y, z), turning, wide, size, most)


def softened_joint(
    model: StructuralModel, places: Sequence[Point], direction: int | None, flexibility: str
) -> Addition:
    """A flexibility in series with a support of a model, or with the end of a beam where it meets others.

    Parameters
    ----------
    model : StructuralModel
        Its nominal values decide what is a support and what a beam, see `supports` and `member_ends`.
    places : sequence of (3,) float
        M. One for the nearest support; two for the nearest end of a beam: its node, and the next one of the beam.
    direction : int or None
        0..5 for x, y, z and rotations about them; of a beam's end a rotation. None for all that a support resists.
    flexibility : str
        Name of the parameter, in m/N or rad/Nm; for all directions over the support's own flexibility.

    Raises
    ------
    InputError
        Where no support or no beam resists that motion.
    """
    values, what = model.space.values, "end of a beam" if len(places) == 2 else "support"
    every = member_ends(model, values, places[0]) if len(places) == 2 else supports(model, values)
    found = [one for one in every if direction in (None, *one.directions)]
    if not found:
        raise InputError(f"the model {model.name} has no {what} that resists motion {direction}", place="effect")

    def far(one: RigidJoint) -> float:
        own = [one.place] if len(places) == 1 else [model.mesh.points[n] for n in one.nodes]
        return sum(math.dist(p, q) for p, q in zip(own, places, strict=True))

    nearest = min(found, key=far)
    term = nearest.softened_in_all(flexibility) if direction is None else nearest.softened(direction, flexibility)
    return Addition(stiffness=(term,))


def _meet(points: np.ndarray, node: int, near: Sequence[int]) -> bool:
    """Whether three or more meet at a node, or two at an angle."""
    if len(near) != 2:
        return len(near) > 2
    one, other = (points[m] - points[node] for m in near)
    across = np.linalg.norm(np.cross(one, other))
    return bool(across > _ANGLE * np.linalg.norm(one) * np.linalg.norm(other))


def _of_end(stiffness: sp.csr_array, own: np.ndarray, other: np.ndarray, rigid: np.ndarray) -> np.ndarray | None:
    """Forces on all degrees of freedom by a unit of each motion of a beam's end, (n_dof, n_own); None of no beam."""
    here, there = rigid[own], rigid[other]
    if len(other) != len(own) or np.linalg.cond(here) > 1 / _HELD or np.linalg.cond(there) > 1 / _HELD:
        return None
    joins = stiffness[own][:, other].toarray()
    end = -np.linalg.solve(here.T, (joins @ there).T).T
    size = np.sqrt(np.abs(np.outer(np.diag(end), np.diag(end))))
    if (np.diag(end) <= 0).any() or np.any(np.abs(end - end.T) > _SYMMETRIC * size):
        return None
    out = np.zeros((len(rigid), len(own)))
    out[own], out[other] = end, joins.T
    return out


def _support(
    model: StructuralModel, stiffness: sp.csr_array, rows: np.ndarray, terms: Sequence[Term], si: Mapping[str, float]
) -> RigidJoint:
    """The support that holds these rows."""
    nodes = np.unique(model.dofs.node[rows][model.dofs.node[rows] >= 0])
    per_node = np.bincount(model.dofs.node[model.dofs.node >= 0])[nodes]
    points = model.mesh.points[nodes]
    kept = np.zeros((model.n_dof, 1))
    kept[rows] = 1.0
    if per_node.min() < per_node.max():
        place = points[per_node == per_node.min()].mean(axis=0)
    else:
        rigid = _rigid(model, points.mean(axis=0))
        whole = (kept * (stiffness @ rigid)).T @ rigid
        moments = np.stack([whole[:3, :3] @ skew for skew in _SKEW], axis=-1).reshape(9, 3)
        centre = np.linalg.lstsq(moments, -whole[:3, 3:].ravel(), rcond=1e-9)[0]
        place = points.mean(axis=0) + 2 * centre
    rigid = _rigid(model, place)
    forces = kept * (stiffness @ rigid)
    resisted = (kept * _resisted(stiffness, rigid)).any(axis=0)
    size = forces.T @ rigid
    share = [float(np.abs(t.coefficient(si) * (t.matrix @ rigid)[rows]).sum()) for t in terms]
    x, y, z = place.tolist()
    directions = tuple(int(d) for d in np.flatnonzero(resisted & (np.diag(size) > 0)))
    most = _over_value(terms[int(np.argmax(share))], si)
    return RigidJoint(tuple(nodes.tolist()), (x, y, z), directions, forces, size, most)


def _stiffness(
    model: StructuralModel, values: Mapping[str, float]
) -> tuple[sp.csr_array, list[Term], dict[str, float]] | None:
    """K at named values with its terms and the values in SI.

    None where degrees of freedom are not the motions of placed nodes by which they are named, those of no node
    excepted, and where parameters place supports.
    """
    expansion, si = sp.csr_array(model.dofs.expansion), model.space.si(model.space.complete(values))
    terms = [t for t in model.stiffness.terms if isinstance(t.coefficient, Monomial) and t.coefficient(si)]
    inside = int((model.dofs.node < 0).sum())
    named = expansion.nnz == model.n_dof - inside and np.all(expansion.data == 1)
    if not named or not model.mesh.placed.all() or not terms or model.stiffness.selected:
        return None
    first, *more = (t.coefficient(si) * sp.csr_array(t.matrix) for t in terms)
    return sp.csr_array(sum(more, first)), terms, si


def _over_value(term: Term, si: Mapping[str, float]) -> Monomial:
    """The coefficient of a term over its value."""
    assert isinstance(term.coefficient, Monomial)
    return replace(term.coefficient, factor=term.coefficient.factor / term.coefficient(si))


def _resisted(stiffness: sp.csr_array, rigid: np.ndarray) -> np.ndarray:
    """Where a motion of the whole as a rigid body meets a force, (n_dof, 6), bool."""
    return np.asarray(np.abs(stiffness @ rigid) > _HELD * np.maximum(abs(stiffness) @ np.abs(rigid), 1e-300))


def _rigid(model: StructuralModel, about: np.ndarray) -> np.ndarray:
    """Motions of the degrees of freedom as a rigid body, translations and rotations about a place, (n_dof, 6)."""
    node, direction = model.dofs.node, model.dofs.direction
    away = np.where(node[:, None] >= 0, model.mesh.points[node], about) - about
    out = np.zeros((model.n_dof, 6))
    turned = np.einsum("kij,nj->nik", _SKEW, away)  # e_k x (point - place), (n_dof, 3, axis)
    moves, turns = (node >= 0) & (direction < 3), (node >= 0) & (direction >= 3)
    out[moves, direction[moves]] = 1.0
    out[moves, 3:] = turned[moves, direction[moves]]
    out[turns, direction[turns]] = 1.0
    return out
