"""``calib extend`` and ``calib report``: from one version of a model to the next."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli


@pytest.mark.slow
def test_the_extended_model_lacks_nothing_more_and_its_errors_fall(guyed, capsys, edit, explanation):
    """Explain, extend, calibrate, explain again, report."""
    edit(guyed, "modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')
    assert cli.execute(["explain", "mast"]) == 0
    (name,) = explanation()["credible_set"]
    assert cli.execute(["extend", "mast", name, "--into", "mast_2"]) == 0
    assert cli.execute(["calibrate", "mast_2", "--workers", "1"]) == 0
    assert cli.execute(["explain", "mast_2"]) == 0
    again = explanation("mast_2")
    assert again["verdict"] == "nothing_detectable" and name not in {e["name"] for e in again["effects"]}
    capsys.readouterr()
    assert cli.execute(["report", "mast_2"]) == 0
    assert "Errors in standard deviations over the versions of the model:" in capsys.readouterr().out
    table = pd.read_csv("results/mast_2/versions.csv", keep_default_na=False)
    assert list(table["study"].unique()) == ["mast", "mast_2"] and list(table["effects"].unique()) == ["", "guy"]
    rms = table.set_index(["group", "study"])["rms"]
    for group in ("fit", "left_out", "held_out_modes"):
        assert rms[group, "mast_2"] < rms[group, "mast"]
    # What the calibration of the extended model finds is what the explanation had found.
    values = pd.read_csv("results/mast_2/parameters.csv").set_index("parameter")["value"]
    first = pd.read_csv("results/mast/effects.csv").set_index("name")["magnitude"]
    assert values[name] == pytest.approx(first[name], rel=0.01)


@pytest.mark.slow
def test_report_says_which_versions_are_left_out(guyed, capsys):
    assert cli.execute(["extend", "mast", "guy", "--into", "mast_2"]) == 0
    assert cli.execute(["calibrate", "mast_2", "--workers", "1"]) == 0
    capsys.readouterr()
    assert cli.execute(["report", "mast_2"]) == 0
    out = capsys.readouterr().out
    command = f"calib explain {Path('mast').resolve()} --results results"
    assert f"Version 1 (mast) has no up-to-date errors under results: run '{command}'." in out.splitlines()
    assert cli.execute(command.split()[1:]) == 0
    capsys.readouterr()
    assert cli.execute(["report", "mast_2"]) == 0
    assert "has no up-to-date errors" not in capsys.readouterr().out
    shutil.rmtree("mast")
    assert cli.execute(["report", "mast_2"]) == 2
    assert "there is no study '../mast' to build on" in capsys.readouterr().err
