"""Terms of matrices in powers of parameters, from runs of a code: one more for a modulus, four for a thickness."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.imports.matrices import KINDS, Kind, ReadMatrices
from calib.problem.parameter import Parameter

WIDE = 2.0
"""Factor of the widest values on the nominal one: differences of values near it cancel too many digits."""
_NOTHING = 1e-13
"""Entries of a term, over the largest entry of its matrix, that are rounding of the file."""
_WRITTEN = 1e-6
"""Change of an entry, over its own size, that may be rounding of the file: single precision is the coarsest. What
parameters do together is all or much of some entry, in the element that they share."""

Powers = tuple[tuple[str, int], ...]
"""Product of powers of parameters, by name."""
Sums = dict[Kind, sp.csr_array]
"""One matrix of each kind."""


@dataclass(frozen=True, eq=False)
class MatrixTerms:
    """Matrices as sums of terms, each multiplied by powers of parameters over their nominal values.

    Attributes
    ----------
    first : ReadMatrices
        Of the nominal run: rows, coordinates, lines.
    matrices : mapping from kind to mapping from powers to csr_array (n_dof, n_dof)
        Symmetric ones may have one triangle alone, as the code wrote them.
    runs : int
        Runs that these were made from.
    together : tuple of frozenset of str
        Parameters that act together, such as the modulus and the thickness of one plate.
    """

    first: ReadMatrices
    matrices: Mapping[Kind, Mapping[Powers, sp.csr_array]]
    runs: int
    together: tuple[frozenset[str], ...] = ()

    @property
    def count(self) -> int:
        """Terms of all matrices."""
        return sum(map(len, self.matrices.values()))

    def without(self, names: Iterable[str]) -> MatrixTerms:
        """The same with some parameters held at their nominal values."""
        held = set(names)
        out: dict[Kind, dict[Powers, sp.csr_array]] = {}
        for kind, terms in self.matrices.items():
            own = out.setdefault(kind, {})
            for powers, matrix in terms.items():
                left = tuple((name, power) for name, power in powers if name not in held)
                own[left] = own[left] + matrix if left in own else matrix
        return MatrixTerms(self.first, out, self.runs, tuple(group for group in self.together if not group & held))


@dataclass
class _Runs:
    """Runs by the factors on the nominal values, and what sets of parameters change together at their own factors."""

    run: Callable[[Mapping[str, float]], ReadMatrices]
    nominal: Mapping[str, float]
    told: Callable[[int], None]
    first: ReadMatrices | None = None
    done: dict[tuple[tuple[str, float], ...], Sums] = field(default_factory=dict)

    def at(self, factors: Mapping[str, float]) -> Sums:
        """Matrices where some parameters have these factors on their nominal values."""
        key = tuple(sorted(factors.items()))
        if key not in self.done:
            self.told(len(self.done))
            read = self.run({name: value * factors.get(name, 1.0) for name, value in self.nominal.items()})
            if self.first is None:
                self.first = read
            _require_same_rows(self.first, read, factors)
            n, sums = len(read.dofs), Sums()
            for kind in KINDS:
                sums[kind] = sum(map(sp.csr_array, read.matrices[kind].values()), sp.csr_array((n, n)))
            self.done[key] = sums
        return self.done[key]

    def act_together(self, factors: Mapping[str, float]) -> bool:
        """Whether all of these parameters change an entry together by more than rounding of the file or of the code."""
        change = self.change(factors)
        some = [n for size in range(len(factors) + 1) for n in itertools.combinations(factors, size)]
        for kind, one in change.items():
            size = sum((abs(self.at({name: factors[name] for name in names})[kind]) for names in some), 0 * one)
            if (abs(one) - _WRITTEN * size).max() > _NOTHING * size.max():
                return True
        return False

    def change(self, factors: Mapping[str, float]) -> Sums:
        """What all of these parameters change together beyond what fewer of them do."""
        names = list(factors)
        out = dict(self.at(factors))
        for size in range(len(names)):
            sign = (-1) ** (len(names) - size)
            for some in itertools.combinations(names, size):
                part = self.at({name: factors[name] for name in some})
                out = {kind: out[kind] + sign * part[kind] for kind in out}
        return out


def terms_of_runs(
    run: Callable[[Mapping[str, float]], ReadMatrices],
    parameters: Sequence[Parameter],
    powers: Mapping[str, Sequence[int]],
    told: Callable[[int], None] = lambda done: None,
) -> MatrixTerms:
    r"""Terms of stiffness, mass and damping from runs at wide values of the parameters.

    With the factors :math:`x_i` on the nominal values a matrix is the sum of what each set S of parameters changes
    together, :math:`K = \sum_S K_S`, where :math:`K_S = 0` as soon as one of them is nominal. Each :math:`K_S` is
    interpolated by products of :math:`x_i^a - 1`, with as many values of each parameter as it has powers a. A set is
    tried where all of its smaller sets act together, by one run at the widest values.

    Parameters
    ----------
    run : callable
        Matrices at named values.
    parameters : sequence of Parameter
    powers : mapping from name to sequence of int
        Without 0, which always occurs.
    told : callable
        Receives the number of finished runs before each one.

    Raises
    ------
    InputError
        For a parameter that is an integer or nominally 0, and where runs have other rows.
    """
    for parameter in parameters:
        if parameter.integer or parameter.value == 0:
            what = "it is an integer" if parameter.integer else "its nominal value is 0"
            raise InputError(f"{what}, so that no wide runs are possible", place=f"parameter {parameter.name}",
                             remedy="leave it to the solver as a process, or give another nominal value")  # fmt: skip
    runs = _Runs(run, {p.name: p.value for p in parameters}, told)
    factors = {p.name: wide_factors(len(powers[p.name])) for p in parameters}
    largest = {kind: abs(one).max() if one.nnz else 0.0 for kind, one in runs.at({}).items()}
    found: dict[Kind, dict[Powers, sp.csr_array]] = {kind: {(): one} for kind, one in runs.at({}).items()}
    active: list[frozenset[str]] = []
    order = [p.name for p in parameters]
    for size in range(1, len(order) + 1):
        for names in itertools.combinations(order, size):
            smaller = [frozenset(some) for some in itertools.combinations(names, size - 1)]
            if size > 1 and not all(some in active for some in smaller):
                continue
            if size > 1 and not runs.act_together({name: factors[name][-1] for name in names}):
                continue
            active.append(frozenset(names))
            _interpolate(runs, names, factors, powers, found)
    assert runs.first is not None
    kept = {kind: _without_rounding(terms, largest[kind]) for kind, terms in found.items()}
    together = tuple(group for group in active if len(group) > 1)
    return MatrixTerms(runs.first, kept, len(runs.done), together)


def wide_factors(count: int) -> list[float]:
    """So many factors from a half to double, without 1, which is the nominal run; the last one is the widest."""
    factors = [float(f) for f in np.geomspace(1 / WIDE, WIDE, count + 1 + count % 2) if not math.isclose(f, 1.0)]
    if count % 2:
        del factors[count // 2]
    return factors


def _interpolate(
    runs: _Runs, names: Sequence[str], factors: Mapping[str, Sequence[float]], powers: Mapping[str, Sequence[int]],
    found: dict[Kind, dict[Powers, sp.csr_array]],
) -> None:  # fmt: skip
    """Add the terms of what some parameters change together."""
    changes = [
        (at, runs.change({name: factors[name][k] for name, k in zip(names, at, strict=True)}))
        for at in itertools.product(*(range(len(factors[name])) for name in names))
    ]
    inverse = {name: np.linalg.inv([[x**a - 1.0 for a in powers[name]] for x in factors[name]]) for name in names}
    for chosen in itertools.product(*(range(len(powers[name])) for name in names)):
        weights = [
            math.prod(inverse[name][a, k] for name, a, k in zip(names, chosen, at, strict=True)) for at, _ in changes
        ]
        for kind in found:
            own = sum((w * one[kind] for w, (_, one) in zip(weights, changes, strict=True)), 0 * changes[0][1][kind])
            # A product of x^a - 1 is a sum of products of powers.
            for size in range(len(names) + 1):
                for some in itertools.combinations(range(len(names)), size):
                    product = tuple((names[i], powers[names[i]][chosen[i]]) for i in some)
                    signed = (-1) ** (len(names) - size) * own
                    known = found[kind]
                    known[product] = known[product] + signed if product in known else signed


def _without_rounding(terms: Mapping[Powers, sp.csr_array], largest: float) -> dict[Powers, sp.csr_array]:
    """Terms without entries that are rounding, and without those that have no others; the constant one stays."""
    out = {}
    for powers, matrix in terms.items():
        one = sp.csr_array(matrix)
        one.data[np.abs(one.data) < _NOTHING * largest] = 0.0
        one.eliminate_zeros()
        if one.nnz or not powers:
            out[powers] = one
    return out


def _require_same_rows(first: ReadMatrices, other: ReadMatrices, factors: Mapping[str, float]) -> None:
    """InputError where a run numbers its rows otherwise than the first one."""
    columns = ["node", "direction"]
    same = len(first.dofs) == len(other.dofs) and pd.DataFrame(first.dofs[columns]).equals(other.dofs[columns])
    if not same or any(set(first.matrices[kind]) != set(other.matrices[kind]) for kind in KINDS):
        changed = ", ".join(f"{name} x {factor:g}" for name, factor in factors.items())
        raise InputError(
            f"with {changed} the code numbers its rows otherwise than at the nominal values", place="runs",
            remedy="a parameter that changes the mesh needs the solver as a process",
        )  # fmt: skip
