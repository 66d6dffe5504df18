"""Products of coefficients, and coefficients that follow the stiffness of a part with all effects that change it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from calib.errors.errors import EvaluationError
from calib.structure.affine import Coefficient, Monomial, Term


@dataclass(frozen=True)
class Product:
    """Product of two coefficients.

    Attributes
    ----------
    one, other : Coefficient
    """

    one: Coefficient
    other: Coefficient

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return self.one.names | self.other.names

    @property
    def roots(self) -> frozenset[str]:
        """Parameters raised to a power below 1 in one of them."""
        return frozenset(name for c in (self.one, self.other) for name in getattr(c, "roots", ()))

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI."""
        return self.one(values) * self.other(values)

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI."""
        one = self.one.derivative(values, name) if name in self.one.names else 0.0
        other = self.other.derivative(values, name) if name in self.other.names else 0.0
        return one * self.other(values) + self.one(values) * other


@dataclass(frozen=True)
class OfPart:
    """A coefficient times a power of a part's stiffness, ``factor * (own + sum of changes)^power * other``.

    Springs and dampers beside a part are shares of its stiffness; where effects change that, the shares change alike.

    Attributes
    ----------
    part : str
    own : Monomial
        The part's coefficient in the model.
    other : Coefficient
    power, factor : float
    changes : tuple of Coefficient
        Of terms of stiffness with `calib.structure.affine.Term.part`, see `following`.
    """

    part: str
    own: Monomial
    other: Coefficient
    power: float = 1.0
    factor: float = 1.0
    changes: tuple[Coefficient, ...] = ()

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return self.other.names.union(self.own.names, *(c.names for c in self.changes))

    @property
    def roots(self) -> frozenset[str]:
        """Parameters raised to a power below 1."""
        own = replace(self.own, powers=tuple((name, self.power * k) for name, k in self.own.powers))
        return own.roots | getattr(self.other, "roots", frozenset())

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI; EvaluationError where nothing is left of the part's stiffness."""
        return self.factor * self._stiffness(values) ** self.power * self.other(values)

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI."""
        out, size = 0.0, self._stiffness(values)
        if name in self.other.names:
            out += size**self.power * self.other.derivative(values, name)
        slope = sum(c.derivative(values, name) for c in (self.own, *self.changes) if name in c.names)
        if slope:
            out += self.power * size ** (self.power - 1) * slope * self.other(values)
        return self.factor * out

    def _stiffness(self, values: Mapping[str, float]) -> float:
        size = self.own(values) + sum(c(values) for c in self.changes)
        if size < 0:
            raise EvaluationError(f"nothing is left of the stiffness of {self.part!r}")
        return size


def following(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Terms of stiffness, those that are shares of a part's stiffness with every change of that by the others."""
    changes: dict[str, tuple[Coefficient, ...]] = {}
    for term in terms:
        if term.part:
            changes[term.part] = (*changes.get(term.part, ()), term.coefficient)

    def changed(coefficient: Coefficient) -> Coefficient:
        if isinstance(coefficient, OfPart):
            return replace(coefficient, changes=changes.get(coefficient.part, ()))
        if isinstance(coefficient, Product):
            one, other = changed(coefficient.one), changed(coefficient.other)
            same = one is coefficient.one and other is coefficient.other
            return coefficient if same else Product(one, other)
        return coefficient

    out = ((term, changed(term.coefficient)) for term in terms)
    return tuple(term if new is term.coefficient else replace(term, coefficient=new) for term, new in out)
