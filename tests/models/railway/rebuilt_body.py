"""The vehicle's body with each of its effects modelled in the mesh itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from calib import StructuralModel
from models.fem.discrete import Spring
from models.fem.member import Member
from models.railway.bogie import SIDES, UY
from models.railway.bolsters import FLOOR_Y
from models.railway.car_lines import BASE_Z, HALF_LENGTH, HEADER, PILLARS, SILL, WALL
from models.railway.equipment import COUPLER_Y
from models.railway.vehicle import Assembly
from models.railway.vehicle_effects_body import DAMPING_FREQ
from tests.models.railway.rebuilding import (
    Values,
    rebuilt,
    with_matrix,
    with_springs,
)


def thin_edges(v: Values, refine: int) -> StructuralModel:
    """Floor and cross-beams that bend more easily across between their outermost lines."""
    share, (inner, outer) = v["floor_joint"], BASE_Z[-2:]

    def change(whole: Assembly) -> Assembly:
        members: list[Member] = []
        for m in whole.structure.members:
            if m.group in ("floor_beam", "bolster_beam"):
                members += cut(m, [-inner, inner], lambda middle: abs(middle[2]) > inner, share)
            else:
                members.append(m)
        return replace(whole, structure=replace(whole.structure, members=tuple(members)))

    model = rebuilt(change, refine)
    structure = model.locator.frame
    middle = structure.points[structure.corners].mean(axis=1)
    strip = (np.abs(middle[:, 2]) > inner) & (np.abs(middle[:, 2]) < outer)
    bending = []
    for left in (1.0, 1 - share):
        panels = []
        for p in structure.panels:
            if p.group == "base":
                sheet = replace(p.sheet, young_modulus_across=left * p.sheet.young_modulus)
                p = replace(p, along=(1.0, 0.0, 0.0), sheet=sheet)
            panels.append(p)
        bending.append(replace(structure, panels=tuple(panels)).shells(("base",), strip).bending)
    full, soft = bending
    return with_matrix(model, "stiffness", "edges", soft - full)


def cut(m: Member, at: Sequence[float], inside: Callable[[np.ndarray], bool], share: float) -> list[Member]:
    """A member across the car cut at some z; stretches inside lose a share of their bending upright."""
    marks = sorted({*at, m.start[2], m.end[2]}, reverse=m.start[2] > m.end[2])
    out = []
    for a, b in pairwise(marks):
        start, end = (m.start[0], m.start[1], a), (m.end[0], m.end[1], b)
        through = tuple(p for p in m.through if min(a, b) < p[2] - 1e-9 < p[2] + 1e-9 < max(a, b))
        section = m.section
        if inside(np.add(start, end) / 2):
            section = replace(section, i_z=(1 - share) * section.i_z)
        out.append(replace(m, start=start, end=end, through=through, section=section))
    return out


def thin_pillars(v: Values, refine: int) -> StructuralModel:
    """Window pillars of a reduced section."""
    low, high = WALL[SILL][0], WALL[HEADER][0]

    def change(whole: Assembly) -> Assembly:
        members = []
        for m in whole.structure.members:
            beside = low - 1e-6 < min(m.start[1], m.end[1]) and max(m.start[1], m.end[1]) < high + 1e-6
            if m.group in ("pillar", "post") and beside and min(abs(m.start[0] - x) for x in PILLARS) < 1e-6:
                m = replace(m, section=replace(m.section, i_z=(1 - v["window_corners"]) * m.section.i_z))
            members.append(m)
        return replace(whole, structure=replace(whole.structure, members=tuple(members)))

    return rebuilt(change, refine)


def glazed(v: Values, refine: int) -> StructuralModel:
    """Panes as pairs of diagonal rods that are as stiff in shear."""

    def change(whole: Assembly) -> Assembly:
        rods = []
        for a, b in pairwise(PILLARS):
            for _, s in SIDES:
                (low_y, low_z), (high_y, high_z) = WALL[SILL], WALL[HEADER]
                width, height = b - a, float(np.hypot(high_y - low_y, high_z - low_z))
                square = width**2 + height**2
                weight = v["window_glass"] * 1e6 * square / (2 * width * height)
                for one, other in ((a, b), (b, a)):
                    low, high = (one, low_y, s * low_z), (other, high_y, s * high_z)
                    along = tuple(float(c) for c in np.subtract(high, low))
                    rods.append(Spring(("walls", low), ("walls", high), along, weight=weight))
        return with_springs(whole, rods)

    return rebuilt(change, refine)


def lossy_body(v: Values, refine: int) -> StructuralModel:
    """A body whose aluminium loses energy in proportion to its strain energy and frequency."""
    model = rebuilt(refine=refine)
    structure = model.locator.frame
    aluminium = {m.group for m in structure.members if m.section.young_modulus == 70e9}
    full = structure.beams(aluminium)[0] + structure.shells().stiffness
    return with_matrix(model, "damping", "loss", 2 * v["body_damping"] * 1e-2 / (2 * np.pi * DAMPING_FREQ) * full)


def coupled(v: Values, refine: int) -> StructuralModel:
    """The rear coupler on springs to the ground."""
    at = ("coupler_rear", (-HALF_LENGTH, COUPLER_Y, 0.0))
    springs = [Spring(at, None, d, weight=v["neighbour_coupling"] * 1e3) for d in ((1, 0, 0), (0, 1, 0))]
    return rebuilt(lambda whole: with_springs(whole, springs), refine)


def top_heavy(v: Values, refine: int) -> StructuralModel:
    """A body whose weight works at every pillar on the square of the roll there, that of the floor's two edges."""
    model = rebuilt(refine=refine)
    structure = model.locator.frame
    rows = []
    for x in PILLARS:
        left, right = (structure.motion((x, FLOOR_Y, s * BASE_Z[-1]), "base")[0][UY] for _, s in SIDES)
        rows.append((left - right) / (2 * BASE_Z[-1]))
    stacked = sp.csr_array(np.array(rows))
    return with_matrix(model, "stiffness", "weight", -v["tipping"] * 1e3 / len(PILLARS) * (stacked.T @ stacked))
