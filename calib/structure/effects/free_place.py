"""Masses and springs to the ground anywhere near a point of a beam or a surface, given by matrices alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.places import Point
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial, Term
from calib.structure.effects.composed import Connection, PointMass
from calib.structure.effects.composition import Composition, Names, slug
from calib.structure.effects.extend import Addition
from calib.structure.model import StructuralModel
from calib.structure.rules import RULES

AXES = "xyz"
_FREE = ("added mass", "spring to ground")
"""Kinds of compositions whose place may be free."""


def _neighbours(stiffness: sp.csr_array, node: np.ndarray, nodes: np.ndarray) -> dict[int, set[int]]:
    """By node, the others that K joins with it."""
    own = np.flatnonzero(np.isin(node, nodes))
    rows = sp.coo_array(stiffness[own])
    joined: dict[int, set[int]] = {int(n): set() for n in nodes}
    for n, m in set(zip(node[own][rows.row].tolist(), node[rows.col].tolist(), strict=True)):
        if n != m and m >= 0:
            joined[n].add(m)
    return joined


@dataclass(frozen=True, eq=False)
class Patch:
    """The straight beam or flat surface about a node, with nothing else joined to it inside.

    Attributes
    ----------
    centre : int
        Index of the node.
    nodes : ndarray (n_nodes,), int
        All of it, the centre first.
    axes : tuple of int
        0..2: coordinates that tell the place on it, one along a beam, two on a surface.
    normals, tangents : ndarray (n, 3)
        Unit vectors.
    ends : tuple of (float, float)
        Least and largest coordinate of places along each axis, from the centre, m; the nodes reach farther.
    """

    centre: int
    nodes: np.ndarray
    axes: tuple[int, ...]
    normals: np.ndarray
    tangents: np.ndarray
    ends: tuple[tuple[float, float], ...]

    @property
    def along(self) -> np.ndarray:
        """How a place on it moves with each of its coordinates, (n_axes, 3)."""
        pick = self.tangents[:, list(self.axes)]
        return np.asarray(np.linalg.solve(pick, self.tangents))


def patch_about(model: StructuralModel, stiffness: sp.csr_array, point: Point, reach: float) -> Patch | None:
    """The beam or surface about the node nearest to a point; None where several meet, and in solids.

    Nodes are neighbours where K joins them. A place at which others join, such as the end of a beam or the root of a
    rib, ends it.

    Parameters
    ----------
    model : StructuralModel
    stiffness : csr_array (n_dof, n_dof)
        K at some values.
    point : (3,) float
        M.
    reach : float
        How far its places may lie from there, m.
    """
    points, node = model.mesh.points, model.dofs.node
    away = np.linalg.norm(points - np.array(point), axis=1)
    centre = int(np.argmin(away))
    offset = points - points[centre]
    far = np.linalg.norm(offset, axis=1)
    near = sorted(_neighbours(stiffness, node, np.array([centre]))[centre])
    if not near:
        return None
    joined = _neighbours(stiffness, node, np.flatnonzero(far <= max(RULES.free_wider * reach, 1.001 * far[near].max())))
    sizes, turned = np.linalg.svd(offset[near], full_matrices=True)[1:]
    dims = int((sizes > RULES.free_flat * sizes[0]).sum())
    if dims > 2 or (dims == 2 and not all(joined.get(n, set()) & set(near) for n in near)):
        return None
    tangents, normals = turned[:dims], turned[dims:]

    def off(n: int, m: int) -> bool:
        across = normals @ (points[m] - points[n])
        return float(np.linalg.norm(across)) > RULES.free_flat * float(np.linalg.norm(points[m] - points[n]))

    found: dict[int, None] = {centre: None}
    ahead = [centre]
    while ahead:
        n = ahead.pop(0)
        if n != centre and any(off(n, m) for m in joined[n]):
            continue  # others join here: it ends
        for m in sorted(joined[n]):
            if m in joined and m not in found and not off(centre, m):
                found[m] = None
                ahead.append(m)
    nodes = np.array(list(found))
    strength = np.abs(tangents).max(axis=0) if dims == 1 else 1 - np.abs(normals[0])
    axes = tuple(sorted(np.argsort(-strength, kind="stable")[:dims].tolist()))
    ends = tuple((max(float(offset[nodes, a].min()), -reach), min(float(offset[nodes, a].max()), reach)) for a in axes)
    return Patch(centre, nodes, axes, normals, tangents, ends)


def with_free_places(
    model: StructuralModel, values: Mapping[str, float], found: Sequence[Composition], names: Names
) -> list[Composition]:
    """The compositions, those of one mass or one spring to the ground with one at a free place as the richer member.

    It moves as far as the farthest node that is nearer to this place than to those of the others of its kind.
    """
    stiffness = sp.csr_array(model.matrices(values)[0])
    patches: dict[tuple[Point, float], Patch | None] = {}
    out, reaches = [], {kind: _reaches(model, found, kind) for kind in _FREE}
    for one in found:
        if one.kind in _FREE and one.count == 1:
            (point,), reach = one.places, reaches[one.kind][one.places[0]]
            if (point, reach) not in patches:
                patches[point, reach] = patch_about(model, stiffness, point, reach)
            patch = patches[point, reach]
            if patch is not None:
                one = replace(one, effect=replace(one.effect, richer=_freed(model, one, patch, reach, names)))
        out.append(one)
    return out


def _reaches(model: StructuralModel, found: Sequence[Composition], kind: str) -> dict[Point, float]:
    """By place of a kind, the distance of the farthest node that is nearer to it than to the others, m."""
    places = list(dict.fromkeys(one.places[0] for one in found if one.kind == kind and one.count == 1))
    if not places:
        return {}
    away = np.linalg.norm(model.mesh.points[:, None] - np.array(places)[None], axis=2)
    nearest, least = away.argmin(axis=1), away.min(axis=1)
    away[away < 1e-9 * max(float(away.max()), 1e-300)] = np.inf
    beside = away.min(axis=0)  # a node at least
    return {p: max(float(least[nearest == k].max(initial=0.0)), float(beside[k])) for k, p in enumerate(places)}


def _freed(model: StructuralModel, one: Composition, patch: Patch, reach: float, names: Names) -> Effect:
    """The same at a place that is free on a patch."""
    effect, build = one.effect, one.builder
    x, y, z = model.mesh.points[patch.centre].tolist()
    assert isinstance(build, PointMass | Connection)
    directions = build.directions if isinstance(build, PointMass) else (build.direction,)
    name = names.free(f"{one.kind} near {effect.name.removeprefix(slug(one.kind)).strip('_')}", "_x", "_y", "_z")
    magnitude = replace(effect.magnitude, name=name, description=f"{effect.magnitude.description}, or near it")
    offsets = tuple(
        Parameter(
            f"{name}_{AXES[axis]}",
            0.0,
            *ends,
            "m",
            prior_sd=reach,
            description=f"its place from there along {AXES[axis]}",
        )
        for axis, ends in zip(patch.axes, patch.ends, strict=True)
    )
    still = {name: magnitude.prior_width} | {p.name: 0.0 for p in offsets}
    grid = [still, *(still | {p.name: end / 2} for p in offsets for end in (p.lower, p.upper) if end)]
    free = FreePlace(name, "mass" if one.kind == "added mass" else "stiffness", (x, y, z), directions, reach)
    what = effect.title.partition(" at ")[0]
    return Effect(
        name, f"{what} near {one.at}", effect.lacks, effect.look_for, magnitude, free, offsets, tuple(grid),
        phrase=f"{what[:1].lower()}{what[1:]} near {one.at}",
    )  # fmt: skip


@dataclass(frozen=True)
class FreePlace:
    """A mass, or a spring to the ground, at a place that parameters move from a point along a beam or a surface.

    Attributes
    ----------
    name : str
        Of the mass or stiffness; offsets along x, y and z have its name with ``_x``, ``_y`` and ``_z``, m.
    matrix : {"mass", "stiffness"}
    point : (3,) float
        M.
    directions : tuple of int
        0..2 for x, y, z: motions on which it acts.
    reach : float
        How far it may move, m.
    """

    name: str
    matrix: str
    point: Point
    directions: tuple[int, ...]
    reach: float

    def __call__(self, model: StructuralModel) -> Addition:
        """See `at_free_place`."""
        return at_free_place(model, self.name, self.matrix, self.point, self.directions, self.reach)

    @property
    def code(self) -> tuple[str, ...]:
        """See `calib.structure.effects.composed.Builder`."""
        point = f"({', '.join(repr(float(c)) for c in self.point)})"
        acts = f"({', '.join(map(str, self.directions))},)"
        return (f'return at_free_place(model, "{self.name}", "{self.matrix}", {point}, {acts}, {self.reach!r})',)

    def moved(self, values: Mapping[str, float]) -> Point:
        """The place at some values, as far as they tell it, m."""
        x, y, z = (c + values.get(f"{self.name}_{axis}", 0.0) for c, axis in zip(self.point, AXES, strict=True))
        return (x, y, z)


def at_free_place(
    model: StructuralModel, name: str, matrix: str, point: Point, directions: Sequence[int], reach: float
) -> Addition:
    """Terms of a mass or a spring to the ground whose place is free, in powers of its offsets from a node.

    Near a node the motion of a beam or a surface is a polynomial of the place, that fits the translations of the nodes
    about it, and their rotations as its slopes, by least squares: what an element's shape functions are where they are
    known. A rigid body's motion is met exactly.

    Parameters
    ----------
    name, matrix, point, directions, reach
        As in `FreePlace`.

    Raises
    ------
    InputError
        Where no beam and no surface lies about that point.
    """
    values = model.space.si(model.space.values)
    patch = patch_about(model, sp.csr_array(model.stiffness(values)), point, reach)
    if patch is None:
        raise InputError(f"the model {model.name} has no beam and no surface there", place=f"effect {name}")
    scale = max(max(map(abs, ends)) for ends in patch.ends)
    powers, columns, motions = _motion(model, patch, directions, scale)
    blocks: dict[tuple[int, ...], np.ndarray] = {}
    for (k, one), (j, other) in product(enumerate(powers), repeat=2):
        key = tuple(np.add(one, other).tolist())
        block = np.einsum("da,db->ab", motions[:, k], motions[:, j])
        blocks[key] = blocks[key] + block if key in blocks else block
    own = [f"{name}_{AXES[axis]}" for axis in patch.axes]
    most = max(float(np.abs(block).max()) for block in blocks.values())
    terms = []
    for key, block in blocks.items():
        if not np.abs(block).max() > 1e-12 * most:
            continue
        row, column = np.meshgrid(columns, columns, indexing="ij")
        whole = sp.coo_array((((block + block.T) / 2).ravel(), (row.ravel(), column.ravel())), (model.n_dof,) * 2)
        raised = tuple((n, float(p)) for n, p in zip(own, key, strict=True) if p)
        coefficient = Monomial(scale ** -sum(key), ((name, 1.0), *raised))
        terms.append(Term(f"{name}: power {' '.join(map(str, key))}", sp.csr_array(whole), coefficient))
    return Addition(mass=tuple(terms)) if matrix == "mass" else Addition(stiffness=tuple(terms))


def _motion(
    model: StructuralModel, patch: Patch, directions: Sequence[int], scale: float
) -> tuple[list[tuple[int, ...]], np.ndarray, np.ndarray]:
    """Powers of the offsets over a scale, degrees of freedom, and the motion's coefficients (n_dir, n_powers, n)."""
    nodes = patch.nodes[_spread(model.mesh.points[patch.nodes])]
    rows = sp.csr_array(model.dofs.expansion)[[6 * n + k for n in nodes.tolist() for k in range(6)]]
    columns = np.unique(rows.indices)
    motion = rows[:, columns].toarray().reshape(len(nodes), 6, len(columns))
    turns = np.abs(motion[:, 3:]).max(axis=(1, 2)) > 0
    at = (model.mesh.points[nodes] - model.mesh.points[patch.centre])[:, list(patch.axes)] / scale
    dims = len(patch.axes)
    powers = list(_powers(RULES.free_degrees[dims - 1], dims))
    out = np.zeros((len(directions), len(powers), len(columns)))
    for across, unit in [*((True, n) for n in patch.normals), *((False, t) for t in patch.tangents)]:
        equations, known = [_values(at, powers)], [np.einsum("k,nkc->nc", unit, motion[:, :3])]
        for axis, way in enumerate(patch.along if across else ()):
            equations.append(_slopes(at[turns], powers, axis))
            known.append(scale * np.einsum("k,nkc->nc", np.cross(way, unit), motion[turns, 3:]))
        left, right = np.vstack(equations), np.vstack(known)
        most = RULES.free_degrees[dims - 1] if across and turns.any() else RULES.free_unturned
        degree = max(d for d in range(most + 1) if len(left) >= RULES.free_spare[dims - 1] * _count(d, dims) or d == 1)
        used = [k for k, p in enumerate(powers) if sum(p) <= degree]
        fitted = np.linalg.pinv(left[:, used], rcond=1e-8) @ right
        out[:, used] += np.einsum("d,kc->dkc", unit[list(directions)], fitted)
    return powers, columns, out


def _spread(points: np.ndarray) -> np.ndarray:
    """Indices of some of many points, each as far as possible from those before; the first one first."""
    if len(points) <= RULES.free_nodes:
        return np.arange(len(points))
    chosen, far = [0], np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < RULES.free_nodes:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _powers(degree: int, dims: int) -> Iterator[tuple[int, ...]]:
    for total in range(degree + 1):
        yield from (p for p in product(range(total + 1), repeat=dims) if sum(p) == total)


def _count(degree: int, dims: int) -> int:
    return degree + 1 if dims == 1 else (degree + 1) * (degree + 2) // 2


def _values(at: np.ndarray, powers: Sequence[tuple[int, ...]]) -> np.ndarray:
    return np.stack([np.prod(at ** np.array(p), axis=1) for p in powers], axis=1)


def _slopes(at: np.ndarray, powers: Sequence[tuple[int, ...]], axis: int) -> np.ndarray:
    out = []
    for p in powers:
        less = np.array(p)
        less[axis] = max(less[axis] - 1, 0)
        out.append(p[axis] * np.prod(at**less, axis=1))
    return np.stack(out, axis=1)
