"""Equilibrium of a thin shell of revolution in strong form: operators by sympy, solved by hoop order.

Nothing of `models.tire` is used: the strains of Sanders (1959) and Koiter (1960) are written down once more, their
adjoint is taken symbolically and discretised by collocated central differences. What both ways agree on is neither an
error of the staggered grid nor one of its energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
import sympy as sp
from scipy import sparse
from scipy.sparse.linalg import spsolve
from sympy.polys.rings import PolyElement

ENTRIES = tuple((i, j) for i in range(6) for j in range(i, 6))
# rho = 1/r, g = r'/r and both curvatures with derivatives of k1: all other derivatives follow from these.
RING, rho, g, k2, k1, k1_1, k1_2, k1_3, *_stiffness = sp.ring(
    ["rho", "g", "k2", "k1", "k1_1", "k1_2", "k1_3", *(f"C{i + 1}{j + 1}" for i, j in ENTRIES)], sp.QQ
)
HALF = RING(sp.Rational(1, 2))
# Gauss gives r'' = -k1 k2 r, and Codazzi (r k2)' = k1 r'.
GROWTH = {rho: -g * rho, g: -k1 * k2 - g**2, k2: (k1 - k2) * g, k1: k1_1, k1_1: k1_2, k1_2: k1_3}


def stiffness(i: int, j: int) -> PolyElement:
    """Entry of the laminate's stiffness, constant over the wall."""
    return _stiffness[ENTRIES.index((min(i, j), max(i, j)))]


def grown(factor: PolyElement) -> PolyElement:
    """Derivative by arc length of a quantity of the geometry."""
    return sum((factor.diff(x) * change for x, change in GROWTH.items()), RING.zero)


@dataclass(frozen=True)
class Form:
    """Linear differential form: factors of derivatives (atom, order by arc length, order by hoop angle)."""

    terms: dict[tuple[str, int, int], PolyElement]

    @classmethod
    def of(cls, atom: str) -> Form:
        return cls({(atom, 0, 0): RING.one})

    def __add__(self, other: Form) -> Form:
        out = dict(self.terms)
        for key, factor in other.terms.items():
            out[key] = out.get(key, RING.zero) + factor
        return Form({key: factor for key, factor in out.items() if factor})

    def __rmul__(self, factor: PolyElement | int) -> Form:
        return Form({key: factor * own for key, own in self.terms.items()})

    def __neg__(self) -> Form:
        return -1 * self

    def __sub__(self, other: Form) -> Form:
        return self + -other

    @property
    def prime(self) -> Form:
        """Derivative by arc length."""
        moved = Form({(atom, a + 1, b): factor for (atom, a, b), factor in self.terms.items()})
        return moved + Form({key: grown(factor) for key, factor in self.terms.items() if grown(factor)})

    @property
    def dot(self) -> Form:
        """Derivative by hoop angle."""
        return Form({(atom, a, b + 1): factor for (atom, a, b), factor in self.terms.items()})


def strains(u: Form, v: Form, w: Form) -> tuple[Form, ...]:
    """e1, e2, g12, c1, c2, t12."""
    b1, b2 = k1 * u - w.prime, k2 * v - rho * w.dot
    return (
        u.prime + k1 * w,
        rho * v.dot + g * u + k2 * w,
        v.prime - g * v + rho * u.dot,
        b1.prime,
        rho * b2.dot + g * b1,
        b2.prime - g * b2 + rho * b1.dot + HALF * (k2 - k1) * (v.prime + g * v - rho * u.dot),
    )


def adjoint(forces: tuple[Form, ...]) -> tuple[Form, ...]:
    """Loads per area along meridian, hoop and normal that stress resultants balance, by virtual work.

    The area is r ds dtheta, so that the adjoint of a derivative by s is -(r X)'/r.
    """
    unknown = strains(*(Form.of(atom) for atom in "uvw"))
    out = []
    for field in "uvw":
        total = Form({})
        for strain, force in zip(unknown, forces, strict=True):
            for (atom, a, b), factor in strain.terms.items():
                if atom == field:
                    part = factor * force
                    for _ in range(a):
                        part = -(part.prime + g * part)
                    for _ in range(b):
                        part = -part.dot
                    total += part
        out.append(total)
    return tuple(out)


def equilibrium(n1: Form, n2: Form, n12: Form, m1: Form, m2: Form, m12: Form) -> tuple[Form, ...]:
    """Left sides of Sanders' three equations of equilibrium, over r; with the loads added they vanish."""

    def ring(x: Form) -> Form:  # (r x)'/r
        return x.prime + g * x

    q1 = ring(m1) + rho * m12.dot - g * m2
    q2 = rho * m2.dot + ring(m12) + g * m12
    return (
        ring(n1) + rho * n12.dot - g * n2 + k1 * q1 + HALF * rho * ((k1 - k2) * m12).dot,
        ring(n12) + g * n12 + rho * n2.dot + k2 * q2 + HALF * ((k2 - k1) * m12).prime,
        ring(q1) + rho * q2.dot - k1 * n1 - k2 * n2,
    )


@cache
def operators() -> dict[tuple[int, int, int, int], PolyElement]:
    """Coefficients of the operators that give loads from u, v, w: (load, field, order by s, order by theta)."""
    strain = strains(*(Form.of(atom) for atom in "uvw"))
    forces = tuple(sum((stiffness(i, j) * strain[j] for j in range(6)), Form({})) for i in range(6))
    return {
        (m, "uvw".index(atom), a, b): factor
        for m, row in enumerate(adjoint(forces))
        for (atom, a, b), factor in row.terms.items()
    }


class Surface(Protocol):
    """A meridian by formulas: what stands in the operators, at arc lengths, in SI units."""

    length: float

    def r(self, s): ...
    def dr(self, s): ...
    def k2(self, s): ...
    def k1(self, s): ...
    def k1_slopes(self, s): ...  # (3, n): first to third derivative of k1


def coefficients(surface: Surface, s: np.ndarray, laminate: np.ndarray) -> dict[tuple[int, int, int, int], np.ndarray]:
    """Values of `operators` at arc lengths s (n,), for a laminate's stiffness (6, 6)."""
    r = surface.r(s)
    geometry = np.stack([1 / r, surface.dr(s) / r, surface.k2(s), surface.k1(s), *surface.k1_slopes(s)])
    entries = np.array([laminate[i, j] for i, j in ENTRIES])
    out = {}
    for key, factor in operators().items():
        out[key] = np.zeros(s.shape)
        for powers, number in factor.terms():
            of_geometry, of_laminate = np.array(powers[: len(geometry)]), np.array(powers[len(geometry) :])
            out[key] += float(number) * np.prod(entries**of_laminate) * np.prod(geometry.T**of_geometry, axis=1)
    return out


STENCILS = {0: {0: 1.0}, 1: {-1: -0.5, 1: 0.5}, 2: {-1: 1.0, 0: -2.0, 1: 1.0},
            3: {-2: -0.5, -1: 1.0, 1: -1.0, 2: 0.5}, 4: {-2: 1.0, -1: -4.0, 0: 6.0, 1: -4.0, 2: 1.0}}  # fmt: skip


def clamped_response(
    surface: Surface, laminate: np.ndarray, n: int, order: int, load: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes of u, v, w under a load of one hoop order between clamped beads.

    Beyond a bead u and v are odd and w is even: the displacements and the turn about the bead vanish.

    Parameters
    ----------
    surface : Surface
    laminate : (6, 6) array
        Stiffness, N/m, N and N m.
    n : int
        Cells from bead to bead.
    order : int
        Waves around the hoop.
    load : tuple of float
        Amplitudes along meridian, hoop and normal, Pa.

    Returns
    -------
    s : (n + 1,) ndarray
        m.
    fields : (3, n + 1) complex ndarray
        m, times exp(i order theta).
    """
    s = np.linspace(0.0, surface.length, n + 1)
    h = surface.length / n
    inside = np.arange(1, n)
    rows, cols, data = [], [], []
    for (m, f, a, b), factor in coefficients(surface, s[1:-1], np.asarray(laminate, float)).items():
        for offset, weight in STENCILS[a].items():
            at = inside + offset
            mirrored = np.where(at < 0, -at, np.where(at > n, 2 * n - at, at))
            sign = np.where(at == mirrored, 1.0, 1.0 if f == 2 else -1.0)
            free = (mirrored > 0) & (mirrored < n)
            rows.append(3 * (inside[free] - 1) + m)
            cols.append(3 * (mirrored[free] - 1) + f)
            data.append((1j * order) ** b * weight / h**a * (sign * factor)[free])
    matrix = sparse.csc_array(
        (np.concatenate(data), (np.concatenate(rows), np.concatenate(cols))), shape=(3 * (n - 1),) * 2
    )
    found = spsolve(matrix, np.tile(np.asarray(load, complex), n - 1)).reshape(n - 1, 3).T
    return s, np.pad(found, ((0, 0), (1, 1)))
