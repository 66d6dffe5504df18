"""Modes of equal frequency: the subspace is compared, and no single direction unless the frequencies tell it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calib
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.subspaces import close_groups, equal_at_nominal, subspace_mac
from calib.measurement.modal import Sensor
from calib.structure.affine import parameter
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition, extend
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes

N, LENGTH = 12, 2.0
NODES = (1, 4, 8, 13)
SENSORS = tuple(Sensor(node, d) for node in NODES for d in "yz")
ONE = {"EIy": 1.0, "EIz": 1.0, "tip": 1.0}


def elements():
    """Stiffness and mass of a free beam in one plane, assembled by hand: deflection and slope at every node."""
    h, ei, rho = LENGTH / N, 1e4, 8.0
    ke = ei / h**3 * np.array(
        [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
         [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
    )  # fmt: skip
    me = rho * h / 420 * np.array(
        [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
         [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
    )  # fmt: skip
    k, m = np.zeros((2, 2 * N + 2, 2 * N + 2))
    for e in range(N):
        s = slice(2 * e, 2 * e + 4)
        k[s, s] += ke
        m[s, s] += me
    return k, m


def beam(damped=False):
    """A square section: the planes y and z are alike, and a lump at the tip acts in both."""
    k, m = elements()
    zero, lump = np.zeros_like(k), np.zeros_like(m)
    lump[-2, -2] = 0.5
    planes = [np.block([[k, zero], [zero, zero]]), np.block([[zero, zero], [zero, k]])]
    axes = [(d, s) for d, s in (("y", "rz"), ("z", "ry"))]
    rows = [(n + 1, d, n * LENGTH / N, 0.0, 0.0) for pair in axes for n in range(N + 1) for d in pair]
    parameters = [calib.Parameter(name, 1.0, 0.8, 1.2) for name in ("EIy", "EIz", "tip")]
    given = {"damping": {"c": 1e-4 * (planes[0] + planes[1])}} if damped else {}
    parameters += [calib.Parameter("c", 1.0, 0.1, 10.0)] if damped else []
    return calib.StructuralModel.from_matrices(
        dict(zip(("EIy", "EIz"), planes, strict=True)),
        {"own": np.kron(np.eye(2), m), "tip": np.kron(np.eye(2), lump)}, **given,
        dofs=pd.DataFrame(rows, columns=["node", "direction", "x", "y", "z"]), parameters=parameters,
    )  # fmt: skip


def measured(angles, freq_ratio=(0.999, 1.001), seed=3, share=0.01, std=1e-3):
    """Two pairs of the beam by hand, each at its angles; the eigenproblem of one plane is solved by NumPy."""
    k, m = elements()
    m = m.copy()
    m[-2, -2] += 0.5
    low = np.linalg.cholesky(m)
    value, vector = np.linalg.eigh(np.linalg.solve(low, np.linalg.solve(low, k).T))
    plane = np.linalg.solve(low.T, vector)[::2][np.array(NODES) - 1][:, 2:4]
    freq = np.sqrt(value[2:4]) / (2 * np.pi)
    rng, columns = np.random.default_rng(seed), []
    for shape in plane.T:
        for angle in np.radians(angles):
            whole = np.column_stack([np.cos(angle) * shape, np.sin(angle) * shape]).ravel()
            columns.append(whole / np.abs(whole).max() + share * rng.standard_normal(len(whole)))
    f = np.outer(freq, freq_ratio).ravel()
    shapes = np.column_stack(columns)
    return calib.MeasuredModes(
        names=("1a", "1b", "2a", "2b"), natural_freq=f, damped_freq=f, freq_std=std * f,
        damping_ratio=np.full(4, np.nan), damping_std=np.full(4, np.nan), sensors=SENSORS, shapes=shapes,
        shape_std=np.full(shapes.shape, share), synthetic=True, source="beam",
    )  # fmt: skip


def problem(data, damped=False):
    return calib.Problem(beam(damped), calib.ModalTest(data, mode_count=8))


def residual(data, damped=False):
    pair = problem(data, damped).study().studies[0].problem
    return ModalResidual(pair)


@pytest.mark.parametrize("angles", [(30, 120), (0, 90), (77, -13)])
@pytest.mark.parametrize("damped", [False, True])
def test_a_right_model_agrees_at_whatever_angles_its_pairs_were_measured(angles, damped):
    found = residual(measured(angles), damped).solve(ONE | {"c": 1.0} if damped else ONE)
    assert found.pairing.mac.min() > 0.995 and len(found.modes.groups) == 2
    table = found.where_it_fails()
    assert (table["verdict"] == "beyond measurement uncertainty").sum() <= 2
    assert found.pairing.margin.min() > 0.3  # the other one of the pair is no rival


def test_turned_modes_stay_orthonormal_and_keep_the_trace_of_their_eigenvalues():
    own = residual(measured((20, 110)))
    values = {**ONE, "EIy": 1.001}
    plain, found = own.problem.solve(values), own.solve(values)
    k, _, m = own.problem.model.matrices(values)
    np.testing.assert_allclose(found.modes.shapes.T @ (m @ found.modes.shapes), np.eye(8), atol=1e-9)
    np.testing.assert_allclose(
        np.diag(found.modes.shapes.T @ (k @ found.modes.shapes)), (2 * np.pi * found.modes.natural_freq) ** 2,
        rtol=1e-9,
    )  # fmt: skip
    np.testing.assert_allclose((found.modes.natural_freq**2).sum(), (plain.natural_freq**2).sum(), rtol=1e-12)


@pytest.mark.parametrize("damped", [False, True])
def test_derivatives_of_a_pair_are_those_of_its_subspace(damped):
    """The residual by differences, in which the modes are turned anew; without noise nothing else turns them."""
    own = residual(measured((30, 120), share=1e-7), damped)
    own = replace(own, problem=replace(own.problem, measured=measured((30, 120), share=1e-7)))
    values = {**ONE, "tip": 1.02, "EIy": 1.0, **({"c": 1.0} if damped else {})}
    names = ("EIy", "EIz", "tip")
    exact = own.jacobian(values, names)
    for p, name in enumerate(names):
        up, down = (own.residual({**values, name: values[name] + s * 1e-4}) for s in (1, -1))
        differences, frequency = (up - down) / 2e-4, own.kinds == "frequency"
        np.testing.assert_allclose(exact[frequency, p], differences[frequency], rtol=1e-4, atol=1e-2)
    assert np.all(np.abs(exact[frequency][:, :2]) > 10.0)  # each plane bears a part of every turned mode


@pytest.mark.medium
def test_measured_frequencies_that_differ_leave_the_directions_to_the_parameter_that_splits_them():
    data = measured((0, 90), freq_ratio=np.sqrt([0.98, 1.02]))
    before = residual(data).solve(ONE)
    assert before.pairing.mac.min() > 0.995
    assert "sensor" not in set(before.where_it_fails().head(4)["kind"])
    fit = problem(data).calibrate(starts=1, progress=False)
    for name, true in (("EIy", 0.98), ("EIz", 1.02)):
        assert fit.values[name] == pytest.approx(true, abs=3 * fit.parameters.loc[name, "std"])
        assert fit.parameters.loc[name, "std"] < 6e-3
    assert fit.statistics.p_fit > 0.01
    after = residual(data).solve(fit.values)
    assert after.modes.groups == () and after.pairing.mac.min() > 0.995


def test_directions_that_a_split_model_has_wrong_are_told():
    """Once the model separates the pair, its shapes are data again."""
    found = residual(measured((30, 120), freq_ratio=np.sqrt([0.96, 1.04]))).solve({**ONE, "EIy": 0.96, "EIz": 1.04})
    assert found.modes.groups == () and found.pairing.mac.max() < 0.9


def test_a_choice_of_pairs_holds_inside_a_subspace():
    pair = residual(measured((30, 120))).problem
    chosen = replace(pair, override={"1a": 2, "1b": 1})
    found = chosen.compare(ONE)
    assert found.pairing.model_index[:2].tolist() == [1, 0] and found.pairing.mac.min() > 0.995


def test_one_measured_mode_of_a_pair_is_compared_with_the_subspace_too():
    test = calib.ModalTest(measured((40, 130)), mode_count=8, held_out=["1b", "2b"])
    found = ModalResidual(calib.Problem(beam(), test).study().studies[0].problem).solve(ONE)
    assert found.measured.names == ("1a", "2a") and found.pairing.mac.min() > 0.995


@pytest.mark.parametrize("angles", [(30, 120), (0, 90)])
def test_a_model_with_an_effect_has_the_equal_modes_of_the_base_model(angles, monkeypatch):
    """Where effects are absent it is the base model, which need not be solved once more with them."""
    problem = residual(measured(angles)).problem
    lump = calib.Effect(
        "lump", "", "", "", calib.Parameter("lump", 0.0, 0.0, 2.0, "kg", prior_sd=0.5),
        lambda m: Addition(mass=(outer_term("lump", [np.eye(m.n_dof)[4]], parameter("lump")),)),
    )  # fmt: skip
    wider = problem.with_model(extend(problem.model, [lump]), 0)
    solved = list[object]()
    own = StructuralModel.modes
    monkeypatch.setattr(StructuralModel, "modes", lambda self, *given: (solved.append(self), own(self, *given))[1])
    assert wider.has_equal_modes is True and all(one is problem.model for one in solved)
    assert equal_at_nominal(wider) is True


def test_groups_are_as_wide_as_the_measurement_is_unsure():
    freq, std = np.array([10.0, 20.0]), np.array([1e-3, 1e-4])
    model = np.array([0.0, 0.0, 10.0, 10.02, 10.04, 20.0, 20.004, 20.01])
    assert close_groups(model, freq, std, 2.0) == ((2, 3), (5, 6))
    assert close_groups(model, freq, np.full(2, np.nan), 2.0) == ()
    assert close_groups(np.array([5.0, 5.0, 9.0]), freq, np.full(2, np.nan), 2.0) == ((0, 1),)


def test_a_subspace_of_as_many_shapes_as_sensors_explains_nothing():
    rng = np.random.default_rng(0)
    assert subspace_mac(rng.standard_normal((2, 5)), np.eye(2)).tolist() == [0.0] * 5
    chance = [subspace_mac(rng.standard_normal((6, 400)), np.linalg.qr(rng.standard_normal((6, d)))[0]) for d in (1, 2)]
    assert chance[0].mean() == pytest.approx(1 / 6, abs=0.03) and chance[1].mean() < 0.25


def test_separate_modes_are_left_as_they_are():
    own = residual(measured((0, 90)))
    values = {**ONE, "EIy": 0.9}
    plain, found = own.problem.solve(values), own.solve(values)
    assert isinstance(found.modes, Modes) and found.modes.groups == ()
    np.testing.assert_array_equal(found.modes.shapes, plain.shapes)
