"""Repeats that disagree are reported by a comparison and an explanation."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses.compare import compare
from calib.analyses.explain import explain
from calib.analyses.provenance.record import check_repeats
from calib.command.example import write_example
from calib.correlation.standard_deviations import std_for
from calib.results.results import Results
from calib.study.study import LoadedStudy

CHAIN = Path(__file__).parents[2] / "studies/five_mass_chain"


@pytest.fixture
def example(tmp_path):
    """The example with five repeats in its tables; the sensor 3x is reversed in the second of them."""
    folder = tmp_path / "mast"
    write_example(folder)
    rng = np.random.default_rng(1)
    modes, shapes = (pd.read_csv(folder / name, comment="#") for name in ("modes.csv", "shapes.csv"))
    many_modes, many_shapes = [], []
    for k in range(1, 6):
        freq = modes["freq"] * (1 + 0.003 * rng.normal(size=len(modes)))
        many_modes.append(modes.assign(freq=freq, repeat=k).drop(columns=["freq_std", "damping_std"]))
        re = shapes["re"] + 0.01 * rng.normal(size=len(shapes))
        reversed_here = (shapes["node"] == 3) & (shapes["direction"] == "x") & (k == 2)
        many_shapes.append(shapes.assign(re=re.where(~reversed_here, -re), repeat=k).drop(columns=["std"]))
    pd.concat(many_modes).to_csv(folder / "modes.csv", index=False)
    pd.concat(many_shapes).to_csv(folder / "shapes.csv", index=False)
    return folder


def pooling(folder, kind):
    file = folder / "study.toml"
    text = file.read_text()
    assert "[held_out]" in text
    file.write_text(text.replace("[held_out]", f'pooling = "{kind}"\n\n[held_out]', 1))


@pytest.mark.slow
def test_a_reversed_channel_in_one_repeat(example, tmp_path):
    study = LoadedStudy.load(example)
    results = Results.at(tmp_path / "results", study.name)
    compare(study, results)
    table = pd.read_csv(results.path / "repeat_disagreements.csv")
    assert table[["kind", "sensor", "left_out"]].to_numpy().tolist() == [["sensor", "3x", True]]
    assert "repeat 2" in table.loc[0, "repeat"]
    assert table.loc[0, "value"] == pytest.approx(-1, abs=0.1)
    assert len(check_repeats(study)) == 1
    measured = pd.read_csv(results.path / "measured.csv")
    assert measured["repeats"].tolist() == [5] * 4
    pooling(example, "plain")
    plain = LoadedStudy.load(example)
    assert [d.left_out for d in plain.disagreements] == [False]
    inflated, clean = (std_for(s.measured).shape.mean() for s in (plain, study))
    assert inflated > 3 * clean
    assert plain.measured.fingerprint != study.measured.fingerprint


@pytest.mark.medium
def test_an_outlying_response_is_reported_by_an_explanation(tmp_path):
    folder = tmp_path / "chain"
    shutil.copytree(CHAIN, folder)
    given = pd.read_csv(folder / "measured.csv", comment="#")
    rng = np.random.default_rng(2)
    runs = []
    for k in range(6):
        own = given["value"] + np.sqrt(6) * given["std"] * rng.normal(size=len(given))
        own[0] *= 1.5 if k == 3 else 1.0
        runs.append(pd.DataFrame({"response": given["response"], "value": own, "repeat": k}))
    pd.concat([*runs[:5], runs[5].drop(index=1)]).to_csv(folder / "measured.csv", index=False)
    study = LoadedStudy.load(folder)
    assert [(d.mode, d.left_out) for d in study.disagreements] == [(given["response"][0], True)]
    assert study.repeats == 5
    assert [study.experiment.measured.counts[n] for n in given["response"][:3]] == [5, 5, 6]
    answer = explain(study, Results.at(tmp_path / "results", study.name))
    assert check_repeats(study)[0] in answer.notes
