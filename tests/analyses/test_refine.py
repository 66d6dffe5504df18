"""New runs: where metamodels know least near the measurement, proposed for a table and evaluated otherwise."""

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.errors.errors import InputError
from calib.sensitivity.infill import chosen_runs, coordinates, local_errors, tempered

CENTRE = np.array([0.7, 0.3])


def bumpy(measured=True):
    """Two responses; the second has a bump at the point that agrees with what was measured."""
    space = calib.ParameterSpace([calib.Parameter(name, 0.5, 0.0, 1.0) for name in "ab"])

    def respond(v):
        bump = np.exp(-((v["a"] - 0.7) ** 2 + (v["b"] - 0.3) ** 2) / 0.03)
        return {"y": v["a"], "z": v["b"] + 0.5 * bump}

    test = calib.ResponseTest({"y": (0.7, 0.01), "z": (0.8, 0.01)} if measured else {"y": (50.0, 0.01)})
    return calib.Problem(calib.FunctionModel("bumpy", space, respond), test)


@pytest.fixture(scope="module")
def sampled():
    return bumpy().sensitivity(samples=50, progress=False)


@pytest.fixture(scope="module")
def more(sampled):
    return sampled.refine(15, progress=False)


@pytest.mark.medium
def test_runs_lie_where_the_metamodels_agree_with_the_measurement_and_err(more):
    runs = more.of.runs
    assert list(runs) == ["a", "b", "weight", "y", "z"] and len(runs) == 15 and not more.of.proposed
    distance = np.linalg.norm(runs[["a", "b"]] - CENTRE, axis=1)
    assert np.median(distance) < 0.25 and len(runs[["a", "b"]].drop_duplicates()) == 15  # 0.45 of uniform points
    np.testing.assert_allclose(runs["y"], runs["a"])
    assert runs["weight"].between(0.0, 1.0).all()
    z = more.table.set_index("response").loc["z"]
    assert z["error_near"] > z["error"] and z["error_near_after"] < 0.8 * z["error_near"]
    assert f"z {z['error_near']:.3g} -> {z['error_near_after']:.3g}" in more.sentences[1]
    assert len(more.of.prognosis["z"].rows) == 65


@pytest.mark.medium
def test_more_runs_begin_with_the_same_ones(sampled, more):
    fewer = sampled.refine(4, progress=False)
    pd.testing.assert_frame_equal(fewer.of.runs, more.of.runs.head(4))
    other = sampled.refine(4, seed=2, progress=False)
    assert not other.of.runs["a"].equals(fewer.of.runs["a"])


@pytest.mark.medium
def test_without_a_measurement_within_reach_runs_are_still_told(capsys):
    found = bumpy(measured=False).sensitivity(samples=40, progress=False).refine(3, progress=False)
    assert len(found.of.runs) == 3 and np.isfinite(found.of.runs["y"]).all()
    with pytest.raises(InputError, match="runs"):
        bumpy().sensitivity(samples=40, progress=False).refine(0)


def test_what_has_no_metamodel_cannot_be_refined():
    space = calib.ParameterSpace([calib.Parameter("a", 0.5, 0.0, 1.0)])
    flat = calib.Problem(calib.FunctionModel("flat", space, lambda v: {"y": 1.0}), calib.ResponseTest({"y": 1.0}))
    with pytest.raises(InputError, match="no response has a metamodel"):
        flat.sensitivity(samples=25, progress=False).refine(3, progress=False)


def test_weights_leave_a_part_of_the_points():
    far = np.concatenate([[0.0], np.full(99, 1e6)])
    weights = tempered(far)
    assert weights.sum() ** 2 / (weights**2).sum() == pytest.approx(5.0, rel=0.01) and weights[0] == 1.0
    near = np.linspace(0.0, 1.0, 100)
    np.testing.assert_allclose(tempered(near), np.exp(-0.5 * near))  # enough of them agree: nothing is tempered
    np.testing.assert_array_equal(tempered(np.full(10, 7.0)), 1.0)


def test_choices_keep_away_from_designs_and_from_each_other():
    line = np.linspace(0.0, 1.0, 11)[:, None]
    assert chosen_runs(np.ones(11), line, line[[0]], 2) == [10, 5]
    assert chosen_runs(np.where(line[:, 0] < 0.55, 1.0, 0.0), line, line[[0]], 1) == [5]


@pytest.mark.medium
def test_errors_are_those_of_the_nearest_designs(sampled):
    models = [one for one in sampled.prognosis.models if one.response == "z"]
    x = sampled.samples[["a", "b"]].to_numpy()
    there = coordinates(models, x)
    assert there[:, 0].max() < there[:, 1].max() <= 1.0  # b decides on z
    errors = local_errors(models, there, coordinates(models, np.array([CENTRE, [0.1, 0.9]])))
    assert errors[0, 0] > 2.0 * errors[1, 0]
    own = local_errors(models, there, there[:1])
    assert own[0, 0] == pytest.approx(abs(models[0].true[0] - models[0].predicted[0]), rel=1e-3)


STUDY = """title = "table"
model = "runs.csv"
model_options = { inputs = ["a", "b"] }
[measurement]
responses = "measured.csv"
"""


@pytest.mark.medium
def test_runs_of_a_table_are_proposed_by_the_command(tmp_path, sampled, capsys, no_drawing):
    folder = tmp_path / "table"
    folder.mkdir()
    sampled.samples.to_csv(folder / "runs.csv", index=False)
    (folder / "measured.csv").write_text("response,value,std\ny,0.7,0.01\nz,0.8,0.01\n")
    (folder / "study.toml").write_text(STUDY)
    with no_drawing():
        assert cli.execute(["refine", str(folder), "--runs", "6", "--quick", "--results", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    proposed = pd.read_csv(tmp_path / "out/table/quick/proposed_runs.csv")
    errors = pd.read_csv(tmp_path / "out/table/quick/refined.csv").set_index("response")
    assert list(proposed) == ["a", "b", "weight"] and len(proposed) == 6
    assert proposed[["a", "b"]].ge(sampled.samples[["a", "b"]].min()).all(axis=None)
    assert errors["error_near_after"].isna().all() and errors.loc["z", "error_near"] > errors.loc["z", "error"]
    assert f"{errors.loc['z', 'error_near']:.3g}" in said
    study = calib.Study.load(folder, results=tmp_path / "other", quick=True, progress=False)
    with no_drawing():
        pd.testing.assert_frame_equal(study.refine(6).of.runs, proposed, rtol=1e-6)
