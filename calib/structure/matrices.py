"""Matrices assembled by another code, validated and made affine in named parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp

from calib.errors.arguments import numbers, values
from calib.errors.errors import InputError
from calib.problem.space import ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial, Term
from calib.structure.dof_table import DofTable
from calib.structure.sparse_indices import require_consistent
from calib.structure.unit_system import SYSTEMS, UnitSystem

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


def affine(
    kind: str, given: Terms, space: ParameterSpace, dofs: DofTable, name: str, units: UnitSystem = SYSTEMS["m-kg-N"]
) -> tuple[AffineMatrix, tuple[str, ...]]:
    """One matrix of a model as a sum of terms, and the names of terms completed from one triangle.

    Parameters
    ----------
    kind : str
        ``stiffness``, ``damping`` or ``mass``.
    given : Terms
        Per parameter, all in ``units``.
    space : ParameterSpace
    dofs : DofTable
    name : str
        Of the model.
    units : UnitSystem
        Of the code that wrote the matrices.

    Raises
    ------
    InputError
        When a matrix has the wrong size, a non-finite entry, is not symmetric, or is scaled by an unknown parameter.
    """
    named = given if isinstance(given, Mapping) else {kind: given}
    terms, completed, scale = [], [], units.matrix_scale(dofs.direction >= 3)
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
        factor = math.prod(units.unit_of(space[name]) ** -power for name, power in powers.items())
        terms.append(Term(key, sp.csr_array(scale @ full @ scale), Monomial(factor, tuple(powers.items()))))
    return AffineMatrix(dofs.n_dof, tuple(terms)), tuple(completed)


def _checked(matrix: Array, dofs: DofTable, place: str) -> sp.csr_array:
    n = dofs.n_dof
    if sp.issparse(matrix):
        require_consistent(matrix, place)
    else:
        matrix = numbers(matrix, place)
        if matrix.dtype.kind == "f":  # sparse arrays know no numbers of 16 bits
            matrix = matrix.astype(float)
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
            place=place, remedy="let the code write finite numbers: did its run end as it should?",
        )  # fmt: skip
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
