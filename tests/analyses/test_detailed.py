"""Richer members of a family: fitted after a decision that their simpler one explains nearly, told, kept and added."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.explained_fit import explained_fit
from calib.command import cli
from calib.missing.detailed import detailed_sentence, leading_fit
from calib.missing.partial import is_far_ahead
from calib.results.results import Results
from calib.study.study import LoadedStudy

LIBRARY = """\
import calib

D = [0.5 * i for i in range(1, 13)]

def at(name):
    return float(name[5:]) / 3

def loads(v):
    return {f"load_{d:g}": v["k"] * d + v["c"] for d in D}

def spring():
    return calib.FunctionModel("spring", calib.ParameterSpace((
        calib.Parameter("k", 10.0, 5.0, 20.0, "kN/m", prior_sd=0.5),
        calib.Parameter("c", 0.0, -5.0, 5.0, "kN", prior_sd=0.2),
    )), loads)

def added(change):
    return lambda model: lambda v: {n: y + change(v, at(n)) for n, y in model.function(v).items()}

def effect(name, title, change, richer=None, nuisance=(), grid=()):
    magnitude = calib.Parameter(name, 0.0, -20.0, 20.0, "kN", prior_sd=3.0)
    return calib.Effect(name, title, "It is linear.", "Coils that touch.", magnitude, added(change), nuisance, grid,
                        richer=richer)

BEND = calib.Parameter("bend", 0.0, -2.0, 2.0, prior_sd=0.5)

def library():
    lump = effect("lump", "hardening with a lump", lambda v, x: v["lump"] * (x**3 * (1 + v["bend"] * x**2) +
                  v["size"] * (x > 1.4)), None, (BEND, calib.Parameter("size", 0.0, -2.0, 2.0, prior_sd=0.5)),
                  tuple({"lump": 2.0, "bend": b, "size": s} for b in (0.3, -0.3) for s in (0.2, -0.2)))
    bow = effect("bow", "hardening that bends", lambda v, x: v["bow"] * x**3 * (1 + v["bend"] * x**2), lump, (BEND,),
                 tuple({"bow": 2.0, "bend": b} for b in (0.3, -0.3)))
    return (effect("cubic", "hardening", lambda v, x: v["cubic"] * x**3, bow),
            effect("step", "a step", lambda v, x: v["step"] * (x > 1)))
"""


@pytest.fixture(scope="module")
def parts():
    space: dict = {}
    exec(LIBRARY, space)
    return space


def measured(parts, richest=0.0, bend=0.1, size=6.0):
    """Loads of a spring that hardens as the member ``bow`` does, and for a ``richest`` of not 0 as ``lump``."""
    (lump,) = (e for e in parts["library"]()[0].family if e.name == "lump")
    truth = lump.build(parts["spring"]())({"k": 10.2, "c": 0.1, "lump": size, "bend": bend, "size": richest})
    noise = np.random.default_rng(1).standard_normal(len(truth))
    return {name: (load + 0.1 * e, 0.1) for (name, load), e in zip(truth.items(), noise, strict=True)}


@pytest.fixture(scope="module")
def explained(parts):
    test = calib.ResponseTest(measured(parts))
    return calib.Problem(parts["spring"](), test).explain(parts["library"](), progress=False)


@pytest.mark.medium
def test_the_adequate_member_is_told_with_its_magnitude(explained):
    answer = explained.explanation
    assert answer.verdict == "none_explains" and answer.explanation.chosen.names == ("cubic",)
    (one,) = answer.richer  # the chain ends with the first that is adequate
    assert one.effect.name == "bow" and one.adequate
    assert one.interval[0] < 6.0 < one.interval[1] and one.candidate_fit.fit.values["bend"] == pytest.approx(
        0.1, abs=0.02
    )
    told = next(s for s in explained.sentences if s.startswith("In more detail cubic explains the data"))
    assert "'calib extend' adds bow." in told and "was fitted after the decision" in told
    assert f"from {answer.explanation.chosen.fit.misfit:.0f} to {one.candidate_fit.fit.misfit:.0f}" in told
    assert explained.lines["Next"].endswith("Or add bow, which is cubic in more detail and explains the data.")


@pytest.mark.medium
def test_the_richer_member_leaves_the_decision_as_it_is(explained, parts):
    bare = tuple(replace(e, richer=None) for e in parts["library"]())
    alone = calib.Problem(parts["spring"](), calib.ResponseTest(measured(parts))).explain(bare, progress=False)
    found, other = explained.explanation, alone.explanation
    assert not other.richer and "richer" not in other.tables
    for name in ("evaluations_intervals", "evaluations_recommendation"):
        assert found.figures[name] == other.figures[name]
    assert found.explanation.evaluations == other.explanation.evaluations
    assert found.explanation.base_adequacy.p_family == other.explanation.base_adequacy.p_family
    pd.testing.assert_frame_equal(found.effects, other.effects)
    assert [s for s in explained.sentences if "In more detail" not in s] == list(alone.sentences)
    assert set(found.tables) - set(other.tables) == {"richer", "richer_errors"}


@pytest.mark.medium
def test_the_chain_goes_on_where_a_member_is_not_adequate(parts):
    test = calib.ResponseTest(measured(parts, richest=0.5))
    explained = calib.Problem(parts["spring"](), test).explain(parts["library"](), progress=False)
    first, second = explained.explanation.richer
    assert (first.effect.name, second.effect.name) == ("bow", "lump")
    assert not first.adequate and second.adequate and second.simpler is first.candidate_fit
    assert second.candidate_fit.fit.values["size"] == pytest.approx(0.5, abs=0.2)
    table = explained.explanation.tables["richer"]
    assert list(table["effect"]) == ["bow"] * 2 + ["lump"] * 3
    assert list(table["parameter"]) == ["bow", "bend", "lump", "bend", "size"]
    words = detailed_sentence((first,), explained.errors)
    assert words.startswith("In more detail cubic does not explain the data either: ") and "extend" not in words


@pytest.mark.medium
def test_only_what_is_far_ahead_and_not_named_is_refined(explained):
    found = explained.explanation.explanation
    assert leading_fit(found) is found.chosen and is_far_ahead(found)
    assert leading_fit(replace(found, verdict="effect")) is None
    rival = replace(found.chosen, effects=(found.groups[1].effect,))
    assert rival.names != found.chosen.names
    assert leading_fit(replace(found, candidate_fits=(*found.candidate_fits, rival))) is None


@pytest.fixture
def folder(parts, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = tmp_path / "spring"
    here.mkdir()
    (here / "model.py").write_text(LIBRARY)
    rows = [f"{name},{value},{std}" for name, (value, std) in measured(parts).items()]
    (here / "measured.csv").write_text("\n".join(["response,value,std", *rows]) + "\n")
    (here / "study.toml").write_text(
        'title = "spring"\nmodel = "model.py:spring"\neffects = "model.py:library"\nselection = ["k", "c"]\n'
        '[measurement]\nresponses = "measured.csv"\n[held_out]\nresponses = ["load_3", "load_5.5"]\n'
        '[calibration]\ncases = [{ name = "F1", seed = 1 }]\n'
    )
    return here


@pytest.mark.slow
def test_a_study_keeps_the_member_and_extends_by_it(folder, capsys):
    assert cli.execute(["explain", "spring"]) == 0
    out = capsys.readouterr().out
    assert "Or add bow" in out and "validation responses" in out
    results = folder.parent / "results/spring"
    table = pd.read_csv(results / "richer.csv").set_index("parameter")
    assert table.loc["bow", "adequate"] and table.loc["bow", "low"] < 6.0 < table.loc["bow", "high"]
    errors = pd.read_csv(results / "richer_errors.csv").set_index("group")
    assert errors.loc["held_out_responses", "rms"] < 3 and (errors["effect"] == "bow").all()
    sentences = json.loads((results / "explanation.json").read_text())["sentences"]
    assert any("'calib extend' adds bow." in s for s in sentences)
    assert cli.execute(["extend", "spring", "bow", "--into", "richer"]) == 0
    extended = LoadedStudy.load(folder.parent / "richer")
    assert [e.name for e in extended.included] == ["bow"] and "bend" in extended.settings.selection
    begun = explained_fit(extended, Results.at(folder.parent / "results", "richer"))
    assert begun["bow"] == pytest.approx(table.loc["bow", "value"])
