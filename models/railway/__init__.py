"""Railway vehicle of the Alfa Pendular case study (Ribeiro et al. 2013): the bogie on its test rig."""

from models.railway.effects import bogie_effects
from models.railway.rig import bogie_on_rig

__all__ = ["bogie_effects", "bogie_on_rig"]
