"""A plane frame with matrices assembled by another code, compared and calibrated in a few lines.

Twelve storeys of four columns, each storey with a stiffness of its own; about a thousand degrees of freedom, no inertia
of rotation, so that the mass matrix is singular. The measurement is synthetic: a finer mesh, other stiffnesses, noise.
"""

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh

import calib

STOREYS, COLUMNS, HEIGHT, BAY = 12, 4, 3.2, 5.0
EI, EA, LINE = 4.0e7, 3.0e9, 450.0
FLOOR = 9000.0


def beam(length):
    """Stiffness of a plane Euler-Bernoulli beam along its axis: bending and stretching, both (6, 6)."""
    k, s = EI / length**3, EA / length
    bend = np.zeros((6, 6))
    rows = np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    a, b = 6 * length, length**2
    bend[rows] = k * np.array([[12, a, -12, a], [a, 4 * b, -a, 2 * b], [-12, -a, 12, -a], [a, 2 * b, -a, 4 * b]])
    stretch = np.zeros((6, 6))
    stretch[np.ix_([0, 3], [0, 3])] = s * np.array([[1, -1], [-1, 1]])
    return bend + stretch


class Frame:
    """Stiffness of each storey's columns and of all floors, mass, and places of the degrees of freedom."""

    def __init__(self, cells):
        self.places, self.index = [], {}
        members = []
        for storey in range(STOREYS):
            low, high = storey * HEIGHT, (storey + 1) * HEIGHT
            members += [(f"EI_{storey + 1}", (c * BAY, low), (c * BAY, high)) for c in range(COLUMNS)]
            members += [("floors", (c * BAY, high), ((c + 1) * BAY, high)) for c in range(COLUMNS - 1)]
        cut = [(name, *self._piece(a, b, k, cells)) for name, a, b in members for k in range(cells)]
        n = 3 * len(self.places)
        self.stiffness = {name: sp.lil_array((n, n)) for name in dict.fromkeys(name for name, *_ in cut)}
        mass = np.zeros(n)
        for name, i, j in cut:
            a, b = (np.array(self.places[k]) for k in (i, j))
            length = float(np.linalg.norm(b - a))
            c, s = (b - a) / length
            turn = np.kron(np.eye(2), np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]))
            dofs = [3 * i, 3 * i + 1, 3 * i + 2, 3 * j, 3 * j + 1, 3 * j + 2]
            own = turn.T @ beam(length) @ turn
            for r, row in enumerate(dofs):
                for q, column in enumerate(dofs):
                    self.stiffness[name][row, column] += own[r, q]
            for k in (i, j):
                mass[3 * k : 3 * k + 2] += 0.5 * length * (LINE if name != "floors" else LINE + FLOOR / BAY)
        free = np.flatnonzero([self.places[k // 3][1] > 0 for k in range(n)])
        self.stiffness = {name: sp.csr_array(m.tocsr()[free][:, free]) for name, m in self.stiffness.items()}
        self.mass = sp.diags_array(mass[free])
        names = np.array(["x", "z", "ry"])
        node = free // 3
        self.dofs = pd.DataFrame(
            {"node": node + 1, "direction": names[free % 3], "x": [self.places[k][0] for k in node], "y": 0.0,
             "z": [self.places[k][1] for k in node]}
        )  # fmt: skip

    def _piece(self, a, b, k, cells):
        ends = [tuple(np.round(np.array(a) + (np.array(b) - a) * part / cells, 9)) for part in (k, k + 1)]
        for end in ends:
            if end not in self.index:
                self.index[end] = len(self.places)
                self.places.append(end)
        return [self.index[end] for end in ends]


@pytest.fixture(scope="module")
def measured():
    """Eight modes of the finer frame at three columns per floor, with noise of the stated standard deviation."""
    frame, rng = Frame(7), np.random.default_rng(4)
    truth = {f"EI_{k}": 1.0 for k in range(1, STOREYS + 1)} | {"EI_1": 0.72, "EI_4": 1.18, "EI_9": 0.85}
    whole = sum(truth.get(name, 1.0) * m for name, m in frame.stiffness.items())
    massive = np.flatnonzero(frame.mass.diagonal() > 0)
    rest = np.setdiff1d(np.arange(len(frame.dofs)), massive)
    lu = sp.linalg.splu(sp.csc_array(whole[rest][:, rest]))
    condensed = whole[massive][:, massive].toarray() - whole[massive][:, rest] @ lu.solve(
        whole[rest][:, massive].toarray()
    )
    inertia, first = frame.mass.tocsr()[massive][:, massive], np.ones(len(massive))
    squares, shapes = eigsh(sp.csc_array(condensed), 8, inertia, sigma=0.0, v0=first)
    freq = np.sqrt(squares) / (2 * np.pi)
    rows, sensors = [], []
    for storey in range(1, STOREYS + 1):
        for node, (direction, x) in enumerate((("x", 0.0), ("z", 0.0), ("z", BAY), ("z", 3 * BAY))):
            at = np.flatnonzero(
                (frame.dofs["direction"] == direction) & np.isclose(frame.dofs["x"], x)
                & np.isclose(frame.dofs["z"], storey * HEIGHT)
            )  # fmt: skip
            rows.append(np.flatnonzero(massive == at[0])[0])
            sensors.append(calib.Sensor(10 * storey + node, direction, (x, 0.0, storey * HEIGHT)))
    seen = shapes[rows] / np.abs(shapes[rows]).max(axis=0)
    n, std = len(freq), np.full(seen.shape, 0.02)
    return truth, calib.MeasuredModes(
        names=tuple(f"M{k + 1}" for k in range(n)),
        natural_freq=freq * (1 + 0.001 * rng.standard_normal(n)),
        damped_freq=freq,
        freq_std=0.001 * freq,
        damping_ratio=np.full(n, np.nan),
        damping_std=np.full(n, np.nan),
        sensors=tuple(sensors),
        shapes=(seen + std * rng.standard_normal(seen.shape)).astype(complex),
        shape_std=std,
        synthetic=True,
    )


@pytest.mark.slow
def test_matrices_of_another_code_are_compared_and_calibrated(measured):
    truth, modes = measured
    frame = Frame(4)
    assert 900 <= len(frame.dofs) < 1100 and (frame.mass.diagonal() == 0).any() and len(frame.stiffness) == 13
    stiffness, mass, dofs = frame.stiffness, frame.mass, frame.dofs

    storeys = [calib.Parameter(name, 1.0, 0.5, 1.5, prior_sd=0.2) for name in stiffness if name != "floors"]
    model = calib.StructuralModel.from_matrices(stiffness, mass, dofs=dofs, parameters=storeys, name="frame")
    problem = calib.Problem(model, calib.ModalTest(modes, accuracy={"freq": "0.2 %"}))  # what the mesh is good for
    before = problem.compare().table
    fit = problem.calibrate(starts=1)
    after = fit.compare().table

    assert before["mac"].notna().all() and before["freq_error"].abs().mean() > 3 * after["freq_error"].abs().mean()
    assert after["freq_error"].abs().max() < 4e-3 and after["mac"].min() > 0.97
    checked = fit.compare().orthogonality()
    for name, values in (("cross_orthogonality", checked.cross), ("self_orthogonality", checked.own)):
        np.testing.assert_allclose(fit.figure(name).images[0].get_array(), values, atol=1e-9)
    off = (fit.parameters["value"] - fit.parameters.index.map(truth)) / fit.parameters["std"]
    assert off.abs().max() < 3.5 and (off**2).mean() < 2.5
    assert fit.parameters["value"]["EI_1"] < 0.85 and fit.statistics.fits


@pytest.mark.medium
def test_measured_shapes_are_expanded_and_checked_from_a_notebook(measured):
    _, modes = measured
    frame = Frame(4)
    model = calib.StructuralModel.from_matrices(frame.stiffness, frame.mass, dofs=frame.dofs, name="frame")
    compared = calib.Problem(model, calib.ModalTest(modes, name="hammer")).compare()
    expanded = compared.expanded()
    assert expanded.shapes.shape == (model.n_dof, modes.n_modes) and expanded.residual.max() < 0.1
    assert compared.expanded("hammer", modes=[1, 2, 3]).residual[0] < 0.1
    cross = compared.orthogonality().cross_table()
    assert cross["mode"].tolist() == list(modes.names) and np.diagonal(compared.orthogonality().cross).min() > 0.9
    with pytest.raises(calib.InputError, match="hammer"):
        compared.expanded("shaker")
