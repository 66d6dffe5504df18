"""Where the springs, dampers, masses and supports of a model are, and which parameter each one is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from calib.problem.space import ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial
from calib.structure.geometry import DofMap, Mesh

Form = Literal["spring", "damper", "mass", "support", "part"]

_KINDS = ("stiffness", "damping", "mass")
_FEW = 24
"""Most degrees of freedom that a spring, a damper or a lumped mass takes part in."""
_LITTLE = 1e-9
"""Eigenvalue of a spring's matrix, over its largest, below which it is zero."""


_NOWHERE = (math.nan, math.nan, math.nan)
_ASIDE = 0.1
"""Largest stiffness across a spring, over that along it, with which it acts in one direction."""


@dataclass(frozen=True)
class ModelPlace:
    """A piece of a model at one place.

    Attributes
    ----------
    name : str
        As in the model, such as ``upper rod front left``.
    form : {"spring", "damper", "mass", "support", "part"}
        A mass is lumped; a support holds all translations; a part is anything larger, such as a beam or a wall.
    kind : {"stiffness", "damping", "mass", ""}
        Matrix that it contributes to; empty for a support.
    parameters : tuple of str
        Parameters that scale or move it; none for what is fixed.
    place : (3,) float
        Its midpoint, m.
    direction : (3,) float
        Unit vector along which a spring or damper acts; NaN for one of several directions or of rotations, and for all
        else.
    """

    name: str
    form: Form
    kind: str
    parameters: tuple[str, ...]
    place: tuple[float, float, float]
    direction: tuple[float, float, float] = _NOWHERE


class _Part(Protocol):
    """What is asked of a named part; see `calib.structure.model.Part`."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def matrix(self) -> sp.csr_array: ...
    @property
    def coefficient(self) -> Monomial: ...
    @property
    def place(self) -> tuple[float, float, float]: ...


class _Structure(Protocol):
    """What is asked of a model; see `calib.structure.model.StructuralModel`."""

    @property
    def space(self) -> ParameterSpace: ...
    @property
    def mesh(self) -> Mesh: ...
    @property
    def dofs(self) -> DofMap: ...
    @property
    def parts(self) -> Sequence[_Part]: ...


def model_places(model: _Structure) -> tuple[ModelPlace, ...]:
    """Pieces of a model: all that parameters scale or move, and springs, dampers, lumped masses and supports.

    Named parts (`StructuralModel.parts`) count first. A parameter without one is placed by the terms that it scales,
    once for each connected group of their nodes. Nodes without coordinates have no place.
    """
    found = [
        ModelPlace(
            p.name,
            _form(model, p.kind, p.matrix),
            p.kind,
            _scaling(model, p.coefficient.names),
            p.place,
            _direction(model, p.matrix),
        )
        for p in model.parts
    ]
    larger = {place.name for place in found if place.form == "part"}  # of a clamped beam too, whose mass is at one node
    found = [replace(place, form="part") if place.name in larger else place for place in found]
    found = [place for place in found if place.parameters or place.form != "part"]
    placed = {(name, place.kind) for place in found for name in place.parameters}
    for kind in _KINDS:
        for name, parameters, matrix in _terms(model, getattr(model, kind)):
            if any((parameter, kind) not in placed for parameter in parameters):
                nodes = model.dofs.node[np.unique(matrix.indices)]
                form = _form(model, kind, matrix)
                way = _direction(model, matrix)
                found += [ModelPlace(name, form, kind, parameters, at, way) for at in middles(model, nodes, matrix)]
    found = [one if one.form in ("spring", "damper") else replace(one, direction=_NOWHERE) for one in found]
    translates = (np.diff(model.dofs.expansion.indptr).reshape(-1, 6)[:, :3] > 0).any(axis=1)
    held = ~translates & translates.any()  # a model of rotations alone holds nothing
    return (*found, *(ModelPlace("support", "support", "", (), at) for at in middles(model, np.flatnonzero(held))))


def _scaling(model: _Structure, names: frozenset[str]) -> tuple[str, ...]:
    """Those of the names that are parameters, in the order of the space."""
    return tuple(name for name in model.space.names if name in names)


def _terms(model: _Structure, matrix: AffineMatrix) -> Iterator[tuple[str, tuple[str, ...], sp.csr_array]]:
    """Name, parameters and matrix of each term; one that discrete parameters select, at their nominal values."""
    for term in matrix.terms:
        yield term.name, _scaling(model, term.coefficient.names), sp.csr_array(term.matrix)
    values = model.space.si(model.space.values)
    for chosen in matrix.selected:
        b = sp.csr_array(chosen.vectors[chosen.choice(values)][None])
        names = chosen.coefficient.names | set(chosen.selectors)
        yield chosen.name, _scaling(model, frozenset(names)), sp.csr_array(b.T @ b)


def _form(model: _Structure, kind: str, matrix: sp.csr_array) -> Form:
    """What a piece of K, C or M looks like in a drawing.

    A spring acts along the translations that its nodes have, and a lumped mass moves as one point does. A beam has
    more: in a plane its stiffness has rank three, as a spring in space has.
    """
    used = np.unique(sp.csr_array(matrix).indices)
    if not 0 < len(used) <= _FEW:
        return "part"
    values = np.abs(np.linalg.eigvalsh(matrix[used][:, used].toarray()))
    rank = int(np.sum(values > _LITTLE * values.max()))
    nodes = np.unique(model.dofs.node[used])
    moves = np.diff(model.dofs.expansion.indptr).reshape(-1, 6)[nodes[nodes >= 0]].any(axis=0)
    if kind == "mass":
        return "mass" if len(nodes) == 1 or (len(nodes) == 2 and rank <= moves.sum()) else "part"
    if rank > max(1, moves[:3].sum()):
        return "part"
    return "damper" if kind == "damping" else "spring"


def _direction(model: _Structure, matrix: sp.csr_array) -> tuple[float, float, float]:
    """Unit vector along which a piece resists translations of its nodes; NaN where that is no single one."""
    coo, block = sp.coo_array(matrix), np.zeros((3, 3))
    (node, way), (row, col) = (model.dofs.node, model.dofs.direction), (coo.row, coo.col)
    own = (node[row] == node[col]) & (node[row] >= 0) & (way[row] < 3) & (way[col] < 3)
    np.add.at(block, (way[row[own]], way[col[own]]), coo.data[own])
    size, vectors = np.linalg.eigh(block)
    if not size[1] <= _ASIDE * size[2] or not size[2] > 0:
        return _NOWHERE
    x, y, z = vectors[:, 2].tolist()
    return x, y, z


def middles(
    model: _Structure, nodes: np.ndarray, matrix: sp.csr_array | None = None
) -> list[tuple[float, float, float]]:
    """Middle of each group of nodes that lines of the mesh, edges of faces or a matrix connect, in metres."""
    count = len(model.mesh.points)
    chosen = np.zeros(count, dtype=bool)
    chosen[nodes[nodes >= 0]] = True
    pairs = [np.reshape(model.mesh.lines, (-1, 2))]
    if matrix is not None:
        coo = sp.coo_array(matrix)
        pairs.append(np.column_stack([model.dofs.node[coo.row], model.dofs.node[coo.col]]))
    both = np.concatenate(pairs)
    both = both[(both >= 0).all(axis=1)]
    both = both[chosen[both].all(axis=1)]
    joined = sp.coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count))
    group = connected_components(joined, directed=False)[1]
    middles: list[tuple[float, float, float]] = []
    for k in dict.fromkeys(group[chosen].tolist()):
        points = model.mesh.points[chosen & (group == k)]
        if np.isfinite(points).all():
            x, y, z = ((points.min(axis=0) + points.max(axis=0)) / 2).tolist()
            middles.append((x, y, z))
    return middles


_STRAIGHT = 0.9
"""Cosine of the largest angle between two lines of one member."""
_AXES = "xyz"


def along_mesh(mesh: Mesh, point: tuple[float, float, float]) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Directions in which the mesh goes on from the node nearest to a place.

    Parameters
    ----------
    mesh : Mesh
        All points with coordinates.
    point : (3,) float
        m.

    Returns
    -------
    list of (axis, before, after)
        Such as ``x`` with the neighbouring points (3,), m, against and along it; at a free end one of them is the node
        itself. The axis is the coordinate along which the direction mostly goes, with a number where it occurs twice.
    """
    at = np.asarray(point, dtype=float)
    node = int(np.argmin(np.linalg.norm(mesh.points - at, axis=1)))
    ends = mesh.lines[np.any(mesh.lines == node, axis=1)]
    others = np.unique(ends[ends != node])
    here = mesh.points[node]
    ways = [(other, mesh.points[other] - here) for other in others.tolist()]
    ways = [(other, way / np.linalg.norm(way)) for other, way in ways if np.linalg.norm(way) > 0]
    found: list[tuple[str, np.ndarray, np.ndarray]] = []
    used: set[int] = set()
    for other, way in ways:
        if other in used:
            continue
        used.add(other)
        axis = int(np.argmax(np.abs(way)))
        opposite = [o for o, w in ways if o not in used and float(way @ w) < -_STRAIGHT]
        used.update(opposite[:1])
        back = mesh.points[opposite[0]] if opposite else here
        first, last = (back, mesh.points[other]) if way[axis] > 0 else (mesh.points[other], back)
        same = sum(name.startswith(_AXES[axis]) for name, _, _ in found)
        found.append((_AXES[axis] + (f" ({same + 1})" if same else ""), first, last))
    return found
