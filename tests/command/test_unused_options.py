"""An option that a form of a command would ignore is refused, before anything is read or computed."""

import numpy as np
import pytest

import calib
from calib.command import cli
from calib.command.example import write_example


def refused(capsys, *arguments):
    assert cli.execute(list(map(str, arguments))) == 2
    return capsys.readouterr().err


FILES = ["compare", "--modes", "fe.unv", "--measured", "test.unv"]


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        ([*FILES, "--quick"], "--quick"),
        ([*FILES, "--undamped"], "--undamped"),
        ([*FILES, "--results", "there"], "--results"),
        (["compare", "mast", "--sensors", "sensors.csv"], "--sensors"),
        (["compare", "mast", "--shapes", "shapes.csv"], "--shapes"),
        (["compare", "mast", "--coordinates", "mast.inp"], "--coordinates"),
        (["compare", "mast", "--length-unit", "mm"], "--length-unit"),
        (["compare", "mast", "--into", "there"], "--into"),
        (["designs", "mast", "--design", "1", "--best", "3"], "--best"),
    ],
)
def test_an_option_of_another_form_is_refused(capsys, arguments, option):
    assert f"{option}: " in refused(capsys, *arguments)


@pytest.mark.parametrize(
    ("options", "place"),
    [
        (["--ignore-constraints"], "ignore_constraints"),
        (["--method", "morris", "--residuals", "natural_freq_B1z"], "method morris"),
        (["--method", "sobol", "--surface", "natural_freq_B1z", "E", "K_base"], "method sobol"),
    ],
)
def test_what_a_method_of_sensitivity_has_not_is_refused(capsys, tmp_path, monkeypatch, options, place):
    write_example(tmp_path / "mast")
    monkeypatch.chdir(tmp_path)
    assert f"{place}: " in refused(capsys, "sensitivity", "mast", *options)
    assert not list(tmp_path.rglob("*.csv")) or not (tmp_path / "results/mast/sensitivity.csv").exists()


@pytest.mark.parametrize(
    "options", [["--averages", "3"], ["--quantity", "mobility"], ["--unit", "g/N"], ["--length-unit", "mm"]]
)
def test_look_refuses_statements_about_files_of_which_there_are_none(capsys, tmp_path, options):
    write_example(tmp_path / "mast")
    name = options[0].removeprefix("--").replace("-", "_")
    assert f"{name}: " in refused(capsys, "look", tmp_path / "mast/modes.csv", "--into", tmp_path / "look", *options)
    assert not (tmp_path / "look").exists()


def test_an_estimator_beside_frfs_is_refused(capsys, tmp_path):
    file = tmp_path / "frf.csv"
    file.write_text(
        "freq,1z/1z re (m/N),1z/1z im (m/N)\n" + "".join(f"{f},{1 / (100 - f)},0.001\n" for f in range(1, 20))
    )
    calib.read_frfs(file)
    assert "estimator H2" in refused(capsys, "modes", file, "--estimator", "H2", "--into", tmp_path / "modes")


def test_a_length_unit_beside_a_table_of_computed_modes_is_refused(tmp_path):
    shapes = np.sin(np.pi * np.outer([0.2, 0.5, 0.7], [1, 2]))
    test = calib.modes([10.1, 38.0], shapes, sensors=["1z", "2z", "3z"])
    (tmp_path / "fe.csv").write_text("mode,freq (Hz)\n1,10.0\n2,40.0\n")
    with pytest.raises(calib.InputError, match="length_unit"):
        calib.compare_modes(tmp_path / "fe.csv", test, length_unit="mm")
