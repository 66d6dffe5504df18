"""The air supply unit of a railcar: motor and screw compressor on a welded frame that stands on four hydraulic bushes.

Axes: x to the front, y to the left, z up, origin at the middle of the frame. Every size is an assumption of this
project: a unit as it hangs below many floors, measured here on the rigid floor of a workshop.
"""

from __future__ import annotations

from dataclasses import replace

import scipy.sparse as sp

from calib import Parameter, ParameterSpace, StructuralModel
from calib.structure import AffineMatrix, Assumption, Monomial, Term, parameter
from models.fem.discrete import FrameLocator, PointMass, Spring, mass_matrix, spring_matrix
from models.fem.frame import Frame
from models.fem.member import Member, Point
from models.fem.parts import beam_parts, mass_parts, spring_parts
from models.fem.section import Section

RAIL_X, RAIL_Y, BUSH_X, BUSH_Z = 0.62, 0.36, 0.52, -0.07
BEARERS = {"rear": -0.52, "middle rear": -0.12, "middle front": 0.16, "front": 0.52}
FOOT_Y = 0.14
MACHINES = {"compressor": ("rear", "middle rear", 0.30), "motor": ("middle front", "front", 0.22)}
"""The bearers below each machine, and the height of its axis, m."""
INERTIA = {"compressor": (4.2, 5.6, 5.0), "motor": (1.1, 2.6, 2.6)}
"""kg m2 about x, y, z through the centre."""
TUBE = Section(5.3e-4, 2.0e-7, 2.0e-7, 3.4e-7, shear_coefficient=0.45)
CASTING = Section(0.05, 2.0e-4, 2.0e-4, 4.0e-4, density=0.0)
K_FOOT = 40e6
CORNERS = {
    f"{end} {side}": (s, t) for end, s in (("front", 1), ("rear", -1)) for side, t in (("left", 1), ("right", -1))
}
AXES = "x to the front, y to the left, z up"

UPRIGHT, SIDEWAYS = ((0.0, 0.0, 1.0),), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))

ASSUMPTIONS = (
    Assumption(
        "frame: rails at y, length; bearers at x", "+-0.36, 1.24; -0.52, -0.12, 0.16, 0.52", "m", "a usual size"
    ),
    Assumption("tubes of the frame: A, I, J", "5.3e-4, 2.0e-7, 3.4e-7", "m2, m4", "50 x 50 x 3 mm"),
    Assumption("bushes at x, y, z", "+-0.52, +-0.36, -0.07", "m", "below the corners"),
    Assumption("compressor: moments of inertia", "4.2, 5.6, 5.0", "kg m2", "a block of its size"),
    Assumption("motor: moments of inertia", "1.1, 2.6, 2.6", "kg m2", "a cylinder of its size"),
    Assumption("foot of a machine, each direction", "40", "MN/m", "one bolt through a tube wall"),
)
"""Every number of the unit that is an engineering assumption."""

PARAMETERS = (
    Parameter("k_bush", 260.0, 150.0, 400.0, "kN/m", prior_sd=40.0, description="one bush, upright"),
    Parameter("k_bush_side", 160.0, 80.0, 280.0, "kN/m", prior_sd=32.0, description="one bush, along and across"),
    Parameter("c_bush", 0.32, 0.08, 1.0, "kNs/m", prior_sd=0.1, description="fluid of one bush, upright"),
    Parameter(
        "c_bush_side", 0.25, 0.05, 1.0, "kNs/m", prior_sd=0.1, description="rubber of one bush, along and across"
    ),
    Parameter("m_compressor", 130.0, 110.0, 155.0, "kg", prior_sd=5.0, description="compressor with its oil"),
    Parameter("m_motor", 95.0, 85.0, 105.0, "kg", prior_sd=2.0, description="motor, by its plate"),
    Parameter(
        "frame", 1.0, 0.7, 1.3, "-", prior_sd=0.08, description="stiffness of the frame over that of its drawing"
    ),
)


def bush_place(corner: str) -> Point:
    """Top of a bush in m, where a rigid arm holds it to the frame."""
    s, t = CORNERS[corner]
    return (s * BUSH_X, t * RAIL_Y, BUSH_Z)


def bushes(directions: tuple[Point, ...]) -> tuple[Spring, ...]:
    """Springs of the four bushes to the floor."""
    return tuple(
        Spring(("rail", bush_place(corner)), None, direction, name=f"bush {corner}{_along(direction)}")
        for corner in CORNERS
        for direction in directions
    )


def _by_parameter(letter: str, kind: str, own: tuple[Spring, ...] | None) -> dict[str, list[Spring]]:
    """Springs, or dampers, upright and sideways, by the parameter that they follow."""
    every = (*bushes(UPRIGHT), *bushes(SIDEWAYS)) if own is None else own
    named = [replace(s, name=s.name.replace("bush", kind, 1)) for s in every]
    return {
        f"{letter}_bush": [s for s in named if s.direction[2]],
        f"{letter}_bush_side": [s for s in named if not s.direction[2]],
    }


def _along(direction: Point) -> str:
    return "" if direction[2] else ", x" if direction[0] else ", y"


def feet() -> tuple[Spring, ...]:
    """Bolted feet between machines and bearers, three springs each."""
    found = []
    for machine, (*below, _) in MACHINES.items():
        for bearer in below:
            for side, t in (("left", 1), ("right", -1)):
                at = (BEARERS[bearer], t * FOOT_Y, 0.0)
                name = f"foot of the {machine} {bearer} {side}"
                found += [
                    Spring((machine, at), (f"bearer {bearer}", at), d, weight=K_FOOT, name=name)
                    for d in (*UPRIGHT, *SIDEWAYS)
                ]
    return tuple(found)


def _unit_masses() -> dict[str, tuple[PointMass, ...]]:
    """A mass of 1 kg at the centre of each machine."""
    return {machine: (PointMass((machine, _centre(machine)), 1.0, name=machine),) for machine in MACHINES}


def _members(size: float) -> tuple[Member, ...]:
    up = (0.0, 0.0, 1.0)
    xs = sorted({*BEARERS.values(), BUSH_X, -BUSH_X})
    rails = [
        Member("frame", "rail", TUBE, (-RAIL_X, t * RAIL_Y, 0.0), (RAIL_X, t * RAIL_Y, 0.0), size,
               tuple((x, t * RAIL_Y, 0.0) for x in xs), up, part=f"rail {side}")
        for side, t in (("left", 1), ("right", -1))
    ]  # fmt: skip
    bearers = [
        Member("frame", f"bearer {name}", TUBE, (x, -RAIL_Y, 0.0), (x, RAIL_Y, 0.0), size,
               ((x, -FOOT_Y, 0.0), (x, FOOT_Y, 0.0)), up, part=f"bearer {name}")
        for name, x in BEARERS.items()
    ]  # fmt: skip
    machines = []
    for machine, (one, other, height) in MACHINES.items():
        ends = ((BEARERS[one], 0.0, height), (BEARERS[other], 0.0, height))
        machines.append(Member(machine, machine, CASTING, *ends, 1.0, (_centre(machine),), up))
    return (*rails, *bearers, *machines)


def _centre(machine: str) -> Point:
    one, other, height = MACHINES[machine]
    return ((BEARERS[one] + BEARERS[other]) / 2, 0.0, height)


def compressor_set(
    element_size: float = 0.12,
    springs: tuple[Spring, ...] | None = None,
    dampers: tuple[Spring, ...] | None = None,
) -> StructuralModel:
    """The unit on the floor, about 50 nodes.

    Parameters
    ----------
    element_size : float
        Largest beam length, m.
    springs, dampers : tuple of Spring, optional
        Those of the bushes, upright and sideways, instead of one in the middle of each.

    Returns
    -------
    StructuralModel
        Parameters: `PARAMETERS`; parts: tubes, machines, bushes and feet, each by name.
    """
    frame = Frame(_members(element_size))
    dofs = frame.dof_map()

    def reduced(full: sp.csr_array) -> sp.csr_array:
        return sp.csr_array(dofs.expansion.T @ full @ dofs.expansion)

    elastic, lossy = (
        _by_parameter(letter, kind, own) for letter, kind, own in (("k", "bush", springs), ("c", "damper", dampers))
    )
    tubes, tube_mass = frame.beams(("rail", *(f"bearer {name}" for name in BEARERS)))
    castings, _ = frame.beams(tuple(MACHINES))
    turning = [PointMass((m, _centre(m)), 0.0, INERTIA[m], name=m) for m in MACHINES]
    stiffness = [
        Term("frame", reduced(tubes), parameter("frame")),
        Term("castings", reduced(castings)),
        Term("feet", reduced(spring_matrix(frame, feet()))),
    ]
    mass = [Term("tubes", reduced(tube_mass)), Term("turning", reduced(mass_matrix(frame, turning)))]
    damping = []
    pieces = beam_parts(frame, reduced, {m.group: parameter("frame") for m in frame.members if m.group not in MACHINES})
    pieces += spring_parts(frame, reduced, feet(), Monomial())
    for name, own in elastic.items():
        stiffness.append(Term(name, reduced(spring_matrix(frame, own)), parameter(name)))
        pieces += spring_parts(frame, reduced, own, parameter(name))
    for name, own in lossy.items():
        damping.append(Term(name, reduced(spring_matrix(frame, own)), parameter(name)))
        pieces += spring_parts(frame, reduced, own, parameter(name), "damping")
    for machine, masses in _unit_masses().items():
        mass.append(Term(f"m_{machine}", reduced(mass_matrix(frame, masses)), parameter(f"m_{machine}")))
        pieces += [replace(p, coefficient=parameter(f"m_{machine}")) for p in mass_parts(frame, reduced, masses)]
    n = dofs.n_dof
    return StructuralModel(
        name="air supply unit",
        space=ParameterSpace(PARAMETERS),
        stiffness=AffineMatrix(n, tuple(stiffness)),
        damping=AffineMatrix(n, tuple(damping)),
        mass=AffineMatrix(n, tuple(mass)),
        mesh=replace(frame.mesh(), axes=AXES),
        dofs=dofs,
        clusters={},
        locator=FrameLocator(frame, dofs.expansion),
        assumptions=ASSUMPTIONS,
        sensor_tolerance=0.2,
        parts=tuple(pieces),
    )  # fmt: skip
