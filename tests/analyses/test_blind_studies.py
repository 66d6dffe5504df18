"""The blind studies of the bogie: the truth is read only after the verdict is written."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli
from calib.execution import team
from calib.missing.local import interval_words
from calib.missing.recommendation import rounded
from calib.results.results import Results

ROOT = Path(__file__).resolve().parents[2]
HIDDEN, NONE, OUTSIDE = "hidden_bogie", "hidden_bogie_none", "hidden_bogie_outside"
THREE = "hidden_three"
EACH = [HIDDEN, NONE, OUTSIDE]
# test_explain.py covers the same with smaller structures.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def explained(blindly, with_basis, tmp_path_factory):
    """The folder of results of each study, explained once."""
    done = {}

    def make(name):
        if name not in done:
            done[name] = blindly(name, with_basis(Results.at(tmp_path_factory.mktemp("blind"), name)))
        return done[name]

    return make


def written(folder):
    """Summary, effects, errors by group and stage, as written."""
    summary = json.loads((folder / "explanation.json").read_text("utf-8"))
    effects = pd.read_csv(folder / "effects.csv", keep_default_na=False, na_values=[""]).set_index("name")
    errors = pd.read_csv(folder / "errors.csv").set_index(["group", "stage"])
    return summary, effects, errors


def truth(name):
    return json.loads((ROOT / f"tests/truth/{name}.json").read_text("utf-8"))


@pytest.mark.whole
def test_the_answer_is_the_same_for_any_number_of_workers(tmp_path, monkeypatch):
    """With nothing kept, so that the basis is trained in one process and in two; apart from the time it took."""
    monkeypatch.setattr(team, "_WORTH", 0.0)
    answers = []
    for workers in ("1", "2"):
        home = tmp_path / workers
        asked = ["--results", str(home), "--cache", str(home / "cache"), "--workers", workers]
        assert cli.execute(["explain", str(ROOT / "studies" / HIDDEN), *asked]) == 0
        summary = json.loads((home / HIDDEN / "explanation.json").read_text("utf-8"))
        assert summary.pop("seconds") > 0
        files = sorted((home / HIDDEN).glob("*.csv")) + sorted((home / HIDDEN).glob("basis_*.npz"))
        answers.append((summary, {file.name: file.read_bytes() for file in files}))
    assert len(answers[0][1]) > 20
    assert answers[0] == answers[1]


# -- an effect of the library ------------------------------------------------------------------------------------------


def test_the_hidden_effect_is_named_and_no_other(explained):
    summary, effects, _ = written(explained(HIDDEN))
    assert summary["verdict"] == "effect" and len(summary["credible_set"]) == 1
    hidden = truth(HIDDEN)
    assert summary["credible_set"] == hidden["effects"]
    (name,) = hidden["effects"]
    assert effects.index[0] == name and summary["chosen"] == [name]
    assert effects.loc[name, "model_probability"] > 0.95 and effects["credible"].sum() == 1
    assert effects.drop(name)["ln_bayes"].max() < effects.loc[name, "ln_bayes"] - 3
    assert name.replace("_", " ") in " ".join(summary["sentences"]).lower()
    assert summary["sentences"][0] == summary["sentence"].split(". ")[0] + "."


def test_the_interval_of_the_magnitude_covers_the_truth(explained):
    _, effects, _ = written(explained(HIDDEN))
    hidden = truth(HIDDEN)
    row = effects.loc[hidden["effects"][0]]
    magnitude = hidden["magnitudes"][hidden["effects"][0]]
    assert row["magnitude_low"] <= magnitude <= row["magnitude_high"]
    assert row["magnitude_high"] - row["magnitude_low"] < magnitude and abs(row["magnitude"] / magnitude - 1) < 0.2


def test_other_parameters_are_found_with_it(explained):
    """Actuator positions are right, and no parameter is off by more than chance."""
    folder = explained(HIDDEN)
    pulls = pd.read_csv(folder / "pulls.csv")
    hidden = truth(HIDDEN)
    after = pulls[pulls["model"] == hidden["effects"][0]].set_index("parameter")
    off = (after["value"] - pd.Series(hidden["parameters"])[after.index]) / after["prior_sd"]
    assert len(after) == 10 and (off.abs() < 2.0).all()
    before = pulls[pulls["model"] == "base"]
    assert before["pulled"].any() and not after["pulled"].any()


def test_held_out_data_are_predicted_to_the_noise(explained):
    _, _, errors = written(explained(HIDDEN))
    rms, expected, p = errors["rms"], errors["expected"], errors["p"]
    assert rms["held_out_sensors", "after"] <= 1.10 * expected["held_out_sensors", "after"]
    assert rms["held_out_sensors", "before"] > 1.5 * expected["held_out_sensors", "before"]
    assert p["held_out_modes", "after"] > 0.01 and rms["held_out_modes", "after"] < rms["held_out_modes", "before"]
    assert rms["left_out", "after"] < 0.5 * rms["left_out", "before"]
    assert p["fit", "before"] < 1e-6 < 0.01 < p["fit", "after"]


@pytest.mark.parametrize("name", EACH)
def test_the_cost_the_basis_and_the_mesh_are_within_bounds(explained, name):
    summary, *_ = written(explained(name))
    # Where nothing is named, places of the actuators are tried by fits: eight neighbours for each step, not charged.
    assert 0 < summary["evaluations"] <= (150 if name != OUTSIDE else 300)
    assert 0 < summary["basis_error"] <= 0.05
    assert 0 < summary["discretisation"] <= 1.0
    assert any("neither hides nor mimics an effect" in note for note in summary["notes"])


@pytest.mark.parametrize("name", EACH)
def test_the_sentence_agrees_with_the_tables(explained, name):
    folder = explained(name)
    summary, effects, errors = written(folder)
    text = summary["sentence"]
    local = len(set(pd.read_csv(folder / "perturbations.csv")["perturbation"]))
    # Faults of pairs have a limit of their own.
    faults = pd.read_csv(folder / "faults.csv")["limit"].value_counts().iloc[0]
    assert faults == summary["faults"] > 50
    counts = f"{len(effects)} effects, {local} local stiffness or mass changes and {faults} measurement errors"
    assert f"largest score of {counts}" in text
    assert local == summary["local_perturbations"] > 100
    for effect, row in effects[~effects["visible"]].iterrows():
        unit = "" if row["unit"] == "-" else f" {row['unit']}"
        hopeless = row["magnitude_min"] > row["largest"]
        words = effect.replace("_", " ")
        assert (
            f"{words} of any possible" if hopeless else f"{words} below {rounded(row['magnitude_min'])}{unit}"
        ) in text
    if summary["chosen"] and summary["verdict"] == "effect":
        row = effects.loc[summary["chosen"][0]]
        assert interval_words(row["magnitude"], row["magnitude_low"], row["magnitude_high"], row["unit"]) in text
        for group, words in (("held_out_sensors", "validation sensors"), ("held_out_modes", "validation modes")):
            before, after = errors["rms"][group, "before"], errors["rms"][group, "after"]
            assert f"{words} {before:.2f} -> {after:.2f}" in text
    assert not re.search(r"\bnan\b|R2|R\^2", text)


# -- no missing effect -------------------------------------------------------------------------------------------------


def test_nothing_is_named_where_nothing_is_missing(explained):
    summary, effects, errors = written(explained(NONE))
    assert summary["verdict"] == "nothing_detectable"
    assert summary["credible_set"] == [] == summary["chosen"] and not effects["credible"].any()
    assert truth(NONE)["effects"] == []
    assert summary["p_family"] > 0.01 and summary["p_fit"] > 0.01
    assert set(errors.reset_index()["stage"]) == {"before"}
    assert errors["p"]["held_out_modes", "before"] > 0.01 and errors["p"]["held_out_sensors", "before"] > 0.01


def test_the_smallest_detectable_magnitude_is_reported_for_every_effect(explained):
    _, effects, _ = written(explained(NONE))
    assert len(effects) == 16 and effects["magnitude_min"].notna().all() and (effects["magnitude_min"] > 0).all()
    assert effects["visible"].any() and not effects["visible"].all()
    assert (effects["visible"] == (effects["magnitude_min"] <= effects["plausible"])).all()


# -- an effect outside the library -------------------------------------------------------------------------------------


def test_an_effect_outside_the_library_is_not_misnamed(explained):
    summary, effects, _ = written(explained(OUTSIDE))
    assert summary["verdict"] in ("none_explains", "partial")
    assert summary["credible_set"] == [] and not effects["credible"].any()
    assert not set(truth(OUTSIDE)["effects"]) & set(effects.index)
    assert summary["p_family"] <= 0.01 or summary["p_fit"] <= 0.01
    assert "Look for" not in summary["sentence"]
    assert not any(name in summary["sentences"][0] for name in effects.index)


def test_the_indicated_location_is_near_the_change(explained):
    """Stiffer rods at the rear axle show at the rear axle and its boxes."""
    folder = explained(OUTSIDE)
    tried = pd.read_csv(folder / "candidate_fits.csv", keep_default_na=False)
    perturbations = pd.read_csv(folder / "perturbations.csv", keep_default_na=False).set_index("perturbation")
    (place,) = [name for name in tried["effects"] if name in perturbations.index]
    assert truth(OUTSIDE)["effects"] == ["stiff_rear_rods"] and perturbations.loc[place, "x"] < 0


# -- the next version of the model -------------------------------------------------------------------------------------


@pytest.mark.whole
def test_the_extended_model_predicts_held_out_sensors_better(explained, tmp_path, capsys, monkeypatch):
    """Explain, extend, calibrate by least squares, and the errors over both versions."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    results = explained(HIDDEN).parent
    (name,) = written(explained(HIDDEN))[0]["credible_set"]
    study = str(ROOT / "studies" / HIDDEN)
    assert cli.execute(["extend", study, name, "--into", "bogie_2"]) == 0
    with Path("bogie_2/study.toml").open("a") as file:
        file.write('\n[calibration]\nmethod = "gauss-newton"\ncases = [{ name = "GB1", seed = 1 }]\n')
    assert cli.execute(["calibrate", "bogie_2", "--results", str(results), "--workers", "1"]) == 0
    assert cli.execute(["report", "bogie_2", "--results", str(results)]) == 0
    assert "Errors in standard deviations over the versions of the model" in capsys.readouterr().out
    table = pd.read_csv(results / "bogie_2/versions.csv", keep_default_na=False)
    assert list(table["study"].unique()) == [HIDDEN, "bogie_2"]
    assert list(table["effects"].unique()) == ["", name]
    rms, expected = (table.set_index(["group", "version"])[c] for c in ("rms", "expected"))
    for group in ("fit", "left_out", "held_out_sensors"):
        assert rms[group, 2] < rms[group, 1]
    assert rms["held_out_sensors", 2] <= 1.10 * expected["held_out_sensors", 2]
    values = pd.read_csv(results / "bogie_2/parameters.csv").set_index("parameter")
    hidden = truth(HIDDEN)
    assert abs(values.loc[name, "value"] / hidden["magnitudes"][name] - 1) < 0.2
    for place in ("pos_long_left", "pos_long_right"):
        assert values.loc[place, "value"] == hidden["parameters"][place]


# -- three effects at once ---------------------------------------------------------------------------------------------


@pytest.mark.whole
def test_three_effects_that_were_built_into_the_mesh_are_found_one_after_the_other(explained):
    folder = explained(THREE)
    summary, effects, errors = written(folder)
    hidden = truth(THREE)
    assert summary["verdict"] == "several_effects" and len(hidden["effects"]) == 3
    assert set(summary["credible_set"]) == set(summary["chosen"]) == set(hidden["effects"])
    for name, true in hidden["magnitudes"].items():
        assert effects.loc[name, "magnitude_low"] <= true <= effects.loc[name, "magnitude_high"]
    steps = pd.read_csv(folder / "steps.csv", keep_default_na=False)
    assert steps["effects"].iloc[0] == "none" and set(steps["effects"].iloc[-1].split(" + ")) == set(hidden["effects"])
    assert steps["ln_bayes"].is_monotonic_increasing and (steps["p_family"].iloc[:-1] < 0.01).all()
    along = pd.read_csv(folder / "steps_errors.csv").pivot(index="step", columns="group", values="rms")
    first, last = along.iloc[0], along.iloc[-1]
    assert (last < first).all() and (last < 1.1).all() and len(along) == len(steps)
    for group in along.columns:
        assert errors["rms"][group, "before"] == pytest.approx(first[group])
        assert errors["rms"][group, "after"] == pytest.approx(last[group])
    rejected = pd.read_csv(folder / "steps_rejected.csv", keep_default_na=False)
    assert len(rejected) and not set(rejected["effect"]) & set(hidden["effects"])
