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
"""Eigenvalue of a part's matrix, over its largest, that is rounding."""
_ROUNDED = 1e-2
"""The same of its product with random vectors, over that of the eigenvalue."""
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
    found = few_motions(matrix, MOST_MOTIONS, _ELASTIC)
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


def few_motions(matrix: sp.csr_array, most: int, least: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Motions that a symmetric matrix resists, where these are few; a large matrix is never made dense.

    Of a large matrix they span its products with random vectors, one more than so many (Halko, Martinsson and Tropp
    2011, SIAM Review 53, 217-288).

    Parameters
    ----------
    matrix : csr_array (n_dof, n_dof)
    most : int
        Largest number of motions.
    least : float
        Eigenvalue, over the largest one, that is rounding.

    Returns
    -------
    seen : ndarray (n_seen,), int
        Degrees of freedom on which the matrix acts.
    sizes : ndarray (n_motions,)
        Eigenvalues other than 0.
    motions : ndarray (n_seen, n_motions)
        Orthonormal. None in place of all where there are more than ``most``.
    """
    seen = np.unique(matrix.nonzero()[0])
    inner = matrix[seen][:, seen]
    if len(seen) <= _SMALL * most:
        sizes, turn = np.linalg.eigh(inner.toarray())
    else:
        rng = np.random.default_rng(20110713)
        probe = rng.standard_normal((len(seen), most + 1))
        some = np.sort(rng.choice(len(seen), _SMALL * most, replace=False))
        if _span(inner[some] @ probe, least).shape[1] > most:
            return None
        span = _span(inner @ probe, least)
        if span.shape[1] > most:
            return None
        sizes, turn = np.linalg.eigh(span.T @ (inner @ span))
        turn = span @ turn
    kept = np.abs(sizes) > least * max(abs(sizes).max(initial=0.0), 1e-300)
    return (seen, sizes[kept], turn[:, kept]) if np.count_nonzero(kept) <= most else None


def _span(columns: np.ndarray, least: float) -> np.ndarray:
    """Orthonormal basis of columns but for rounding, (n, rank)."""
    span, triangle, _ = la.qr(columns, mode="economic", pivoting=True)
    reached = np.abs(np.diag(triangle))
    return np.asarray(span[:, reached > _ROUNDED * least * reached[0]])
