"""What a model of a tire may lack: `models.tire.model.tire_of` reads the parameters of these effects itself."""

from __future__ import annotations

from calib import Effect, Parameter
from models.function_effect import function_effect


def tire_effects() -> tuple[Effect, ...]:
    """Effects that `models.tire.model.tire_on_ground` leaves out; plausible sizes are estimates (assumed)."""
    return (
        function_effect(
            "belt", "Belt under the tread", "a belt under the tread",
            "The carcass is the same from bead to bead.",
            "Two further plies of small angle in a cut through the crown.", 1.0, "mm", 0.4,
            nuisance=(
                Parameter("belt_angle", 20.0, 14.0, 26.0, "deg", prior_sd=2.0, description="from the circumference"),
            ),
            grid=[{"belt": 0.1, "belt_angle": angle} for angle in (16.0, 18.0, 20.0, 22.0, 24.0)],
        ),
        function_effect(
            "tread_layer", "Layer of tread rubber", "the stiffness and mass of the tread's rubber",
            "The tread neither stiffens nor loads the carcass.",
            "The depth of the tread at the crown.", 16.0, "mm", 6.0,
        ),
        function_effect(
            "tread_compliance", "Compliance of the tread", "the compliance of the tread under contact pressure",
            "The wall meets the ground without a soft layer between.",
            "Soft or deep tread blocks; an ink print of the patch.", 4.0, "mm/MPa", 1.0,
        ),
        function_effect(
            "soft_bead", "Soft bead", "a soft bead",
            "The wall bends as stiffly beside the bead as elsewhere.",
            "A loose fit on the rim, or a worn filler beside the bead.", 0.9, "-", 0.3,
        ),
        function_effect(
            "thin_sidewall", "Thin sidewalls", "thinner sidewalls",
            "The plies are as thick in the sidewalls as under the tread.",
            "The thickness of the sidewall in a cut, or scuffs along it.", 0.5, "-", 0.15,
        ),
        function_effect(
            "halpin_tsai", "Stiffer matrix of the plies", "the stiffness of the plies across their cords",
            "Plies have the constants of Gough and Tangorra.",
            "A test of a coupon of the ply across its cords and in shear.", 1.0, "-", 0.4,
        ),
        function_effect(
            "crown_mass", "Mass under the tread", "the mass of the tread",
            "The tread weighs nothing.",
            "The weight of the tire, or of a piece cut from its crown.", 16.0, "kg/m2", 5.0,
        ),
        function_effect(
            "uncoupled", "Plies without coupling", "plies that do not couple stretching and bending",
            "Plies lie as they were laid, so that stretching the wall also twists it.",
            "The order of the plies in a cut; plies that are woven or laid symmetrically.", 1.0, "-", 0.5,
        ),
        function_effect(
            "dead_pressure", "Pressure as a dead load", "pressure that does not follow the wall",
            "The pressure follows the wall as it turns and stretches.",
            "The load type of a computation that stands for the test: does it have a pressure stiffness?",
            1.0, "-", 0.5,
        ),
    )  # fmt: skip
