"""Motions that a part resists: those of its springs or dampers."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.model import Part

MOST_MOTIONS = 120
"""Largest number of elastic motions of a part: each can have a spring or a damper of its own in series or beside it."""
_ELASTIC = 1e-9
"""Eigenvalue of a part's matrix, over its largest, that is rounding."""


def elongations(part: Part) -> sp.csr_array:
    """Motions u of a part over the degrees of freedom, (n_motions, n_dof), whose ``u^T u`` is the part's matrix.

    Raises
    ------
    InputError
        When its stiffness or damping is negative in some motion, or it has too many of them.
    """
    matrix, place = sp.csr_array(part.matrix), f"part {part.name!r}"
    seen = np.unique(matrix.nonzero()[0])
    sizes, turn = np.linalg.eigh(matrix[seen][:, seen].toarray())
    least = _ELASTIC * max(abs(sizes).max(initial=0.0), 1e-300)
    if part.coefficient.factor < 0 or sizes.min(initial=0.0) < -1e2 * least:
        remedy = "name parts that are dampers" if part.kind == "damping" else "name parts that are springs or elements"
        raise InputError(f"its {part.kind} is negative", place=place, remedy=remedy)
    kept = sizes > least
    if np.count_nonzero(kept) > MOST_MOTIONS:
        more = "" if part.kind == "damping" else ", or give it damping in proportion to its stiffness"
        raise InputError(
            f"it has {np.count_nonzero(kept)} elastic motions; at most {MOST_MOTIONS} can have springs or dampers of "
            "their own", place=place, remedy=f"name springs, dampers, joints or smaller parts{more}",
        )  # fmt: skip
    out = np.zeros((int(np.count_nonzero(kept)), matrix.shape[0]))
    out[:, seen] = (np.sqrt(sizes[kept]) * turn[:, kept]).T
    return sp.csr_array(out)
