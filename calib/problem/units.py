"""Units of parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping

SI_FACTORS: Mapping[str, float] = {
    "-": 1.0,
    "%": 0.01,
    "m": 1.0,
    "mm": 1e-3,
    "kg": 1.0,
    "g": 1e-3,
    "t": 1e3,
    "kg/m": 1.0,
    "kg/m2": 1.0,
    "kg/m3": 1.0,
    "kgm2": 1.0,
    "m2": 1.0,
    "mm2": 1e-6,
    "m4": 1.0,
    "mm4": 1e-12,
    "N": 1.0,
    "kN": 1e3,
    "MN": 1e6,
    "Nm2": 1.0,
    "kNm2": 1e3,
    "MNm2": 1e6,
    "N/m": 1.0,
    "kN/m": 1e3,
    "MN/m": 1e6,
    "mm/kN": 1e-6,
    "mm/MN": 1e-9,
    "Nm/rad": 1.0,
    "kNm/rad": 1e3,
    "MNm/rad": 1e6,
    "rad/kNm": 1e-3,
    "Nms/rad": 1.0,
    "Ns/m": 1.0,
    "kNs/m": 1e3,
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "GPa": 1e9,
    "mm/MPa": 1e-9,
    "Hz": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180,
    "s": 1.0,
    "ms": 1e-3,
}
"""Factor from the named unit to SI."""
