"""A chain of masses that moves along and across: small enough for closed forms, rich enough for ambiguous pairs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp

from calib.measurement.modal import MeasuredModes, Sensor
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial, Term, parameter
from calib.structure.geometry import DofMap, Mesh
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes

N = 6


@dataclass(frozen=True)
class NodeLocator:
    """Sensors are at the nodes (k, 0, 0); odd degrees of freedom are transverse."""

    n: int

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        row = np.zeros(2 * self.n)
        node = int(np.clip(round(point[0]), 0, self.n - 1))
        if direction < 2:
            row[2 * node + direction] = 1.0
        return row, float(np.linalg.norm(np.asarray(point) - [node, 0, 0]))


def chain_matrix(n: int, direction: int, pairs: Sequence[tuple[int, int]]) -> sp.csr_array:
    """Unit springs between neighbours; a node of -1 is the ground."""
    out = np.zeros((2 * n, 2 * n))
    for a, b in pairs:
        row = np.zeros(2 * n)
        for node, sign in ((a, 1.0), (b, -1.0)):
            if node >= 0:
                row[2 * node + direction] += sign
        out += np.outer(row, row)
    return sp.csr_array(out)


@pytest.fixture
def build() -> Callable[..., StructuralModel]:
    def make(n: int = N, damped: bool = True, grounded: bool = True) -> StructuralModel:
        links = [(k, k + 1) for k in range(n - 1)] + ([(-1, 0)] if grounded else [])
        space = ParameterSpace(
            (
                Parameter("k_along", 40.0, 20.0, 80.0, "kN/m"),
                Parameter("k_across", 11.0, 5.0, 30.0, "kN/m"),
                Parameter("c_end", 300.0, 0.0, 2000.0, "Ns/m"),
                Parameter("mass", 10.0, 5.0, 20.0, "kg"),
            )
        )
        stiffness = [
            Term("along", chain_matrix(n, 0, links), parameter("k_along")),
            Term("across", chain_matrix(n, 1, links), parameter("k_across")),
            # Couples the two directions a little, so that no mode is purely one or the other.
            Term("skew", sp.csr_array(5000.0 * np.outer(v := np.eye(2 * n)[0] + np.eye(2 * n)[1], v)), Monomial())
            if grounded
            else Term("none", sp.csr_array((2 * n, 2 * n))),
        ]
        end = np.diag([0.0] * (2 * n - 2) + [1.0, 0.4])
        damping = (Term("end", sp.csr_array(end), parameter("c_end")),) if damped else ()
        mass = np.diag(np.repeat(1.0 + 0.1 * np.arange(n), 2))
        expansion = sp.csr_array(
            (np.ones(2 * n), ([6 * (d // 2) + d % 2 for d in range(2 * n)], range(2 * n))), shape=(6 * n, 2 * n)
        )
        points = np.column_stack([np.arange(n, dtype=float), np.zeros(n), np.zeros(n)])
        return StructuralModel(
            name="chain",
            space=space,
            stiffness=AffineMatrix(2 * n, tuple(stiffness)),
            damping=AffineMatrix(2 * n, damping),
            mass=AffineMatrix(2 * n, (Term("mass", sp.csr_array(mass), parameter("mass")),)),
            mesh=Mesh(points, np.array([(k, k + 1) for k in range(n - 1)]), ("chain",) * (n - 1)),
            dofs=DofMap(expansion, np.arange(2 * n) // 2, np.arange(2 * n) % 2),
            clusters={"along": np.arange(0, 2 * n, 2), "across": np.arange(1, 2 * n, 2)},
            locator=NodeLocator(n),
        )

    return make


@pytest.fixture
def twin() -> Callable[..., MeasuredModes]:
    """A measurement made from a model's modes: ``order`` picks and orders them, ``noise`` is added to everything."""

    def make(
        model: StructuralModel,
        values: Mapping[str, float],
        order: Sequence[int] = (0, 1, 2, 3),
        directions: str = "xy",
        noise: float = 0.0,
        seed: int = 0,
        real: bool = False,
        shapes: bool = True,
    ) -> MeasuredModes:
        modes: Modes = model.modes(values, max(order) + 1)
        sensors = tuple(
            Sensor(k + 1, d, (float(k), 0.0, 0.0)) for k in range(len(model.mesh.points)) for d in directions
        )
        if not shapes:
            sensors = ()
        seen = model.sensor_rows(sensors) @ modes.shapes[:, list(order)] if shapes else np.zeros((0, len(order)))
        seen = np.asarray(seen, dtype=complex)
        for m in range(len(order) if shapes else 0):
            largest = seen[np.argmax(np.abs(seen[:, m])), m]
            seen[:, m] /= largest
        rng = np.random.default_rng(seed)
        freq = modes.natural_freq[list(order)]
        damping = modes.damping_ratio[list(order)]
        freq_std, damping_std = 0.005 * freq, 0.07 * damping
        std = np.full(seen.shape, noise if noise else np.nan)
        if noise:
            seen = seen + noise * (rng.standard_normal(seen.shape) + 1j * rng.standard_normal(seen.shape))
            freq = freq + freq_std * rng.standard_normal(freq.shape)
            damping = damping * np.exp(0.07 * rng.standard_normal(freq.shape))
        else:
            freq_std, damping_std = np.full(len(freq), np.nan), np.full(len(freq), np.nan)
        if real:
            seen = seen.real.astype(complex)
        names = tuple(f"M{m + 1}" for m in range(len(order)))
        return MeasuredModes(
            names=names,
            natural_freq=freq,
            damped_freq=freq * np.sqrt(1 - damping**2),
            freq_std=freq_std,
            damping_ratio=damping,
            damping_std=damping_std,
            sensors=sensors,
            shapes=seen,
            shape_std=std,
            synthetic=True,
        )

    return make
