"""Designs: every point of searches and samples, with its values, responses and errors."""

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.designs import HEAD, OTHER
from calib.command import cli
from calib.errors.errors import InputError

MODEL = """
import calib

def wave():
    space = calib.ParameterSpace(
        [calib.Parameter("a", 1.0, 0.0, 3.0, "m"), calib.Parameter("b", 1.0, 0.0, 3.0, "m")],
        [calib.LinearConstraint("both", (("a", 1.0), ("b", 1.0)), 0.0, 4.0, "m")],
    )

    def answer(v):
        if v["a"] > 2.5:
            raise calib.EvaluationError("it does not converge")
        return {"y": v["a"] + v["b"], "z": v["a"] * v["b"]}

    return calib.FunctionModel("wave", space, answer)
"""
STUDY = """
title = "wave"
model = "model.py:wave"
selection = ["a", "b"]
[measurement]
responses = "measured.csv"
[calibration]
method = "genetic"
population = 12
generations = 4
cases = [{ name = "A", seed = 1 }, { name = "B", seed = 2 }]
"""
FILES = {"model.py": MODEL, "study.toml": STUDY, "measured.csv": "response,value,std\ny,3.0,0.1\nz,2.0,0.1\n"}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wave")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    found = calib.Study.load(folder, folder / "results", workers=1)
    with pytest.raises(InputError, match="no design"):
        found.designs()
    found.calibrate()
    return found


@pytest.fixture(scope="module")
def table(study):
    return study.designs().table


@pytest.mark.medium
def test_each_row_is_a_point_with_its_responses_constraint_and_errors(table):
    assert list(table.columns[: len(HEAD)]) == list(HEAD)
    good = table[table["status"] == "ok"]
    np.testing.assert_allclose(good["y"], good["a"] + good["b"], rtol=1e-12)
    np.testing.assert_allclose(good["both"], good["a"] + good["b"], rtol=1e-12)
    np.testing.assert_allclose(good["error z"], good["a"] * good["b"] / 2 - 1, rtol=1e-9, atol=1e-12)
    errors = good[["error y", "error z"]].abs()
    np.testing.assert_allclose(good["objective"], errors.sum(axis=1), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(good["mean_error"], errors.mean(axis=1), rtol=1e-9, atol=1e-12)
    assert (table["both"] <= 4).all() and set(table["case"]) == {"A", "B", OTHER}


@pytest.mark.medium
def test_the_best_stand_first_and_what_failed_last(study, table):
    assert table["objective"].dropna().is_monotonic_increasing and table["rank"].tolist() == list(
        range(1, len(table) + 1)
    )
    failed = table["status"] == "failed"
    assert failed.any() and (failed == (table["a"] > 2.5)).all() and failed.iloc[-int(failed.sum()) :].all()
    feasible = study.designs(feasible=True).table
    assert len(feasible) == int((~failed).sum()) and "failed" not in set(feasible["status"])


@pytest.mark.medium
def test_every_evaluated_individual_is_there_once(study, table):
    summary = pd.read_json(study.folder.path / "summary.json", typ="series")
    for case in ("A", "B"):
        own = table[table["case"] == case]
        assert len(own) <= summary["evaluations"] / 2 and own["generation"].between(1, 4).all()
    assert not table["design"].duplicated().any()
    pd.testing.assert_frame_equal(study.designs().table, table)  # numbers stay


def test_a_design_is_taken_as_a_start(study, table):
    design = int(table["design"].iloc[3])
    values = study.designs().of.values(design)
    assert values == table.set_index("design").loc[design, ["a", "b"]].to_dict()
    printed = str(study.designs(design=design))
    assert f'begin_at = "design {design}"' in printed
    with pytest.raises(InputError, match="design 99999"):
        study.designs(design=99999)


@pytest.mark.medium
def test_the_whole_table_and_pictures_are_written_on_request(study, table, tmp_path):
    study.designs(csv=tmp_path / "all.csv", anthill=[("a", "z")], parallel=True, draw=["history", "matrix"])
    written = pd.read_csv(tmp_path / "all.csv")
    assert list(written.columns) == list(table.columns)
    np.testing.assert_allclose(written["objective"], table["objective"], rtol=1e-9)
    drawn = {path.name for path in study.folder.path.glob("*.png")}
    assert {"anthill_a_z.png", "designs_parallel.png", "designs_history.png", "designs_matrix_rank.png"} <= drawn
    assert study.designs().of.outputs == ("y", "z")
    with pytest.raises(InputError, match="unknown picture 'cloud'"):
        study.designs(draw=["cloud"])
    with pytest.raises(InputError, match="cannot be written"):
        study.designs(csv=tmp_path / "no" / "all.csv")


@pytest.mark.medium
def test_the_command_prints_the_same_and_draws(study, table, capsys):
    where = [str(study.path), "--results", str(study.results)]
    assert cli.execute(["designs", *where, "--best", "3", "--anthill", "a", "z"]) == 0
    said = capsys.readouterr().out
    assert study.designs(3).of.answer.found in said and "anthill_a_z.png" in said
    assert f"{table['design'].iloc[2]} " in said and f"{table['objective'].iloc[2]:.5g}" in said
    assert cli.execute(["designs", *where, "--design", "99999"]) == 2
