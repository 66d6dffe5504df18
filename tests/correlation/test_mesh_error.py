"""The error of the mesh in residuals, against the exact frequencies of a bar of linear elements."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.mesh_error import MeshError
from calib.correlation.modal.held_out import held_out_errors
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.rigid import both_meshes
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.study.loading import module_of

BAR = module_of(Path(__file__).parents[1] / "template/bar.py")
LENGTH, SPEED, PLACES, bar = BAR.LENGTH, BAR.SPEED, BAR.PLACES, BAR.bar
MODES, STD = 4, 1e-3


def by_hand(elements, stiffness=1.0):
    """Natural frequencies of that bar, Hz: ``w^2 = 6 c^2/h^2 (1 - cos kh)/(2 + cos kh)`` with kL = pi/2, 3 pi/2, ..."""
    h, wave = LENGTH / elements, (np.arange(MODES) + 0.5) * np.pi / LENGTH
    square = 6 * stiffness * SPEED**2 / h**2 * (1 - np.cos(wave * h)) / (2 + np.cos(wave * h))
    return np.sqrt(square) / (2 * np.pi)


def measured(elements=None):
    """The exact bar, or that of another mesh, at four places."""
    freq = (np.arange(MODES) + 0.5) * SPEED / LENGTH / 2 if elements is None else by_hand(elements)
    wave = (np.arange(MODES) + 0.5) * np.pi / LENGTH
    shapes = np.sin(np.outer(np.array(PLACES) / 1000, wave)).astype(complex)
    nan = np.full(MODES, np.nan)
    return calib.MeasuredModes(
        tuple(f"m{k + 1}" for k in range(MODES)), freq, freq, STD * freq, nan, nan,
        tuple(Sensor(node, "x") for node in PLACES), shapes, np.full(shapes.shape, 0.01), 5, True,
    )  # fmt: skip


@pytest.fixture(scope="module")
def problem():
    coarse = bar(8)
    mesh = MeshError(coarse, bar(16), {"EA": 1.0}, 1.33)
    return ModalProblem(coarse, measured(), mode_count=MODES, mesh=mesh)


def test_the_change_is_that_of_the_frequencies_of_both_meshes(problem):
    residual = ModalResidual(problem)
    change = residual.mesh_change[residual.kinds == "frequency"]
    std = residual.std.freq
    np.testing.assert_allclose(change, np.log(by_hand(16) / by_hand(8)) / std, rtol=1e-6)
    assert (change < -0.5).all()


def test_richardson_s_multiple_takes_the_frequencies_to_the_exact_ones(problem):
    """Linear elements converge with the order 2: for halved elements the multiple is 4/3, to leading order."""
    residual = ModalResidual(problem)
    left = [residual.residual({"EA": 1.0, "mesh_error": c})[residual.kinds == "frequency"] for c in (0.0, 4 / 3)]
    assert (np.abs(left[1]) < 0.06 * np.abs(left[0])).all()


def test_residual_and_slope_are_linear_in_the_multiple(problem):
    residual = ModalResidual(problem)
    at = {"EA": 1.03, "mesh_error": 0.7}
    slope = residual.jacobian(at, ["mesh_error", "EA"])
    np.testing.assert_allclose(slope[:, 0], -residual.mesh_change)
    np.testing.assert_allclose(
        residual.residual({**at, "mesh_error": 1.7}) - residual.residual(at), slope[:, 0], atol=1e-9
    )
    np.testing.assert_allclose(slope[:, 1], residual.jacobian({"EA": 1.03}, ["EA"])[:, 0], rtol=1e-12)
    plain = ModalResidual(replace(problem, mesh=None))
    np.testing.assert_array_equal(residual.residual({"EA": 1.03}), plain.residual({"EA": 1.03}))
    assert "mesh_error" in residual.space and "mesh_error" not in plain.space


def test_held_out_modes_have_the_error_too(problem):
    """The highest mode is predicted from the others: only with the fitted multiple as well as expected."""
    whole = problem
    used = replace(problem, measured=measured().without(["m4"], ()))
    names, cov = ("EA", "mesh_error"), np.diag([1e-4, 0.05]) ** 2

    def error(multiple):
        return held_out_errors(used, whole, {"EA": 1.0, "mesh_error": multiple}, names, cov).iloc[0]

    assert error(4 / 3)["p"] > 0.05 and error(0.0)["p"] < 1e-6
    less = held_out_errors(used, whole, {"EA": 1.0, "mesh_error": 0.0}, names[:1], cov[:1, :1])
    assert error(0.0)["expected"] > less.iloc[0]["expected"]


def test_functions_move_to_those_of_the_finer_mesh():
    freq = np.linspace(100.0, 2500.0, 12)
    known = np.ones((12, 4, 1), complex)
    sensors = tuple(Sensor(node, "x") for node in PLACES)
    frfs = MeasuredFRFs(freq, sensors, sensors[-1:], "receptance", known, np.full(known.shape, 1e-9), synthetic=True)
    coarse, fine = FRFProblem(bar(8), frfs), FRFProblem(bar(16), frfs)
    own = replace(coarse, mesh=MeshError(coarse.model, fine.model, {"EA": 1.0}, 1.0))
    at = {"EA": 1.0, "mesh_error": 1.0}
    np.testing.assert_allclose(own.functions(at), fine.functions({"EA": 1.0}), rtol=1e-9)
    np.testing.assert_array_equal(own.functions({"EA": 1.1}), coarse.functions({"EA": 1.1}))
    slopes = FRFResidual(own).jacobian(at, ["mesh_error", "EA"])
    change = FRFResidual(fine).residual({"EA": 1.0}) - FRFResidual(coarse).residual({"EA": 1.0})
    np.testing.assert_allclose(slopes[:, 0], change, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(slopes[:, 1], FRFResidual(coarse).jacobian({"EA": 1.0}, ["EA"])[:, 0], rtol=1e-12)


def test_a_finer_model_with_other_parameters_or_modes_is_refused(problem):
    other = bar(16)
    renamed = replace(other, space=calib.ParameterSpace((replace(other.space["EA"], name="EI"),)))
    with pytest.raises(InputError, match="has the parameter EA"):
        MeshError(problem.model, renamed, {"EA": 1.0}, 1.0)


def test_modes_that_the_finer_mesh_lacks_are_taken_as_exact(problem):
    """It has other ones, which move one place each."""
    own = replace(problem, mesh=replace(problem.mesh, finer=_apart(bar(16))))
    assert both_meshes(own).lost == {"m1", "m2", "m3", "m4"} and not ModalResidual(own).mesh_change.any()
    assert not both_meshes(problem).lost


def test_modes_of_equal_frequency_may_be_turned_by_the_finer_mesh():
    """Two equal oscillators: any two directions at right angles are modes, and the change of both meshes is 0."""

    def pair(turn):
        c, s = np.cos(turn), np.sin(turn)
        turned = np.array([[c, -s], [s, c]])
        dofs = pd.DataFrame({"node": [1, 1], "direction": ["x", "z"], "x": 0.0, "y": 0.0, "z": 0.0})
        split = turned @ np.diag([1.0, 1.0 + 1e-6]) @ turned.T  # which decides the directions
        stiffness = calib.Parameter("k", 1e4, 5e3, 2e4, "N/m")
        return calib.StructuralModel.from_matrices({"k": split}, {"m": np.eye(2)}, dofs=dofs, parameters=[stiffness])

    nan, freq = np.full(2, np.nan), np.full(2, 15.9)
    shapes = np.array([[1.0, 0.3], [0.3, -1.0]], complex)
    modes = calib.MeasuredModes(
        ("a", "b"), freq, freq, 0.01 * freq, nan, nan, (Sensor(1, "x"), Sensor(1, "z")), shapes,
        np.full((2, 2), 0.01), 5, True,
    )  # fmt: skip
    mesh = MeshError(pair(0.0), pair(np.pi / 4), {"k": 1e4}, 1.0)
    change = ModalResidual(ModalProblem(pair(0.0), modes, mode_count=2, mesh=mesh)).mesh_change
    np.testing.assert_allclose(change, 0.0, atol=1e-3)


def _apart(model):
    """Oscillators at the places of the sensors."""
    dofs = pd.DataFrame({
        "node": [2000, 1500, 1000, 500], "direction": "x", "x": [2.0, 1.5, 1.0, 0.5], "y": 0.0, "z": 0.0,
    })  # fmt: skip
    return calib.StructuralModel.from_matrices(
        {"EA": np.diag([1.0, 2.0, 3.0, 4.0])}, {"own": np.eye(4)}, dofs=dofs, parameters=[model.space["EA"]], name="bar"
    )
