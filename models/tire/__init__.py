"""A tire as a laminate shell of revolution, inflated and pressed on flat ground."""

from models.tire.tire import Tire, base_tire

__all__ = ["Tire", "base_tire"]
