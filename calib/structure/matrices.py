"""Matrices assembled by another code, validated and made affine in named parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.errors.arguments import numbers, values
from calib.errors.errors import InputError
from calib.measurement.modal import DIRECTIONS
from calib.problem.space import ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial, Term
from calib.structure.sparse_indices import require_consistent

Array: TypeAlias = (
    np.ndarray | sp.coo_array | sp.csc_array | sp.csr_array | sp.coo_matrix | sp.csc_matrix | sp.csr_matrix
)
"""A square matrix, dense or sparse."""

Scaling: TypeAlias = str | Mapping[str, float]
"""Multiplier of a matrix: a parameter, or a product of powers of parameters."""

Terms: TypeAlias = Array | Mapping[str, Array | tuple[Array, Scaling]]
"""One constant matrix, or named ones; a matrix named like a parameter is multiplied by it."""

_ROUNDING = 1e-6
"""Asymmetry that assembly may leave, over the largest entry."""


@dataclass(frozen=True)
class DofTable:
    """Node and direction of each row of the matrices, and coordinates of the nodes.

    Attributes
    ----------
    node : ndarray (n_dof,), int
        Index into ``labels``.
    direction : ndarray (n_dof,), int
        0..5 for ux, uy, uz, rx, ry, rz.
    labels : tuple of int
        Node labels, length n_nodes.
    points : ndarray (n_nodes, 3)
        m; NaN where no coordinates are given.
    """

    node: np.ndarray
    direction: np.ndarray
    labels: tuple[int, ...]
    points: np.ndarray

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return len(self.node)

    @property
    def expansion(self) -> sp.csr_array:
        """Nodal motions over the degrees of freedom, (6 * n_nodes, n_dof)."""
        n = self.n_dof
        where = (6 * self.node + self.direction, np.arange(n))
        return sp.csr_array((np.ones(n), where), shape=(6 * len(self.labels), n))

    def words(self, k: int) -> str:
        """Name of a degree of freedom in messages."""
        return f"row {k + 1} (node {self.labels[self.node[k]]}, {DIRECTIONS[self.direction[k]]})"

    @staticmethod
    def of(given: pd.DataFrame | Iterable[tuple[int, str]], name: str) -> DofTable:
        """Read a table ``node, direction[, x, y, z]`` (m), or pairs of node and direction, in the order of the rows.

        Raises
        ------
        InputError
            When a column is missing, a direction is unknown, a row is named twice, or a node has two positions.
        """
        place = f"model {name}, dofs"
        if isinstance(given, pd.DataFrame):
            table = given
        else:
            table = pd.DataFrame(two_columns(given, place, "(node, direction)"), columns=["node", "direction"])
        for column in ("node", "direction"):
            if column not in table:
                raise InputError(f"the column {column!r} is missing", place=place, remedy="name node and direction")
        direction = np.array([_direction(d, k, place) for k, d in enumerate(table["direction"])], dtype=int)
        numbers = pd.to_numeric(table["node"], errors="coerce").to_numpy(dtype=float)
        wrong = np.flatnonzero(~(np.isfinite(numbers) & (numbers == np.round(numbers))))
        if len(wrong):
            k = int(wrong[0])
            raise InputError(
                f"the node of row {k + 1} is {table['node'].iloc[k]!r}", place=place, remedy="give integers"
            )
        labels, node = np.unique(numbers.astype(int), return_inverse=True)
        named = pd.MultiIndex.from_arrays([node, direction])
        if named.has_duplicates:
            k = int(np.flatnonzero(named.duplicated())[0])
            raise InputError(
                f"{DIRECTIONS[direction[k]]} of node {labels[node[k]]} is named twice",
                place=f"{place}, row {k + 1}",
                remedy="name every row of the matrices once",
            )
        return DofTable(node, direction, tuple(labels.tolist()), _points(table, node, len(labels), labels, place))


def _direction(given: object, k: int, place: str) -> int:
    if given in DIRECTIONS:
        return DIRECTIONS.index(str(given))
    if isinstance(given, int | np.integer) and 1 <= given <= len(DIRECTIONS):
        return int(given) - 1
    raise InputError(
        f"the direction of row {k + 1} is {given!r}", place=place, remedy=f"one of {', '.join(DIRECTIONS)}, or 1 to 6"
    )


def two_columns(given: object, place: str, of: str) -> list[tuple[Any, Any]]:
    """Rows of two entries each; InputError for anything else."""
    rows: list[Any] = list(given) if isinstance(given, Iterable) and not isinstance(given, str | Mapping) else [given]
    for k, row in enumerate(rows):
        if isinstance(row, str) or not isinstance(row, Sequence | np.ndarray) or len(row) != 2:
            raise InputError(f"row {k + 1} is {row!r:.40}", place=place, remedy=f"give pairs {of}")
    return [(row[0], row[1]) for row in rows]


def _points(table: pd.DataFrame, node: np.ndarray, count: int, labels: np.ndarray, place: str) -> np.ndarray:
    out = np.full((count, 3), np.nan)
    given = [c for c in "xyz" if c in table]
    if not given:
        return out
    if len(given) < 3:
        raise InputError(f"only {', '.join(given)} of the coordinates", place=place, remedy="give x, y and z in m")
    rows = table[["x", "y", "z"]].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    if np.any(np.isnan(rows) & table[["x", "y", "z"]].notna().to_numpy()):
        raise InputError("a coordinate is not a number", place=place, remedy="give x, y and z in m")
    out[node] = rows
    apart = np.flatnonzero(np.abs(out[node] - rows).max(axis=1) > 0)
    if len(apart):
        raise InputError(f"node {labels[node[apart[0]]]} has two positions", place=place, remedy="give each node one")
    return out


def affine(
    kind: str, given: Terms, space: ParameterSpace, dofs: DofTable, name: str
) -> tuple[AffineMatrix, tuple[str, ...]]:
    """One matrix of a model as a sum of terms, and the names of terms completed from one triangle.

    Parameters
    ----------
    kind : str
        ``stiffness``, ``damping`` or ``mass``.
    given : Terms
        Per parameter in SI.
    space : ParameterSpace
    dofs : DofTable
    name : str
        Of the model.

    Raises
    ------
    InputError
        When a matrix has the wrong size, a non-finite entry, is not symmetric, or is scaled by an unknown parameter.
    """
    named = given if isinstance(given, Mapping) else {kind: given}
    terms, completed = [], []
    for key, entry in named.items():
        place = f"model {name}, {kind} {key!r}"
        if isinstance(entry, tuple) and len(entry) != 2:
            raise InputError(f"it has {len(entry)} entries", place=place, remedy="give (matrix, parameter)")
        matrix, scaling = entry if isinstance(entry, tuple) else (entry, {key: 1.0} if key in space else {})
        powers = {scaling: 1.0} if isinstance(scaling, str) else values(scaling, f"{place}, scaling")
        for parameter in powers:
            if parameter not in space:
                raise InputError(
                    f"it is scaled by {parameter!r}, which is not a parameter",
                    place=place,
                    remedy=f"the parameters are {', '.join(space.names) or 'none'}",
                )
        full, half = _symmetric(_checked(matrix, dofs, place), dofs, place)
        completed += [key] if half else []
        terms.append(Term(key, full, Monomial(1.0, tuple(powers.items()))))
    return AffineMatrix(dofs.n_dof, tuple(terms)), tuple(completed)


def _checked(matrix: Array, dofs: DofTable, place: str) -> sp.csr_array:
    n = dofs.n_dof
    if sp.issparse(matrix):
        require_consistent(matrix, place)
    else:
        matrix = numbers(matrix, place)
    if tuple(matrix.shape) != (n, n):
        raise InputError(
            f"its shape is {tuple(matrix.shape)}, and {n} rows are named",
            place=place,
            remedy="give a matrix with a row and a column for each entry of dofs",
        )
    out = sp.coo_array(matrix)
    if np.iscomplexobj(out.data):
        raise InputError("its entries are complex", place=place, remedy="give stiffness, damping and mass apart")
    out = sp.coo_array((out.data.astype(float), (out.row, out.col)), shape=(n, n))
    wrong = np.flatnonzero(~np.isfinite(out.data))
    if len(wrong):
        k = int(wrong[0])
        raise InputError(
            f"the entry at {dofs.words(int(out.row[k]))} and {dofs.words(int(out.col[k]))} is {out.data[k]}",
            place=place,
        )
    return sp.csr_array(out)


def _symmetric(matrix: sp.csr_array, dofs: DofTable, place: str) -> tuple[sp.csr_array, bool]:
    """The matrix, completed from one triangle where only that is given, and whether it was."""
    largest = abs(matrix).max() if matrix.nnz else 0.0
    off = abs(matrix - matrix.T)
    if not largest or off.max() <= _ROUNDING * largest:
        return sp.csr_array((matrix + matrix.T) / 2), False
    for other in (sp.tril(matrix, -1), sp.triu(matrix, 1)):
        if abs(other).max() <= _ROUNDING * largest:
            return sp.csr_array(matrix + matrix.T - sp.diags_array(matrix.diagonal())), True
    worst = sp.coo_array(off)
    k = int(np.argmax(worst.data))
    raise InputError(
        f"it is not symmetric: the entries at {dofs.words(int(worst.row[k]))} and {dofs.words(int(worst.col[k]))} "
        f"differ by {worst.data[k]:.3g}",
        place=place,
        remedy="give a symmetric matrix, or one of its triangles",
    )


def require_mass(mass: sp.csc_array, dofs: DofTable, name: str) -> None:
    """InputError for a negative mass on the diagonal at the nominal values."""
    diagonal = mass.diagonal()
    wrong = np.flatnonzero(diagonal < 0)
    if len(wrong):
        k = int(wrong[0])
        raise InputError(
            f"the mass at {dofs.words(k)} is {diagonal[k]:g}",
            place=f"model {name}, mass",
            remedy="correct the sign of the matrix or of its parameter",
        )


def require_used(space: ParameterSpace, matrices: Sequence[AffineMatrix], name: str) -> None:
    """InputError for a parameter that scales no matrix."""
    used = {parameter for m in matrices for t in m.terms for parameter in t.coefficient.names}
    idle = [n for n in space.names if n not in used]
    if idle:
        raise InputError(
            f"no matrix is scaled by {', '.join(map(repr, idle))}",
            place=f"model {name}, parameters",
            remedy="name a matrix like the parameter, or give (matrix, parameter)",
        )
