"""Notes of an explanation on its data and failures, and its refusals."""

import json

import numpy as np
import pandas as pd
import pytest

from calib.analyses import explain as asked
from calib.analyses.explain import explain
from calib.analyses.uncertainty import assumed_words
from calib.errors.errors import EvaluationError, InputError
from calib.results.results import Results
from calib.study.study import LoadedStudy

# -- standard deviations and mesh --------------------------------------------------------------------------------------


def test_a_standard_deviation_that_the_file_states_is_noted(bare):
    assert bare[2].notes == ("There are no repeats: the standard deviation is the one the file states.",)


@pytest.mark.slow
def test_a_standard_deviation_that_is_assumed_is_noted(mast, tmp_path):
    folder = mast.write_study(tmp_path / "mast")
    for name, drop in (("modes.csv", "freq_std"), ("shapes.csv", "std")):
        pd.read_csv(folder / name, comment="#").drop(columns=drop).to_csv(folder / name, index=False)
    study = LoadedStudy.load(folder)
    (note,) = explain(study, Results.at(tmp_path / "results", "mast")).notes
    assert assumed_words(study) in note


@pytest.mark.slow
def test_repeats_need_no_note(mast, edited, tmp_path):
    folder = edited(mast.write_study(tmp_path / "mast"), 'std_of = "mean"', 'std_of = "mean"\nrepeats = 5')
    assert explain(LoadedStudy.load(folder), Results.at(tmp_path / "results", "mast")).notes == ()


@pytest.mark.slow
def test_the_discretisation_error_is_noted_first(mast, edited, tmp_path):
    finer = "[explain]\nfiner_options = { element_size = 0.1 }\n\n[calibration]"
    folder = edited(mast.write_study(tmp_path / "mast"), "[calibration]", finer)
    results = Results.at(tmp_path / "results", "mast")
    answer = explain(LoadedStudy.load(folder), results)
    assert answer.notes[0].startswith("A finer mesh of the same model gives scores of up to ")
    table = pd.read_csv(results.path / "discretisation.csv")
    content = json.loads((results.path / "explanation.json").read_text())
    assert content["discretisation"] == pytest.approx(table["score"].abs().max()) and content["discretisation"] < 1


@pytest.mark.slow
def test_an_assumed_std_of_scalar_responses_is_noted(chain_folder, tmp_path):
    table = pd.read_csv(chain_folder / "measured.csv", comment="#")
    table.loc[table["response"] == "freq_1", "std"] = np.nan
    table.to_csv(chain_folder / "measured.csv", index=False)
    study = LoadedStudy.load(chain_folder)
    (note,) = explain(study, Results.at(tmp_path / "results", "chain")).notes
    assert assumed_words(study) in note and "freq_1" in assumed_words(study)


# -- failures ----------------------------------------------------------------------------------------------------------


REFUSING = """

def refusing(e):
    def build(model):
        inner = e.build(model) or model.function

        def some(values):
            if values[NAME] > LEAST:
                raise ValueError("out of reach")
            return inner(values)

        return some

    return Effect(e.name, e.title, e.lacks, e.look_for, e.magnitude, build, e.nuisance, e.grid)


inner_library = library


def library():
    return tuple(refusing(e) if NAME in e.names else e for e in inner_library())
"""


@pytest.fixture
def refusing(chain_folder, tmp_path):
    """The chain with a function that fails above some value of one effect's parameter."""

    def write(name, least):
        with (chain_folder / "effects.py").open("a") as file:
            file.write(REFUSING.replace("NAME", repr(name)).replace("LEAST", repr(least)))
        return LoadedStudy.load(chain_folder), Results.at(tmp_path / "results", "chain")

    return write


@pytest.mark.slow
def test_points_that_failed_are_noted(refusing):
    study, results = refusing("hung_freq", 11.0)
    answer = explain(study, results)
    assert answer.explanation.credible == ("hung_mass_5",)
    failed = json.loads((results.path / "explanation.json").read_text())["failed"]
    points = f"{failed} point{'s' * (failed > 1)} failed; the first (with hung_mass_5): "
    assert failed > 0 and answer.notes[-1].startswith(points)
    assert "out of reach" in answer.notes[-1]


@pytest.mark.slow
def test_an_effect_that_can_never_be_evaluated_is_reported_as_not_tested(refusing):
    study, results = refusing("bracket_mass_1", 0.0)
    answer = explain(study, results)
    assert "Not tested, since the model fails with it: bracket mass 1." in answer.sentence
    assert "bracket mass 1 of any" not in answer.sentence
    content = json.loads((results.path / "explanation.json").read_text())
    (row,) = [e for e in content["effects"] if e["name"] == "bracket_mass_1"]
    assert row["magnitude_min"] is None and content["credible_set"] == ["hung_mass_5"]


# -- refusals ----------------------------------------------------------------------------------------------------------


def refused(study, tmp_path, match):
    results = Results.at(tmp_path / "results", study.name)
    with pytest.raises(InputError, match=match) as fault:
        explain(study, results)
    assert not list(results.path.iterdir())
    return fault.value


@pytest.mark.slow
def test_a_study_without_effects_is_explained_by_local_perturbations(mast, edited, tmp_path):
    folder = edited(mast.write_study(tmp_path / "mast", {"guy": 12000.0}), 'effects = "effects.py:library"\n', "")
    study = LoadedStudy.load(folder)
    answer = explain(study, Results.at(tmp_path / "results", study.name))
    assert answer.verdict == "none_explains" and len(answer.effects) == 0
    perturbation = answer.explanation.perturbation
    assert perturbation is not None and answer.explanation.ln_bayes(perturbation) > 10
    assert len(answer.tables["perturbations"]) > 5 and answer.tables["confounding"].empty


def test_too_few_responses_are_refused(chain_folder, tmp_path):
    table = pd.read_csv(chain_folder / "measured.csv", comment="#").head(6)
    table.to_csv(chain_folder / "measured.csv", index=False)
    refused(LoadedStudy.load(chain_folder), tmp_path, "6 measured responses cannot tell")


def test_a_model_that_cannot_be_solved_is_refused(mast, tmp_path, monkeypatch):
    def fails(*a, **k):
        raise EvaluationError("the matrix is singular")

    monkeypatch.setattr(asked.engine, "decide", fails)
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    fault = refused(study, tmp_path, "the model cannot be fitted: the matrix is singular")
    assert fault.remedy


@pytest.mark.medium
def test_an_interrupted_explanation_leaves_no_summary(mast, tmp_path, monkeypatch):
    """Tables are written whole or not at all, and the summary last."""
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    results = Results.at(tmp_path / "results", study.name)
    write = Results.write_table

    def stops(self, name, table, index=False):
        if name == "pulls":
            raise InputError("it cannot be written")
        return write(self, name, table, index)

    monkeypatch.setattr(Results, "write_table", stops)
    with pytest.raises(InputError, match="cannot be written"):
        explain(study, results)
    assert not (results.path / "explanation.json").exists() and not list(results.path.glob(".*"))
