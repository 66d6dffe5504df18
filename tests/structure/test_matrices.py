"""Models from matrices of other codes, and validation of the input."""

import numpy as np
import pandas as pd
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.problem.space import Parameter
from calib.structure import model
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


def test_a_point_is_solved_once_and_what_a_caller_changes_stays_with_the_caller(monkeypatch):
    solved, whole, built = [], model.solve_modes, chain()
    monkeypatch.setattr(model, "solve_modes", lambda *more, **keys: solved.append(0) or whole(*more, **keys))
    first = built.modes({"k": 1.5}, 2)
    expected = first.shapes.copy()
    first.shapes[:] = 0.0
    np.testing.assert_array_equal(built.modes({"k": 1.5, "t": 3.0}, 2).shapes, expected)
    assert len(solved) == 1
    for value in (1.1, 1.2, 1.3, 1.4, 1.5):
        built.modes({"k": value}, 2)
    assert len(solved) == 6  # only the latest are remembered
    assert built.modes({"k": 1.5}, 0).n_modes == 0


def test_matrices_of_half_precision_are_taken_as_their_numbers():
    half = chain(mass=MASS.astype(np.float16)).modes({"k": 1.5}, N).natural_freq
    assert half == pytest.approx(chain().modes({"k": 1.5}, N).natural_freq, rel=1e-12)


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


@pytest.mark.parametrize(
    "dofs",
    [
        [(11.0, 3.0), (12.0, 1.0), (12.0, 2.0), (123456.0, 6.0), (7.0, 4.0)],
        np.array([[11.0, 3.0], [12.0, 1.0], [12.0, 2.0], [123456.0, 6.0], [7.0, 4.0]]),
        np.array([[11.03], [12.01], [12.02], [123456.06], [7.04]]),
        [11.3, 12.1, 12.2, 123456.6, 7.4],
        pd.DataFrame({"node": [11.0, 12, 12, 123456, 7], "direction": ["3", "1", "2", "6", "4"]}),
    ],
)
def test_rows_are_named_by_doubles_as_files_of_other_codes_do(dofs):
    model = chain(dofs=dofs)
    assert model.labels == (7, 11, 12, 123456)
    assert [(model.labels[n], d) for n, d in zip(model.dofs.node, model.dofs.direction, strict=True)] == [
        (11, 2), (12, 0), (12, 1), (123456, 5), (7, 3)
    ]  # fmt: skip


@pytest.mark.parametrize("dofs", [[11.03, 12.1, 13.1, 14.1, 15.1], [1, 2, 3, 4, 5], [1.07, 2.01, 3.01, 4.01, 5.01]])
def test_numbers_that_name_no_direction_are_refused_with_their_row(dofs):
    with pytest.raises(InputError, match="row 1 is"):
        chain(dofs=dofs)


def test_a_scalar_point_has_a_sentence():
    with pytest.raises(InputError, match="SPOINT"):
        chain(dofs=[(1, "x"), (2, "x"), (3, "x"), (4, "x"), (900001, 0)])


@pytest.mark.parametrize("none", [None, np.nan, ""])
def test_a_row_of_no_node_stays_in_the_model(none):
    rows = [(1, "x"), (2, "x"), (3, "x"), (4, "x"), (none, none)]
    model = chain(dofs=rows)
    assert model.modes({}, N).natural_freq == pytest.approx(chain().modes({}, N).natural_freq)
    assert model.labels == (1, 2, 3, 4) and model.dofs.node[-1] == -1 and model.dofs.expansion[:, [4]].nnz == 0
    assert 4 not in np.concatenate(list(model.clusters.values()))
    first = chain(dofs=[rows[-1], *rows[:-1]])
    assert first.sensor_rows([Sensor(1, "x")])[0].tolist() == [0.0, 1.0, 0.0, 0.0, 0.0]
    with pytest.raises(InputError, match="no row names a node"):
        chain(dofs=[(none, none)] * N)


LAYERED = [(10, "x"), (20, "x"), (20, "x"), (20, "x"), (30, "x")]


def test_repeated_rows_ask_for_layers_of_a_shell():
    with pytest.raises(InputError, match="shell") as fault:
        chain(dofs=LAYERED)
    assert "row 3" in str(fault.value.place) and "1 other" in str(fault.value)


def test_a_node_moves_as_the_mean_of_its_outer_layers():
    model = chain(dofs=LAYERED, layers="mean")
    assert model.sensor_rows([Sensor(20, "x")])[0].tolist() == [0.0, 0.5, 0.0, 0.5, 0.0]
    assert model.sensor_rows([Sensor(30, "x")])[0].tolist() == [0.0, 0.0, 0.0, 0.0, 1.0]
    assert model.modes({}, N).natural_freq == pytest.approx(chain().modes({}, N).natural_freq)
    with pytest.raises(InputError, match="first"):
        chain(dofs=LAYERED, layers="first")


def test_rows_of_several_runs_must_agree():
    other = DOFS.iloc[[0, 1, 3, 2, 4]]
    assert chain(dofs=[DOFS, DOFS]).fingerprint == chain().fingerprint
    for runs, words in (([DOFS, DOFS, other], "run 3"), ([DOFS, DOFS[:4]], "run 2 has 4")):
        with pytest.raises(InputError, match=words):
            chain(dofs=runs)


METRIC = (("GPa", 210.0), ("mm", 4.0), ("kg/m3", 7850.0))
INCH = (("psi", 210e9 / 6894.757293168), ("in", 4.0 / 25.4), ("lbfs2/in4", 7850.0 * 0.0254**4 / 4.4482216152605))


def cantilever(units, metre, named=METRIC):
    """A beam of one element with its length and width in the system's unit of length, by the formulas of a handbook."""
    length, width = 0.8 * metre, 0.05 * metre
    bent = np.array([[12 / length**3, -6 / length**2], [-6 / length**2, 4 / length]]) * width / 12
    moved = np.array([[156, -22 * length], [-22 * length, 4 * length**2]]) * width * length / 420
    dofs = pd.DataFrame({"node": [1, 1], "direction": ["y", "rz"], "x": length, "y": 0.0, "z": 0.0})
    return StructuralModel.from_matrices(
        {"bent": (bent, {"E": 1.0, "t": 3.0})}, {"moved": (moved, {"rho": 1.0, "t": 1.0})}, dofs=dofs, units=units,
        parameters=[
            Parameter(name, value, 0.4 * value, 2.0 * value, unit)
            for name, (unit, value) in zip(("E", "t", "rho"), named, strict=True)
        ],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("units", "metre"),
    [("mm-t-N", 1e3), ("mm-kg-mN", 1e3), ("in-lbf", 1 / 0.0254), ("in-kip", 1 / 0.0254), ("ft-lbf", 1 / 0.3048)],
)
def test_matrices_in_another_unit_system_give_the_same_model(units, metre):
    named = [cantilever(units, metre, own).matrices({}) for own in (METRIC, INCH)]
    for one, another in zip(*named, strict=True):
        assert another.toarray() == pytest.approx(one.toarray(), rel=1e-9)
    other, plain = cantilever(units, metre), cantilever("m-kg-N", 1.0)
    wanted = 3.533 / (2 * np.pi * 0.8**2) * np.sqrt(2.1e11 * 0.004**2 / 12 / 7850)  # of one element; exact is 3.516
    assert other.modes({}, 1).natural_freq == pytest.approx(wanted, rel=1e-3)
    for values in ({}, {"E": 150.0, "t": 7.0, "rho": 7000.0}):
        for one, another in zip(plain.matrices(values), other.matrices(values), strict=True):
            assert another.toarray() == pytest.approx(one.toarray(), rel=1e-12)
    assert other.mesh.points == pytest.approx(plain.mesh.points)


def test_an_unknown_unit_system_is_refused():
    with pytest.raises(InputError, match=r"mm-kg-mN \(mass in 1 kg\), in-lbf \(mass in 175.1 kg\)"):
        chain(units="mm-kg-N")


def test_sets_are_clusters_of_energy_and_colours_of_lines():
    ground, spring = np.diag([1.0, 0, 0]), np.array([[1.0, -1], [-1, 1]])
    k = ground.copy()
    k[:2, :2] += spring
    k[1:, 1:] += 1e-3 * spring
    places = pd.DataFrame({"node": [1, 2, 3], "direction": "x", "x": [0.0, 1, 2], "y": 0.0, "z": 0.0})

    def model(sets):
        return StructuralModel.from_matrices(k, np.eye(3), dofs=places, lines=[(1, 2), (2, 3)], sets=sets)

    own = model({"stiff": [1, 2], "soft": [3, 3], "rest": [2, 3]})
    assert own.mesh.groups == ("stiff", "rest") and own.clusters["soft"].tolist() == [2]
    shapes = own.modes({}, 3).shapes
    shares = own.energy_shares({}, shapes, ["stiff", "soft"])
    assert shares.sum(axis=0) == pytest.approx(1.0) and shares[0, 2] > 0.99
    for sets in ({"x": [1]}, {"soft": [9]}):
        with pytest.raises(InputError, match=r"x|node 9"):
            model(sets)
