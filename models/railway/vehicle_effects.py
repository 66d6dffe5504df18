"""Library of effects that the model of the whole vehicle may lack; they keep the meaning of its parameters."""

from __future__ import annotations

from calib import Effect
from models.railway.vehicle_effects_body import body_effects
from models.railway.vehicle_effects_bogies import bogie_and_track_effects
from models.railway.vehicle_effects_equipment import equipment_effects
from models.railway.vehicle_effects_secondary import secondary_effects


def vehicle_effects() -> tuple[Effect, ...]:
    """Effects that may be missing in `models.railway.vehicle` with rigid seats, on any of its meshes.

    Plausible sizes (``prior_sd``) and limits are engineering estimates for a car of this size; with magnitude 0 each
    leaves the model as it is. Their base model is ``vehicle(seats="rigid")``: with sprung seats the effect of soft
    seats is refused.
    """
    return (*body_effects(), *equipment_effects(), *secondary_effects(), *bogie_and_track_effects())
