"""Explanations of studies: the verdict, and the summary ``explanation.json``."""

import json
import math
import re
import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses import explain as asked
from calib.analyses.explain import GROUPS, explain, explanation_summary
from calib.missing.local import interval_words, local_perturbation
from calib.missing.profile import profile_interval
from calib.results.results import Results
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
KEYS = {
    "study", "synthetic", "verdict", "sentence", "sentences", "notes", "alpha", "p_family", "p_fit", "credible_set",
    "effects", "chosen", "chosen_values", "adequacy_p", "adequacy_p_family", "adequacy_p_fit", "noise_scale",
    "measured_noise_scale", "local_perturbations", "local_perturbation", "evaluations", "begun_anew",
    "accuracy", "std_assumed", "accuracy_that_explains", "place", "misfit_at", "measurement_fault", "wrong_datum",
    "refused", "nearly", "doubts", "to_add",
    "faults", "pair_faults", "blamed", "evaluations_intervals", "evaluations_recommendation", "errors", "seconds",
}  # fmt: skip


# -- verdicts ----------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_the_rope_is_named_with_its_magnitude(guyed):
    _, _, answer, _ = guyed
    assert answer.verdict == "effect" and answer.explanation.credible == ("guy",)
    row = answer.effects.iloc[0]
    assert row["name"] == "guy" and row["magnitude_low"] <= 12000.0 <= row["magnitude_high"]
    sized = interval_words(row["magnitude"], row["magnitude_low"], row["magnitude_high"], "N/m")
    assert f"'Guy rope along x', {sized}" in answer.answer.found and "Look at 4.5 m." in answer.answer.then


@pytest.mark.parametrize(
    "hidden",
    [pytest.param(one, marks=pytest.mark.slow) for one in ({"stuck_base": 0.8}, {"platform": 25.0}, {"lamp": 25.0})],
)
def test_other_effects_are_named_too(mast, tmp_path, hidden):
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast", hidden))
    answer = explain(study, Results.at(tmp_path / "results", study.name))
    ((name, magnitude),) = hidden.items()
    assert answer.explanation.credible == (name,)
    row = answer.effects.set_index("name").loc[name]
    assert row["magnitude_low"] <= magnitude <= row["magnitude_high"]


@pytest.mark.medium
def test_without_a_missing_effect_none_is_named(bare):
    *_, answer = bare
    assert answer.verdict == "nothing_detectable" and answer.explanation.credible == ()
    assert np.isfinite(answer.effects["magnitude_min"]).all() and not answer.effects["refitted"].any()
    assert "Error in units" not in answer.sentence


@pytest.mark.medium
def test_the_mass_hung_on_the_chain_is_named(chain):
    truth = json.loads((ROOT / "tests/truth/five_mass_chain.json").read_text("utf-8"))
    *_, answer = chain
    assert answer.verdict == "effect" and answer.explanation.credible == (truth["effect"],)
    row = answer.effects.iloc[0]
    assert row["magnitude_low"] <= truth["magnitude"][truth["effect"]] <= row["magnitude_high"]
    assert not set(truth["parameters"]) & set(answer.effects["name"])


@pytest.fixture
def heavier(chain_folder, tmp_path):
    """The chain with the held mass 3 a sixth heavier, which is no effect of the library."""
    study = LoadedStudy.load(chain_folder)
    table = pd.read_csv(chain_folder / "measured.csv", comment="#").set_index("response")
    values = study.model.space.values
    table["value"] = pd.Series(study.model.function(values | {"m3": values["m3"] * 7 / 6}))[table.index]
    table.to_csv(chain_folder / "measured.csv")
    return explain(LoadedStudy.load(chain_folder), Results.at(tmp_path / "results", "chain"))


@pytest.mark.slow
def test_a_wrong_mass_that_no_effect_describes_is_located(heavier):
    assert heavier.verdict == "none_explains" and heavier.explanation.credible == ()
    change = local_perturbation(heavier.explanation.perturbation)
    assert change.effect.name == "change of m3" and change.low < 1 / 6 < change.high
    assert change.in_words.startswith("m3, about ") and f"{change.in_words}; it fits better" in heavier.sentence


@pytest.mark.slow
def test_indistinguishable_effects_are_named_with_a_measurement_that_discriminates(mast, tmp_path):
    """Two masses near each other, with few data: the recommendation is to discriminate between them."""
    folder = mast.write_study(tmp_path / "mast", {"platform": 3.0})
    text = (folder / "effects.py").read_text()
    near = text.replace('"Lamp near the top", 4.5', '"Lamp near the platform", 3.4')
    assert near != text
    (folder / "effects.py").write_text(near)
    study = LoadedStudy.load(folder)
    answer = explain(study, Results.at(tmp_path / "results", "mast"))
    assert answer.verdict == "indistinguishable" and set(answer.explanation.credible) == {"platform", "lamp"}
    either = "(platform and lamp|lamp and platform)"
    assert re.search(rf"odds of (over )?[\d.,:]+ for the true one of {either} \(", answer.sentence)
    assert "To tell them apart, " in answer.sentence or "No measurement looked at would tell" in answer.sentence
    promised = answer.tables["next_measurement"]
    assert promised["chance"].between(0, 1).all()
    assert (promised["ln_bayes_low"] < promised["ln_bayes_high"]).all()
    assert (promised["gain_low"] <= promised["gain_high"]).all()
    table = answer.effects.set_index("name")
    assert table.loc["platform", "confounded_with"] == "lamp"
    for candidate_fit in answer.explanation.singles[:2]:  # intervals of both by profile likelihood
        row = table.loc[candidate_fit.names[0]]
        assert (row["magnitude_low"], row["magnitude_high"]) == pytest.approx(
            profile_interval(candidate_fit.fit, candidate_fit.names[0])
        )
        assert row["magnitude_low"] < row["magnitude"] < row["magnitude_high"]
    assert math.isfinite(table.loc["lamp", "held_out_gain"])


@pytest.mark.slow
def test_settings_of_the_study_reach_the_decision(mast, edited, tmp_path, monkeypatch):
    seen = []
    inner = asked.engine.decide
    monkeypatch.setattr(asked.engine, "decide", lambda h, s, p: seen.append(s) or inner(h, s, p))
    own = "[explain]\nalpha = 0.02\nrefits = 3\nmerge = 0.9\nseed = 7\n\n[calibration]"
    folder = edited(mast.write_study(tmp_path / "mast"), "[calibration]", own)
    explain(LoadedStudy.load(folder), Results.at(tmp_path / "results", "mast"))
    assert (seen[0].alpha, seen[0].refits, seen[0].merge, seen[0].seed) == (0.02, 3, 0.9, 7)


# -- summary -----------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_the_summary_has_the_documented_keys(guyed, bare, chain):
    for study, results, answer in (guyed[:3], bare, chain):
        content = json.loads((results.path / "explanation.json").read_text())
        more = {"failed"} if study is chain[0] else {"basis_error"}
        assert set(content) == KEYS | more == set(explanation_summary(study, answer))
        assert content["study"] == study.name and content["synthetic"] is True
        assert content["verdict"] == answer.verdict and content["sentence"] == answer.sentence
        assert content["notes"] == list(answer.notes) and content["credible_set"] == list(answer.explanation.credible)
        assert content["evaluations"] == answer.explanation.evaluations and content["seconds"] == answer.seconds > 0
        assert set(content["errors"]) == set(GROUPS)
        assert [e["name"] for e in content["effects"]] == list(answer.effects["name"])


@pytest.mark.medium
def test_every_key_of_the_summary_is_documented(guyed, chain):
    documented = runpy.run_path(str(ROOT / "tests/docs/tables.py"))["documented"]()["explanation.json"]
    for results in (guyed[1], chain[1]):
        assert set(json.loads((results.path / "explanation.json").read_text())) <= set(documented)


@pytest.mark.medium
def test_the_summary_holds_the_chosen_effects(guyed, bare):
    content = json.loads((guyed[1].path / "explanation.json").read_text())
    found = guyed[2].explanation
    assert content["chosen"] == content["to_add"] == ["guy"]
    assert content["chosen_values"] == {"guy": found.chosen.fit.values["guy"]}
    assert content["adequacy_p"] == min(found.chosen_adequacy.p_family, found.chosen_adequacy.p_fit) > 0.01
    assert content["p_family"] == found.base_adequacy.p_family < 0.001 and content["p_fit"] == found.base_adequacy.p_fit
    empty = json.loads((bare[1].path / "explanation.json").read_text())
    assert empty["chosen"] == empty["to_add"] == [] and empty["chosen_values"] == {} and empty["adequacy_p"] is None
    assert empty["errors"]["fit"]["after"] is None and empty["errors"]["held_out_modes"] == {
        "before": None,
        "after": None,
    }


def test_the_sentence_gives_the_errors_of_the_table(guyed):
    answer = guyed[2]
    by = answer.errors.set_index(["group", "stage"])
    for group, words in (
        ("left_out", "data left out in turn"),
        ("held_out_sensors", "validation sensors"),
        ("held_out_modes", "validation modes"),
    ):
        before, after = by.loc[(group, "before")], by.loc[(group, "after")]
        assert (
            f"{words} {before['rms']:.2f} -> {after['rms']:.2f} (noise floor {after['expected']:.2f})"
            in answer.sentence
        )


def test_progress_is_reported_in_order(guyed):
    *_, progress = guyed
    wanted = [
        "calibrating the base model",
        "testing whether anything is missing",
        "intervals and leave-one-out errors",
        "validation data",
        "what to measure next",
        "discretisation error",
    ]
    assert [words for words in dict.fromkeys(progress) if words in wanted] == wanted
    assert "fitting Guy rope along x" in progress


@pytest.mark.slow
def test_where_the_rest_of_a_nearly_explained_misfit_sits_is_told_and_kept(mast, tmp_path, monkeypatch):
    monkeypatch.setattr("calib.missing.partial.is_simpler_form", lambda found: found.chosen is not None)
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast", {"guy": 12000.0}))
    answer = explain(study, Results.at(tmp_path / "results", study.name))
    kept = json.loads((tmp_path / "results/mast/explanation.json").read_text("utf-8"))["left"]
    assert set(kept) == {"near", "distance", "modes", "modes_expected"}
    assert kept["near"] is None or any(s.startswith("What is left sits ") for s in answer.sentences)
