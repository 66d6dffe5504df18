"""A solar array of two panels on beams, clamped at the yoke: the example of Li and Hong (2012), reconstructed.

The article gives 31 nodes, 90 degrees of freedom, 16 plates, 4 beams, the moduli, the plates' thickness, the beams'
area and the twelve master nodes. Its geometry, densities and Poisson's ratios are lost and assumed here; so is the
rigid connection of plates and beams, since hinged beams would leave mechanisms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib import InputError, Parameter, ParameterSpace, StructuralModel
from calib.structure import AffineMatrix, Assumption, DofMap, Mesh, Monomial, NodeLocator, Part, Term, parameter
from models.fem import beam, thin_plate
from models.fem.nodes import NodeTable, assemble
from models.fem.section import Section

SOURCE = "Li and Hong 2012"
LENGTH, WIDTH = 0.8, 0.4
"""Of a panel, m (assumed)."""
GAP, YOKE = 0.4, 0.4
"""Between the panels, and from the second one to the clamp, m (assumed)."""
THICKNESS = 6e-3
PLATE_POISSON, PLATE_DENSITY = 0.30, 8000.0
SIDE = 10e-3
"""Of the beams' square section, m: the area of 1 cm^2 is published."""
TORSION = 0.1406
"""Torsion constant of a square over the fourth power of its side (Timoshenko and Goodier 1970)."""


def square_bar(side: float) -> Section:
    """Section of a square aluminium bar of that side, m, for a Young's modulus of 1 Pa; it does not shear."""
    return Section(
        area=side**2, i_y=side**4 / 12, i_z=side**4 / 12, torsion=TORSION * side**4, young_modulus=1.0,
        poisson_ratio=0.33, density=2700.0, shear_coefficient=math.inf,
    )  # fmt: skip


BEAM = square_bar(SIDE)
E_PLATE, E_BEAM = 193.0, 70.0
"""GPa."""
MASTERS = (1, 3, 7, 9, 13, 15, 16, 18, 22, 24, 28, 30)
"""Nodes whose deflections are measured."""
BEAMS = {17: (13, 16), 18: (15, 18), 19: (28, 31), 20: (30, 31)}
"""Their nodes; node 31 is the clamp."""
GROUPS = ("E_panel_1", "E_panel_2", "E_beam_17", "E_beam_18", "E_beam_19", "E_beam_20")
FRAME = "frame"
"""Group of the bars round the panels."""
ROWS = 5
"""Of nodes along a panel; three nodes in each row."""
LARGEST_RATIO = 0.1
"""Of damping; a light metal structure has less than a tenth of it."""
_FREE = (2, 3, 4)
"""Deflection and the two rotations that bend: motions in the panels' plane are constrained, as in the article."""

_ASSUMED = (
    Assumption("panels", f"{LENGTH:g} x {WIDTH:g}", "m", "dimensions are lost"),
    Assumption("gap and yoke", f"{GAP:g} and {YOKE:g}", "m", "dimensions are lost"),
    Assumption("plates", "8000", "kg/m3", "density of the steel is lost; Poisson's ratio 0.30 as well"),
    Assumption("beams", "2700", "kg/m3", "density of the aluminium is lost; Poisson's ratio 0.33 as well"),
    Assumption("beams", "10 x 10", "mm", "only the area of 1 cm2 is published"),
    Assumption("connections", "rigid", "-", "hinges would leave mechanisms"),
)
_ASSUMED_DAMPING = Assumption("damping", "equal ratios of all modes", "-", "the article's array has no damping")


@dataclass(frozen=True)
class _Piece:
    """A plate or beam of the article, or a side of a frame, with its elements.

    Attributes
    ----------
    name, group : str
        Its number in the article, and the parameter that is its Young's modulus; a frame has a known one.
    nodes : ndarray (n, 4) or (n, 2), int
        Of each element.
    stiffness, mass : ndarray (n, 6 m, 6 m)
        Element matrices over all motions of their m nodes, for a Young's modulus of 1 Pa.
    """

    name: str
    group: str
    nodes: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray


def solar_panel(
    density: int = 1, gap: float = GAP, yoke: float = YOKE, damping_ratio: float = 0.0, frame: float = 0.0
) -> StructuralModel:
    """The array, with the Young's moduli of its two panels and four beams as parameters.

    Parameters
    ----------
    density : int
        Elements along each side of a plate and along each beam; 1 is the article's mesh.
    gap, yoke : float
        m.
    damping_ratio : float
        Nominal ratio of one more parameter, ``damping_ratio``: viscous damping with that ratio in every mode of the
        nominal array. 0 leaves the array undamped, as in the article, and without the parameter.
    frame : float
        Side of square aluminium bars along all edges of both panels, m. 0 leaves the panels without, as in the article:
        its beams then turn a thin plate at a point, which gives way the more, the finer the mesh. Bars of 20 mm take
        that couple, and natural frequencies converge: those of density 2 below 75 Hz are within 0.06 % of the limit.

    Raises
    ------
    InputError
        When the density is below 1, a length is not positive, the frame is negative or the ratio is not within 0 and
        0.1.
    """
    if density < 1 or not (gap > 0 and yoke > 0):
        raise InputError(
            f"the density is {density}, the gap {gap:g} m and the yoke {yoke:g} m",
            place="solar panel",
            remedy="give a density of 1 or more and positive lengths",
        )
    if not 0 <= frame < math.inf:
        raise InputError(
            f"the bars of the frame have a side of {frame:g} m", place="solar panel", remedy="give 0 or more, in m"
        )
    if not 0 <= damping_ratio <= LARGEST_RATIO:
        raise InputError(
            f"the damping ratio is {damping_ratio:g}",
            place="solar panel",
            remedy=f"give one between 0 and {LARGEST_RATIO:g}",
        )
    table = NodeTable()
    clamp = [table.number("array", place) for place in _places(gap, yoke)][-1]
    pieces = [*_plates(table, density), *_beams(table, density), *(_frames(table, density, frame) if frame else ())]
    points = np.array(table.points)
    node = np.repeat(np.delete(np.arange(len(points)), clamp), len(_FREE))
    direction = np.tile(_FREE, len(points) - 1)
    expansion = sp.csr_array(
        (np.ones(len(node)), (6 * node + direction, np.arange(len(node)))), shape=(6 * len(points), len(node))
    )

    def free(own: _Piece, blocks: np.ndarray) -> sp.csr_array:
        return sp.csr_array(expansion.T @ assemble(own.nodes, blocks, 6 * len(points)) @ expansion)

    stiff = {piece.name: free(piece, piece.stiffness) for piece in pieces}
    heavy = {piece.name: free(piece, piece.mass) for piece in pieces}
    parts = []
    for piece in pieces:
        x, y, z = points[np.unique(piece.nodes)].mean(axis=0)
        parts.append(Part(piece.name, "stiffness", stiff[piece.name], _modulus_of(piece), (x, y, z)))
        parts.append(Part(piece.name, "mass", heavy[piece.name], Monomial(), (x, y, z)))
    own: dict[str, list[_Piece]] = {}
    for piece in pieces:
        own.setdefault(piece.group, []).append(piece)
    lines = [(piece.group, line) for piece in pieces for line in _edges(piece.nodes)]
    faces = [(piece.group, face) for piece in pieces for face in piece.nodes if len(face) == 4]
    stiffness = AffineMatrix(
        len(node), tuple(Term(g, _sum(stiff[p.name] for p in some), _modulus_of(some[0])) for g, some in own.items())
    )
    mass, space = _sum(heavy.values()), ParameterSpace(tuple(_modulus(group) for group in GROUPS))
    damping: tuple[Term, ...] = ()
    if damping_ratio > 0:
        each = _modal_damping(stiffness(space.si(space.values)), mass)
        damping = (Term("damping_ratio", each, parameter("damping_ratio")),)
        space = ParameterSpace((*space.parameters, _ratio(damping_ratio)))
    return StructuralModel(
        name="solar panel",
        space=space,
        stiffness=stiffness,
        damping=AffineMatrix(len(node), damping),
        mass=AffineMatrix(len(node), (Term("mass", mass),)),
        mesh=Mesh(
            points,
            np.array([line for _, line in lines]),
            tuple(group for group, _ in lines),
            np.array([face for _, face in faces]),
            tuple(group for group, _ in faces),
        ),
        dofs=DofMap(expansion, node, direction),
        clusters={
            "front_panel": np.flatnonzero(points[node, 0] < LENGTH + gap / 2),
            "rear_panel": np.flatnonzero(points[node, 0] > LENGTH + gap / 2),
        },
        locator=NodeLocator(points, expansion),
        assumptions=(*_ASSUMED, *((_ASSUMED_DAMPING,) if damping else ()), *((_framed(frame),) if frame else ())),
        sensor_tolerance=0.02,
        parts=tuple(parts),
        labels=tuple(range(1, len(points) + 1)),
    )


def _places(gap: float, yoke: float) -> list[np.ndarray]:
    """Of the article's 31 nodes: rows of three along either panel, and the clamp on the centre line."""
    along = np.linspace(0.0, LENGTH, ROWS)
    rows = [*along, *(along + LENGTH + gap)]
    out = [np.array([x, y, 0.0]) for x in rows for y in (-WIDTH / 2, 0.0, WIDTH / 2)]
    return [*out, np.array([rows[-1] + yoke, 0.0, 0.0])]


def _plates(table: NodeTable, density: int) -> Iterator[_Piece]:
    """Plates 1 to 8 of the first panel and 9 to 16 of the second."""
    motions = (6 * np.arange(4)[:, None] + _FREE).ravel()
    for panel in range(2):
        for k in range(8):
            row, column = divmod(k, 2)
            first = table.points[3 * (ROWS * panel + row) + column]
            a, b = LENGTH / (ROWS - 1) / density, WIDTH / 2 / density
            nodes = []
            for i, j in np.ndindex(density, density):
                corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                nodes.append([table.number("array", first + np.array([p * a, q * b, 0.0])) for p, q in corners])
            blocks = np.zeros((2, 24, 24))
            blocks[0][np.ix_(motions, motions)] = thin_plate.stiffness(a, b, THICKNESS, PLATE_POISSON)
            blocks[1][np.ix_(motions, motions)] = thin_plate.mass(a, b, PLATE_DENSITY * THICKNESS)
            stiffness, mass = (np.repeat(block[None], density**2, axis=0) for block in blocks)
            yield _Piece(f"plate {8 * panel + k + 1}", GROUPS[panel], np.array(nodes), stiffness, mass)


def _beams(table: NodeTable, density: int) -> Iterator[_Piece]:
    for number, (first, last) in BEAMS.items():
        yield _bar(f"beam {number}", f"E_beam_{number}", BEAM, table, first - 1, last - 1, density)


def _frames(table: NodeTable, density: int, side: float) -> Iterator[_Piece]:
    """Four bars round each panel, between its corners."""
    section, last = square_bar(side), 3 * (ROWS - 1)
    for panel in range(2):
        first = 3 * ROWS * panel
        sides = {"front": (0, 2), "rear": (last, last + 2), "right": (0, last), "left": (2, last + 2)}
        for name, (a, b) in sides.items():
            count = density * (2 if name in ("front", "rear") else ROWS - 1)
            yield _bar(f"frame {panel + 1} {name}", FRAME, section, table, first + a, first + b, count)


def _bar(name: str, group: str, section: Section, table: NodeTable, first: int, last: int, count: int) -> _Piece:
    """So many beam elements on a straight line between two nodes, given by their indices."""
    start, end = table.points[first], table.points[last]
    chain = [table.number("array", start + t * (end - start)) for t in np.linspace(0.0, 1.0, count + 1)]
    points = np.array([table.points[k] for k in chain])
    length, rotation = beam.axes(points[:-1], points[1:], np.tile([0.0, 0.0, 1.0], (count, 1)))
    arms = np.zeros((count, 2, 3))
    stiffness, mass = (beam.to_global(make(section, length), rotation, arms) for make in (beam.stiffness, beam.mass))
    return _Piece(name, group, np.column_stack([chain[:-1], chain[1:]]), stiffness, mass)


def _modulus_of(piece: _Piece) -> Monomial:
    """Young's modulus, Pa: a parameter, or that of a frame."""
    return Monomial(1e9 * E_BEAM) if piece.group == FRAME else parameter(piece.group)


def _framed(side: float) -> Assumption:
    words = "the article's panels have none; with them frequencies converge with the mesh"
    return Assumption("frames", f"{1e3 * side:g} x {1e3 * side:g}", "mm", words)


def _edges(nodes: np.ndarray) -> list[tuple[int, int]]:
    """Lines of beams, or of the edges of plates, as pairs of node indices."""
    closed = np.column_stack([nodes, nodes[:, 0]]) if nodes.shape[1] > 2 else nodes
    return [(int(a), int(b)) for chain in closed for a, b in pairwise(chain)]


def _sum(matrices: Iterable[sp.csr_array]) -> sp.csr_array:
    first, *others = matrices
    return sp.csr_array(sum(others, first))


def _modal_damping(stiffness: sp.csc_array, mass: sp.csr_array) -> sp.csr_array:
    """``C = sum_r 2 omega_r (M phi_r)(M phi_r)^T``: a damping ratio of 1 in every mode (Clough and Penzien 1993)."""
    dense = mass.toarray()
    squares, shapes = la.eigh(stiffness.toarray(), dense)
    moved = dense @ (shapes * np.sqrt(2) * squares**0.25)
    return sp.csr_array(moved @ moved.T)


def _ratio(nominal: float) -> Parameter:
    return Parameter(
        "damping_ratio", nominal, 0.2 * nominal, 5.0 * nominal, source="assumed", assumed="nominal value and limits",
        description="damping ratio of every mode of the nominal array",
    )  # fmt: skip


def _modulus(name: str) -> Parameter:
    nominal = E_PLATE if name.startswith("E_panel") else E_BEAM
    return Parameter(
        name, nominal, 0.5 * nominal, 2.0 * nominal, "GPa", source=SOURCE, assumed="limits",
        description=f"Young's modulus of {name[2:].replace('_', ' ')}",
    )  # fmt: skip
