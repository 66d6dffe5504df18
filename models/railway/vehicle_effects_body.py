"""Effects of the car body: soft joints and corners, window panes in shear, damping, coupling and gravity."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, Assumption, Monomial, Place, Term, between, motion, outer_term
from models.fem.parts import shell_coefficients
from models.railway.bogie import RX, RY, RZ, SIDES, UX, UY, UZ
from models.railway.bolsters import FLOOR_Y, PAD_Z
from models.railway.car_body import CROSS_BEAMS, SECTIONS, SHEETS
from models.railway.car_lines import BASE_Z, BOGIE_X, HALF_LENGTH, HEADER, PILLARS, SILL, WALL, stations
from models.railway.equipment import COUPLER_Y

JOINT_WIDTH = BASE_Z[-1] - BASE_Z[-2]
STRETCHES = 3
"""Number of segments of a softened strip or half pillar: for a bending moment that falls linearly to zero, the mean
curvature misses a quarter of the energy with one segment and 3 % with three."""
DAMPING_FREQ = 10.0

_FULL = (("E_aluminium", 1.0),)


def body_effects() -> tuple[Effect, ...]:
    """Effects of the car body and of forces on it as a whole."""
    return (
        Effect(
            name="floor_joint",
            title="Soft joint between side walls and floor",
            phrase="a soft joint between side walls and floor",
            lacks="Floor and cross-beams keep their full bending stiffness up to the side walls.",
            look_for="Bolted or riveted joints, access holes and thin webs where cross-beams and floor meet the walls.",
            magnitude=Parameter(
                "floor_joint", 0.0, 0.0, 0.95, "-", prior_sd=0.4,
                description="share of the stiffness in bending across that is lost over 0.30 m along both walls",
            ),
            build=_floor_joint,
        ),
        Effect(
            name="window_corners",
            title="Window corners soft in shear",
            phrase="window corners that are soft in shear",
            lacks="The window pillars keep their full section up to the rails over and under the windows.",
            look_for="Cut-outs, tapered pillars, cracks or missing gussets at the corners of the windows.",
            magnitude=Parameter(
                "window_corners", 0.0, 0.0, 0.95, "-", prior_sd=0.4,
                description="share of the pillars' bending stiffness in the wall lost from their middle to both ends",
            ),
            build=_window_corners,
        ),
        Effect(
            name="window_glass",
            title="Bonded window panes carry shear",
            phrase="bonded window panes that carry shear",
            lacks="The windows are open holes.",
            look_for="Panes bonded all round with stiff adhesive instead of sitting in a soft rubber profile.",
            magnitude=Parameter(
                "window_glass", 0.0, 0.0, 200.0, "MN/m", prior_sd=3.0,
                description="shear modulus times thickness of a pane with its bond",
            ),
            build=_window_glass,
        ),
        Effect(
            name="body_damping",
            title="The car body dissipates",
            phrase="damping of the car body",
            lacks="The car body is elastic without loss.",
            look_for="Damping layers, insulation, linings and floor coverings that are glued on or rub.",
            magnitude=Parameter(
                "body_damping", 0.0, 0.0, 10.0, "%", prior_sd=0.7,
                description="damping ratio of the aluminium body at 10 Hz, in proportion to frequency",
            ),
            build=_body_damping,
        ),
        Effect(
            name="neighbour_coupling",
            title="Coupling to the neighbouring car",
            phrase="a coupling to the neighbouring car",
            lacks="Both ends of the car are free.",
            look_for="Whether the car was tested uncoupled: coupler, gangway and cables at the rear end.",
            magnitude=Parameter(
                "neighbour_coupling", 0.0, 0.0, 5000.0, "kN/m", prior_sd=150.0,
                description="stiffness of the rear coupler against rising, and the same lengthwise",
            ),
            build=_neighbour_coupling,
        ),
        Effect(
            name="tipping",
            title="The body's weight tips it",
            phrase="the tipping of the body by its weight",
            lacks="The body's weight does no work when the body rolls.",
            look_for="Height of the centre of gravity: the moment is weight times height over the lateral links.",
            magnitude=Parameter(
                "tipping", 0.0, 0.0, 600.0, "kNm/rad", prior_sd=150.0,
                description="moment that tips the body over its angle of roll",
            ),
            build=_tipping,
        ),
    )  # fmt: skip


def _floor_joint(model: StructuralModel) -> Addition:
    """The mean curvature of a segment of length b has a stiffness of at most ``E I/b`` (Cauchy-Schwarz).

    Across a sheet, I is that of a beam: the curvature along is free, which gives the factor ``1 - nu^2``. Each cell
    between two lines is evaluated at two places a quarter from its ends: for a rotation that is linear between nodes,
    the sum of squares there is at most the mean square.
    """
    sheet, length = SHEETS["base"], JOINT_WIDTH / STRETCHES
    bending = shell_coefficients(sheet, "E_aluminium", "t_base", "RMI_base").bending
    plate = sheet.young_modulus * sheet.rmi * sheet.thickness**3 / 12
    shell: list[np.ndarray] = []
    beams: list[np.ndarray] = []
    for zone, xs in stations().items():
        for _, s in SIDES:
            for a, b in pairwise(xs):
                for x in (0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b):
                    shell += [np.sqrt(plate * abs(b - a) / 2 / length) * row for row in _across(model, "base", x, s)]
            for group, x in CROSS_BEAMS[zone]:
                beams += [np.sqrt(SECTIONS[group].i_z / length) * row for row in _across(model, group, x, s)]
    own = (("floor_joint", 1.0),)
    return Addition(
        stiffness=(
            outer_term("floor_joint: floor", shell, Monomial(-bending.factor, (*bending.powers, *own))),
            outer_term("floor_joint: cross-beams", beams, Monomial(-1.0, (*_FULL, *own))),
        )
    )


def _across(model: StructuralModel, part: str, x: float, side: float) -> list[np.ndarray]:
    """Relative rotation of the floor about the longitudinal axis over every segment from a wall to the joint's end."""
    places: list[Place] = [
        (part, (x, FLOOR_Y, side * z)) for z in np.linspace(BASE_Z[-1], BASE_Z[-2], STRETCHES + 1).tolist()
    ]
    return [between(model, one, other, RX) for one, other in pairwise(places)]


def _window_corners(model: StructuralModel) -> Addition:
    """The mean curvature of a segment has a stiffness of at most ``E I/L``; no load acts between a pillar's ends."""
    rows, middle = [], (SILL + HEADER) // 2
    for x in PILLARS:
        group = "post" if x in (PILLARS[0], PILLARS[-1]) else "pillar"
        for _, s in SIDES:
            for corner in (SILL, HEADER):
                # About the normal of the wall, which leans a little.
                up = _upwards(s, corner, middle)
                cuts = np.linspace((x, *_wall(corner, s)), (x, *_wall(middle, s)), STRETCHES + 1)
                length = float(np.linalg.norm(cuts[1] - cuts[0]))
                places: list[Place] = [(group, (float(a), float(b), float(c))) for a, b, c in cuts]
                for one, other in pairwise(places):
                    ry, rz = (between(model, one, other, d) for d in (RY, RZ))
                    rows.append(np.sqrt(SECTIONS[group].i_z / length) * (up[1] * rz - up[2] * ry))
    coefficient = Monomial(-1.0, (*_FULL, ("window_corners", 1.0)))
    return Addition(stiffness=(outer_term("window_corners", rows, coefficient),))


def _window_glass(model: StructuralModel) -> Addition:
    """The mean shear of a pane follows from the motions of its four corners; its energy is ``G t A gamma^2/2``."""
    rows = []
    for a, b in pairwise(PILLARS):
        for _, s in SIDES:
            up, low, high = _upwards(s, SILL, HEADER), _wall(SILL, s), _wall(HEADER, s)
            width, height = b - a, float(np.hypot(high[0] - low[0], high[1] - low[1]))
            gamma = np.zeros(model.n_dof)
            for x, sx in ((a, -1.0), (b, 1.0)):
                for (y, z), sy in ((low, -1.0), (high, 1.0)):
                    ux, uy, uz = (motion(model, ("walls", (x, y, z)), d) for d in (UX, UY, UZ))
                    gamma += sy * ux / (2 * height) + sx * (up[1] * uy + up[2] * uz) / (2 * width)
            rows.append(np.sqrt(width * height) * gamma)
    return Addition(stiffness=(outer_term("window_glass", rows, Monomial(1.0, (("window_glass", 1.0),))),))


def _wall(line: int, side: float) -> tuple[float, float]:
    """Place (y, z) of a line of a side wall."""
    y, z = WALL[line]
    return y, side * z


def _upwards(side: float, one: int, other: int) -> np.ndarray:
    """Unit vector up a side wall, along the line between two of its lines."""
    low, high = (np.array([0.0, *_wall(k, side)]) for k in sorted((one, other)))
    along: np.ndarray = (high - low) / np.linalg.norm(high - low)
    return along


def _body_damping(model: StructuralModel) -> Addition:
    """A damping ratio of ``zeta f/f_0`` is a damping of ``2 zeta/(2 pi f_0)`` times the stiffness."""
    rate = 2 / (2 * np.pi * DAMPING_FREQ)
    terms = []
    for term in model.stiffness.terms:
        if isinstance(term.coefficient, Monomial) and "E_aluminium" in term.coefficient.names:
            powers = (*term.coefficient.powers, ("body_damping", 1.0))
            terms.append(
                Term(f"body_damping: {term.name}", term.matrix, Monomial(rate * term.coefficient.factor, powers))
            )
    return Addition(damping=tuple(terms))


def _neighbour_coupling(model: StructuralModel) -> Addition:
    place: Place = ("coupler_rear", (-HALF_LENGTH, COUPLER_Y, 0.0))
    rows = [motion(model, place, direction) for direction in (UX, UY)]
    return Addition(
        stiffness=(outer_term("neighbour_coupling", rows, Monomial(1.0, (("neighbour_coupling", 1.0),))),),
        assumptions=(Assumption("neighbouring car", "at rest", "-", "heavy, and not excited"),),
    )


def _tipping(model: StructuralModel) -> Addition:
    rows = []
    for bogie, x in (("front", BOGIE_X), ("rear", -BOGIE_X)):
        left, right = (
            motion(model, (f"{bogie}_floor_{side}", (x, FLOOR_Y, s * PAD_Z)), UY) for side, s in SIDES
        )  # fmt: skip
        rows.append((left - right) / (2 * PAD_Z))
    return Addition(stiffness=(outer_term("tipping", rows, Monomial(-0.5, (("tipping", 1.0),))),))
