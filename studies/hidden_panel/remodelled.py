"""The solar array with an effect really built into its finer mesh, and designs that no effect of the library describes.

Every effect of the library has a counterpart here of the same parameters, made otherwise: a hinge splits the node, a
skin comes loose more in the middle than at the ends, a mass has a size, air moves more at the middle than at the edge,
a strut is a beam with nodes of its own. The magnitude keeps its meaning. Nothing here is a candidate of any analysis.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import scipy.sparse as sp

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, Monomial, Term, between, motion, outer_term, parameter, part_of
from models.fem import beam, thin_plate
from models.solar_panel import BEAM, GAP, LENGTH, PLATE_DENSITY, PLATE_POISSON, THICKNESS, WIDTH
from models.solar_panel_effects import (
    CENTRES,
    CLAMP,
    HARNESS,
    HARNESS_RATIO,
    INSTRUMENT,
    PANEL_HINGES,
    RX,
    RY,
    UZ,
    YOKE_HINGES,
    solar_panel_effects,
    strut_stiffness,
)

MOTIONS = (UZ, RX, RY)
HALF = 0.05
"""Half of the side of the instrument, of the distance of the harness' clips and of the cords' two ends, m."""
ROW = LENGTH / 4
"""Length of a row of the article's plates, m."""
ELEMENTS = 4
"""Of the finer mesh along such a row."""
STRUT_PIECES = 4
STRUT_MASS = 0.2
"""Mass of the strut over that of an aluminium beam of its stiffness: it is made of carbon."""

Build = Callable[[StructuralModel], Addition]


def remodelled_effects() -> tuple[Effect, ...]:
    """The library with everything built otherwise, for the finer mesh with an even number of elements along a plate."""
    made: dict[str, Build] = {
        "hinge_flexibility": partial(_hinges, "hinge_flexibility", PANEL_HINGES),
        "yoke_flexibility": partial(_hinges, "yoke_flexibility", YOKE_HINGES),
        "root_flexibility": _root, "locking_strut": _strut, "hinge_damper": _damper, "cracked_row": _cut,
        "instrument_mass": _instrument, "hung_harness": _harness, "air_mass": _air, "offload_cords": _cords,
    }  # fmt: skip
    return tuple(replace(effect, build=made[effect.name]) for effect in solar_panel_effects())


def outside_effects() -> tuple[Effect, ...]:
    """Designs that no effect of the library describes; the plausible size is one that an inspection would find."""
    designs: tuple[tuple[str, str, float, float, str, Build], ...] = (
        ("heavy_left", "Heavier left half of the rear panel", 2.0, 0.15, "share added to its mass", _heavy_left),
        ("broken_bar", "Cut rear bar of the front panel's frame", 0.95, 0.6, "share of its stiffness", _broken_bar),
        ("corner_mass", "Mass at a corner of the rear panel", 5.0, 0.4, "kg", _corner_mass),
    )
    return tuple(
        Effect(
            name, title, "It has no such difference.", "It is no candidate.",
            Parameter(name, 0.0, 0.0, upper, "kg" if words == "kg" else "-", prior_sd=size, description=words), build,
        )
        for name, title, upper, size, words, build in designs
    )  # fmt: skip


# -- split nodes -------------------------------------------------------------------------------------------------------


def _hinges(name: str, hinges: tuple[tuple[int, int], ...], model: StructuralModel) -> Addition:
    """Each beam ends in a rotation of its own, which a spring ties to that of the panel."""
    total, stiffness, mass, pins = model.n_dof + len(hinges), list[Term](), list[Term](), []
    for k, (number, node) in enumerate(hinges):
        shared = _dof(model, node - 1, RY)
        # The beam with its rotation at the node moved to a new degree of freedom, less the beam as it was.
        moved = sp.lil_array((model.n_dof, total))
        moved.setdiag(1.0)
        moved[shared, shared], moved[shared, model.n_dof + k] = 0.0, 1.0
        turn = sp.csr_array(moved)
        for kind, terms in (("stiffness", stiffness), ("mass", mass)):
            part = part_of(model, "stiffness" if kind == "stiffness" else "mass", f"beam {number}")
            change = turn.T @ part.matrix @ turn - _wide(part.matrix, total)
            terms.append(Term(f"{name}: split {kind} {k}", sp.csr_array(change), part.coefficient))
        pins.append(_unit(total, {shared: 1.0, model.n_dof + k: -1.0}))
    springs = outer_term(f"{name}: springs", pins, Monomial(1.0, ((name, -1.0),)))
    return Addition(stiffness=(*stiffness, springs), mass=tuple(mass), n_added=len(hinges))


def _root(model: StructuralModel) -> Addition:
    """The clamp's node gets a rotation for each arm, with the arm's last element on it and a spring to the ground."""
    name, added = "root_flexibility", len(YOKE_HINGES)
    total, stiffness, mass, pins = model.n_dof + added, list[Term](), list[Term](), []
    for k, (number, _) in enumerate(YOKE_HINGES):
        other = _beside_clamp(model, f"E_beam_{number}")
        length, rotation = beam.axes(
            model.mesh.points[[other]], model.mesh.points[[CLAMP - 1]], np.array([[0.0, 0.0, 1.0]])
        )
        own = [_dof(model, other, d) for d in MOTIONS]
        for make, terms, coefficient in (
            (beam.stiffness, stiffness, parameter(f"E_beam_{number}")), (beam.mass, mass, Monomial()),
        ):  # fmt: skip
            block = beam.to_global(make(BEAM, length), rotation, np.zeros((1, 2, 3)))[0]
            new, grown = model.n_dof + k, sp.lil_array((total, total))
            for dof, d in zip(own, MOTIONS, strict=True):
                grown[dof, new] = grown[new, dof] = block[d, 6 + RY]
            grown[new, new] = block[6 + RY, 6 + RY]
            terms.append(Term(f"{name}: {make.__name__} {number}", sp.csr_array(grown), coefficient))
        pins.append(_unit(total, {model.n_dof + k: 1.0}))
    springs = outer_term(f"{name}: springs", pins, Monomial(1.0, ((name, -1.0),)))
    return Addition(stiffness=(*stiffness, springs), mass=tuple(mass), n_added=added)


def _strut(model: StructuralModel) -> Addition:
    """A chain of beam elements between the panels' edges, with nodes of its own."""
    name, inner = "locking_strut", STRUT_PIECES - 1
    total = model.n_dof + len(MOTIONS) * inner
    x = np.linspace(LENGTH, LENGTH + GAP, STRUT_PIECES + 1)
    points = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    ends = [[_dof(model, _node(model, p), d) for d in MOTIONS] for p in points[[0, -1]]]
    inside = [[model.n_dof + len(MOTIONS) * k + d for d in range(len(MOTIONS))] for k in range(inner)]
    chain = [ends[0], *inside, ends[1]]
    length, rotation = beam.axes(points[:-1], points[1:], np.tile([0.0, 0.0, 1.0], (STRUT_PIECES, 1)))
    arms = np.zeros((STRUT_PIECES, 2, 3))
    both = []
    for make in (beam.stiffness, beam.mass):
        whole = sp.lil_array((total, total))
        for k, block in enumerate(beam.to_global(make(BEAM, length), rotation, arms)):
            dofs, local = [*chain[k], *chain[k + 1]], [*MOTIONS, *(6 + d for d in MOTIONS)]
            for a, i in zip(dofs, local, strict=True):
                for b, j in zip(dofs, local, strict=True):
                    whole[a, b] += block[i, j]
        both.append(sp.csr_array(whole))
    modulus = strut_stiffness() / BEAM.i_y
    return Addition(
        stiffness=(Term(name, both[0], parameter(name, modulus)),),
        mass=(Term(f"{name}: mass", both[1], parameter(name, STRUT_MASS)),),
        n_added=len(MOTIONS) * inner,
    )


def _damper(model: StructuralModel) -> Addition:
    """Each acts through two feet on the edges."""
    rows = [
        between(model, (None, (LENGTH + GAP, y, 0.0)), (None, (LENGTH, y, 0.0)), RY)
        for side in (-1, 1)
        for y in (side * WIDTH / 2, side * (WIDTH / 2 - HALF))
    ]
    return Addition(damping=(outer_term("hinge_damper", rows, parameter("hinge_damper", 0.5)),))


# -- panels ------------------------------------------------------------------------------------------------------------


def _cut(model: StructuralModel) -> Addition:
    """A skin that came loose most in the middle of the row, less towards its ends: a parabola of the same mean."""
    middle, half = LENGTH + GAP + LENGTH - ROW / 2, ROW / 2
    ends = np.linspace(-1, 1, ELEMENTS + 1)
    mean = float(np.mean(1 - ((ends[1:] + ends[:-1]) / 2) ** 2))
    loose = _plates(model, "stiffness", lambda x, y: max(0.0, 1 - ((x - middle) / half) ** 2) / mean)
    return Addition(stiffness=(Term("cracked_row", loose, Monomial(-1.0, (("cracked_row", 1.0), ("E_panel_2", 1.0)))),))


def _instrument(model: StructuralModel) -> Addition:
    def covered(x: float, y: float) -> float:
        return float(max(abs(x - INSTRUMENT[0]), abs(y - INSTRUMENT[1])) < HALF)

    spread = _plates(model, "mass", covered) / ((2 * HALF) ** 2 * PLATE_DENSITY * THICKNESS)
    return Addition(mass=(Term("instrument_mass", sp.csr_array(spread), parameter("instrument_mass")),))


def _air(model: StructuralModel) -> Addition:
    """As much as on a rigid plate that moves in a fluid: half an ellipse across its width (Lamb 1932, section 71)."""
    air = _plates(model, "mass", lambda x, y: 4 / np.pi * float(np.sqrt(1 - (2 * y / WIDTH) ** 2)))
    return Addition(mass=(Term("air_mass", sp.csr_array(air / (PLATE_DENSITY * THICKNESS)), parameter("air_mass")),))


def _heavy_left(model: StructuralModel) -> Addition:
    heavy = _plates(model, "mass", lambda x, y: float(x > LENGTH + GAP / 2 and y > 0))
    return Addition(mass=(Term("heavy_left", heavy, parameter("heavy_left")),))


def _broken_bar(model: StructuralModel) -> Addition:
    part = part_of(model, "stiffness", "frame 1 rear")
    return Addition(
        stiffness=(Term("broken_bar", part.matrix, Monomial(-part.coefficient.factor, (("broken_bar", 1.0),))),)
    )


def _corner_mass(model: StructuralModel) -> Addition:
    row = motion(model, (None, (LENGTH + GAP + ROW, -WIDTH / 2, 0.0)), UZ)
    return Addition(mass=(outer_term("corner_mass", [row], parameter("corner_mass")),))


def _plates(model: StructuralModel, kind: str, weight: Callable[[float, float], float]) -> sp.csr_array:
    """Sum of all plate elements, each times a weight at its centre; stiffness for a Young's modulus of 1 Pa."""
    found = sp.lil_array((model.n_dof, model.n_dof))
    for nodes in model.mesh.faces:
        corners = model.mesh.points[nodes]
        x, y, _ = corners.mean(axis=0)
        factor = weight(float(x), float(y))
        if factor:
            a, b, _ = np.ptp(corners, axis=0)
            block = (
                thin_plate.stiffness(a, b, THICKNESS, PLATE_POISSON)
                if kind == "stiffness"
                else thin_plate.mass(a, b, PLATE_DENSITY * THICKNESS)
            )
            dofs = [_dof(model, int(node), d) for node in nodes for d in MOTIONS]
            for i, p in enumerate(dofs):
                for j, q in enumerate(dofs):
                    found[p, q] += factor * block[i, j]
    return sp.csr_array(found)


# -- what hangs and holds ----------------------------------------------------------------------------------------------


def _harness(model: StructuralModel) -> Addition:
    """A mass with a motion of its own under two clips."""
    x, y, z = HARNESS
    clips = [motion(model, (None, (x + side * HALF, y, z)), UZ) for side in (-1, 1)]
    row = np.append(np.mean(clips, axis=0), -1.0)
    stretch, own = [row], [_unit(len(row), {len(row) - 1: 1.0})]
    mass, freq = "hung_harness", "hung_harness_freq"
    return Addition(
        stiffness=(outer_term(f"{mass}: clips", stretch, Monomial((2 * np.pi) ** 2, ((mass, 1.0), (freq, 2.0)))),),
        damping=(
            outer_term(
                f"{mass}: loss", stretch, Monomial(4 * np.pi * HARNESS_RATIO, ((mass, 1.0), (freq, 1.0)))
            ),
        ),
        mass=(outer_term(mass, own, parameter(mass)),),
        n_added=1,
    )  # fmt: skip


def _cords(model: StructuralModel) -> Addition:
    """Each cord divides into two ends."""
    rows = [
        motion(model, (None, (x, y + side * HALF, z)), UZ) for x, y, z in CENTRES for side in (-1, 1)
    ]  # fmt: skip
    return Addition(stiffness=(outer_term("offload_cords", rows, parameter("offload_cords", 0.5)),))


# -- degrees of freedom ------------------------------------------------------------------------------------------------


def _dof(model: StructuralModel, node: int, direction: int) -> int:
    return int(np.flatnonzero((model.dofs.node == node) & (model.dofs.direction == direction))[0])


def _node(model: StructuralModel, point: np.ndarray) -> int:
    return int(np.argmin(np.linalg.norm(model.mesh.points - point, axis=1)))


def _beside_clamp(model: StructuralModel, group: str) -> int:
    """The node at the other end of the last element of a beam."""
    lines: Iterator[np.ndarray] = (
        line for line, name in zip(model.mesh.lines, model.mesh.groups, strict=True) if name == group
    )
    for line in lines:
        if CLAMP - 1 in line:
            return int(line[0] if line[1] == CLAMP - 1 else line[1])
    raise ValueError(f"no element of {group} ends at the clamp")


def _unit(size: int, entries: Mapping[int, float]) -> np.ndarray:
    row = np.zeros(size)
    for k, value in entries.items():
        row[k] = value
    return row


def _wide(matrix: sp.csr_array, size: int) -> sp.csr_array:
    coo = sp.coo_array(matrix)
    return sp.csr_array((coo.data, (coo.row, coo.col)), shape=(size, size))
