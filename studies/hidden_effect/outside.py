"""Changes of the vehicle outside its library of effects: a twin may have them, but no candidate represents them."""

from __future__ import annotations

from pathlib import Path

from calib import Effect
from calib.study.loading import module_of

designs = module_of(Path(__file__).resolve().parents[1] / "hidden_bogie" / "outside.py")


def outside_effects() -> tuple[Effect, ...]:
    """Four designs; the plausible size of each is a change that an inspection would clearly find."""
    return (
        designs.design(
            "soft_rear_wall", "Right side wall softer in the rear", -0.8, 0.0, 0.4, "relative change of its membrane",
            designs.scaled("soft_rear_wall", "stiffness", ("wall right rear",)),
        ),
        designs.design(
            "heavy_front", "Heavier front third of the car", 0.0, 3.0, 0.5, "share added to its panels",
            designs.scaled("heavy_front", "mass", ("base front", "wall left front", "wall right front", "cover front")),
        ),
        designs.design(
            "soft_rear_frame", "Left girder of the rear bogie softer", -0.8, 0.0, 0.4, "relative change",
            designs.scaled(
                "soft_rear_frame", "stiffness",
                ("rear bogie, girder left", "rear bogie, girder end front left", "rear bogie, girder end rear left"),
            ),
        ),
        designs.design(
            "stiff_rear_primary", "Rear axle of the front bogie on stiffer springs", -0.8, 3.0, 0.4, "relative change",
            designs.scaled(
                "stiff_rear_primary", "stiffness",
                ("front bogie, primary springs rear left", "front bogie, primary springs rear right"),
            ),
        ),
    )  # fmt: skip
