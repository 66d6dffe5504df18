"""Effects of the vehicle's bogies, their pivots and the track."""

from __future__ import annotations

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, Assumption, Place, motion, outer_term, parameter, softened_part
from models.railway.bogie import ENDS, SIDES, UX, UY
from models.railway.bolsters import FLOOR_Y, LOAD_BOLSTER_Y, PAD_Z
from models.railway.car_lines import BOGIE_X
from models.railway.vehicle import BOGIES

_CORNERS = tuple((end, side) for end, _ in ENDS for side, _ in SIDES)


def bogie_and_track_effects() -> tuple[Effect, ...]:
    """Effects of the track, connecting rods, bolsters and pivots."""
    return (
        Effect(
            name="track_compliance",
            title="Compliance of the track",
            phrase="the compliance of the track",
            lacks="The rails stand on rigid ground.",
            look_for="Soft rail pads, ballast, or a workshop floor that gives under the rails.",
            magnitude=Parameter(
                "track_compliance", 0.0, 0.0, 100.0, "mm/MN", prior_sd=8.0,
                description="flexibility in series with the contact of each wheel",
            ),
            build=_track_compliance,
        ),
        Effect(
            name="rod_bushes",
            title="Soft bushes of the front bogie's connecting rods",
            phrase="soft bushes of the front bogie's connecting rods",
            lacks="The connecting rods of both bogies are alike, bushes included.",
            look_for="New, soft or cracked rubber bushes at the axle-box rods of the front bogie.",
            magnitude=Parameter(
                "rod_bushes", 0.0, 0.0, 500.0, "mm/MN", prior_sd=40.0,
                description="flexibility in series with each axle-box rod of the front bogie",
            ),
            build=_rod_bushes,
        ),
        Effect(
            name="tilting_rod_bush",
            title="Soft bush of a tilting rod",
            phrase="a soft bush of a tilting rod",
            lacks="All tilting rods are alike, bushes included.",
            look_for="Wear or clearance in the joints of the front left tilting rod.",
            magnitude=Parameter(
                "tilting_rod_bush", 0.0, 0.0, 1000.0, "mm/MN", prior_sd=20.0,
                description="flexibility in series with the front bogie's left tilting rod",
            ),
            build=_tilting_rod_bush,
        ),
        Effect(
            name="bolster_mass",
            title="Unmodelled mass on the front load bolster",
            phrase="a mass on the front load bolster",
            lacks="The load bolsters carry nothing but themselves.",
            look_for="Brackets, valves, pipes or test equipment on the load bolster of the front bogie.",
            magnitude=Parameter("bolster_mass", 0.0, 0.0, 1500.0, "kg", prior_sd=200.0, description="mass of it"),
            build=_bolster_mass,
        ),
        Effect(
            name="pivot_yaw",
            title="Centre pivots resist turning",
            phrase="the resistance of the centre pivots to turning",
            lacks="The bogies turn freely about their centre pivots.",
            look_for="Side bearers with friction, tight pivots, hoses and cables between bogie and floor.",
            magnitude=Parameter(
                "pivot_yaw", 0.0, 0.0, 1000.0, "MNm/rad", prior_sd=2.0,
                description="stiffness of each pivot against turning about the upright axis",
            ),
            build=_pivot_yaw,
        ),
    )  # fmt: skip


def _track_compliance(model: StructuralModel) -> Addition:
    names = [f"{bogie} bogie, wheel-rail contact {end} {side}" for bogie, _ in BOGIES for end, side in _CORNERS]
    return Addition(stiffness=tuple(softened_part(model, name, "track_compliance") for name in names))


def _rod_bushes(model: StructuralModel) -> Addition:
    names = [f"front bogie, {rod} rod {end} {side}" for rod in ("upper", "lower") for end, side in _CORNERS]
    return Addition(stiffness=tuple(softened_part(model, name, "rod_bushes") for name in names))


def _tilting_rod_bush(model: StructuralModel) -> Addition:
    return Addition(stiffness=(softened_part(model, "front bogie, tilting rod left", "tilting_rod_bush"),))


def _bolster_mass(model: StructuralModel) -> Addition:
    """A bolster has vertical motion and rotations only."""
    row = motion(model, ("front_load_bolster", (BOGIE_X, LOAD_BOLSTER_Y, 0.0)), UY)
    return Addition(
        mass=(outer_term("bolster_mass", [row], parameter("bolster_mass")),),
        assumptions=(Assumption("unmodelled mass: place on the front load bolster", "its middle", "-", "simplest"),),
    )


def _pivot_yaw(model: StructuralModel) -> Addition:
    """The bogies' frames do not yaw in this model: the pivot acts between floor and ground."""
    rows = []
    for bogie, x in BOGIES:
        places: list[Place] = [(f"{bogie}_floor_{side}", (x, FLOOR_Y, s * PAD_Z)) for side, s in SIDES]
        left, right = (motion(model, place, UX) for place in places)
        rows.append((left - right) / (2 * PAD_Z))
    return Addition(stiffness=(outer_term("pivot_yaw", rows, parameter("pivot_yaw")),))
