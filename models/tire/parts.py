"""Parts of a tire that may be wrong by themselves: zones of the wall, and plies."""

from __future__ import annotations

import numpy as np

from calib.structure import ScaledPart

BEAD = 0.08
"""Share of the meridian beside a bead that counts as bead."""
ZONES = ("beads", "sidewalls", "crown")
"""Both beads and both sidewalls alike: loads and frequencies hardly tell one side from the other."""
N_PLIES = 4


def zone(s: np.ndarray, length: float, crown: float) -> np.ndarray:
    """Number in `ZONES` of the zone at arc lengths s (n,), m: (n,), int.

    Parameters
    ----------
    s : (n,) ndarray
    length : float
        Of the meridian, m.
    crown : float
        Share of the meridian that the crown covers.
    """
    part = np.asarray(s) / length
    beside, middle = np.minimum(part, 1 - part) < BEAD, np.abs(part - 0.5) <= crown / 2
    return np.where(middle, 2, np.where(beside, 0, 1))


STIFFNESS_OF_ZONE = tuple(ScaledPart(f"the {name}", "stiffness") for name in ZONES)
MASS_OF_ZONE = tuple(ScaledPart(f"the {name}", "mass") for name in ZONES)
STIFFNESS_OF_PLY = tuple(ScaledPart(f"ply {k + 1}", "stiffness") for k in range(N_PLIES))
"""From inside to outside."""
PARTS = (*STIFFNESS_OF_ZONE, *MASS_OF_ZONE, *STIFFNESS_OF_PLY)
"""Parts of a tire with four plies."""
