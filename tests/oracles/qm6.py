"""The incompatible modes of Taylor, Beresford and Wilson (1976) with tied rotations, by numerical integration.

What `models.fem.membrane` is for rectangles, and what it is measured against in other shapes.
"""

from __future__ import annotations

import numpy as np

from models.fem.quad import GAUSS, Quads, shape, slope
from models.fem.sheet import Sheet


def qm6(elements: Quads, sheet: Sheet, tie: float) -> np.ndarray:
    """Stiffness (n, 12, 12) of membrane and drilling penalty ``tie`` (N/m), modes condensed out."""
    jacobian = elements.jacobian(GAUSS)
    area = np.linalg.det(jacobian)
    gradient = np.linalg.solve(jacobian, np.broadcast_to(slope(GAUSS), (len(area), 4, 2, 4)))
    centre = elements.jacobian(np.zeros((1, 2)))[:, 0]
    natural = np.zeros((4, 2, 2))  # derivatives of 1 - xi^2 and 1 - eta^2 by xi and eta
    natural[:, 0, 0], natural[:, 1, 1] = -2 * GAUSS[:, 0], -2 * GAUSS[:, 1]
    modes = np.einsum("eab,pbm->epam", np.linalg.inv(centre), natural)
    modes *= (np.linalg.det(centre)[:, None] / area)[:, :, None, None]
    both = np.concatenate([gradient, modes], axis=3)
    b = np.zeros((len(area), 4, 4, 16))  # exx, eyy, 2 exy and drilling angle over corners' ux and uy, rz; then modes
    u = np.r_[0:8:2, 12:16:2]
    b[:, :, 0, u] = b[:, :, 2, u + 1] = both[:, :, 0]
    b[:, :, 1, u + 1] = b[:, :, 2, u] = both[:, :, 1]
    b[:, :, 3, u + 1], b[:, :, 3, u] = both[:, :, 0] / 2, -both[:, :, 1] / 2
    b[:, :, 3, 8:12] = -shape(GAUSS)
    rigidity = np.zeros((4, 4))
    rigidity[:3, :3], rigidity[3, 3] = sheet.membrane, tie
    k = np.einsum("epia,ij,epjb,ep->eab", b, rigidity, b, area)
    across = k[:, 12:, :12]
    return k[:, :12, :12] - np.swapaxes(across, 1, 2) @ np.linalg.solve(k[:, 12:, 12:], across)
