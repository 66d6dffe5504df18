"""What the model of the four-storey rig may lack; plausible sizes are estimates for a table-top rig (assumed)."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, SeriesLoss, Term, parameter
from models.four_storey_rig import (
    LEAF_LENGTH,
    LEAF_THICKNESS,
    LEAF_WIDTH,
    MASS,
    STOREYS,
    storey_drift,
    storey_stiffness,
)

STEEL = 7850.0
"""Density of the leaf springs, kg/m3 (assumed)."""
GRAVITY = 9.81


def four_storey_effects() -> tuple[Effect, ...]:
    """Effects that `models.four_storey_rig.four_storey_rig` leaves out."""
    return (
        Effect(
            "foundation", "A foundation that gives way", "The lowest leaf springs are clamped to rigid ground.",
            "Bolts and plate under the rig: push the base and measure how it gives way.",
            Parameter(
                "foundation", 0.0, 0.0, 100.0, "mm/kN", prior_sd=10.0,
                description="flexibility in series with the lowest storey",
            ),
            _foundation, phrase="a foundation that gives way",
        ),
        Effect(
            "foundation_damping", "Loss where the rig is clamped to the ground",
            "Every storey dissipates alike.",
            "Bolts, foam or rubber under the base; tighten the clamps and measure the damping again.",
            Parameter("foundation_damping", 0.0, 0.0, 20.0, "Ns/m", prior_sd=1.0, description="of the lowest storey"),
            _foundation_damping, phrase="loss where the rig is clamped to the ground",
        ),
        Effect(
            "joint_rotation", "Storeys that rock on their leaf springs",
            "The masses move sideways without turning.",
            "Screws of the clamps, and how near to each other the two leaf springs of a storey stand.",
            Parameter(
                "joint_rotation", 0.0, 0.0, 30.0, "rad/kNm", prior_sd=5.0, description="rotation of a mass per moment"
            ),
            _joint_rotation, phrase="the rocking of the storeys on their leaf springs",
        ),
        Effect(
            "leaf_mass", "Mass of the leaf springs", "Leaf springs weigh nothing.",
            f"Weigh them: two of a storey should have {leaf_mass() * 1e3:.1f} g between the clamps.",
            Parameter("leaf_mass", 0.0, 0.0, 30.0, "g", prior_sd=9.0, description="of the two of one storey"),
            _leaf_mass, phrase="the mass of the leaf springs",
        ),
        Effect(
            "gravity", "Weight carried by upright leaf springs", "Leaf springs carry no axial force.",
            "Whether the rig stands (1), lies (0) or hangs (-1).",
            Parameter(
                "gravity", 0.0, -1.5, 1.5, "-", prior_sd=1.0, description="upward part of the direction of the storeys"
            ),
            _gravity, phrase="the weight that upright leaf springs carry",
        ),
        Effect(
            "top_mass", "Sensor and cable at the top", "Nothing but the four weighed masses moves.",
            "What is glued or taped to the top mass.",
            Parameter("top_mass", 0.0, 0.0, 50.0, "g", prior_sd=5.0, description="mass of both"),
            _top_mass, phrase="a sensor or cable at the top",
        ),
        Effect(
            "cable", "Cable from the top to the ground", "Nothing but the leaf springs joins the masses to the ground.",
            "A cable that is taut or rubs; let it hang free and measure again.",
            Parameter("cable", 0.0, 0.0, 500.0, "N/m", prior_sd=50.0, description="stiffness at the top mass"),
            _cable, phrase="the stiffness of a cable at the top",
        ),
        Effect(
            "cable_damping", "Friction of a cable, or air, at the top", "The top moves without loss of its own.",
            "A cable that rubs, a rod of a shaker or a magnet beside the top mass.",
            Parameter("cable_damping", 0.0, 0.0, 20.0, "Ns/m", prior_sd=0.3, description="between top mass and ground"),
            _cable_damping, phrase="friction of a cable at the top",
        ),
        Effect(
            "air", "Air drag of the masses", "The masses move in a vacuum.",
            "Large plates on the masses.",
            Parameter("air", 0.0, 0.0, 20.0, "Ns/m", prior_sd=0.1, description="between each mass and the ground"),
            _air, phrase="air drag of the masses",
        ),
    )  # fmt: skip


def leaf_mass() -> float:
    """Of the two leaf springs of a storey between their clamps, kg."""
    return 2 * STEEL * LEAF_LENGTH * LEAF_THICKNESS * LEAF_WIDTH


def _of(rows: np.ndarray) -> sp.csr_array:
    """Squares of motions (n, 4), summed."""
    rows = np.atleast_2d(rows)
    return sp.csr_array(rows.T @ rows)


def _foundation(model: StructuralModel) -> Addition:
    (first,) = (term for term in model.stiffness.terms if term.name == "k1")
    flexible = SeriesLoss(first.coefficient, parameter("foundation", storey_stiffness()))
    return Addition(stiffness=(Term("foundation", first.matrix, flexible),))


def _foundation_damping(model: StructuralModel) -> Addition:
    return Addition(damping=(Term("foundation_damping", _of(storey_drift(1)), parameter("foundation_damping")),))


def _joint_rotation(model: StructuralModel) -> Addition:
    """A mass turns by its flexibility times the moments of the leaf springs below and above, ``k L / 2`` per drift.

    To first order in the flexibility, with the nominal stiffness k of every storey.
    """
    drifts = [storey_drift(k) for k in range(1, STOREYS + 1)]
    moments = np.array([low + high for low, high in zip(drifts, [*drifts[1:], np.zeros(STOREYS)], strict=True)])
    arm = storey_stiffness() * LEAF_LENGTH / 2
    return Addition(stiffness=(Term("joint_rotation", _of(moments), parameter("joint_rotation", -(arm**2))),))


def _leaf_mass(model: StructuralModel) -> Addition:
    """Consistent mass of a beam whose ends move sideways without turning: 13/35 at each, 9/70 between them."""
    total = np.zeros((STOREYS, STOREYS))
    for low, high in zip(range(-1, STOREYS - 1), range(STOREYS), strict=True):
        total[high, high] += 13 / 35
        if low >= 0:
            total[low, low] += 13 / 35
            total[low, high] += 9 / 70
            total[high, low] += 9 / 70
    return Addition(mass=(Term("leaf_mass", sp.csr_array(total), parameter("leaf_mass")),))


def _gravity(model: StructuralModel) -> Addition:
    """Geometric stiffness of a clamped beam under the weight P above it, ``-6 P / (5 L)`` per drift."""
    weight = MASS * GRAVITY
    each = [np.sqrt(1.2 * weight * (STOREYS - k + 1) / LEAF_LENGTH) * storey_drift(k) for k in range(1, STOREYS + 1)]
    return Addition(stiffness=(Term("gravity", _of(np.array(each)), parameter("gravity", -1.0)),))


def _top(name: str) -> Term:
    return Term(name, _of(np.eye(STOREYS)[-1]), parameter(name))


def _top_mass(model: StructuralModel) -> Addition:
    return Addition(mass=(_top("top_mass"),))


def _cable(model: StructuralModel) -> Addition:
    return Addition(stiffness=(_top("cable"),))


def _cable_damping(model: StructuralModel) -> Addition:
    return Addition(damping=(_top("cable_damping"),))


def _air(model: StructuralModel) -> Addition:
    return Addition(damping=(Term("air", sp.eye_array(STOREYS, format="csr"), parameter("air")),))
