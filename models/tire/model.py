"""The tire as a model of scalar responses: growth, load-deflection curve, patch and frequencies."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.errors import InputError
from calib.function import FunctionModel
from calib.space import Parameter, ParameterSpace
from calib.structure.model import Assumption
from models.tire.contact import RotationWarning, load_curve, press_to_load
from models.tire.harmonics import hoop_modes
from models.tire.inflated import inflate
from models.tire.micromechanics import CordRubber
from models.tire.patch import bulge, patch_length, patch_width
from models.tire.profile import netting_profile
from models.tire.tire import Tire

DEFLECTIONS = (4.0, 8.0, 12.0, 16.0, 20.0)
"""mm."""
ORDERS = (0, 1, 2, 3)
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
    """The tire of `parameters`, and of those of `models.tire.effects` where they are given."""
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
    )


def tire_on_ground(
    n_meridian: int = 29,
    n_hoop: int = 16,
    deflections: Sequence[float] = DEFLECTIONS,
    loads: Sequence[float] = (),
    orders: Sequence[int] = ORDERS,
) -> FunctionModel:
    """A bias tire, inflated and pressed on flat ground.

    Responses, with a number d for each deflection in mm and F for each load in N: ``radius_inflated`` and
    ``radius_growth`` (mm); ``load_d`` (N), ``stiffness_d`` (N/mm), ``patch_length_d``, ``patch_width_d`` and
    ``bulge_d`` (mm), ``centre_d`` (kPa, contact pressure under the crown); ``radius_at_F`` (mm, loaded radius);
    ``freq_n`` (Hz) for each hoop order n, lowest mode of the inflated tire free of the ground. With tread compliance
    also ``peak_d`` (kPa); without, the largest pressure grows with the mesh and is no response.

    Parameters
    ----------
    n_meridian, n_hoop : int
        Cells.
    deflections : sequence of float
        mm, ascending.
    loads : sequence of float
        N, ascending.
    orders : sequence of int
    """
    if list(deflections) != sorted(set(deflections)) or list(loads) != sorted(set(loads)):
        raise InputError("the deflections and loads of a tire must ascend", remedy="sort them, each once")

    def function(values: Mapping[str, float]) -> dict[str, float]:
        return tire_responses(tire_of(values), values["pressure"] * KPA, n_meridian, n_hoop, deflections, loads, orders)

    assumptions = (
        Assumption("beads", "clamped", "-", "a mounted bead seat is far stiffer than a sidewall"),
        Assumption("ground", "flat, without friction, met by the middle of the wall", "-", "Bozdog and Olson"),
        Assumption("theory", "no transverse shear, moderate rotations", "-", "a wall that is thin against its radii"),
        Assumption("mesh", f"{n_meridian} x {n_hoop}", "cells", "bead to bead, and around"),
    )
    return FunctionModel("tire on the ground", ParameterSpace(parameters()), function, assumptions)


def tire_responses(
    tire: Tire,
    pressure: float,
    n_meridian: int,
    n_hoop: int,
    deflections: Sequence[float],
    loads: Sequence[float] = (),
    orders: Sequence[int] = (),
) -> dict[str, float]:
    """Responses of `tire_on_ground` at a pressure, Pa."""  # fmt: skip
    ground = tire.on_ground(pressure, n_meridian, n_hoop)
    inflated = ground.inflated
    out = {"radius_inflated": inflated.radius / MM, "radius_growth": inflated.growth / MM}
    last = None
    if len(deflections):
        centre = int(np.argmax(ground.rest))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RotationWarning)  # a search would repeat it at every point
            curve = load_curve(ground, np.asarray(deflections) * MM).complete()
        for name, step in zip((f"{d:g}" for d in deflections), curve.steps, strict=True):
            last = step
            out |= {
                f"load_{name}": step.load, f"stiffness_{name}": step.stiffness * MM,
                f"patch_length_{name}": patch_length(step) / MM, f"patch_width_{name}": patch_width(step) / MM,
                f"bulge_{name}": bulge(step) / MM, f"centre_{name}": float(step.pressure[centre]) / KPA,
            }  # fmt: skip
            if step.largest_pressure_converges:
                out[f"peak_{name}"] = step.largest_pressure / KPA
    for load in loads:
        step = press_to_load(ground, load, last)
        out[f"radius_at_{load:g}"] = step.loaded_radius / MM
    if len(orders):
        cells = max(4 * max(orders), 48)
        even = inflate(tire.wall(n_meridian, cells, 0.0), tire.wall(n_meridian, 1), pressure)
        modes = hoop_modes(even, np.array(orders))
        out |= {f"freq_{n}": float(f) for n, f in zip(orders, modes.frequencies[:, 0], strict=True)}
    return out
