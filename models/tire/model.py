"""The tire as a model: scalar responses with derivatives, or modes at sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from calib import FunctionModel, Parameter, ParameterSpace
from calib.structure import Assumption, relative_change, slope_entry
from models.tire.derivatives import Change, change
from models.tire.effects import tire_effects
from models.tire.grid import Grid
from models.tire.micromechanics import CordRubber
from models.tire.parts import PARTS
from models.tire.profile import netting_profile
from models.tire.responses import Rig, State
from models.tire.tire import Tire

DEFLECTIONS = (4.0, 8.0, 12.0, 16.0, 20.0)
"""mm."""
ORDERS = (0, 1, 2, 3)
SHAPING = ("crown_radius", "widest_radius", "bead_radius", "profile_angle")
"""Parameters that shape the profile: no derivatives are returned for them."""
KPA, MM, GPA, MPA = 1e3, 1e-3, 1e9, 1e6


def parameters() -> tuple[Parameter, ...]:
    """Parameters of a generic bias tire (assumed); the pressure is that of the test and not fitted."""
    return (
        Parameter("pressure", 200.0, 100.0, 300.0, "kPa", "fixed", description="inflation pressure"),
        Parameter("crown_angle", 38.0, 30.0, 46.0, "deg", prior_sd=1.0, description="cords from the circumference"),
        Parameter("E_cord", 2.0, 1.0, 4.0, "GPa", prior_sd=0.3, description="modulus of the cords"),
        Parameter("E_rubber", 5.0, 2.0, 10.0, "MPa", prior_sd=0.75, description="modulus of the rubber"),
        Parameter("t_ply", 1.2, 0.9, 1.5, "mm", prior_sd=0.05, description="thickness of each of four plies"),
        Parameter("cord_fraction", 0.3, 0.2, 0.5, "-", "fixed", description="volume of cords over that of a ply"),
        Parameter("density", 1150.0, 1000.0, 1300.0, "kg/m3", prior_sd=40.0, description="of cords and rubber alike"),
        Parameter("crown_radius", 330.0, 320.0, 340.0, "mm", "fixed", description="of the profile as built"),
        Parameter("widest_radius", 265.0, 260.0, 270.0, "mm", "fixed", description="of the profile as built"),
        Parameter("bead_radius", 215.0, 212.0, 220.0, "mm", "fixed", description="of the profile as built"),
        Parameter("profile_angle", 38.0, 30.0, 46.0, "deg", "fixed", description="crown angle that shaped the profile"),
    )


def tire_of(values: Mapping[str, float]) -> Tire:
    """The tire of `parameters`; with those of `models.tire.effects` and `models.tire.parts` where they are given."""
    get = values.get
    radii = (values[name] * MM for name in ("crown_radius", "widest_radius", "bead_radius"))
    profile = netting_profile(*radii, float(np.radians(values["profile_angle"])))
    plies = CordRubber(values["E_cord"] * GPA, values["E_rubber"] * MPA, values["cord_fraction"])
    tire = Tire(
        profile, plies, float(np.radians(values["crown_angle"])), ply_thickness=values["t_ply"] * MM,
        density=values["density"],
    )  # fmt: skip
    return replace(
        tire,
        belt_thickness=get("belt", 0.0) * MM,
        belt_angle=float(np.radians(get("belt_angle", 20.0))),
        belt_modulus=values["E_cord"] * GPA,
        tread_thickness=get("tread_layer", 0.0) * MM,
        tread_modulus=values["E_rubber"] * MPA,
        tread_compliance=get("tread_compliance", 0.0) * MM / MPA,
        soft_bead=get("soft_bead", 0.0),
        thin_sidewall=get("thin_sidewall", 0.0),
        halpin_tsai=get("halpin_tsai", 0.0),
        crown_mass=get("crown_mass", 0.0),
        uncoupled=get("uncoupled", 0.0),
        dead_pressure=get("dead_pressure", 0.0),
        changes={part.parameter: values[part.parameter] for part in PARTS if part.parameter in values},
    )


def tire_on_ground(
    n_meridian: int = 29,
    n_hoop: int = 16,
    deflections: Sequence[float] = DEFLECTIONS,
    loads: Sequence[float] = (),
    orders: Sequence[int] = ORDERS,
    derivatives: bool = True,
) -> FunctionModel:
    """A bias tire, inflated and pressed on flat ground.

    Responses, with a number d for each deflection in mm and F for each load in N: ``radius_inflated``, and what crown
    and width of the section gain by inflation, ``growth_crown`` and ``growth_width`` (mm); ``load_d`` (N),
    ``stiffness_d`` (N/mm, slope of the load from the deflection before), ``patch_length_d``, ``patch_width_d``,
    ``bulge_d`` (mm, largest axial displacement of the wall below the axle), ``shoulder_d`` (mm, rise of the tread's
    edges), ``centre_d`` (kPa, contact pressure under the crown); ``radius_at_F`` (mm, loaded radius); ``freq_n`` (Hz)
    for each hoop order n, lowest mode of the inflated tire free of the ground. With tread compliance also ``peak_d``
    (kPa); without, the largest pressure grows with the mesh and is no response.

    Parameters
    ----------
    n_meridian, n_hoop, deflections, loads, orders
        See `models.tire.responses.Rig`.
    derivatives : bool
        Whether it also returns derivatives, see `calib.structure.function_model.slope_entry`, by all parameters but
        those that shape the profile, and by those of `tire_effects` and `PARTS` that are among the values. Each takes
        an eighth of the time of a point; a difference would take two points.
    """
    space = ParameterSpace(parameters())
    function = TireFunction(Rig(n_meridian, n_hoop, tuple(deflections), tuple(loads), tuple(orders)), derivatives)
    return FunctionModel("tire on the ground", space, function, assumptions(n_meridian, n_hoop), PARTS)


def assumptions(n_meridian: int, n_hoop: int) -> tuple[Assumption, ...]:
    """What the model takes for granted."""
    return (
        Assumption("beads", "clamped", "-", "a mounted bead seat is far stiffer than a sidewall"),
        Assumption("ground", "flat, without friction, met by the middle of the wall", "-", "Bozdog and Olson (2005)"),
        Assumption("theory", "no transverse shear, moderate rotations", "-", "a wall that is thin against its radii"),
        Assumption("mesh", f"{n_meridian} x {n_hoop}", "cells", "bead to bead, and around"),
    )


@dataclass(frozen=True)
class TireFunction:
    """The function of `tire_on_ground`.

    Attributes
    ----------
    rig : Rig
    derivatives : bool
    """

    rig: Rig
    derivatives: bool

    def __call__(self, values: Mapping[str, float]) -> dict[str, float]:
        """Responses, and derivatives where wanted."""
        state = _solved(self.rig, tuple(sorted((name, value) for name, value in values.items() if value)))
        out = self.rig.responses(state)
        if self.derivatives:
            varied = _varied(values)
            ranges = {name: p.upper - p.lower for name, p in varied.items()}
            changes = {name: self._change(values, p) for name, p in varied.items()}
            for name, slopes in self.rig.slopes(state, changes, ranges).items():
                out |= {slope_entry(response, name): slope for response, slope in slopes.items()}
        return out

    def _change(self, values: Mapping[str, float], p: Parameter) -> Change:
        places = Grid(tire_of(values).profile, self.rig.n_meridian).s_quarter
        if p.name == "pressure":
            n = len(places)
            return Change(np.zeros((n, 6, 6)), np.zeros(n), pressure=KPA)
        at = values.get(p.name, p.value)
        return change(lambda value: tire_of({**values, p.name: value}), at, p.lower, p.upper, places)


@lru_cache(maxsize=4)
def _solved(rig: Rig, values: tuple[tuple[str, float], ...]) -> State:
    """The state at values that are not 0: the same for all derivatives that are wanted there."""
    named = {**{p.name: 0.0 for p in parameters()}, **dict(values)}
    return rig.solve(tire_of(named), named["pressure"] * KPA)


def _varied(values: Mapping[str, float]) -> dict[str, Parameter]:
    """Parameters by which derivatives are returned: the model's, magnitudes of effects, nuisances of those in use."""
    own = [p for p in parameters() if p.name not in SHAPING]
    for effect in tire_effects():
        own += [p for p in (effect.parameters if values.get(effect.name) else [effect.magnitude]) if p.name in values]
    own += [relative_change(part) for part in PARTS if part.parameter in values]
    return {p.name: p for p in own}
