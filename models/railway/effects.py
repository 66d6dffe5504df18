"""Library of effects that the model of the bogie on its rig may lack; they keep the meaning of its parameters."""

from __future__ import annotations

from calib import Effect
from models.railway.effects_frame import frame_effects
from models.railway.effects_rig import rig_effects
from models.railway.effects_suspension import suspension_effects


def bogie_effects() -> tuple[Effect, ...]:
    """Effects that may be missing in `models.railway.bogie_on_rig`, on any of its meshes.

    Plausible sizes (``prior_sd``) and limits are engineering estimates for a bogie of this size; with magnitude 0 each
    leaves the model as it is.
    """
    return (*rig_effects(), *frame_effects(), *suspension_effects())
