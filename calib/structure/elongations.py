"""Motions that a part resists: those of its springs or dampers."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.model import Part

MOST_MOTIONS = 120
"""Largest number of elastic motions of a part: each can have a spring or a damper of its own in series or beside it."""
_ELASTIC = 1e-9
"""Eigenvalue of a part's matrix, over its largest, below which it is rounding."""
_ROUNDED = 1e-2
"""The limit of a product with random vectors, over `_ELASTIC`: a small eigenvalue can be smaller there."""
_SMALL = 4
"""Degrees of freedom, over the largest number of motions, up to which a matrix is made dense."""


def elongations(part: Part) -> sp.csr_array:
    """Motions u of a part over the degrees of freedom, (n_motions, n_dof), whose ``u^T u`` is the part's matrix.

    Raises
    ------
    InputError
        When its stiffness or damping is negative in some motion, or it has too many of them.
    """
    matrix, place = sp.csr_array(part.matrix), f"part {part.name!r}"
    found = few_motions(matrix)
    if found is None:
        more = "" if part.kind == "damping" else ", or give it damping in proportion to its stiffness"
        raise InputError(
            f"it has more than {MOST_MOTIONS} elastic motions; at most {MOST_MOTIONS} can have springs or dampers of "
            "their own",
            place=place, remedy=f"name springs, dampers, joints or smaller parts{more}",
        )  # fmt: skip
    seen, sizes, turn = found
    if part.coefficient.factor < 0 or np.any(sizes < 0):
        remedy = "name parts that are dampers" if part.kind == "damping" else "name parts that are springs or elements"
        raise InputError(f"its {part.kind} is negative", place=place, remedy=remedy)
    out = np.zeros((len(sizes), matrix.shape[0]))
    out[:, seen] = (np.sqrt(sizes) * turn).T
    return sp.csr_array(out)


def few_motions(matrix: sp.csr_array, most: int = MOST_MOTIONS) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Motions that a symmetric matrix resists, where these are few; a large matrix is never made dense.

    Those of a large matrix are sought in its products with ``most + 1`` random vectors (Halko, Martinsson and Tropp
    2011, SIAM Review 53, 217-288).

    Parameters
    ----------
    matrix : csr_array (n_dof, n_dof)
    most : int
        Largest number of motions.

    Returns
    -------
    tuple of ndarray, or None
        None where there are more than ``most``. Else the degrees of freedom on which the matrix acts (n_seen,), int;
        its eigenvalues other than 0 (n_motions,), which may be negative; and the motions (n_seen, n_motions),
        orthonormal.
    """
    seen = np.unique(matrix.nonzero()[0])
    inner = matrix[seen][:, seen]
    if len(seen) <= _SMALL * most:
        sizes, turn = np.linalg.eigh(inner.toarray())
    else:
        rng = np.random.default_rng(20110713)
        probe = rng.standard_normal((len(seen), most + 1))
        some = np.sort(rng.choice(len(seen), _SMALL * most, replace=False))
        if _span(inner[some] @ probe).shape[1] > most:
            return None
        span = _span(inner @ probe)
        if span.shape[1] > most:
            return None
        sizes, turn = np.linalg.eigh(span.T @ (inner @ span))
        turn = span @ turn
    kept = np.abs(sizes) > _ELASTIC * max(abs(sizes).max(initial=0.0), 1e-300)
    return (seen, sizes[kept], turn[:, kept]) if np.count_nonzero(kept) <= most else None


def _span(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis (n, rank) of products (n, m) with random vectors; what is rounding is left out."""
    span, triangle, _ = la.qr(columns, mode="economic", pivoting=True)
    reached = np.abs(np.diag(triangle))
    return np.asarray(span[:, reached > _ROUNDED * _ELASTIC * reached[0]])
