"""Places on a model that has nodes but no elements to interpolate over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp


@dataclass(frozen=True)
class ChainLocator:
    """Finds the nearest node.

    Attributes
    ----------
    points : ndarray (n_nodes, 3)
        Coordinates, m.
    expansion : csr_array (6 * n_nodes, n_dof)
    """

    points: np.ndarray
    expansion: sp.csr_array

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        """See `calib.structure.model.Locator`; there are no parts, so ``on`` says nothing here."""
        distance = np.linalg.norm(self.points - np.asarray(point, dtype=float), axis=1)
        nearest = int(np.argmin(distance))
        return self.expansion[[6 * nearest + direction]].toarray()[0], float(distance[nearest])
