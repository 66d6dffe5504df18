"""What is answered about what a study's model lacks: the verdict, and the summary that is written of it."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.missing.local import local_change
from calib.missing.profile import profile_interval
from calib.questions import explain as asked
from calib.questions.explain import explain
from calib.questions.explanation import GROUPS, summary
from calib.results import Results
from calib.study import Study

ROOT = Path(__file__).resolve().parents[2]
KEYS = {
    "study", "synthetic", "verdict", "sentence", "sentences", "notes", "p_family", "p_fit", "credible_set", "effects",
    "chosen",
    "adequacy_p_family", "adequacy_p_fit",
    "chosen_values", "adequacy_p", "noise_scale", "measured_noise_scale", "local_changes", "local_change",
    "evaluations", "begun_anew",
    "accuracy", "scatter_assumed", "accuracy_that_explains", "misfit_at", "measurement_fault", "wrong_datum", "refused",
    "evaluations_intervals", "evaluations_advice", "errors", "seconds",
}  # fmt: skip


# -- verdicts ----------------------------------------------------------------------------------------------------------


def test_the_rope_is_named_with_its_strength(guyed):
    _, _, answer, _ = guyed
    assert answer.verdict == "effect" and answer.findings.credible == ("guy",)
    row = answer.effects.iloc[0]
    assert row["name"] == "guy" and row["phi_low"] <= 12000.0 <= row["phi_high"]
    assert f"Guy rope along x (guy), {row['phi']:.3g} N/m" in answer.sentence and "Look at 4.5 m." in answer.sentence


@pytest.mark.parametrize("hidden", [{"platform": 25.0}, {"lamp": 25.0}, {"stuck_base": 0.8}])
def test_other_effects_are_named_too(mast, tmp_path, hidden):
    study = Study.load(mast.write_study(tmp_path / "mast", hidden))
    answer = explain(study, Results.at(tmp_path / "results", study.name))
    ((name, strength),) = hidden.items()
    assert answer.findings.credible == (name,)
    row = answer.effects.set_index("name").loc[name]
    assert row["phi_low"] <= strength <= row["phi_high"]


def test_a_mast_that_lacks_nothing_names_nothing(bare):
    *_, answer = bare
    assert answer.verdict == "nothing_detectable" and answer.findings.credible == ()
    assert np.isfinite(answer.effects["phi_min"]).all() and not answer.effects["refitted"].any()
    assert "Error in units" not in answer.sentence


def test_what_swings_on_the_chain_is_named(chain):
    truth = json.loads((ROOT / "tests/truth/five_mass_chain.json").read_text("utf-8"))
    *_, answer = chain
    assert answer.verdict == "effect" and answer.findings.credible == (truth["effect"],)
    row = answer.effects.iloc[0]
    assert row["phi_low"] <= truth["strength"][truth["effect"]] <= row["phi_high"]
    assert not set(truth["parameters"]) & set(answer.effects["name"])


@pytest.fixture
def heavier(chain_folder, tmp_path):
    """The chain as it would answer if mass 3, which is held, were a sixth heavier: nothing that is listed."""
    study = Study.load(chain_folder)
    table = pd.read_csv(chain_folder / "measured.csv", comment="#").set_index("response")
    values = study.model.space.values
    table["value"] = pd.Series(study.model.function(values | {"m3": values["m3"] * 7 / 6}))[table.index]
    table.to_csv(chain_folder / "measured.csv")
    return explain(Study.load(chain_folder), Results.at(tmp_path / "results", "chain"))


def test_a_wrong_weight_that_no_effect_describes_is_pointed_at(heavier):
    assert heavier.verdict == "none_explains" and heavier.findings.credible == ()
    change = local_change(heavier.findings.atom)
    assert change.effect.name == "change of m3" and change.low < 1 / 6 < change.high
    assert change.told.startswith("m3, about ") and f"{change.told}, fits better" in heavier.sentence


def test_those_that_cannot_be_told_apart_are_told_with_what_would(mast, tmp_path):
    """Two masses near each other, with few data: the advice is about telling these two apart."""
    folder = mast.write_study(tmp_path / "mast", {"platform": 3.0})
    text = (folder / "effects.py").read_text()
    near = text.replace('"Lamp near the top", 4.5', '"Lamp near the platform", 3.4')
    assert near != text
    (folder / "effects.py").write_text(near)
    study = Study.load(folder)
    answer = explain(study, Results.at(tmp_path / "results", "mast"))
    assert answer.verdict == "indistinguishable" and set(answer.findings.credible) == {"platform", "lamp"}
    assert re.search(r"odds of [\d.,:]+ for the true one of (platform and lamp|lamp and platform) \(", answer.sentence)
    assert (
        "To tell them apart, measure next: " in answer.sentence
        or "No measurement looked at would tell" in answer.sentence
    )
    promised = answer.tables["next_measurement"]
    assert promised["chance"].between(0, 1).all()
    assert (promised["ln_bayes_low"] < promised["ln_bayes_high"]).all()
    assert (promised["gain_low"] <= promised["gain_high"]).all()
    table = answer.effects.set_index("name")
    assert table.loc["platform", "confounded_with"] == "lamp"
    for trial in answer.findings.singles[:2]:  # intervals of both by profile likelihood
        row = table.loc[trial.names[0]]
        assert (row["phi_low"], row["phi_high"]) == pytest.approx(profile_interval(trial.state, trial.names[0]))
        assert row["phi_low"] < row["phi"] < row["phi_high"]
    assert math.isfinite(table.loc["lamp", "heldout_gain"])


def test_settings_of_the_study_reach_the_decision(mast, edited, tmp_path, monkeypatch):
    seen = []
    inner = asked.engine.explain
    monkeypatch.setattr(asked.engine, "explain", lambda h, s, p: seen.append(s) or inner(h, s, p))
    own = "[explain]\nalpha = 0.02\nrefits = 3\nmerge = 0.9\nseed = 7\n\n[calibration]"
    folder = edited(mast.write_study(tmp_path / "mast"), "[calibration]", own)
    explain(Study.load(folder), Results.at(tmp_path / "results", "mast"))
    assert (seen[0].alpha, seen[0].refits, seen[0].merge, seen[0].seed) == (0.02, 3, 0.9, 7)


# -- summary -----------------------------------------------------------------------------------------------------------


def test_the_summary_has_the_documented_keys(guyed, bare, chain):
    for study, results, answer in (guyed[:3], bare, chain):
        content = json.loads((results.path / "explanation.json").read_text())
        more = {"failed"} if study is chain[0] else {"basis_error"}
        assert set(content) == KEYS | more == set(summary(study, answer))
        assert content["study"] == study.name and content["synthetic"] is True
        assert content["verdict"] == answer.verdict and content["sentence"] == answer.sentence
        assert content["notes"] == list(answer.notes) and content["credible_set"] == list(answer.findings.credible)
        assert content["evaluations"] == answer.findings.evaluations and content["seconds"] == answer.seconds > 0
        assert set(content["errors"]) == set(GROUPS)
        assert [e["name"] for e in content["effects"]] == list(answer.effects["name"])


def test_the_read_me_documents_every_key_of_the_summary(guyed, chain):
    readme = (ROOT / "README.md").read_text("utf-8")
    (row,) = [line for line in readme.splitlines() if line.startswith("| `explanation.json`")]
    documented = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]*)`", row))))
    for results in (guyed[1], chain[1]):
        assert set(json.loads((results.path / "explanation.json").read_text())) <= documented


def test_the_summary_tells_what_was_chosen(guyed, bare):
    content = json.loads((guyed[1].path / "explanation.json").read_text())
    found = guyed[2].findings
    assert content["chosen"] == ["guy"] and content["chosen_values"] == {"guy": found.chosen.state.values["guy"]}
    assert content["adequacy_p"] == min(found.chosen_check.p_family, found.chosen_check.p_fit) > 0.01
    assert content["p_family"] == found.base_check.p_family < 0.001 and content["p_fit"] == found.base_check.p_fit
    empty = json.loads((bare[1].path / "explanation.json").read_text())
    assert empty["chosen"] == [] and empty["chosen_values"] == {} and empty["adequacy_p"] is None
    assert empty["errors"]["fit"]["after"] is None and empty["errors"]["withheld_modes"] == {
        "before": None,
        "after": None,
    }


def test_the_sentence_tells_the_errors_of_the_table(guyed):
    answer = guyed[2]
    by = answer.errors.set_index(["group", "stage"])
    for group, words in (
        ("left_out", "data left out in turn"),
        ("withheld_sensors", "withheld sensors"),
        ("withheld_modes", "withheld modes"),
    ):
        before, after = by.loc[(group, "before")], by.loc[(group, "after")]
        assert (
            f"{words} {before['rms']:.2f} -> {after['rms']:.2f} (noise floor {after['expected']:.2f})"
            in answer.sentence
        )


def test_progress_is_told_in_order(guyed):
    *_, told = guyed
    wanted = [
        "calibrating the base model",
        "testing whether anything is missing",
        "intervals and data that were left out",
        "withheld data",
        "what to measure next",
        "what the discretisation alone would look like",
    ]
    assert [words for words in told if words in wanted] == wanted and "fitting Guy rope along x" in told
