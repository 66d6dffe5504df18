"""Effects of the test rig: flexibility of the actuators, tilting stiffness and damping of the blocks."""

from __future__ import annotations

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, Place, SelectedTerm, SeriesLoss, Term, between, outer_term, parameter
from models.railway.bogie import GIRDER_Y, RX, SIDES
from models.railway.rig import BLOCK_HALF, BLOCK_Y, BLOCK_Z


def rig_effects() -> tuple[Effect, ...]:
    """Effects of actuators, distribution blocks and elastic blocks."""
    return (
        Effect(
            name="actuator_flexibility",
            title="Compliance of the actuators and their frame",
            phrase="the compliance of the actuators and their frame",
            lacks="The actuators hold the distribution blocks almost rigidly.",
            look_for="Motion of the actuators' frame, oil columns under pressure, clearances in their joints.",
            magnitude=Parameter(
                "actuator_flexibility", 0.0, 0.0, 200.0, "mm/MN", prior_sd=10.0,
                description="flexibility in series with the support at each actuator",
            ),
            build=_actuator_flexibility,
        ),
        Effect(
            name="block_tilt",
            title="Elastic blocks resist tilting across",
            phrase="the resistance of the elastic blocks to tilting across",
            lacks="The elastic blocks carry vertical force but no moment about the longitudinal axis.",
            look_for="Whether the elastic blocks have the width of the drawing and stand on their whole face.",
            magnitude=Parameter(
                "block_tilt", 0.0, 0.0, 2000.0, "kNm/rad", prior_sd=150.0,
                description="stiffness of one elastic block against tilting about the longitudinal axis",
            ),
            build=_block_tilt,
        ),
        Effect(
            name="block_damping",
            title="Elastic blocks dissipate",
            phrase="damping in the elastic blocks",
            lacks="The elastic blocks of the secondary suspension are elastic without loss.",
            look_for="Warmth of the rubber after running; its loss angle from the supplier.",
            magnitude=Parameter(
                "block_damping", 0.0, 0.0, 200.0, "kNs/m", prior_sd=15.0,
                description="vertical damping of one elastic block",
            ),
            build=_block_damping,
        ),
    )  # fmt: skip


def _actuator_flexibility(model: StructuralModel) -> Addition:
    name = "actuator_flexibility"
    supports = (t for t in model.stiffness.selected if t.name.startswith("support_"))
    return Addition(
        selected=tuple(
            SelectedTerm(f"{name}: {t.name}", SeriesLoss(t.coefficient, parameter(name)), t.selectors, t.vectors)
            for t in supports
        )
    )


def _block_tilt(model: StructuralModel) -> Addition:
    rows = []
    for side, s in SIDES:
        for x in (-BLOCK_HALF, BLOCK_HALF):
            block: Place = (f"block_{side}", (x, BLOCK_Y, s * BLOCK_Z))
            girder: Place = ("girder_centre", (x, GIRDER_Y, s * BLOCK_Z))
            rows.append(between(model, block, girder, RX))
    # Two halves of a block, as for its vertical stiffness.
    return Addition(stiffness=(outer_term("block_tilt", rows, parameter("block_tilt", 0.5)),))


def _block_damping(model: StructuralModel) -> Addition:
    (blocks,) = (t for t in model.stiffness.terms if t.name == "K_block")
    return Addition(damping=(Term("block_damping", blocks.matrix, parameter("block_damping")),))
