"""Undamped frequencies beside damped ones: closed forms of proportional damping, and of a strong damper."""

import numpy as np
import pandas as pd
import pytest

import calib
from calib.errors.errors import InputError

K = np.array([[3.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]) * 1e4
M = np.diag([2.0, 1.0, 1.5])


def problem(damping):
    dofs = pd.DataFrame({"node": [1, 2, 3], "direction": "x", "x": [0.0, 1.0, 2.0], "y": 0.0, "z": 0.0})
    model = calib.StructuralModel.from_matrices(
        {"s": K}, M, damping, dofs=dofs, parameters=[calib.Parameter("s", 1.0, 0.5, 2.0)]
    )
    freq = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.inv(M) @ K).real)) / (2 * np.pi)
    shapes = np.linalg.eigh(np.diag(1 / np.sqrt(np.diag(M))) @ K @ np.diag(1 / np.sqrt(np.diag(M))))[1]
    shapes = shapes / np.sqrt(np.diag(M))[:, None]
    measured = calib.modes(freq, shapes, sensors=["1x", "2x", "3x"], names=["a", "b", "c"])
    return calib.Problem(model, calib.ModalTest(measured)), freq


@pytest.mark.parametrize("share", [0.0, 2e-3])
def test_damping_that_does_not_couple_modes_leaves_their_undamped_frequencies(share):
    found, freq = problem(share * K)
    table = found.compare().undamped
    np.testing.assert_allclose(table["undamped_freq_model"], freq, rtol=1e-9)
    np.testing.assert_allclose(table["natural_freq_model"], freq, rtol=1e-9)
    np.testing.assert_allclose(table["alike"], 1.0, rtol=1e-9)
    np.testing.assert_allclose(table["undamped_error"], 0.0, atol=1e-9)
    ratio = share * np.pi * freq
    np.testing.assert_allclose(table["damped_freq_model"], freq * np.sqrt(1 - ratio**2), rtol=1e-9)


def test_a_damper_on_one_mass_moves_natural_frequencies_and_not_the_undamped_ones():
    found, freq = problem(np.diag([0.0, 0.0, 120.0]))
    table = found.compare().undamped
    np.testing.assert_allclose(table["undamped_freq_model"], freq, rtol=1e-9)
    assert (np.abs(table["natural_freq_model"] / freq - 1) > 1e-3).any() and (table["alike"] < 0.999).any()


def test_a_model_without_matrices_has_none():
    space = calib.ParameterSpace((calib.Parameter("k", 1.0, 0.5, 2.0),))
    model = calib.FunctionModel("number", space, lambda v: {"y": v["k"]})
    with pytest.raises(InputError, match="model with matrices"):
        _ = calib.Problem(model, calib.ResponseTest({"y": (1.0, 0.1)})).compare().undamped


@pytest.mark.medium
def test_the_command_writes_and_prints_them(tmp_path, capsys, no_drawing):
    from calib.command import cli
    from calib.command.example import write_example

    write_example(tmp_path / "mast")
    there = [str(tmp_path / "mast"), "--results", str(tmp_path / "out")]
    with no_drawing():
        assert cli.execute(["compare", *there, "--undamped"]) == 0
    said, file = capsys.readouterr().out, tmp_path / "out/mast/undamped.csv"
    stored = pd.read_csv(file)
    assert len(stored) and all(f"{freq:.3f}" in said for freq in stored["undamped_freq_model"])
    with no_drawing():
        assert cli.execute(["compare", *there]) == 0
    assert not file.exists() and "ndamped freq" not in capsys.readouterr().out
