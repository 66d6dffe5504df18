"""Changes of the bogie outside its library of effects: a twin may have them, but no candidate represents them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse as sp

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, PartKind, Term, between, parameter, scaled_part
from models.railway.bogie import GIRDER_Y, UY, UZ
from models.railway.rig import BLOCK_HALF, BLOCK_Y, BLOCK_Z

Build = Callable[[StructuralModel], Addition]


def outside_effects() -> tuple[Effect, ...]:
    """Four designs; the plausible size of each is a change that an inspection would clearly find."""
    return (
        design(
            "heavy_rear", "Heavier rear half of the frame", 0.0, 3.0, 0.4, "share added to its steel",
            scaled("heavy_rear", "mass", ("girder end rear left", "girder end rear right", "crossbar rear")),
        ),
        design(
            "stiff_rear_rods", "Stiffer lower connecting rods of the rear axle", -0.8, 3.0, 0.3, "relative change",
            scaled("stiff_rear_rods", "stiffness", ("lower rod rear left", "lower rod rear right")),
        ),
        design(
            "soft_girder", "One girder softer", -0.8, 0.0, 0.3, "relative change of its stiffness",
            scaled("soft_girder", "stiffness", ("girder left", "girder end front left", "girder end rear left")),
        ),
        design(
            "skew_block", "Left elastic block couples vertical and lateral motion", -0.4, 0.4, 0.1,
            "coupling stiffness over the mean of both stiffnesses", _skew_block,
        ),
    )  # fmt: skip


def design(name: str, title: str, lower: float, upper: float, plausible: float, words: str, build: Build) -> Effect:
    """Effect of a change with given name, limits and plausible size."""
    magnitude = Parameter(name, 0.0, lower, upper, "-", prior_sd=plausible, description=words)
    return Effect(name, title, "It has no such difference.", "It is no candidate.", magnitude, build)


def scaled(name: str, kind: PartKind, parts: Sequence[str]) -> Build:
    """Relative change of stiffness or mass of some parts."""

    def build(model: StructuralModel) -> Addition:
        terms = tuple(scaled_part(model, kind, part, name) for part in parts)
        return Addition(mass=terms) if kind == "mass" else Addition(stiffness=terms)

    return build


def _skew_block(model: StructuralModel) -> Addition:
    """Coupling stiffness between the vertical and the lateral deformation of the left block."""
    nominal = model.space.si(model.space.values)
    size = 0.25 * (nominal["K_block"] + nominal["K_contact"])
    total = sp.csr_array((model.n_dof, model.n_dof))
    for x in (-BLOCK_HALF, BLOCK_HALF):
        above, below = ("block_left", (x, BLOCK_Y, BLOCK_Z)), ("girder_centre", (x, GIRDER_Y, BLOCK_Z))
        vertical = between(model, above, below, UY)
        middle = (x, (BLOCK_Y + GIRDER_Y) / 2, BLOCK_Z)
        lateral = between(model, ("block_left", middle), ("girder_centre", middle), UZ)
        one, other = (sp.csr_array(np.atleast_2d(b)) for b in (vertical, lateral))
        total = total + one.T @ other + other.T @ one
    return Addition(stiffness=(Term("skew_block", sp.csr_array(total), parameter("skew_block", size)),))
