"""Calibration workbench for structural-dynamics models."""

__version__ = "0.1.0"
