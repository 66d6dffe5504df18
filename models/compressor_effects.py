"""What the model of the air supply unit may lack: worn bushes and what a fitter may have left; sizes are estimates."""

from __future__ import annotations

from functools import partial

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, motion, outer_term, parameter, scaled_part
from models.compressor import BEARERS, CORNERS, RAIL_X, RAIL_Y

HOSE_POINT = (-0.32, 0.15, 0.48)
"""Where the delivery hose leaves the compressor, m."""


def compressor_effects() -> tuple[Effect, ...]:
    """Effects that `models.compressor.compressor_set` leaves out."""
    return (*map(_loose, CORNERS), *map(_dead, CORNERS), *_others())


def _loose(corner: str) -> Effect:
    name = f"loose_bush_{corner.replace(' ', '_')}"
    return Effect(
        name, f"Loose bush {corner}", "All four bushes are alike.",
        f"The bush {corner}: cracked rubber, a loose bolt, a gap between bush and frame.",
        Parameter(name, 0.0, 0.0, 95.0, "%", prior_sd=25.0, description="of its stiffness and damping that is lost"),
        partial(_lost, name, corner, True), phrase=f"a bush that has come loose ({corner})",
    )  # fmt: skip


def _dead(corner: str) -> Effect:
    name = f"dead_damper_{corner.replace(' ', '_')}"
    return Effect(
        name, f"Bush {corner} without fluid", "The fluid of all four bushes damps alike.",
        f"The bush {corner}: fluid below it, a torn membrane; it is soft to a quick push by hand.",
        Parameter(name, 0.0, 0.0, 100.0, "%", prior_sd=50.0, description="of its upright damping that is lost"),
        partial(_lost, name, corner, False), phrase=f"a bush that has lost its fluid ({corner})",
    )  # fmt: skip


def _others() -> tuple[Effect, ...]:
    return (
        Effect(
            "loose_foot", "Loose foot of the compressor", "All feet are bolted alike.",
            "The bolt of the compressor's foot rear left: its torque, a missing washer.",
            Parameter("loose_foot", 0.0, 0.0, 98.0, "%", prior_sd=60.0, description="of its stiffness, lost"),
            _loose_foot, phrase="a loose foot of the compressor (rear left)",
        ),
        Effect(
            "cracked_bearer", "Cracked bearer", "All tubes of the frame are sound.",
            "Cracks at the welds of the middle rear bearer.",
            Parameter("cracked_bearer", 0.0, 0.0, 90.0, "%", prior_sd=30.0, description="of its stiffness, lost"),
            _cracked_bearer, phrase="a cracked bearer (middle rear)",
        ),
        Effect(
            "stiff_hose", "Delivery hose that pulls", "Nothing but the bushes joins the unit to the vehicle.",
            "A delivery hose that is too short or clamped close to the compressor; take it off and measure again.",
            Parameter("stiff_hose", 0.0, 0.0, 500.0, "kN/m", prior_sd=30.0, description="stiffness across the unit"),
            _stiff_hose, phrase="a delivery hose that pulls at the compressor",
        ),
        Effect(
            "air_dryer", "Air dryer on the front bearer", "The frame carries the two machines alone.",
            "An air dryer or a filter that the drawing does not show, at the middle of the front bearer.",
            Parameter("air_dryer", 0.0, 0.0, 60.0, "kg", prior_sd=10.0, description="its mass"),
            _air_dryer, phrase="an air dryer on the front bearer",
        ),
        Effect(
            "cable_box", "Cable box on the left rail", "The frame carries the two machines alone.",
            "A box of cables or a controller at the front end of the left rail.",
            Parameter("cable_box", 0.0, 0.0, 40.0, "kg", prior_sd=6.0, description="its mass"),
            _cable_box, phrase="a cable box at the front of the left rail",
        ),
        Effect(
            "soft_floor", "Floor that gives way below the rear bushes", "The floor is rigid.",
            "A plate, a trolley or a joint of the floor below both rear bushes.",
            Parameter("soft_floor", 0.0, 0.0, 90.0, "%", prior_sd=20.0, description="of their stiffness that is lost"),
            _soft_floor, phrase="a floor that gives way below the rear bushes",
        ),
    )  # fmt: skip


def _lost(name: str, corner: str, whole: bool, model: StructuralModel) -> Addition:
    """A bush without a share of its damping, and of its stiffness where it is loose as a whole."""
    ways = ("", ", x", ", y") if whole else ("",)
    dampers = tuple(scaled_part(model, "damping", f"damper {corner}{way}", name, -1.0) for way in ways)
    springs = tuple(scaled_part(model, "stiffness", f"bush {corner}{way}", name, -1.0) for way in ways if whole)
    return Addition(stiffness=springs, damping=dampers)


def _loose_foot(model: StructuralModel) -> Addition:
    return Addition(
        stiffness=(scaled_part(model, "stiffness", "foot of the compressor rear left", "loose_foot", -1.0),)
    )


def _cracked_bearer(model: StructuralModel) -> Addition:
    return Addition(stiffness=(scaled_part(model, "stiffness", "bearer middle rear", "cracked_bearer", -1.0),))


def _stiff_hose(model: StructuralModel) -> Addition:
    row = motion(model, ("compressor", HOSE_POINT), 1)
    return Addition(stiffness=(outer_term("stiff_hose", [row], parameter("stiff_hose")),))


def _added_mass(model: StructuralModel, name: str, body: str, x: float, y: float) -> Addition:
    rows = [motion(model, (body, (x, y, 0.0)), direction) for direction in range(3)]
    return Addition(mass=(outer_term(name, rows, parameter(name)),))


def _air_dryer(model: StructuralModel) -> Addition:
    return _added_mass(model, "air_dryer", "bearer front", BEARERS["front"], 0.0)


def _cable_box(model: StructuralModel) -> Addition:
    return _added_mass(model, "cable_box", "rail", RAIL_X, RAIL_Y)


def _soft_floor(model: StructuralModel) -> Addition:
    names = [f"bush rear {side}" for side in ("left", "right")]
    return Addition(stiffness=tuple(scaled_part(model, "stiffness", name, "soft_floor", -1.0) for name in names))
