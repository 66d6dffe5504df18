"""Effects of the bogie's frame: soft joints and girder ends, unmodelled masses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, Assumption, Place, between, hung_masses, motion, outer_term, parameter
from models.fem.section import Section
from models.railway.bogie import (
    AXLE_X,
    CROSSBAR,
    CROSSBAR_X,
    ENDS,
    GIRDER_END,
    GIRDER_Y,
    GIRDER_Z,
    RX,
    RY,
    RZ,
    SIDES,
    UX,
    UY,
    UZ,
)
from models.railway.effects_richer import brake_unit_on_mounts, crossbar_body

JOINT_LENGTH = 0.15
GIRDER_END_STRETCHES = 2
BRAKE_UNIT_Z, BRAKE_UNIT_RATIO = 0.45, 0.03

_MIDDLE: Place = ("crossbar", (CROSSBAR_X, GIRDER_Y, 0.0))
_UNIT: Place = ("crossbar", (CROSSBAR_X, GIRDER_Y, BRAKE_UNIT_Z))
_UNIT_FREQ = Parameter(
    "brake_unit_freq", 18.0, 8.0, 40.0, "Hz", prior_sd=7.0,
    description="natural frequency of the unit alone, its bushes on a base that does not move",
    assumed="limits: at 8 Hz the bushes deflect by 4 mm under its weight",
)  # fmt: skip
_REASON = "where such parts usually sit"


def frame_effects() -> tuple[Effect, ...]:
    """Effects of the frame, its joints and the masses on it."""
    return (
        Effect(
            name="crossbar_joint",
            title="Soft joints between crossbars and girders",
            phrase="soft joints between crossbars and girders",
            lacks="The crossbars keep their full section up to the girders' axes.",
            look_for="Cracked or skipped welds, access holes and thin webs where the crossbars meet the girders.",
            magnitude=Parameter(
                "crossbar_joint", 0.0, 0.0, 0.95, "-", prior_sd=0.5,
                description="share of the stiffness in bending and torsion lost over 0.15 m at all four joints",
            ),
            build=_crossbar_joint,
        ),
        Effect(
            name="girder_end",
            title="Soft girder ends",
            phrase="soft girder ends",
            lacks="The girder ends keep plane sections and their full walls from the crossbars to the axles.",
            look_for="Cut-outs, thin walls or warping of the girders between crossbar and axle box.",
            magnitude=Parameter(
                "girder_end", 0.0, 0.0, 0.95, "-", prior_sd=0.2,
                description="share of the stiffness in bending and torsion lost between crossbar and axle, all four",
            ),
            build=_girder_end,
        ),
        Effect(
            name="crossbar_mass",
            title="Unmodelled mass at the middle of the front crossbar",
            phrase="a mass at the middle of the front crossbar",
            lacks="The additional mass of the crossbars is spread evenly over both of them.",
            look_for="Brackets, pipes, ballast or test equipment at the middle of the front crossbar.",
            magnitude=Parameter("crossbar_mass", 0.0, 0.0, 600.0, "kg", prior_sd=100.0, description="mass of it"),
            build=_crossbar_mass,
            richer=crossbar_body(_MIDDLE),
        ),
        Effect(
            name="brake_unit",
            title="Brake unit hung elastically on the front crossbar",
            phrase="a brake unit hung elastically on the front crossbar",
            lacks="Everything on the crossbars moves rigidly with them.",
            look_for="A brake unit on rubber bushes at the left of the front crossbar: weigh it; an accelerometer on "
            "it shows a resonance of its own when it is tapped.",
            magnitude=Parameter("brake_unit", 0.1, 0.1, 500.0, "kg", prior_sd=80.0, description="mass of the unit"),
            build=_brake_unit,
            nuisance=(_UNIT_FREQ,),
            grid=tuple({"brake_unit": 80.0, "brake_unit_freq": f} for f in (9.0, 12.0, 15.0, 19.0, 24.0, 32.0)),
            richer=brake_unit_on_mounts(_UNIT, _UNIT_FREQ, BRAKE_UNIT_RATIO),
        ),
    )  # fmt: skip


def _crossbar_joint(model: StructuralModel) -> Addition:
    rows = []
    for _, s in ENDS:
        for _, t in SIDES:
            joint: Place = ("crossbar", (s * CROSSBAR_X, GIRDER_Y, t * GIRDER_Z))
            inner: Place = ("crossbar", (s * CROSSBAR_X, GIRDER_Y, t * (GIRDER_Z - JOINT_LENGTH)))
            rows += _turned(model, joint, inner, CROSSBAR, RZ)
    return Addition(stiffness=(outer_term("crossbar_joint", rows, parameter("crossbar_joint", -1.0)),))


def _girder_end(model: StructuralModel) -> Addition:
    rows, cuts = [], np.linspace(CROSSBAR_X, AXLE_X, GIRDER_END_STRETCHES + 1).tolist()
    for _, s in ENDS:
        for _, t in SIDES:
            places: list[Place] = [("girder_end", (s * x, GIRDER_Y, t * GIRDER_Z)) for x in cuts]
            for one, other in pairwise(places):
                rows += _turned(model, one, other, GIRDER_END, RX)
    return Addition(stiffness=(outer_term("girder_end", rows, parameter("girder_end", -1.0)),))


def _turned(model: StructuralModel, one: Place, other: Place, section: Section, twist: int) -> list[np.ndarray]:
    """Relative rotations of the ends of a straight segment, times the root of the stiffness against them.

    A segment of length L stores bending energy with the stiffness ``E I/L`` in the mean curvature and torsion energy
    with ``G J/L`` in the mean twist: at most all of it, by the inequality of Cauchy and Schwarz. Losing a share of that
    leaves a stiffness that is nowhere negative and does not depend on the mesh.
    """
    length = float(np.linalg.norm(np.subtract(other[1], one[1])))
    rigidity = {RY: section.young_modulus * section.i_y, twist: section.shear_modulus * section.torsion}
    vertical = section.young_modulus * section.i_z
    return [float(np.sqrt(rigidity.get(d, vertical) / length)) * between(model, other, one, d) for d in (RX, RY, RZ)]


def _crossbar_mass(model: StructuralModel) -> Addition:
    rows = [motion(model, _MIDDLE, direction) for direction in (UX, UY, UZ)]
    return Addition(
        mass=(outer_term("crossbar_mass", rows, parameter("crossbar_mass")),),
        assumptions=(Assumption("unmodelled mass: x, y, z", f"{CROSSBAR_X}, {GIRDER_Y}, 0", "m", _REASON),),
    )


def _brake_unit(model: StructuralModel) -> Addition:
    hung = hung_masses([motion(model, _UNIT, UY)], "brake_unit", "brake_unit_freq", BRAKE_UNIT_RATIO)
    assumed = (
        Assumption("brake unit: x, y, z", f"{CROSSBAR_X}, {GIRDER_Y}, {BRAKE_UNIT_Z}", "m", _REASON),
        Assumption("brake unit: damping ratio on its bushes", f"{BRAKE_UNIT_RATIO}", "-", "rubber bushes"),
    )
    return Addition(hung.stiffness, hung.damping, hung.mass, hung.selected, hung.n_added, assumed)
