"""The bogie on its test rig (first phase of the case study).

Secondary suspension, bolsters and yaw dampers are removed; on either side a wooden distribution block stands on the
elastic blocks of the secondary suspension and is held by a hydraulic actuator, whose place is a parameter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from calib import ParameterSpace, StructuralModel
from calib.structure import AffineMatrix, Assumption, DofMap, Monomial, SelectedTerm, Term, parameter
from models.fem.discrete import FrameLocator, Spring, mass_matrix, spring_matrix
from models.fem.frame import Frame
from models.fem.member import Member
from models.fem.parts import beam_parts, mass_parts, spring_parts
from models.fem.section import Section
from models.railway.bogie import ASSUMPTIONS as BOGIE_ASSUMPTIONS
from models.railway.bogie import AXES, GIRDER_Y, SIDES, UY, bogie
from models.railway.parameters import BOGIE, RIG

BLOCK_Y, BLOCK_Z, BLOCK_HALF = 1.05, 1.17, 0.28
CONTACT_Y = 0.92
POSITION_SPACING, LATERAL_SPACING, CENTRE_POSITION = 0.07, 0.03, 5
K_SUPPORT, K_RESTRAINT = 500e6, 20e6
WOOD = Section(0.04, 1.33e-4, 1.33e-4, 2.2e-4, young_modulus=1.0, density=650.0)

_REASON = "lost in the case study; plausible for the rig described there"

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("distribution block: axis (y, z), half length", "1.05, +-1.17, 0.28", "m", _REASON),
    Assumption("distribution block: section, density", "0.20 x 0.20 m, 650 kg/m3", "-", _REASON),
    Assumption("wood: shear over Young's modulus", "1/2.6", "-", "isotropic; the blocks are nearly rigid"),
    Assumption("elastic block: two springs of half the stiffness", "x +-0.28", "m", _REASON),
    Assumption("block contact: two springs of half the stiffness at a height of", "0.92", "m", _REASON),
    Assumption("actuator positions: spacing along x, along z", "0.07, 0.03", "m", _REASON),
    Assumption("support at the actuator (rigid in the source)", "500", "MN/m", "stiff against all it carries"),
    Assumption("horizontal restraint of each block, x and z", "20", "MN/m", "else the block is a mechanism"),
)
"""Every number of the rig that is an engineering assumption."""


def bogie_on_rig(element_size: float = 0.075, distributed: bool = False) -> StructuralModel:
    """The bogie under test as a structural model of about 340 nodes.

    Parameters
    ----------
    element_size : float
        Largest beam length, m.
    distributed : bool
        Consistent instead of lumped added masses, and point masses distributed over the length they represent.

    Returns
    -------
    StructuralModel
        Parameters of `models.railway.parameters`; clusters ``<part>.<x|y|z|r>`` with the parts girder, crossbar, axle,
        box, block.
    """
    parts = bogie(element_size, distributed)
    frame = Frame((*parts.members, *_blocks(element_size)), parts.ties, parts.suppressions)
    dofs = frame.dof_map()

    def reduced(full: sp.csr_array) -> sp.csr_array:
        return sp.csr_array(dofs.expansion.T @ full @ dofs.expansion)

    steel, steel_mass = frame.beams(("girder_centre", "girder_end", "crossbar", "axle", "box"))
    wood, wood_mass = frame.beams(("block",))
    block, contact, restraint = _rig_springs()
    stiffness = [
        Term("steel", reduced(steel)),
        Term("wood", reduced(wood), parameter("E_wood")),
        Term("suspension_fixed", reduced(spring_matrix(frame, parts.springs["suspension_fixed"]))),
        Term("restraint", reduced(spring_matrix(frame, restraint)), Monomial(K_RESTRAINT)),
    ]
    driven = {
        "K_primary": parts.springs["primary"],
        "K_rod_upper": parts.springs["rod_upper"],
        "K_rod_lower": parts.springs["rod_lower"],
        "K_rail": parts.springs["rail"],
        "K_block": block,
        "K_contact": contact,
    }
    for name, springs in driven.items():
        stiffness.append(Term(name, reduced(spring_matrix(frame, springs)), parameter(name)))
    mass = [Term("beams", reduced(steel_mass + wood_mass)), Term("points", reduced(mass_matrix(frame, parts.masses)))]
    for name, group in (
        ("m_girder_centre", "girder_centre"),
        ("m_girder_ends", "girder_end"),
        ("m_crossbar", "crossbar"),
        ("m_axle", "axle"),
    ):
        mass.append(Term(name, reduced(frame.added_mass((group,), distributed)), parameter(name)))
    damping = (Term("c_primary", reduced(spring_matrix(frame, parts.dampers)), parameter("c_primary")),)
    pieces = beam_parts(frame, reduced, {"block": parameter("E_wood")})
    pieces += spring_parts(frame, reduced, parts.springs["suspension_fixed"], Monomial())
    pieces += spring_parts(frame, reduced, restraint, Monomial(K_RESTRAINT))
    for name, springs in driven.items():
        pieces += spring_parts(frame, reduced, springs, parameter(name))
    pieces += spring_parts(frame, reduced, parts.dampers, parameter("c_primary"), "damping")
    pieces += mass_parts(frame, reduced, parts.masses)
    supports = tuple(_support(frame, dofs, side, z) for side, z in SIDES)
    n = dofs.n_dof
    return StructuralModel(
        name="bogie on its test rig",
        space=ParameterSpace(BOGIE + RIG),
        stiffness=AffineMatrix(n, tuple(stiffness), supports),
        damping=AffineMatrix(n, damping),
        mass=AffineMatrix(n, tuple(mass)),
        mesh=replace(frame.mesh(), axes=AXES),
        dofs=dofs,
        clusters=_clusters(frame, dofs),
        locator=FrameLocator(frame, dofs.expansion),
        assumptions=BOGIE_ASSUMPTIONS + ASSUMPTIONS,
        sensor_tolerance=0.05,
        parts=tuple(pieces),
    )


def _blocks(size: float) -> tuple[Member, ...]:
    return tuple(
        Member(
            f"block_{side}", "block", WOOD, (-BLOCK_HALF, BLOCK_Y, s * BLOCK_Z), (BLOCK_HALF, BLOCK_Y, s * BLOCK_Z),
            min(size, POSITION_SPACING), part=f"distribution block {side}",
            through=tuple((POSITION_SPACING * k, BLOCK_Y, s * BLOCK_Z) for k in range(-3, 4)),
        )
        for side, s in SIDES
    )  # fmt: skip


def _rig_springs() -> tuple[tuple[Spring, ...], tuple[Spring, ...], tuple[Spring, ...]]:
    block, contact, restraint = [], [], []
    for side, s in SIDES:
        body, z = f"block_{side}", s * BLOCK_Z
        for x in (-BLOCK_HALF, BLOCK_HALF):
            below = (x, GIRDER_Y, z)  # an arm of 0.12 m reaches out from the girder
            block.append(
                Spring((body, (x, BLOCK_Y, z)), ("frame", below), (0, 1, 0), False, 0.5, f"elastic block {side}")
            )
            meet = (x, CONTACT_Y, z)
            for direction in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
                name = f"block contact {side} {'x' if direction[0] else 'z'}"
                contact.append(Spring((body, meet), ("frame", meet), direction, weight=0.5, name=name))
        for direction in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
            name = f"restraint of block {side} {'x' if direction[0] else 'z'}"
            restraint.append(Spring((body, (0.0, BLOCK_Y, z)), None, direction, name=name))
    return tuple(block), tuple(contact), tuple(restraint)


def _support(frame: Frame, dofs: DofMap, side: str, s: float) -> SelectedTerm:
    """The actuator's vertical support, at one of 7 x 3 positions."""
    vectors: dict[tuple[int, ...], np.ndarray] = {}
    for position in range(2, 9):
        for lateral in (-1, 0, 1):
            place = (
                (position - CENTRE_POSITION) * POSITION_SPACING,
                BLOCK_Y,
                s * BLOCK_Z + lateral * LATERAL_SPACING,
            )
            row = frame.motion(place, f"block_{side}")[0][UY]
            vectors[(position, lateral)] = row @ dofs.expansion
    return SelectedTerm(f"support_{side}", Monomial(K_SUPPORT), (f"pos_long_{side}", f"pos_lat_{side}"), vectors)


def _clusters(frame: Frame, dofs: DofMap) -> dict[str, np.ndarray]:
    """Degrees of freedom by part and direction; a node that two parts share belongs to the first of them."""
    parts = {
        "girder": ("girder_centre", "girder_end"),
        "crossbar": ("crossbar",),
        "axle": ("axle",),
        "box": ("box",),
        "block": ("block",),
    }
    owner = np.full(len(frame.points), "", dtype=object)
    for part, groups in parts.items():
        nodes = frame.group_nodes(groups)
        owner[nodes[owner[nodes] == ""]] = part
    clusters = {}
    for part in parts:
        own = owner[dofs.node] == part
        for letter, mask in (*(("xyz"[d], dofs.direction == d) for d in range(3)), ("r", dofs.direction >= 3)):
            index = np.flatnonzero(own & mask)
            if len(index):
                clusters[f"{part}.{letter}"] = index
    return clusters
