"""Faults of the measurement, planted in the files of a study: what ``calib explain`` says of them."""

from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli
from calib.missing.rules import RULES

pytestmark = pytest.mark.usefixtures("functions_in_this_process")


@pytest.fixture
def faulty(here, write_study):
    """A mast that lacks nothing, or an effect, measured with a fault: ``read`` gives an entry from all of its mode."""

    def make(sensor, read, hidden=None, seed=11):
        write_study(Path("mast"), hidden, seed=seed)
        table = pd.read_csv("mast/shapes.csv", comment="#")
        for _, own in table.groupby("mode"):
            by = {f"{n}{d}": v for n, d, v in zip(own["node"], own["direction"], own["re"], strict=True)}
            at = own.index[own["node"].astype(str) + own["direction"] == sensor]
            table.loc[at, "re"] = read(by)
        table.to_csv("mast/shapes.csv", index=False)

    return make


def table():
    return pd.read_csv("results/mast/faults.csv").set_index("fault")


def named(explanation, blamed, sensor, magnitude):
    """The verdict names that fault, and its interval holds the planted magnitude."""
    told, row = explanation(), table().loc[blamed]
    assert told["verdict"] == "measurement" and told["credible_set"] == [] and told["chosen"] == []
    assert blamed in [one["name"] for one in told["blamed"]]
    assert len(table()) == told["faults"] + min(told["pair_faults"], RULES.screened)
    assert row["blamed"] and row["sensor"] == sensor and row["low"] <= magnitude <= row["high"]
    assert f"sensor {sensor}" in told["sentences"][0]


@pytest.mark.medium
def test_a_gain_is_named_and_its_correction_taken_while_the_files_stay(faulty, explanation, edit, capsys):
    faulty("3z", lambda by: 1.2 * by["3z"])
    before = Path("mast/shapes.csv").read_bytes()
    assert cli.execute(["explain", "mast"]) == 0
    named(explanation, "gain of sensor 3z", "3z", 0.2)
    assert explanation()["sentences"][0] in capsys.readouterr().out
    (offer,) = [s for s in explanation()["sentences"] if "corrected = {" in s]
    line = offer[offer.index("corrected") : offer.index("}") + 1]
    edit(Path("mast"), "[measurement]\n", f"[measurement]\n{line}\n")
    assert cli.execute(["explain", "mast"]) == 0
    assert explanation()["verdict"] == "nothing_detectable"
    assert any("corrected for gain of sensor 3z" in note for note in explanation()["notes"])
    assert Path("mast/shapes.csv").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "read", "blamed", "magnitude"),
    [
        ("2z", lambda by: -by["2z"], "gain of sensor 2z", -2.0),
        ("5z", lambda by: by["5z"] + 0.15 * by["5x"], "cross-talk of sensor 5x into 5z", 0.15),
        # by the slope between its neighbours, which is not the one at the sensor: some 110 mm fit better
        ("3x", lambda by: by["3x"] + 0.15 * (by["4x"] - by["2x"]) / 2, "place of sensor 3x along y", 120.0),
    ],
)
def test_other_faults_are_named_with_their_magnitude(faulty, explanation, sensor, read, blamed, magnitude):
    faulty(sensor, read)
    assert cli.execute(["explain", "mast"]) == 0
    named(explanation, blamed, sensor, magnitude)


@pytest.mark.slow
def test_nothing_is_added_to_the_model_for_a_fault(faulty, capsys):
    faulty("3z", lambda by: 1.2 * by["3z"])
    assert cli.execute(["run", "mast", "--quick"]) == 0
    assert "nothing is added to the model" in capsys.readouterr().out


@pytest.mark.slow
def test_a_missing_effect_is_no_fault_of_the_measurement(here, write_study, explanation):
    write_study(Path("mast"), {"guy": 12000.0}, seed=11)
    assert cli.execute(["explain", "mast"]) == 0
    assert explanation()["verdict"] == "effect" and explanation()["credible_set"] == ["guy"]
    assert explanation()["blamed"] == [] and not table()["blamed"].any()


@pytest.mark.medium
@pytest.mark.parametrize(
    "seed", [11, pytest.param(12, marks=pytest.mark.slow), pytest.param(13, marks=pytest.mark.slow)]
)
def test_sound_data_are_silent(here, write_study, explanation, seed):
    write_study(Path("mast"), seed=seed)
    assert cli.execute(["explain", "mast"]) == 0
    assert explanation()["verdict"] == "nothing_detectable" and not table()["blamed"].any()
    assert (table()["score"].abs() <= table()["limit"]).all()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('"gain of sensor 99x" = 0.1', "sensor '99x' was not measured"),
        ('"gain of sensor 3z" = -1.0', "leaves nothing of its motion"),
        ('"mood of sensor 3z" = 0.1', "there is no correction of 'mood of sensor 3z'"),
    ],
)
def test_an_impossible_correction_is_refused_with_its_place(here, write_study, edit, capsys, line, words):
    write_study(Path("mast"))
    edit(Path("mast"), "[measurement]\n", f"[measurement]\ncorrected = {{ {line} }}\n")
    assert cli.execute(["compare", "mast"]) == 2
    assert words in capsys.readouterr().err
