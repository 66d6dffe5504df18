"""The vehicle, rebuilt with each of its effects modelled in the mesh itself.

Masses move or are added, sections are reduced, bushes and bodies are added; no term of the library is used. Every
function takes the effect's parameters and the number of pieces of every edge.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from calib import StructuralModel
from models.railway.bogie import ENDS, SIDES
from models.railway.vehicle import BOGIES
from tests.models.railway.rebuilding import Values
from tests.models.railway.rebuilt_body import coupled, glazed, lossy_body, thin_edges, thin_pillars, top_heavy
from tests.models.railway.rebuilt_equipment import hung, moved_equipment, sprung_seats
from tests.models.railway.rebuilt_suspension import (
    air_springs,
    anti_roll_bars,
    loaded_bolster,
    lossy_pads,
    on_bushes,
    scaled,
    soft_track,
    tight_pivots,
)


def _dampers(v: Values) -> dict[str, float]:
    return {
        f"{bogie} bogie, secondary damper {end} {side}": 1 + s * v["damper_asymmetry"]
        for bogie, _ in BOGIES for end, _ in ENDS for side, s in SIDES
    }  # fmt: skip


def _springs(v: Values) -> dict[str, float]:
    return {
        f"front bogie, secondary spring {end} {side}": 1 + s * v["secondary_asymmetry"]
        for end, _ in ENDS for side, s in SIDES
    }  # fmt: skip


def _pads(v: Values) -> dict[str, float]:
    return {f"{bogie} bogie, floor pad {end} left": 1 - v["soft_pads"] for bogie, _ in BOGIES for end, _ in ENDS}


VEHICLES: dict[str, Callable[[Values, int], StructuralModel]] = {
    "floor_joint": thin_edges,
    "window_corners": thin_pillars,
    "window_glass": glazed,
    "body_damping": lossy_body,
    "neighbour_coupling": coupled,
    "tipping": top_heavy,
    "hung_converter": partial(hung, name="hung_converter", item="traction converter"),
    "hung_roof_unit": partial(hung, name="hung_roof_unit", item="front roof unit"),
    "soft_seats": sprung_seats,
    "equipment_offset": moved_equipment,
    "anti_roll_bar": anti_roll_bars,
    "damper_asymmetry": partial(scaled, "dampers", _dampers),
    "secondary_asymmetry": partial(scaled, "springs", _springs),
    "air_spring": air_springs,
    "yaw_damper_mount": partial(on_bushes, "dampers", ("c_yaw",), lambda name: True, "yaw_damper_mount"),
    "soft_pads": partial(scaled, "springs", _pads),
    "pad_damping": lossy_pads,
    "track_compliance": soft_track,
    "rod_bushes": partial(
        on_bushes, "springs", ("K_rod_upper", "K_rod_lower"), lambda name: name.startswith("front"), "rod_bushes"
    ),
    "tilting_rod_bush": partial(
        on_bushes,
        "springs",
        ("K_rod_tilting",),
        lambda name: name == "front bogie, tilting rod left",
        "tilting_rod_bush",
    ),
    "bolster_mass": loaded_bolster,
    "pivot_yaw": tight_pivots,
}
"""The rebuilt vehicle of every effect by name."""
