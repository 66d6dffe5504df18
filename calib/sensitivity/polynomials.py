"""Sparse polynomials of few inputs, found by orthogonal least squares: linear, quadratic, and polynomial chaos."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product
from typing import Literal

import numpy as np
from scipy import special

from calib.sensitivity.rules import PROGNOSIS

Kind = Literal["linear", "quadratic", "polynomial chaos"]
KINDS: tuple[Kind, ...] = ("linear", "quadratic", "polynomial chaos")
_OWN = 1e-9
"""Part of a term's length outside the terms taken before below which it is rounding."""


@dataclass(frozen=True, eq=False)
class PolynomialTerms:
    """Products of orthonormal Legendre polynomials of inputs between -1 and 1.

    Attributes
    ----------
    inputs, degrees : ndarray (n_terms, n_factors), int
        Input and degree of every factor; a degree of 0 stands for no factor.
    """

    inputs: np.ndarray
    degrees: np.ndarray

    @classmethod
    def of(cls, kind: Kind, inputs: Sequence[int]) -> PolynomialTerms:
        """All terms of a kind in some inputs, without the constant.

        Those of polynomial chaos have degrees whose q-norm (q = 3/4, Blatman and Sudret 2011) is bounded, and at most
        three inputs each; the bound is the largest with which there are not more than `PROGNOSIS.terms` of them. Of
        inputs so many that they have `PROGNOSIS.products` products in pairs, quadratic ones have squares alone.
        """
        return _terms(kind, tuple(inputs))

    @classmethod
    def alternatives(cls, kind: Kind, inputs: Sequence[int]) -> tuple[PolynomialTerms, ...]:
        """Term sets of a kind to choose from: of polynomial chaos also those of a total degree (q = 1)."""
        return (_terms(kind, tuple(inputs)), *([_terms(kind, tuple(inputs), 1.0)] if kind == KINDS[-1] else []))

    @classmethod
    def _filled(cls, found: Sequence[tuple[tuple[int, int], ...]]) -> PolynomialTerms:
        width = max(map(len, found))
        filled = np.array([[*term, *((term[0][0], 0),) * (width - len(term))] for term in found], dtype=int)
        return cls(filled[:, :, 0], filled[:, :, 1])

    def take(self, which: Sequence[int] | np.ndarray) -> PolynomialTerms:
        """Some of the terms."""
        return PolynomialTerms(self.inputs[which], self.degrees[which])

    def values(self, z: np.ndarray) -> np.ndarray:
        """The terms (n, n_terms) at points (n, n_inputs)."""
        legendre = np.ones((self.degrees.max(initial=0) + 1, *z.shape))
        for d in range(1, len(legendre)):
            before = legendre[d - 2] if d > 1 else 0.0
            legendre[d] = ((2 * d - 1) * z * legendre[d - 1] - (d - 1) * before) / d
        legendre *= np.sqrt(2.0 * np.arange(len(legendre)) + 1.0)[:, None, None]
        out = np.ones((len(self.inputs), len(z)))
        for inputs, degrees in zip(self.inputs.T, self.degrees.T, strict=True):
            out *= legendre[degrees, :, inputs]
        return out.T

    def of_input(self, i: int) -> np.ndarray:
        """Which terms involve an input, bool (n_terms,)."""
        return np.asarray(((self.inputs == i) & (self.degrees > 0)).any(axis=1))


@lru_cache(maxsize=256)
def _terms(kind: Kind, inputs: tuple[int, ...], q: float = PROGNOSIS.q) -> PolynomialTerms:
    own: list[tuple[tuple[int, int], ...]] = [((i, 1),) for i in inputs]
    if kind == "quadratic":
        products = list(combinations(inputs, 2)) if math.comb(len(inputs), 2) < PROGNOSIS.products else []
        own += [*(((i, 2),) for i in inputs), *(((a, 1), (b, 1)) for a, b in products)]
    degrees: list[tuple[int, ...]] = [(1,)]
    if kind == "polynomial chaos":
        for bound in range(2, PROGNOSIS.degree + 1):
            larger = _bounded(float(bound), min(3, len(inputs)), q)
            if sum(math.comb(len(inputs), len(d)) for d in larger) > PROGNOSIS.terms:
                break
            degrees = larger
        own = [tuple(zip(some, d, strict=True)) for d in degrees for some in combinations(inputs, len(d))]
    return PolynomialTerms._filled(own)


def _bounded(bound: float, most: int, q: float) -> list[tuple[int, ...]]:
    """Degrees of at most so many factors whose q-norm is bounded."""
    highest = range(1, int(bound) + 1)
    found = (d for count in range(1, most + 1) for d in product(highest, repeat=count))
    return [d for d in found if sum(x**q for x in d) ** (1.0 / q) <= bound + 1e-9]


@dataclass(frozen=True, eq=False)
class Polynomial:
    """A polynomial of inputs between -1 and 1.

    Attributes
    ----------
    kind : str
    terms : Terms
    weights : ndarray (n_terms,)
    constant : float
    """

    kind: Kind
    terms: PolynomialTerms
    weights: np.ndarray
    constant: float

    @property
    def inputs(self) -> tuple[int, ...]:
        """Inputs that it has."""
        return _inputs(self.terms)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Values (n,) at points (n, n_inputs)."""
        return self.constant + self.terms.values(z) @ self.weights

    def total_shares(self, count: int) -> np.ndarray:
        """Total share of each input in the variance over independent, uniform inputs (Sudret 2008), (count,)."""
        parts = self.weights**2
        whole = parts.sum()
        return np.array([parts[self.terms.of_input(i)].sum() for i in range(count)]) / (whole if whole > 0 else 1.0)


def fitted_polynomial(kind: Kind, z: np.ndarray, y: np.ndarray, values: np.ndarray | None = None) -> Polynomial:
    """The sparse polynomial of a kind that is expected to predict best, in the inputs that certainly matter.

    First terms of all inputs are taken by orthogonal least squares (Chen, Cowan and Grant 1991) as long as the next
    one is significant among all that could be taken; their inputs are kept. Then terms of these inputs are taken anew,
    as many as make ``n log(RSS) + 2 k log(count)`` smallest, the risk inflation of choosing k out of so many (Foster
    and George 1994). Beyond that polynomial further inputs may be significant, with which it is built once more.

    Parameters
    ----------
    kind : {"linear", "quadratic", "polynomial chaos"}
    z : ndarray (n, n_inputs)
        Between -1 and 1.
    y : ndarray (n,)
    values : ndarray (n, n_terms), optional
        Those of the kind's terms of all inputs, where they are known.

    Returns
    -------
    Polynomial
        Without any term where no input is significant.
    """
    terms = PolynomialTerms.of(kind, range(z.shape[1]))
    values = terms.values(z) if values is None else values
    ones = np.ones((len(y), 1))
    best, inputs = of_inputs(kind, z, y, ()), tuple[int, ...]()
    for _ in range(PROGNOSIS.rounds):
        own = best.terms.values(z)
        kept, _ = _pursued(values, y, np.column_stack([ones, own]), significant=True)
        if set(more := _inputs(terms.take(kept))) <= set(inputs):
            break
        inputs = tuple(sorted({*inputs, *more}))
        best = of_inputs(kind, z, y, inputs)
    return best


def of_inputs(kind: Kind, z: np.ndarray, y: np.ndarray, inputs: Sequence[int]) -> Polynomial:
    """The polynomial of some inputs that is expected to predict best; without any term where there is no input."""
    if not inputs:
        return Polynomial(kind, PolynomialTerms.of(kind, range(z.shape[1])).take([]), np.zeros(0), float(y.mean()))
    ones = np.ones((len(y), 1))
    found = [
        (*_pursued(one.values(z), y, ones, significant=False), one)
        for one in PolynomialTerms.alternatives(kind, inputs)
    ]
    kept, _, some = min(found, key=lambda one: one[1])
    own = some.take(kept).values(z)
    weights = np.linalg.lstsq(np.column_stack([ones, own]), y, rcond=None)[0]
    return Polynomial(kind, some.take(kept), weights[1:], float(weights[0]))


def _inputs(terms: PolynomialTerms) -> tuple[int, ...]:
    return tuple(sorted({int(i) for i in terms.inputs[terms.degrees > 0]}))


def _pursued(values: np.ndarray, y: np.ndarray, before: np.ndarray, significant: bool) -> tuple[list[int], float]:
    """Terms beyond some (n, n_before) by orthogonal least squares, while each is significant or the risk falls."""
    (n, count), held = values.shape, before.shape[1]
    q, _ = np.linalg.qr(before)
    beyond, rest = values - q @ (q.T @ values), y - q @ (q.T @ y)
    size = np.linalg.norm(beyond, axis=0)
    free = size > _OWN**0.5 * np.linalg.norm(values, axis=0)
    beyond /= np.where(free, size, 1.0)
    floor = PROGNOSIS.exact * float((y - y.mean()) @ (y - y.mean()))
    gain, own = beyond.T @ rest, free.astype(float)
    most = min(count, int(PROGNOSIS.terms_a_row * n) - held)
    frame, kept, risks = np.empty((max(most, 0), n)), list[int](), [math.log(max(float(rest @ rest), floor))]
    level = float(special.fdtri(1, max(1, n - 2), 1.0 - PROGNOSIS.chance / count)) if significant else 0.0
    for k in range(most):
        left = float(rest @ rest)
        parts = np.where(own > _OWN, gain**2 / np.maximum(own, _OWN), 0.0)
        best = int(parts.argmax())
        if left <= floor or not own[best] > _OWN:
            break
        if significant and parts[best] * (n - held - k - 1) <= level * max(left - parts[best], 0.0):
            break
        q = beyond[:, best]
        for _ in range(2):  # one projection of nearly dependent columns leaves some rounding behind
            q = q - frame[:k].T @ (frame[:k] @ q)
        q = q / np.linalg.norm(q)
        part = float(q @ rest)
        frame[k], rest = q, rest - part * q
        along = q @ beyond
        gain, own = gain - part * along, own - along**2
        own[best] = 0.0
        kept.append(best)
        risks.append(math.log(max(float(rest @ rest), floor)) + 2 * (k + 1) * math.log(count) / n)
        if not significant and k > PROGNOSIS.patience and min(risks[-PROGNOSIS.patience :]) > min(risks):
            break
    return kept if significant else kept[: int(np.argmin(risks))], min(risks)
