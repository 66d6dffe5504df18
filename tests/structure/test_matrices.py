"""Models from matrices of other codes, and validation of the input."""

import numpy as np
import pandas as pd
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel

N = 5
DOFS = pd.DataFrame({"node": [10, 20, 30, 40, 50], "direction": ["y"] * N, "x": np.arange(N), "y": 0.0, "z": 0.0})
K = Parameter("k", 2.0, 1.0, 4.0, "kN/m")
T = Parameter("t", 3.0, 1.0, 6.0, "mm")


def springs(*pairs):
    """Unit springs; the index -1 is the ground."""
    out = np.zeros((N, N))
    for a, b in pairs:
        row = np.zeros(N)
        row[[p for p in (a, b) if p >= 0]] = [1.0, -1.0][: 2 if min(a, b) >= 0 else 1]
        out += np.outer(row, row)
    return out


FIXED, SCALED, BENT = springs((-1, 0), (0, 1)), springs((1, 2), (2, 3)), springs((3, 4))
MASS = np.diag([2.0, 1.0, 1.0, 3.0, 1.0])


def chain(**changes):
    given = {
        "stiffness": {"fixed": 5e3 * FIXED, "k": SCALED, "bent": (1e11 * BENT, {"t": 3.0})},
        "mass": MASS, "dofs": DOFS, "parameters": [K, T],
    }  # fmt: skip
    return StructuralModel.from_matrices(**(given | changes))


def test_frequencies_are_those_of_the_matrices():
    stiffness = 5e3 * FIXED + 1.5e3 * SCALED + 1e11 * 0.004**3 * BENT
    wanted = np.sqrt(la.eigvalsh(stiffness, MASS)) / (2 * np.pi)
    assert chain().modes({"k": 1.5, "t": 4.0}, N).natural_freq == pytest.approx(wanted, rel=1e-9)


def test_derivatives_are_those_of_the_coefficients():
    slope = chain().matrix_derivatives({"t": 4.0}, "t")[0].toarray()
    assert slope == pytest.approx(1e11 * 3 * 0.004**2 * 1e-3 * BENT)


def test_damping_makes_modes_complex():
    model = chain(damping={"c": (0.01 * SCALED, "k")})
    assert model.is_damped and not chain().is_damped
    assert np.all(model.modes({}, 3).damping_ratio > 0)


@pytest.mark.parametrize("form", [sp.csr_array, sp.csc_array, sp.coo_array, sp.csr_matrix, np.asarray])
def test_sparse_and_dense_matrices_give_the_same_model(form):
    sparse = chain(stiffness={"fixed": form(5e3 * FIXED), "k": form(SCALED), "bent": (form(1e11 * BENT), {"t": 3.0})})
    assert sparse.modes({}, N).natural_freq == pytest.approx(chain().modes({}, N).natural_freq, rel=1e-12)


@pytest.mark.parametrize("half", [np.tril, np.triu])
def test_one_triangle_is_completed_and_reported(half):
    model = chain(stiffness={"fixed": half(5e3 * FIXED), "k": SCALED, "bent": (1e11 * BENT, {"t": 3.0})})
    assert model.modes({}, N).natural_freq == pytest.approx(chain().modes({}, N).natural_freq, rel=1e-12)
    assert [a.item for a in model.assumptions] == ["stiffness 'fixed'"] and not chain().assumptions


def test_mass_may_be_singular_and_the_structure_free():
    model = chain(
        stiffness={"k": springs((0, 1), (1, 2), (2, 3), (3, 4))}, mass=np.diag([2.0, 1, 0, 3, 1]), parameters=[K]
    )
    free = model.modes({}, 3).natural_freq
    condensed = 2e3 * springs((0, 1), (3, 4))[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])]
    past = np.array([0.0, 1, -1, 0])
    condensed += 1e3 * np.outer(past, past)  # two springs in series across the massless node
    wanted = np.sqrt(np.abs(la.eigvalsh(condensed, np.diag([2.0, 1, 3, 1])))) / (2 * np.pi)
    assert free == pytest.approx(wanted[wanted > 1e-3][:3], rel=1e-8)


def test_sensors_are_located_by_coordinates_or_by_label():
    model, nowhere = chain(), chain(dofs=DOFS[["node", "direction"]])
    third = np.eye(N)[2]
    assert model.sensor_rows([Sensor(7, "y", (2.05, 0.0, 0.0))])[0] == pytest.approx(third)
    assert model.sensor_rows([Sensor(30, "y")])[0] == pytest.approx(third)
    assert nowhere.sensor_rows([Sensor(30, "y", (99.0, 0.0, 0.0))])[0] == pytest.approx(third)
    with pytest.raises(InputError):
        nowhere.sensor_rows([Sensor(31, "y")])
    with pytest.raises(InputError):
        model.sensor_rows([Sensor(30, "x")])


def test_fingerprint_changes_with_a_matrix():
    assert chain().fingerprint == chain().fingerprint != chain(mass=1.001 * MASS).fingerprint


def broken(matrix, i, j, value):
    out = np.array(matrix, dtype=float)
    out[i, j] = value
    return out


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"mass": np.eye(4)}, "mass"),
        ({"mass": broken(MASS, 2, 2, np.nan)}, "mass"),
        ({"mass": broken(MASS, 2, 2, -1.0)}, "mass"),
        ({"mass": MASS * 1j}, "mass"),
        ({"stiffness": {"k": SCALED, "t": broken(broken(BENT, 0, 4, 2.0), 4, 0, 1.0)}}, "stiffness 't'"),
        ({"stiffness": {"k": SCALED, "bent": (BENT, "T")}}, "stiffness 'bent'"),
        ({"stiffness": {"k": SCALED}}, "parameters"),
        ({"dofs": [(1, "y")] * N}, "dofs"),
        ({"dofs": [(k, "w") for k in range(N)]}, "dofs"),
        ({"dofs": [("a", "x")] * N}, "dofs"),
        ({"dofs": DOFS[["node", "direction", "x"]]}, "dofs"),
        ({"dofs": DOFS.drop(columns="direction")}, "dofs"),
        ({"dofs": pd.concat([DOFS[:4], DOFS[:1].assign(direction="x", x=9.0)])}, "dofs"),
        ({"lines": [(10, 11)]}, "lines"),
    ],
)  # fmt: skip
def test_invalid_input_is_refused_with_its_place(changes, place):
    with pytest.raises(InputError) as fault:
        chain(**changes)
    assert place in str(fault.value.place)


def test_lines_connect_labels():
    mesh = chain(lines=[(10, 20), (50, 40)]).mesh
    assert mesh.lines.tolist() == [[0, 1], [4, 3]]
    assert mesh.points[4].tolist() == [4.0, 0.0, 0.0]
