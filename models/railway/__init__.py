"""Railway vehicle of the Alfa Pendular case study (Ribeiro et al. 2013): bogie on its rig, whole vehicle."""

from models.railway.effects import bogie_effects
from models.railway.rig import bogie_on_rig
from models.railway.vehicle import vehicle
from models.railway.vehicle_effects import vehicle_effects

__all__ = ["bogie_effects", "bogie_on_rig", "vehicle", "vehicle_effects"]
