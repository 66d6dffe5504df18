"""Matrices that are affine in functions of named parameters: ``K(theta) = sum_q c_q(theta) K_q``."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.pattern import Pattern, narrow, padded, with_data
from calib.structure.sparse_indices import require_consistent


class Coefficient(Protocol):
    """A scalar function of parameters in SI; its ``repr`` identifies it."""

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        ...

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI."""
        ...

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI."""
        ...


@dataclass(frozen=True)
class Monomial:
    """Coefficient ``factor * prod_k theta_k**power_k`` over parameters in SI.

    Attributes
    ----------
    factor : float
    powers : tuple of (name, exponent)
    """

    factor: float = 1.0
    powers: tuple[tuple[str, float], ...] = ()

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return frozenset(name for name, _ in self.powers)

    @property
    def roots(self) -> frozenset[str]:
        """Parameters raised to a power below 1: the derivative is infinite where they are 0."""
        return frozenset(name for name, power in self.powers if 0 < power < 1)

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI."""
        out = self.factor
        for name, power in self.powers:
            out *= values[name] ** power
        return out

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI."""
        total = 0.0
        for k, (key, power) in enumerate(self.powers):
            if key != name:
                continue
            part = self.factor * power * values[key] ** (power - 1)
            for m, (other, exponent) in enumerate(self.powers):
                if m != k:
                    part *= values[other] ** exponent
            total += part
        return total


def parameter(name: str, factor: float = 1.0) -> Monomial:
    """Coefficient ``factor * theta``."""
    return Monomial(factor, ((name, 1.0),))


@dataclass(frozen=True)
class SeriesLoss:
    """Change of a stiffness k by a flexibility f in series: ``1/(1/k + f) - k = -k^2 f/(1 + k f)``.

    Attributes
    ----------
    stiffness, flexibility : Coefficient
        In N/m and m/N (or Nm/rad and rad/Nm).
    """

    stiffness: Coefficient
    flexibility: Coefficient

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return self.stiffness.names | self.flexibility.names

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI; 0 without flexibility."""
        k, f = self.stiffness(values), self.flexibility(values)
        return -(k**2) * f / (1 + k * f)

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI."""
        k, f = self.stiffness(values), self.flexibility(values)
        dk, df = self.stiffness.derivative(values, name), self.flexibility.derivative(values, name)
        return (dk - k**2 * df) / (1 + k * f) ** 2 - dk


@dataclass(frozen=True)
class Grown:
    """A monomial times a power of ``x^2/(x^2 + half^2)``: 0 at x = 0, the monomial for x far above ``half``.

    Attributes
    ----------
    monomial : Monomial
    parameter : str
        x, in SI.
    half : float
        Value of x at which the quotient is 1/2, SI.
    power : int
    """

    monomial: Monomial
    parameter: str
    half: float
    power: int = 1

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return self.monomial.names | {self.parameter}

    def _size(self, values: Mapping[str, float]) -> float:
        x = values[self.parameter]
        return x**2 / (x**2 + self.half**2)

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI."""
        return self.monomial(values) * self._size(values) ** self.power

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI."""
        size = self._size(values)
        out = self.monomial.derivative(values, name) * size**self.power
        if name == self.parameter:
            slope = 2 * values[name] * self.half**2 / (values[name] ** 2 + self.half**2) ** 2
            out += self.monomial(values) * self.power * size ** (self.power - 1) * slope
        return out


@dataclass(frozen=True)
class StretchPower:
    """Coefficient ``t**power`` on an interval of one parameter in SI, where t grows from 0 to 1; 0 outside it.

    Attributes
    ----------
    parameter : str
    start, end : float
        Where t is 0 and 1; the end may lie below the start. The interval includes its start, not its end.
    power : int
    last : bool
        The interval continues beyond its end.
    """

    parameter: str
    start: float
    end: float
    power: int
    last: bool = False

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return frozenset((self.parameter,))

    def _along(self, values: Mapping[str, float]) -> float:
        return (values[self.parameter] - self.start) / (self.end - self.start)

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI."""
        t = self._along(values)
        return t**self.power if t >= 0 and (t < 1 or self.last) else 0.0

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI; where intervals meet, each gives half of its own."""
        t = self._along(values)
        if name != self.parameter or self.power == 0 or t < 0 or (t > 1 and not self.last):
            return 0.0
        slope = self.power * t ** (self.power - 1) / (self.end - self.start)
        return slope / 2 if t == 0 or (t == 1 and not self.last) else slope


@dataclass(frozen=True)
class Term:
    """A coefficient times a constant symmetric matrix, (n_dof, n_dof); ``part`` of stiffness is what it changes."""

    name: str
    matrix: sp.csr_array
    coefficient: Coefficient = Monomial()
    part: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", narrow(self.matrix))


@dataclass(frozen=True)
class SelectedTerm:
    """A rank-one term ``c(theta) b b^T`` whose vector is selected by discrete parameters.

    Attributes
    ----------
    name : str
    coefficient : Coefficient
    selectors : tuple of str
        Names of the discrete parameters.
    vectors : mapping from tuple of int to ndarray (n_dof,)
        One vector b for every combination of selector values.
    """

    name: str
    coefficient: Coefficient
    selectors: tuple[str, ...]
    vectors: Mapping[tuple[int, ...], np.ndarray]

    def choice(self, values: Mapping[str, float]) -> tuple[int, ...]:
        """The combination of selector values at a point; InputError without a vector for it."""
        key = tuple(round(values[name]) for name in self.selectors)
        if key not in self.vectors:
            named = ", ".join(f"{n} = {v}" for n, v in zip(self.selectors, key, strict=True))
            raise InputError(f"{self.name} has no position for {named}", place="model")
        return key


@dataclass(frozen=True)
class AffineMatrix:
    """A sparse symmetric matrix as the sum of terms on one common sparsity pattern.

    Attributes
    ----------
    n_dof : int
    terms : tuple of Term
    selected : tuple of SelectedTerm
    leading : bool
        Whether a term may be over the first degrees of freedom alone, and zero over the others.
    """

    n_dof: int
    terms: tuple[Term, ...]
    selected: tuple[SelectedTerm, ...] = ()
    leading: bool = False

    def __post_init__(self) -> None:
        n = self.n_dof
        for term in self.terms:
            require_consistent(term.matrix, f"model matrices, term {term.name!r}")
            if term.matrix.shape != (n, n) and not (self.leading and max(term.matrix.shape) <= n):
                raise InputError(f"term {term.name!r} is {term.matrix.shape}, not ({n}, {n})", place="model matrices")
            if not np.all(np.isfinite(term.matrix.data)):
                raise InputError(
                    f"term {term.name!r} holds entries that are not finite",
                    place="model matrices",
                    remedy="check the sections and coordinates of that group",
                )

    @cached_property
    def _pattern(self) -> Pattern:
        """Assembled on first use: a model that is only projected on a basis never needs it."""
        return Pattern.of(self.n_dof, [term.matrix for term in self.terms], [one.vectors for one in self.selected])

    @cached_property
    def roots(self) -> frozenset[str]:
        """Parameters raised to a power below 1: the derivative is infinite where they are 0."""
        coefficients = [*(t.coefficient for t in self.terms), *(t.coefficient for t in self.selected)]
        return frozenset(name for c in coefficients for name in getattr(c, "roots", ()))

    @cached_property
    def unselected(self) -> AffineMatrix:
        """The terms alone; the matrix itself where it has no selected ones."""
        return AffineMatrix(self.n_dof, self.terms, leading=self.leading) if self.selected else self

    def continues(self, other: AffineMatrix) -> bool:
        """Whether it is the other matrix with further terms."""
        shared = zip(self.terms, other.terms, strict=False)
        same = all(one.coefficient is its.coefficient and one.matrix is its.matrix for one, its in shared)
        return same and len(self.selected) == len(other.selected)

    @property
    def is_zero(self) -> bool:
        """Whether the matrix has no terms."""
        return not self.terms and not self.selected

    def __call__(self, values: Mapping[str, float]) -> sp.csc_array:
        """The matrix at parameters in SI, shape (n_dof, n_dof)."""
        pattern = self._pattern
        data = pattern.stack @ np.array([t.coefficient(values) for t in self.terms])
        for term, pick in zip(self.selected, pattern.picks, strict=True):
            where, entries = pick[term.choice(values)]
            data[where] += term.coefficient(values) * entries
        return with_data(pattern.form, data)

    def derivative(self, values: Mapping[str, float], name: str) -> sp.csc_array:
        """Derivative of the matrix with respect to one parameter in SI, shape (n_dof, n_dof).

        It holds only entries that the parameter changes. A discrete parameter that selects a vector counts as fixed.
        """
        terms, selected = self._changed_by.get(name, ((), ()))
        parts: list[sp.csc_array] = []
        for term in terms:
            if slope := term.coefficient.derivative(values, name):
                # Symmetric, as each term is: the transpose is the same matrix, compressed by columns at no cost.
                parts.append(padded(with_data(term.matrix, slope * term.matrix.data), self.n_dof).T)
        for chosen in selected:
            if slope := chosen.coefficient.derivative(values, name):
                b = sp.csc_array(chosen.vectors[chosen.choice(values)][:, None])
                parts.append(sp.csc_array(slope * (b @ b.T)))
        return sum(parts[1:], parts[0]) if parts else sp.csc_array((self.n_dof, self.n_dof))

    @cached_property
    def _changed_by(self) -> Mapping[str, tuple[tuple[Term, ...], tuple[SelectedTerm, ...]]]:
        """Terms that depend on each parameter: most depend on one or none."""
        terms = [(term, term.coefficient.names) for term in self.terms]
        selected = [(term, term.coefficient.names) for term in self.selected]
        known = frozenset().union(*(names for _, names in (*terms, *selected)))
        return {
            name: (tuple(t for t, names in terms if name in names), tuple(t for t, names in selected if name in names))
            for name in known
        }

    def digest(self) -> bytes:
        """Hash over every term, for the model's fingerprint."""
        out = hashlib.sha256(repr((self.n_dof, [(t.name, t.coefficient) for t in self.terms])).encode())
        stack = self._pattern.stack
        for array in (self._pattern.form.indptr, self._pattern.form.indices):
            out.update(np.ascontiguousarray(array).tobytes())
        for array in (stack.indptr, stack.indices):  # as 64 bits, whatever they take in memory
            out.update(np.ascontiguousarray(array, dtype=np.int64 if self.terms else np.int32).tobytes())
        out.update(np.ascontiguousarray(stack.data).tobytes())
        for term in self.selected:
            out.update(repr((term.name, term.coefficient, term.selectors, sorted(term.vectors))).encode())
            for key in sorted(term.vectors):
                out.update(np.ascontiguousarray(term.vectors[key], dtype=float).tobytes())
        return out.digest()
