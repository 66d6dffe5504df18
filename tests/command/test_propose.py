"""``calib propose``: from a misfit that no listed effect explains to an effect of the model."""

import json
from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli
from calib.missing.rules import RULES
from calib.study.study import LoadedStudy


@pytest.fixture
def without_guy(guyed, edit):
    """The guy rope is present, and the library holds all other effects."""
    text = (guyed / "effects.py").read_text()
    guy = next(line for line in text.splitlines() if line.strip().startswith('_one("guy"'))
    (guyed / "effects.py").write_text(text.replace(guy + "\n", "", 1))
    edit(guyed, "modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')
    return guyed


def test_an_explanation_comes_first(guyed, capsys):
    assert cli.execute(["propose", "mast"]) == 2
    said = capsys.readouterr().err
    assert "mast/study.toml: the study was not explained yet; run it first: calib explain mast" in said
    assert said.count("\n") == 1 and not Path("results/mast/proposals.csv").exists()


def test_a_number_of_proposals_is_positive(guyed, capsys):
    assert cli.execute(["propose", "mast", "--rank", "0"]) == 2
    assert "--rank" in capsys.readouterr().err


@pytest.mark.slow
def test_a_proposal_is_named_added_and_predicts_better(without_guy, capsys, explanation, edit):
    """Explain, propose, explain with the proposals, extend, calibrate."""
    before = {p: p.read_bytes() for p in without_guy.rglob("*") if p.is_file()}
    assert cli.execute(["explain", "mast"]) == 0
    assert explanation()["verdict"] in ("none_explains", "partial")
    assert "compose it with: calib propose mast" in capsys.readouterr().out
    assert cli.execute(["propose", "mast", "--rank", "1"]) == 0
    out = capsys.readouterr().out
    assert "Found:    Proposed: " in out and "spring" in out
    table = pd.read_csv("results/mast/proposals.csv", keep_default_na=False)
    (first,) = table.to_dict("records")
    # The rope acts along x at 4.5 m, where no sensor is.
    assert first["kind"].startswith("spring") and 3.0 <= first["y"] <= 6.0 and first["at"].endswith("x")
    assert first["kind"] == "spring to ground" or "spring to ground at sensor 4x" in first["alike"]
    told = json.loads(Path("results/mast/proposals.json").read_text())
    assert told["proposed"] and told["found"] in " ".join(out.split())
    study = "results/mast/mast_proposed"
    assert f"Test them with: calib explain {study}" in out.splitlines()
    loaded = LoadedStudy.load(Path(study))
    assert [e.name for e in loaded.library] == ["platform", "lamp", "stuck_base", first["name"]]
    assert {p: p.read_bytes() for p in without_guy.rglob("*") if p in before} == before
    assert cli.execute(["explain", study]) == 0
    assert explanation("mast_proposed")["credible_set"] == [first["name"]]
    assert cli.execute(["extend", study, first["name"], "--into", "mast_2"]) == 0
    assert cli.execute(["calibrate", "mast_2", "--workers", "1"]) == 0
    assert cli.execute(["explain", "mast_2"]) == 0
    assert explanation("mast_2")["verdict"] == "nothing_detectable"
    errors = explanation("mast_proposed")["errors"]
    for group in ("fit", "held_out_modes"):
        assert errors[group]["after"] < errors[group]["before"]


@pytest.mark.slow
def test_files_of_the_user_stay_and_old_explanations_are_refused(without_guy, capsys, edit):
    assert cli.execute(["explain", "mast"]) == 0 and cli.execute(["propose", "mast"]) == 0
    code = Path("results/mast/mast_proposed/proposed_effects.py")
    code.write_text(code.read_text() + "# corrected by hand\n")
    assert cli.execute(["propose", "mast"]) == 0
    said = capsys.readouterr()
    assert "The study that was there had been changed, and is kept as" in " ".join((said.out + said.err).split())
    assert "corrected by hand" in Path("results/mast/mast_proposed_earlier/proposed_effects.py").read_text()
    assert "corrected by hand" not in code.read_text()
    edit(without_guy, "K_base = { value = 2.0", "K_base = { value = 2.1")
    assert cli.execute(["propose", "mast"]) == 2
    assert "was run on an earlier state of" in capsys.readouterr().err


@pytest.mark.slow
def test_nothing_is_proposed_where_the_library_explains(guyed, capsys):
    assert cli.execute(["explain", "mast"]) == 0
    assert cli.execute(["propose", "mast"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "Nothing is proposed: listed causes explain the data, guy." in out
    assert not Path("results/mast/mast_proposed").exists()
    assert pd.read_csv("results/mast/proposals.csv").empty


@pytest.mark.slow
def test_the_number_of_proposals_is_recorded_and_places_are_a_table(without_guy, capsys):
    assert cli.execute(["explain", "mast"]) == 0 and cli.execute(["propose", "mast", "--rank", "2"]) == 0
    record = json.loads(Path("results/mast/record.json").read_text())["analyses"]["propose"]
    assert record["options"] == ["--rank", "2"] and record["rules"]["missing"]["equal"] == RULES.equal
    table = pd.read_csv("results/mast/proposals.csv", keep_default_na=False)
    places = pd.read_csv("results/mast/proposal_places.csv")
    assert len(table) == 2
    own = places[places["fitted"]].groupby("rank")[["x", "y", "z"]].mean()
    for r in table.to_dict("records"):
        assert own.loc[r["rank"]].tolist() == pytest.approx([float(r[c]) for c in "xyz"])


@pytest.mark.slow
def test_earlier_proposals_are_set_aside_where_there_are_none_now(without_guy, capsys, edit):
    assert cli.execute(["explain", "mast"]) == 0 and cli.execute(["propose", "mast"]) == 0
    written = Path("results/mast/mast_proposed/proposed_effects.py").read_text()
    (without_guy / "taken_over.py").write_text(written)
    edit(without_guy, 'effects = "effects.py:library"', 'effects = "taken_over.py:proposed_effects"')
    assert cli.execute(["explain", "mast"]) == 0
    capsys.readouterr()
    assert cli.execute(["propose", "mast"]) == 0
    said = capsys.readouterr()
    words = " ".join((said.out + said.err).split())
    assert "Nothing is proposed: listed causes explain the data" in words
    assert "Earlier proposals are kept as results/mast/mast_proposed_earlier." in words
    assert not Path("results/mast/mast_proposed").exists()
    assert Path("results/mast/mast_proposed_earlier/proposed_effects.py").read_text() == written
