"""Exact solutions of Timoshenko beams in space, by transfer matrices and without finite elements."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp
from scipy.optimize import brentq

from models.fem.frame import Frame
from models.fem.member import Member, Point, Suppression
from models.fem.section import Section

STATE = 12
"""Motions (ux, uy, uz, rx, ry, rz), then force and moment of the cut whose normal points along the beam."""


def field_matrix(section: Section, omega: float) -> np.ndarray:
    """Matrix A of the beam equations ``d state/dx = A state`` in local axes, vibrating at ``omega`` rad/s."""
    e, g, rho = section.young_modulus, section.shear_modulus, section.density
    shear = section.shear_coefficient * g * section.area
    a = np.zeros((STATE, STATE))
    ux, uy, uz, rx, ry, rz, n, qy, qz, t, my, mz = range(STATE)
    a[ux, n], a[n, ux] = 1 / (e * section.area), -rho * section.area * omega**2
    a[rx, t], a[t, rx] = 1 / (g * section.torsion), -rho * (section.i_y + section.i_z) * omega**2
    a[uy, rz], a[uy, qy], a[rz, mz], a[qy, uy] = 1, 1 / shear, 1 / (e * section.i_z), -rho * section.area * omega**2
    a[mz, qy], a[mz, rz] = -1, -rho * section.i_z * omega**2
    a[uz, ry], a[uz, qz], a[ry, my], a[qz, uz] = -1, 1 / shear, 1 / (e * section.i_y), -rho * section.area * omega**2
    a[my, qz], a[my, ry] = 1, -rho * section.i_y * omega**2
    return a


def local_axes(start: Point, end: Point, up: Point) -> tuple[float, np.ndarray]:
    """Length and local axes as rows; y is what is left of ``up`` after taking off its part along the beam."""
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    x = along / length
    y = np.asarray(up) - (np.asarray(up) @ x) * x
    y = y / np.linalg.norm(y)
    return length, np.array([x, y, np.cross(x, y)])


def transfer(members: Sequence[Member], omega: float) -> np.ndarray:
    """State at the end of a chain of members over the state at its start, global axes."""
    total = np.eye(STATE)
    for m in members:
        length, axes = local_axes(m.start, m.end, m.up)
        turn = np.kron(np.eye(4), axes)
        total = turn.T @ la.expm(field_matrix(m.section, omega) * length) @ turn @ total
    return total


class Exact:
    """Natural frequencies and static solutions of a chain of members with any end conditions."""

    FIXED, FREE = tuple(range(6)), tuple(range(6, STATE))

    def __init__(
        self,
        *members: Member,
        start_zero: Sequence[int] = FIXED,
        end_zero: Sequence[int] = FIXED,
        states: Sequence[int] = range(STATE),
    ):
        """Members, the states that vanish at either end, and the states that take part (one plane, say)."""
        self.members = members
        self.unknown = [i for i in states if i not in start_zero]
        self.end_zero = list(end_zero)
        e, size = members[0].section, sum(local_axes(m.start, m.end, m.up)[0] for m in members)
        force = e.young_modulus * e.i_z / size**2
        # Motions of order 1 m and 1 rad cause forces and moments of this order: the determinant is well scaled.
        self.scale = np.array([size] * 3 + [1.0] * 3 + [force] * 3 + [force * size] * 3)

    def determinant(self, freq: float) -> float:
        t = transfer(self.members, 2 * np.pi * freq) * self.scale / self.scale[:, None]
        part = t[np.ix_(self.end_zero, self.unknown)]
        sign, size = np.linalg.slogdet(part)
        return float(sign * np.exp(min(size, 600.0)))

    def frequencies(self, low: float, high: float, steps: int = 400) -> np.ndarray:
        """Natural frequencies between two limits in Hz; neighbours must be further apart than a step."""
        grid = np.linspace(low, high, steps)
        value = np.array([self.determinant(f) for f in grid])
        change = np.flatnonzero(np.sign(value[:-1]) != np.sign(value[1:]))
        return np.array([brentq(self.determinant, grid[i], grid[i + 1], xtol=1e-13 * high, rtol=1e-13) for i in change])

    def tip_motion(self, load: Sequence[float]) -> np.ndarray:
        """Six motions of the far end, the start being clamped, under a static force and moment there."""
        t = transfer(self.members, 0.0)
        return t[:6, 6:] @ np.linalg.solve(t[6:, 6:], np.asarray(load, dtype=float))


@pytest.fixture
def exact() -> type[Exact]:
    return Exact


@pytest.fixture
def section() -> Section:
    """Unequal in every plane, and stout enough for shear and rotary inertia to matter."""
    return Section(area=6e-3, i_y=9e-6, i_z=2.3e-5, torsion=1.1e-5, shear_coefficient=0.6)


@pytest.fixture
def reduced() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Dense stiffness and mass over the free motions of a frame."""

    def matrices(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        k, m = frame.beams()
        t = frame.dof_map().expansion
        return (t.T @ k @ t).toarray(), (t.T @ m @ t).toarray()

    return matrices


@pytest.fixture
def natural_freq() -> Callable[..., np.ndarray]:
    """Natural frequencies in Hz of a frame by LAPACK, zero ones as zero."""

    def solve(frame: Frame, count: int) -> np.ndarray:
        k, m = frame.beams()
        t = frame.dof_map().expansion
        squares = la.eigh((t.T @ k @ t).toarray(), (t.T @ m @ t).toarray(), eigvals_only=True)
        return np.sqrt(np.maximum(squares[:count], 0.0)) / (2 * np.pi)

    return solve


@pytest.fixture
def line(section: Section) -> Callable[..., Frame]:
    """A straight beam along x with motions suppressed at its ends."""

    def build(
        n: int, length: float = 2.0, start: Sequence[int] = (), end: Sequence[int] = (), only: Sequence[int] = range(6),
        given: Section = section,
    ) -> Frame:  # fmt: skip
        a, b = (0.0, 0.0, 0.0), (length, 0.0, 0.0)
        held = [
            Suppression(tuple(d for d in range(6) if d not in only), groups=("line",)),
            Suppression(tuple(start), body="beam", point=a),
            Suppression(tuple(end), body="beam", point=b),
        ]
        return Frame((Member("beam", "line", given, a, b, length / n),), (), tuple(h for h in held if h.directions))

    return build


@pytest.fixture
def rigid() -> Callable[..., np.ndarray]:
    """Six rigid-body motions at points, shape (6 * n, 6), about the origin."""

    def motions(points: np.ndarray) -> np.ndarray:
        out = np.zeros((6 * len(points), 6))
        for i, p in enumerate(points):
            for d in range(6):
                out[6 * i + d, d] = 1.0
            for d in range(3):
                out[6 * i : 6 * i + 3, 3 + d] = np.cross(np.eye(3)[d], p)
        return out

    return motions


@pytest.fixture
def solve_static() -> Callable[..., np.ndarray]:
    """All nodal motions of a frame under nodal loads (n_full,)."""

    def solve(frame: Frame, load: np.ndarray, extra: sp.sparray | None = None) -> np.ndarray:
        k = frame.beams()[0]
        if extra is not None:
            k = sp.csr_array(k + extra)
        t = frame.dof_map().expansion
        return t @ np.linalg.solve((t.T @ k @ t).toarray(), t.T @ load)

    return solve
