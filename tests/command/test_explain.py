"""``calib explain`` as a user meets it."""

import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli
from calib.correlation import basis as requirements
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
CHAIN = str(ROOT / "studies/five_mass_chain")
FIGURES = {
    "answer", "where_it_fails_sigma", "sensor_misfit", "perturbation_map", "pulls", "why_this_effect", "ranked_effects",
    "where_this_effect",
    "confounding", "errors_before_after", "next_measurement", "model_places", "suspects",
}  # fmt: skip
pytestmark = pytest.mark.usefixtures("functions_in_this_process")


@pytest.fixture(scope="module")
def explained(write_study, asked, tmp_path_factory):
    """A folder with the explanation of a mast with a guy rope that its model lacks, and its output."""
    folder = tmp_path_factory.mktemp("explained")
    write_study(folder / "mast", {"guy": 9000.0})
    return folder, asked(folder, "explain", "mast", "-v")


def test_explain_tells_and_writes_the_verdict(explained, explanation, monkeypatch):
    folder, out = explained
    monkeypatch.chdir(folder)
    told = explanation()
    assert "A mast that may lack something: explain  [synthetic measurement]" in out
    assert "Verdict: effect" in out and told["verdict"] == "effect"
    assert all(sentence in out for sentence in told["sentences"])
    assert all(note in out for note in told["notes"]) and len(told["notes"]) == 1
    assert f"{told['evaluations']} model evaluations" in out
    assert "z is a score, not a probability" in out
    assert "Add it with: calib extend mast guy --into FOLDER" in out
    table = pd.read_csv("results/mast/effects.csv")
    line = next(line for line in out.splitlines() if line.startswith("guy "))
    for number in (
        f"{table['z'][0]:.1f}",
        f"{table['ln_bayes'][0]:.1f}",
        f"{table['unabsorbed'][0]:.2f}",
        f"{table['magnitude'][0]:.3g}",
    ):
        assert number in line
    errors = pd.read_csv("results/mast/errors.csv")
    for row in errors.to_dict("records"):
        (line,) = [x.split() for x in out.splitlines() if x.split()[:2] == [row["group"], row["stage"]]]
        assert line[2:5] == [str(row["rows"]), f"{row['rms']:.2f}", f"{row['expected']:.2f}"]


def test_explain_draws_a_figure_beside_every_table(explained):
    folder, out = explained
    assert {p.stem for p in (folder / "results/mast").glob("*.png")} == FIGURES
    for name in FIGURES:
        assert f"{name}.png" in out


@pytest.mark.slow
def test_report_draws_the_explanation_from_tables_alone(explained, here, drawn, unrendered, monkeypatch, files):
    shutil.copytree(explained[0], here, dirs_exist_ok=True)
    drawings = (".png", ".html", ".sha256")
    before = {p: b for p, b in files("results/mast").items() if p.suffix not in drawings}
    for figure in Path("results/mast").glob("*.png"):
        figure.unlink()
    monkeypatch.setattr("calib.correlation.modal.problem.ModalProblem.compare", lambda *a: pytest.fail("it solved"))
    assert cli.execute(["report", "mast"]) == 0
    assert {p.stem for p in Path("results/mast").glob("*.png")} == FIGURES
    assert before == {p: b for p, b in files("results/mast").items() if p.suffix not in drawings}


@pytest.mark.slow
def test_the_summary_has_exactly_the_keys_of_a_modal_study_with_a_finer_mesh(guyed, edit, explanation):
    edit(guyed, "[calibration]", "[explain]\nfiner_options = { element_size = 0.1 }\n\n[calibration]")
    assert cli.execute(["explain", "mast"]) == 0
    assert set(explanation()) == {
        "study", "synthetic", "verdict", "sentence", "sentences", "notes", "p_family", "p_fit", "credible_set",
        "effects", "chosen", "adequacy_p_family", "adequacy_p_fit",
        "chosen_values", "adequacy_p", "noise_scale", "measured_noise_scale",
        "local_perturbations", "local_perturbation", "place", "evaluations", "errors", "begun_anew",
        "accuracy", "std_assumed", "accuracy_that_explains", "alpha",
        "misfit_at", "measurement_fault", "wrong_datum", "refused", "nearly", "faults", "blamed",
        "to_add", "pair_faults", "doubts",
        "basis_error", "discretisation", "seconds", "evaluations_intervals", "evaluations_recommendation",
    }  # fmt: skip
    assert set(explanation()["effects"][0]) == {
        "name", "z", "unabsorbed", "magnitude", "magnitude_low", "magnitude_high", "magnitude_min",
        "ln_bayes", "model_probability", "held_out_gain", "implausible", "confounded_with",
    }  # fmt: skip


@pytest.mark.slow
def test_nothing_missing_is_reported_without_a_name(here, write_study, capsys, explanation):
    write_study(Path("mast"))
    assert cli.execute(["explain", "mast"]) == 0
    out = capsys.readouterr().out
    assert explanation()["verdict"] == "nothing_detectable" and explanation()["sentences"][0] in out
    assert "calib extend" not in out and explanation()["credible_set"] == []


@pytest.mark.slow
def test_two_effects_are_told_without_offering_one_of_them(here, write_study, capsys, explanation):
    write_study(Path("mast"), {"platform": 25.0, "stuck_base": 0.6})
    assert cli.execute(["explain", "mast"]) == 0
    out = capsys.readouterr().out
    assert explanation()["verdict"] == "two_effects" and "before and after with platform and stuck_base" in out
    assert "Add them with: calib extend mast platform stuck_base --into FOLDER" in out.splitlines()
    assert cli.execute(["extend", "mast", "platform", "stuck_base", "--into", "FOLDER"]) == 0
    assert LoadedStudy.load(Path("FOLDER")).settings.with_effects == ("platform", "stuck_base")


@pytest.mark.slow
def test_a_rejected_candidate_fit_is_reported_as_one(guyed, capsys, explanation):
    """The guy rope is present, and the library holds all other effects."""
    text = (guyed / "effects.py").read_text()
    guy = next(line for line in text.splitlines() if line.strip().startswith('_one("guy"'))
    (guyed / "effects.py").write_text(text.replace(guy + "\n", "", 1))
    assert cli.execute(["explain", "mast"]) == 0
    out = capsys.readouterr().out
    told = explanation()
    assert told["verdict"] in ("none_explains", "partial") and "Add it with" not in out
    (name,) = told["chosen"]
    assert f"Errors in standard deviations, before and with {name}: best attempt, not believed:" in out
    assert set(pd.read_csv("results/mast/errors.csv")["stage"]) == {"before", "attempt"}
    assert set(pd.read_csv("results/mast/misfit_kinds.csv")["stage"]) == {"base", "attempt"}


@pytest.mark.slow
def test_one_effect_is_told_in_the_singular(guyed, capsys):
    (guyed / "effects.py").write_text(
        (guyed / "effects.py").read_text()
        + "\n\neverything = library\n\n\ndef library():\n    return everything()[2:3]\n"
    )
    assert cli.execute(["explain", "mast", "--verbose"]) == 0
    out = capsys.readouterr().out
    assert "\n1 effect and " in out and not re.search(r"\b1 [a-z]+s (tested|fitted)", out)


@pytest.mark.slow
def test_what_is_not_known_is_left_empty(guyed, capsys):
    """The second guy rope is collinear with the first; it has no numbers of its own."""
    (guyed / "effects.py").write_text(
        (guyed / "effects.py").read_text()
        + "\n\nothers = library\n\n\ndef library():\n"
        + '    twin = _one("guy_too", "Another", 4.5, (0,), "stiffness", "N/m", 5e3, 1e5)\n'
        + "    return (*others(), twin)\n"
    )
    assert cli.execute(["explain", "mast", "--verbose"]) == 0
    out = capsys.readouterr().out
    table = out[out.index("\neffect  ") : out.index("tested, ")]
    assert "guy" in table and not re.search(r"\b(nan|inf)\b", table)


@pytest.mark.slow
def test_a_basis_says_the_same_and_twice_the_same_bytes(explained, guyed, monkeypatch, capsys, explanation, files):
    monkeypatch.setattr(requirements, "WORTHWHILE_DOFS", 10)
    assert cli.execute(["explain", "mast"]) == 0
    first = {p: b for p, b in files("results/mast").items() if p.suffix in (".csv", ".npz")}
    assert any(p.suffix == ".npz" for p in first)
    monkeypatch.setattr(requirements, "effect_basis", lambda *a: pytest.fail("a basis is there"))
    before = explanation()
    assert cli.execute(["explain", "mast"]) == 0
    assert first == {p: b for p, b in files("results/mast").items() if p.suffix in (".csv", ".npz")}
    assert explanation() | {"seconds": 0} == before | {"seconds": 0}
    whole = explained[0] / "results/mast"
    full, reduced = json.loads((whole / "explanation.json").read_text()), before
    assert 0 < reduced["basis_error"] < 0.05 and full["basis_error"] == pytest.approx(0.0, abs=1e-9)
    assert reduced["verdict"] == full["verdict"] and reduced["credible_set"] == full["credible_set"]
    one, other = (pd.read_csv(k / "effects.csv").set_index("name") for k in (whole, Path("results/mast")))
    assert (one["z"] - other["z"][one.index]).abs().max() < 0.1


@pytest.mark.slow
def test_held_out_data_are_told_and_enter_no_fit(guyed, capsys, edit, explanation):
    edit(guyed, "modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x"]')
    assert cli.execute(["explain", "mast", "--verbose"]) == 0
    out = capsys.readouterr().out
    assert "Held out, never fitted: modes B3x; sensors 2x." in out
    assert explanation()["errors"]["held_out_modes"]["after"] < explanation()["errors"]["held_out_modes"]["before"]
    assert "mode B3x, validation data so far" in set(pd.read_csv("results/mast/next_measurement.csv")["measurement"])
    misfit = pd.read_csv("results/mast/sensor_misfit.csv")
    assert "B3x" not in set(misfit["mode"]) and "2x" not in set(misfit["sensor"])


@pytest.mark.slow
def test_without_repeats_the_assumed_std_is_told(here, write_study, capsys, explanation):
    folder = write_study(Path("mast"))
    for name, drop in (("modes.csv", "freq_std"), ("shapes.csv", "std")):
        pd.read_csv(folder / name, comment="#").drop(columns=drop).to_csv(folder / name, index=False)
    assert cli.execute(["explain", "mast"]) == 0
    assumed = explanation()["std_assumed"]
    assert "natural frequencies 0.5 %" in assumed and "shapes 3 %" in assumed
    assert assumed in " ".join(capsys.readouterr().out.split()) and assumed in explanation()["sentence"]


@pytest.mark.slow
def test_frequencies_alone_can_be_explained(here, write_study, capsys, edit, explanation):
    folder = write_study(Path("mast"), {"guy": 9000.0})
    edit(folder, 'shapes = ["shapes.csv"]\n', "")
    edit(folder, 'sensors = "sensors.csv"\n', "")
    assert cli.execute(["explain", "mast"]) == 0
    assert explanation()["errors"]["held_out_sensors"] == {"before": None, "after": None}
    assert explanation()["local_perturbations"] == 4  # parts; there are no sensors to change anything at
    assert explanation()["measured_noise_scale"] is None


# -- without matrices --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_chain_is_explained_twice_and_extended(here, drawn, unrendered, monkeypatch, capsys, explanation, files):
    truth = json.loads((ROOT / "tests/truth/five_mass_chain.json").read_text("utf-8"))
    assert cli.execute(["explain", CHAIN]) == 0
    out = capsys.readouterr().out
    told = explanation("five_mass_chain")
    assert told["verdict"] == "effect" and told["credible_set"] == [truth["effect"]] and told["sentences"][0] in out
    assert set(told) >= {"failed", "verdict", "credible_set"} and told["failed"] == 0
    row = pd.read_csv("results/five_mass_chain/effects.csv").iloc[0]
    assert row["magnitude_low"] <= truth["magnitude"][truth["effect"]] <= row["magnitude_high"]
    # The figures of a function are those that need no structure.
    assert {p.stem for p in Path("results/five_mass_chain").glob("*.png")} == {
        "where_it_fails_sigma", "response_misfit", "pulls", "why_this_effect", "ranked_effects", "confounding",
        "errors_before_after",
    }  # fmt: skip
    first = {p: b for p, b in files("results/five_mass_chain").items() if p.suffix == ".csv"}
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    assert cli.execute(["explain", CHAIN]) == 0
    assert first == {p: b for p, b in files("results/five_mass_chain").items() if p.suffix == ".csv"}
    assert cli.execute(["extend", CHAIN, truth["effect"], "--into", "chain_2"]) == 0
    assert cli.execute(["explain", "chain_2"]) == 0
    assert explanation("chain_2")["verdict"] == "nothing_detectable"
    assert truth["effect"] not in {e["name"] for e in explanation("chain_2")["effects"]}
