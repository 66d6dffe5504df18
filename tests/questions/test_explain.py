"""Everything that is told and written about what a study's model lacks."""

import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.errors import EvaluationError, InputError
from calib.missing.left_out import left_out
from calib.missing.profile import profile_interval
from calib.missing.tables import EFFECT_COLUMNS
from calib.questions import explain as asked
from calib.questions.explain import GROUPS, explain, summary
from calib.results import Results
from calib.study import Study

ROOT = Path(__file__).resolve().parents[2]
CHAIN = ROOT / "studies/five_mass_chain"
ERRORS = ["group", "stage", "rows", "rms", "expected", "p", "unpaired"]
KEYS = {
    "study", "synthetic", "verdict", "sentence", "notes", "p_family", "p_fit", "credible_set", "effects", "chosen",
    "chosen_values", "adequacy_p", "noise_scale", "measured_noise_scale", "local_changes", "evaluations", "errors",
    "seconds",
}  # fmt: skip
COMMON = {"effects", "errors", "atoms", "confounding", "strain", "misfit_kinds", "tried", "next_measurement"}
MODAL = COMMON | {"sensor_misfit", "structure"}


def edit(folder, **changes):
    """A study folder with lines of its study file replaced."""
    text = (folder / "study.toml").read_text()
    for old, new in changes.values():
        assert old in text, old
        text = text.replace(old, new)
    (folder / "study.toml").write_text(text)
    return folder


HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')


@pytest.fixture(scope="module")
def guyed(mast, tmp_path_factory):
    """A mast with a guy rope that its model lacks; one mode and two sensors are withheld."""
    folder = tmp_path_factory.mktemp("guyed")
    study = Study.load(edit(mast.write_study(folder / "mast", {"guy": 9000.0}), held=HELD))
    results, told = Results.at(folder / "results", study.name), []
    return study, results, explain(study, results, told.append), told


@pytest.fixture(scope="module")
def bare(mast, tmp_path_factory):
    """A mast that lacks nothing."""
    folder = tmp_path_factory.mktemp("bare")
    study = Study.load(mast.write_study(folder / "mast"))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """The chain without matrices."""
    study = Study.load(CHAIN)
    results = Results.at(tmp_path_factory.mktemp("chain"), study.name)
    return study, results, explain(study, results)


def saved(results, name):
    return pd.read_csv(results.path / f"{name}.csv", keep_default_na=False, na_values=[""])


# -- verdicts ----------------------------------------------------------------------------------------------------------


def test_the_rope_is_named_with_its_strength(guyed):
    _, _, answer, _ = guyed
    assert answer.verdict == "effect" and answer.findings.credible == ("guy",)
    row = answer.effects.iloc[0]
    assert row["name"] == "guy" and row["phi_low"] <= 9000.0 <= row["phi_high"]
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
def heavier(tmp_path):
    """The chain as it would answer if mass 3, which is held, were a sixth heavier: nothing that is listed."""
    shutil.copytree(CHAIN, tmp_path / "chain", ignore=shutil.ignore_patterns("__pycache__", "results"))
    study = Study.load(tmp_path / "chain")
    table = pd.read_csv(tmp_path / "chain/measured.csv", comment="#").set_index("response")
    values = study.model.space.values
    table["value"] = pd.Series(study.model.function(values | {"m3": values["m3"] * 7 / 6}))[table.index]
    table.to_csv(tmp_path / "chain/measured.csv")
    return explain(Study.load(tmp_path / "chain"), Results.at(tmp_path / "results", "chain"))


def test_a_wrong_weight_that_no_effect_describes_is_pointed_at(heavier):
    assert heavier.verdict == "none_explains" and heavier.findings.credible == ()
    assert heavier.findings.atom.names == ("change of m3",) and "change of m3" in heavier.sentence


def test_a_change_is_not_called_a_change_of_a_change(heavier):
    assert "change of the change" not in heavier.sentence


# -- what is written ---------------------------------------------------------------------------------------------------


def test_every_table_is_written_as_it_was_answered(guyed, bare, chain):
    for results, answer, names in (
        (guyed[1], guyed[2], MODAL),
        (bare[1], bare[2], MODAL),
        (chain[1], chain[2], COMMON | {"response_misfit"}),
    ):
        assert {p.stem for p in results.path.glob("*.csv")} == names
        assert {p.name for p in results.path.iterdir() if p.suffix != ".csv"} == {"explanation.json"}
        for name in names:
            table = {"effects": answer.effects, "errors": answer.errors, **answer.tables}[name]
            assert list(saved(results, name).columns) == list(table.columns) and len(saved(results, name)) == len(table)


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


def test_errors_are_told_by_group_before_and_after(guyed, bare):
    _, results, answer, _ = guyed
    table = answer.errors
    assert list(table.columns) == ERRORS == list(saved(results, "errors").columns)
    assert list(zip(table["stage"], table["group"], strict=True)) == [
        (s, g) for s in ("before", "after") for g in GROUPS
    ]
    by = table.set_index(["group", "stage"])["rms"]
    expected = table.set_index(["group", "stage"])["expected"]
    for group in ("fit", "left_out", "withheld_modes"):
        assert by[group, "after"] < by[group, "before"]
    for group in ("fit", "withheld_sensors", "withheld_modes"):
        assert by[group, "after"] < 1.5 * expected[group, "after"]
    content = json.loads((results.path / "explanation.json").read_text())["errors"]
    assert content == {g: {s: by[g, s] for s in ("before", "after")} for g in GROUPS}
    assert set(bare[2].errors["stage"]) == {"before"}


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


def test_effects_have_the_documented_columns(guyed, chain):
    for results in (guyed[1], chain[1]):
        assert tuple(saved(results, "effects").columns) == EFFECT_COLUMNS
    readme = (ROOT / "README.md").read_text("utf-8")
    (row,) = [line for line in readme.splitlines() if line.startswith("| `effects.csv`")]
    documented = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]*)`", row))))
    assert set(EFFECT_COLUMNS) - {"name", "title", "unit", "ln_bayes_third", "ln_bayes_triple"} <= documented


def test_the_read_me_documents_every_key_of_the_summary(guyed, chain):
    readme = (ROOT / "README.md").read_text("utf-8")
    (row,) = [line for line in readme.splitlines() if line.startswith("| `explanation.json`")]
    documented = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]*)`", row))))
    for results in (guyed[1], chain[1]):
        assert set(json.loads((results.path / "explanation.json").read_text())) <= documented


def test_local_changes_are_told_with_their_places(guyed, chain):
    study, results, answer, _ = guyed
    table = saved(results, "atoms")
    assert list(table.columns) == ["atom", "kind", "x", "y", "z", "sensor", "score", "gamma"]
    places = {s.name: s.point for s in study.measured.sensors}
    for row in table[table["sensor"].notna()].to_dict("records"):
        assert (row["x"], row["y"], row["z"]) == places[row["sensor"]] and row["sensor"] in row["atom"]
    scores = answer.findings.base_check.atoms
    np.testing.assert_allclose(table["score"], scores.z, rtol=1e-8, atol=1e-9)
    assert list(table["atom"]) == list(scores.owners) and {"2x", "4z"}.isdisjoint(table["sensor"].dropna())
    plain = saved(chain[1], "atoms")
    assert set(plain["kind"]) == {"parameter"} and plain[["x", "y", "z"]].isna().all(axis=None)


def test_gains_on_data_left_out_are_those_of_the_two_models(guyed):
    *_, answer, _ = guyed
    found = answer.findings
    modes = [row.mode for row in found.base.state.question.inner.rows]

    def density(trial):
        s = trial.state
        return left_out(s.residual, s.slope, s.prior_sd, modes).elpd.sum()

    table = answer.effects.set_index("name")["heldout_gain"]
    for trial in found.singles:
        assert table[trial.names[0]] == pytest.approx(density(trial) - density(found.base))
    assert (
        table["guy"] > 10
        and table[[n for n in table.index if n not in {t.names[0] for t in found.singles}]].isna().all()
    )


def test_misfit_by_sensor_is_that_of_the_fits(guyed, chain):
    _, results, answer, _ = guyed
    table = saved(results, "sensor_misfit")
    for stage, trial in (("base", answer.findings.base), ("explained", answer.findings.chosen)):
        own = table[table["stage"] == stage]
        shapes = [k for k, row in enumerate(trial.state.question.inner.rows) if row.kind == "shape"]
        np.testing.assert_allclose(own["re"], trial.state.residual[shapes], rtol=1e-8, atol=1e-9)
    plain = saved(chain[1], "response_misfit")
    np.testing.assert_allclose(
        plain.loc[plain["stage"] == "base", "residual"], chain[2].findings.base.state.residual, rtol=1e-8
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


def test_asked_twice_the_answer_is_the_same(guyed, tmp_path):
    study, results, _, _ = guyed
    again = Results.at(tmp_path, study.name)
    explain(Study.load(study.file), again)
    for path in results.path.glob("*.csv"):
        assert path.read_bytes() == (again.path / path.name).read_bytes(), path.name


# -- notes -------------------------------------------------------------------------------------------------------------


def test_a_scatter_that_the_file_states_is_noted(bare):
    assert bare[2].notes == ("There are no repeats: the scatter is the one the file states.",)


def test_a_scatter_that_is_assumed_is_noted(mast, tmp_path):
    folder = mast.write_study(tmp_path / "mast")
    for name, drop in (("modes.csv", "freq_std"), ("shapes.csv", "std")):
        pd.read_csv(folder / name, comment="#").drop(columns=drop).to_csv(folder / name, index=False)
    study = Study.load(folder)
    (note,) = explain(study, Results.at(tmp_path / "results", "mast")).notes
    assert "0.5 % of frequencies" in note and "3 % of the largest entry of shapes is assumed" in note


def test_repeats_need_no_note(mast, tmp_path):
    folder = edit(mast.write_study(tmp_path / "mast"), more=('std_of = "mean"', 'std_of = "mean"\nrepeats = 5'))
    assert explain(Study.load(folder), Results.at(tmp_path / "results", "mast")).notes == ()


def test_what_a_finer_mesh_says_is_noted_first(mast, tmp_path):
    folder = edit(
        mast.write_study(tmp_path / "mast"),
        finer=("[calibration]", "[explain]\nfiner_options = { element_size = 0.1 }\n\n[calibration]"),
    )
    results = Results.at(tmp_path / "results", "mast")
    answer = explain(Study.load(folder), results)
    assert answer.notes[0].startswith("A finer mesh of the same model gives scores of up to ")
    table = saved(results, "discretisation")
    content = json.loads((results.path / "explanation.json").read_text())
    assert content["discretisation"] == pytest.approx(table["score"].abs().max()) and content["discretisation"] < 1


def test_an_assumed_scatter_of_plain_responses_is_noted(tmp_path):
    shutil.copytree(CHAIN, tmp_path / "chain", ignore=shutil.ignore_patterns("__pycache__", "results"))
    table = pd.read_csv(tmp_path / "chain/measured.csv", comment="#")
    table.loc[table["response"] == "freq_1", "std"] = np.nan
    table.to_csv(tmp_path / "chain/measured.csv", index=False)
    answer = explain(Study.load(tmp_path / "chain"), Results.at(tmp_path / "results", "chain"))
    (note,) = answer.notes
    assert note == "Assumed: scatter of freq_1: 1 % (no standard deviation was measured)."


REFUSING = """

def refusing(e):
    def build(model):
        inner = e.build(model) or model.function

        def some(values):
            if values[NAME] > LEAST:
                raise ValueError("out of reach")
            return inner(values)

        return some

    return Effect(e.name, e.title, e.lacks, e.look_for, e.strength, build, e.nuisance, e.grid)


inner_library = library


def library():
    return tuple(refusing(e) if NAME in e.names else e for e in inner_library())
"""


def refusing(tmp_path, name, least):
    """The chain whose function fails beyond some value of one effect's parameter."""
    shutil.copytree(CHAIN, tmp_path / "chain", ignore=shutil.ignore_patterns("__pycache__", "results"))
    with (tmp_path / "chain/effects.py").open("a") as file:
        file.write(REFUSING.replace("NAME", repr(name)).replace("LEAST", repr(least)))
    return Study.load(tmp_path / "chain"), Results.at(tmp_path / "results", "chain")


def test_points_that_failed_are_noted(tmp_path):
    study, results = refusing(tmp_path, "hung_freq", 11.0)
    answer = explain(study, results)
    assert answer.findings.credible == ("hung_mass_5",)
    failed = json.loads((results.path / "explanation.json").read_text())["failed"]
    assert failed > 0 and answer.notes[-1].startswith(f"{failed} points failed; the first: ")
    assert "out of reach" in answer.notes[-1]


def test_an_effect_that_can_never_be_evaluated_is_told_as_invisible(tmp_path):
    study, results = refusing(tmp_path, "bracket_mass_1", 0.0)
    answer = explain(study, results)
    assert "bracket_mass_1 of any possible strength" in answer.sentence
    content = json.loads((results.path / "explanation.json").read_text())
    (row,) = [e for e in content["effects"] if e["name"] == "bracket_mass_1"]
    assert row["phi_min"] is None and content["credible_set"] == ["hung_mass_5"]


# -- withheld plain responses ------------------------------------------------------------------------------------------


def test_withheld_responses_of_a_function_enter_no_fit_and_tell_whether_it_holds(tmp_path, chain):
    shutil.copytree(CHAIN, tmp_path / "chain", ignore=shutil.ignore_patterns("__pycache__", "results"))
    file = tmp_path / "chain/study.toml"
    held = '[withheld]\nmodes = ["freq_2", "damping_2"]\nsensors = ["shape_1_3", "shape_2_4"]\n\n[calibration]'
    file.write_text(file.read_text().replace("[calibration]", held))
    study = Study.load(tmp_path / "chain")
    answer = explain(study, Results.at(tmp_path / "results", "chain"))
    assert answer.findings.credible == ("hung_mass_5",)
    table = answer.errors.set_index(["group", "stage"])
    rows = table["rows"].xs("after", level=1).to_dict()
    assert rows == {"fit": 26, "left_out": 26, "withheld_sensors": 2, "withheld_modes": 2}
    values = answer.findings.chosen.state.values
    effect = answer.findings.chosen.effects[0]
    function = effect.build(study.model) or study.model.function
    model = function(values)
    e = [(study.whole_targets[n][0] - model[n]) / study.whole_targets[n][1] for n in ("freq_2", "damping_2")]
    assert table.loc[("withheld_modes", "after"), "rms"] == pytest.approx(np.sqrt(np.mean(np.square(e))), rel=1e-6)
    assert table.loc[("withheld_modes", "after"), "p"] > 0.01


# -- refusals ----------------------------------------------------------------------------------------------------------


def refused(study, tmp_path, match):
    results = Results.at(tmp_path / "results", study.name)
    with pytest.raises(InputError, match=match) as told:
        explain(study, results)
    assert not list(results.path.iterdir())
    return told.value


def test_a_study_without_effects_is_told_how_to_name_some(mast, tmp_path):
    folder = edit(mast.write_study(tmp_path / "mast"), none=('effects = "effects.py:library"\n', ""))
    fault = refused(Study.load(folder), tmp_path, "names no effects")
    assert "effects = " in fault.remedy and "study.toml" in str(fault.place)


def test_a_study_whose_model_has_all_effects_is_told_so(mast, tmp_path):
    folder = edit(
        mast.write_study(tmp_path / "mast"),
        all=("selection =", 'with_effects = ["lamp", "platform", "guy", "stuck_base"]\nselection ='),
    )
    refused(Study.load(folder), tmp_path, "every effect of the library is in the model already")


def test_too_few_modes_are_told(mast, tmp_path):
    folder = edit(mast.write_study(tmp_path / "mast"), few=("modes = []", 'modes = ["B3x", "B3z", "B2z"]'))
    fault = refused(Study.load(folder), tmp_path, "3 measured modes cannot tell a missing effect from a parameter")
    assert "at least 4" in fault.remedy


def test_too_few_responses_are_told(tmp_path):
    shutil.copytree(CHAIN, tmp_path / "chain", ignore=shutil.ignore_patterns("__pycache__", "results"))
    table = pd.read_csv(tmp_path / "chain/measured.csv", comment="#").head(6)
    table.to_csv(tmp_path / "chain/measured.csv", index=False)
    refused(Study.load(tmp_path / "chain"), tmp_path, "6 measured responses cannot tell")


def test_a_model_that_cannot_be_solved_is_told(mast, tmp_path, monkeypatch):
    def fails(*a, **k):
        raise EvaluationError("the matrix is singular")

    monkeypatch.setattr(asked.engine, "explain", fails)
    study = Study.load(mast.write_study(tmp_path / "mast"))
    fault = refused(study, tmp_path, "the model cannot be fitted: the matrix is singular")
    assert fault.remedy


def test_an_explanation_that_stops_leaves_no_summary(mast, tmp_path, monkeypatch):
    """Tables come whole or not at all, the summary last of all."""
    study = Study.load(mast.write_study(tmp_path / "mast"))
    results = Results.at(tmp_path / "results", study.name)
    write = Results.write_table

    def stops(self, name, table, index=False):
        if name == "strain":
            raise InputError("it cannot be written")
        return write(self, name, table, index)

    monkeypatch.setattr(Results, "write_table", stops)
    with pytest.raises(InputError, match="cannot be written"):
        explain(study, results)
    assert not (results.path / "explanation.json").exists() and not list(results.path.glob(".*"))


def test_settings_of_the_study_reach_the_decision(mast, tmp_path, monkeypatch):
    seen = []
    inner = asked.engine.explain
    monkeypatch.setattr(asked.engine, "explain", lambda h, s, p: seen.append(s) or inner(h, s, p))
    folder = edit(
        mast.write_study(tmp_path / "mast"),
        own=("[calibration]", "[explain]\nalpha = 0.02\nrefits = 3\nmerge = 0.9\nseed = 7\n\n[calibration]"),
    )
    explain(Study.load(folder), Results.at(tmp_path / "results", "mast"))
    assert (seen[0].alpha, seen[0].refits, seen[0].merge, seen[0].seed) == (0.02, 3, 0.9, 7)


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
    assert re.search(r"Odds to expect with these sensors: [\d.]+:1\.", answer.sentence)
    assert (
        "To tell them apart, measure next: " in answer.sentence
        or "No measurement looked at would tell" in answer.sentence
    )
    assert answer.tables["next_measurement"]["ln_bayes"].notna().all()
    table = answer.effects.set_index("name")
    assert table.loc["platform", "confounded_with"] == "lamp"
    for trial in answer.findings.singles[:2]:  # intervals of both by profile likelihood
        row = table.loc[trial.names[0]]
        assert (row["phi_low"], row["phi_high"]) == pytest.approx(profile_interval(trial.state, trial.names[0]))
        assert row["phi_low"] < row["phi"] < row["phi_high"]
    assert math.isfinite(table.loc["lamp", "heldout_gain"])
