"""Building blocks of effects: springs between points, scaled parts, oscillators, dampers on flexible mounts.

Each acts at points of the geometry, found by the model's locator, or on named parts, so that an effect does not depend
on the mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from calib.errors.errors import InputError
from calib.structure.affine import Coefficient, Monomial, SelectedTerm, SeriesLoss, StretchPower, Term, parameter
from calib.structure.effects.extend import Addition
from calib.structure.elongations import elongations
from calib.structure.located import nearest_limit
from calib.structure.model import Part, PartKind, StructuralModel

GRAVITY = 9.81
ENDS = 48
"""Most degrees of freedom that a spring or a damper with ends takes part in."""

Place = tuple[str | None, tuple[float, float, float]]
"""Part that carries a point (None for the nearest), and the point in m."""


def motion(model: StructuralModel, place: Place, direction: int) -> np.ndarray:
    """Motion of a point over the model's degrees of freedom, (n_dof,); direction 0..5 for ux, uy, uz, rx, ry, rz.

    InputError for an unknown part, or a point farther from its part than the size of the model.
    """
    part, point = place
    row, distance = model.locator.row(point, direction, part)
    if distance > max(nearest_limit(model), float(np.ptp(model.mesh.points, axis=0).max(initial=0.0))):
        raise InputError(
            f"the point ({', '.join(f'{c:g}' for c in point)}) lies {distance:.4g} m from the {part or 'model'}",
            remedy="coordinates are in m",
        )
    return row


def between(model: StructuralModel, one: Place, other: Place, direction: int) -> np.ndarray:
    """Relative motion of two points, (n_dof,); for translations they should coincide, or rotations contribute."""
    return motion(model, one, direction) - motion(model, other, direction)


def outer_term(name: str, rows: Sequence[np.ndarray], coefficient: Coefficient, n_added: int = 0) -> Term:
    """The sum of ``b b^T`` over motions b (n_dof,), such as springs of one stiffness, with degrees of freedom added."""
    stacked = sp.csr_array(np.pad(np.atleast_2d(np.asarray(rows, dtype=float)), ((0, 0), (0, n_added))))
    stacked.eliminate_zeros()
    return Term(name, sp.csr_array(stacked.T @ stacked), coefficient)


def parts_of(model: StructuralModel) -> tuple[Part, ...]:
    """The parts of a model; without any, its affine terms with a monomial coefficient, at the centroid of its nodes."""
    return model.parts or tuple(_terms_as_parts(model))


def _terms_as_parts(model: StructuralModel) -> Iterator[Part]:
    kinds: tuple[PartKind, ...] = ("stiffness", "damping", "mass")
    for kind in kinds:
        for term in getattr(model, kind).terms:
            if isinstance(term.coefficient, Monomial):
                nodes = model.dofs.node[np.unique(sp.csr_array(term.matrix).indices)]
                points = model.mesh.points[nodes[nodes >= 0]]
                x, y, z = points.mean(axis=0) if len(points) else np.full(3, np.nan)  # matrices may have no nodes
                place = (float(x), float(y), float(z))
                yield Part(term.name, kind, sp.csr_array(term.matrix), term.coefficient, place)


def part_of(model: StructuralModel, kind: PartKind, name: str) -> Part:
    """The part of that kind and name; InputError when there is not exactly one."""
    found = [p for p in parts_of(model) if p.kind == kind and p.name == name]
    if len(found) != 1:
        raise InputError(f"the model {model.name} has {len(found)} parts {name!r} of {kind}", place="effect")
    return found[0]


def scaled_part(model: StructuralModel, kind: PartKind, name: str, magnitude: str, factor: float = 1.0) -> Term:
    """Term that scales a part by ``1 + factor * magnitude``."""
    part = part_of(model, kind, name)
    powers = (*part.coefficient.powers, (magnitude, 1.0))
    return Term(f"{magnitude}: {name}", part.matrix, Monomial(factor * part.coefficient.factor, powers), name)


def thicker_part(model: StructuralModel, name: str, magnitude: str) -> tuple[Term, ...]:
    """Terms that scale a part's stiffness by ``(1 + magnitude)^3``, as bending grows with the thickness."""
    part = part_of(model, "stiffness", name)
    powers, factor = part.coefficient.powers, part.coefficient.factor
    return tuple(
        Term(
            f"{magnitude}: {name}, power {k}", part.matrix, Monomial(n * factor, (*powers, (magnitude, float(k)))), name
        )
        for k, n in ((1, 3.0), (2, 3.0), (3, 1.0))
    )


def softened_part(model: StructuralModel, name: str, flexibility: str) -> Term:
    """Change of a part's stiffness by a flexibility in series with each of its springs.

    The part's coefficient is the stiffness of each spring; no two springs share an end.
    """
    part = part_of(model, "stiffness", name)
    return Term(f"{flexibility}: {name}", part.matrix, SeriesLoss(part.coefficient, parameter(flexibility)), name)


def moved_masses(motions: Callable[[float], np.ndarray], shift: str, reach: float, stretches: int) -> tuple[Term, ...]:
    """Mass terms that shift masses of a model from their positions, all by one distance.

    The masses are removed at their positions and added at the shifted ones, so that they load the carrier there. The
    carrier's motion is a cubic polynomial of the shift on each interval, like that of a beam between its nodes; the
    mass is then a polynomial there, nowhere negative, and at shift 0 the model's own.

    Parameters
    ----------
    motions : callable
        From a shift in m to the motions of the masses there, (n_motions, n_dof), each times the square root of its mass
        or moment of inertia; at shift 0 those of the model.
    shift : str
        Name of the parameter.
    reach : float
        Largest shift in either direction, m.
    stretches : int
        Intervals in either direction; one for each element of the carrier is enough.
    """
    places = (1 - np.cos(np.linspace(0, np.pi, 4))) / 2
    weights = np.linalg.inv(np.vander(places, increasing=True))
    weights[0] = (1, 0, 0, 0)  # exact, so that the terms vanish at shift 0
    own = sp.csr_array(motions(0.0))
    n, terms = own.shape[0], []
    for side in (1, -1):
        first = own
        for k in range(stretches):
            start, end = (side * reach * j / stretches for j in (k, k + 1))
            at = [first, *(sp.csr_array(motions(start + float(place) * (end - start))) for place in places[1:])]
            first = at[-1]
            powers = sp.csr_array(sp.kron(weights, sp.eye_array(n)) @ sp.vstack(at))
            for power in range(7):
                pairs = [(p, power - p) for p in range(4) if 0 <= power - p < 4]
                one, other = (
                    sp.vstack([powers[n * pair[i] : n * (pair[i] + 1)] for pair in pairs]).tocsr() for i in (0, 1)
                )
                matrix = one.T @ other
                if power == 0:
                    if k == 0:
                        continue
                    matrix = matrix - own.T @ own
                coefficient = StretchPower(shift, start, end, power, k == stretches - 1)
                terms.append(
                    Term(f"{shift}: stretch {side * (k + 1)}, power {power}", sp.csr_array(matrix), coefficient)
                )
    return tuple(terms)


def hung_masses(rows: Sequence[np.ndarray], mass: str, freq: str, damping_ratio: float, share: float = 1.0) -> Addition:
    """Masses attached to a model by springs, one added degree of freedom each.

    With b the motion of the attachment and s the relative motion times the square root of the mass, the kinetic energy
    is ``m b'^2/2 + sqrt(m) b' s' + s'^2/2`` and the strain energy ``(2 pi f)^2 s^2/2``: regular at mass 0, where the
    oscillators are decoupled.

    Parameters
    ----------
    rows : sequence of ndarray (n_dof,)
    mass, freq : str
        Names of the parameters: total mass, natural frequency on a fixed base.
    damping_ratio : float
        Of the oscillators on a fixed base.
    share : float
        Fraction of the mass in each oscillator, times their number.
    """
    count = len(rows)
    part = share / count
    own, cross = _beside(rows)
    return Addition(
        stiffness=(Term(f"{mass}: spring", own, Monomial((2 * math.pi) ** 2, ((freq, 2.0),))),),
        damping=(Term(f"{mass}: damper", own, Monomial(4 * math.pi * damping_ratio, ((freq, 1.0),))),),
        mass=(
            outer_term(f"{mass}: carried along", rows, Monomial(part, ((mass, 1.0),)), count),
            Term(f"{mass}: coupling", cross, Monomial(math.sqrt(part), ((mass, 0.5),))),
            Term(f"{mass}: own", own),
        ),
        n_added=count,
    )


def loosened_masses(rows: Sequence[np.ndarray], sag: str, damping_ratio: float) -> Addition:
    """Masses that a model carries rigidly, released on springs, one added degree of freedom for each row.

    With b a row (motion times the square root of the mass), ``s = sag/gravity = 1/omega^2`` and ``g sqrt(s)`` the
    motion relative to it, the kinetic energy is ``(b' + sqrt(s) g')^2/2``, whose first term the model has, and the
    strain energy ``g^2/2``: regular at sag 0, where g is 0.

    Parameters
    ----------
    rows : sequence of ndarray (n_dof,)
    sag : str
        Name of the parameter: static deflection of the springs under the mass.
    damping_ratio : float
        Of the masses on a fixed base.
    """
    own, cross = _beside(rows)
    return Addition(
        stiffness=(Term(f"{sag}: springs", own),),
        damping=(Term(f"{sag}: dampers", own, Monomial(2 * damping_ratio / math.sqrt(GRAVITY), ((sag, 0.5),))),),
        mass=(
            Term(f"{sag}: coupling", cross, Monomial(1 / math.sqrt(GRAVITY), ((sag, 0.5),))),
            Term(f"{sag}: own", own, Monomial(1 / GRAVITY, ((sag, 1.0),))),
        ),
        n_added=len(rows),
    )


def maxwell_branches(rows: Sequence[np.ndarray], stiffness: str, corner_freq: str) -> Addition:
    """Springs with a damper in series (Maxwell elements) added to a model, one degree of freedom each.

    With b the elongation of the branch, k its spring and ``g/sqrt(k)`` the stroke of its damper, the strain energy is
    ``(sqrt(k) b - g)^2/2`` and the dissipation ``g'^2/(2 pi f)``: regular at stiffness 0, where g is decoupled.

    Parameters
    ----------
    rows : sequence of ndarray (n_dof,)
        Elongation of each branch.
    stiffness, corner_freq : str
        Names of the parameters: stiffness of each spring, and the corner frequency f, at which its damper has the same
        dynamic stiffness.
    """
    count = len(rows)
    own, cross = _beside(rows)
    return Addition(
        stiffness=(
            outer_term(f"{stiffness}: springs", rows, parameter(stiffness), count),
            Term(f"{stiffness}: coupling", cross, Monomial(-1.0, ((stiffness, 0.5),))),
            Term(f"{stiffness}: own", own),
        ),
        damping=(Term(f"{stiffness}: dampers", own, Monomial(1 / (2 * math.pi), ((corner_freq, -1.0),))),),
        n_added=count,
    )


def soft_mounts(rows: Sequence[np.ndarray], damping: str, flexibility: str) -> Addition:
    """Flexible mounts in series with dampers that a model mounts rigidly (Maxwell elements).

    With s the flexibility and ``g = x/sqrt(s)`` for the deflection x of the mount, the force balance between mount and
    damper is ``g + c s g' - c sqrt(s) b' = 0``: regular at flexibility 0, where g is 0.

    Parameters
    ----------
    rows : sequence of ndarray (n_dof,)
        Elongation of each damper.
    damping, flexibility : str
        Names of the parameters: damping constant of each damper, flexibility of each mount.
    """
    count = len(rows)
    own, cross = _beside(rows)
    return Addition(
        stiffness=(Term(f"{flexibility}: mounts", own),),
        damping=(
            Term(f"{flexibility}: own", own, Monomial(1.0, ((damping, 1.0), (flexibility, 1.0)))),
            Term(f"{flexibility}: coupling", cross, Monomial(-1.0, ((damping, 1.0), (flexibility, 0.5)))),
        ),
        n_added=count,
    )


def mounted_dampers(model: StructuralModel, names: Sequence[str], lag: str) -> Addition:
    """Springs in series with dampers of a model (Maxwell elements), one degree of freedom for each motion they damp.

    The lag t of a damper c on a spring k is ``c/k``; as a function of the frequency its damping is ``c/(1 + (2 pi f
    t)^2)``. With b the elongation and ``g = x sqrt(c/t)`` for the deflection x of the spring, the balance of forces is
    ``g + t g' - sqrt(c t) b' = 0``: regular at lag 0, where g is 0.

    Parameters
    ----------
    names : sequence of str
        Parts of damping; InputError for another name, or for one as by `calib.structure.elongations.elongations`.
    lag : str
        Name of the parameter.
    """
    parts = [part_of(model, "damping", name) for name in names]
    rows = [elongations(part).toarray() for part in parts]
    count, first, damping = sum(map(len, rows)), 0, []
    own, _ = _beside([row for one in rows for row in one])
    for part, motions in zip(parts, rows, strict=True):
        still = np.zeros(model.n_dof)
        _, cross = _beside([*[still] * first, *motions, *[still] * (count - first - len(motions))])
        half = tuple((name, power / 2) for name, power in part.coefficient.powers)
        size = -math.sqrt(part.coefficient.factor)
        damping.append(Term(f"{lag}: {part.name}", cross, Monomial(size, (*half, (lag, 0.5)))))
        first += len(motions)
    return Addition(
        stiffness=(Term(f"{lag}: springs", own),),
        damping=(Term(f"{lag}: own", own, parameter(lag)), *damping),
        n_added=count,
    )


def softened_supports(model: StructuralModel, names: Sequence[str], flexibility: str) -> Addition:
    """Flexibilities in series with supports whose position discrete parameters select."""
    chosen = [term for term in model.stiffness.selected if term.name in names]
    if len(chosen) != len(names):
        raise InputError(f"the model {model.name} lacks one of the supports {', '.join(names)}", place="effect")
    soft = parameter(flexibility)
    return Addition(
        selected=tuple(
            SelectedTerm(f"{flexibility}: {t.name}", SeriesLoss(t.coefficient, soft), t.selectors, t.vectors)
            for t in chosen
        )
    )


def joined_nodes(model: StructuralModel, part: Part) -> dict[int, int]:
    """By the bodies that a spring joins, its node that is nearest to its midpoint; of one body if it is grounded.

    Bodies are groups of nodes that lines of the mesh connect; they are numbered. Empty for a large part, and for a
    spring within a single body.
    """
    matrix = sp.csr_array(part.matrix)
    used = np.unique(matrix.indices)
    nodes = np.unique(model.dofs.node[used]) if 0 < len(used) <= ENDS else np.zeros(0, dtype=int)
    nodes = nodes[nodes >= 0]
    if not len(nodes):
        return {}
    count, lines = len(model.mesh.points), np.reshape(model.mesh.lines, (-1, 2))
    joined = sp.coo_array((np.ones(len(lines)), (lines[:, 0], lines[:, 1])), shape=(count, count))
    body = connected_components(joined, directed=False)[1]
    far = np.linalg.norm(model.mesh.points[nodes] - np.array(part.place), axis=1)
    ends = {int(one): int(nodes[np.where(body[nodes] == one, far, np.inf).argmin()]) for one in np.unique(body[nodes])}
    grounded = _strained(model, used, matrix[used][:, used].toarray())
    return ends if len(ends) == 2 or (len(ends) == 1 and grounded) else {}


def relative_rotation(model: StructuralModel, part: Part, direction: int) -> np.ndarray | None:
    """Rotation of the bodies that a spring joins against each other, (n_dof,), or of one body against the ground.

    None where there are no such bodies (`joined_nodes`) or they have no such rotation; direction 3, 4, 5 for rx, ry,
    rz.
    """
    nodes = joined_nodes(model, part).values()
    rows = [model.dofs.expansion[[6 * node + direction]].toarray()[0] for node in nodes]
    if not rows or any(np.abs(row).max(initial=0.0) < 1e-9 for row in rows):
        return None
    row = rows[0] - rows[1] if len(rows) == 2 else rows[0]
    return row if np.abs(row).max() > 1e-9 else None


def _strained(model: StructuralModel, used: np.ndarray, own: np.ndarray) -> bool:
    """Whether translations of everything strain a spring, so that it stands on the ground."""
    moves = [(model.dofs.direction[used] == d).astype(float) for d in range(3)]
    return any(float(np.linalg.norm(own @ move)) > 1e-6 * float(np.abs(own).max()) for move in moves)


def elongation(model: StructuralModel, one: Place, other: Place) -> np.ndarray:
    """Elongation of a rod between two points, (n_dof,), along the line that joins them."""
    along = np.subtract(one[1], other[1])
    along = along / np.linalg.norm(along)
    moves = [motion(model, one, d) - motion(model, other, d) for d in range(3)]
    return np.asarray(along @ np.array(moves))


def _beside(rows: Sequence[np.ndarray]) -> tuple[sp.csr_array, sp.csr_array]:
    """Identity on one added degree of freedom a row, and its coupling with that row; over all degrees of freedom."""
    n, count = len(rows[0]), len(rows)
    own = sp.csr_array(sp.diags_array(np.concatenate([np.zeros(n), np.ones(count)])))
    own.eliminate_zeros()
    motions = sp.csr_array(np.asarray(rows, dtype=float))
    cross = sp.hstack([sp.csr_array((n + count, n)), sp.vstack([motions.T, sp.csr_array((count, count))])])
    return own, sp.csr_array(cross + cross.T)
