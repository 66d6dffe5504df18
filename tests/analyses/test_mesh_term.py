"""The error of the mesh in the covariance of an explanation: a coarse mast, measured on a five times finer mesh."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.linalg as la

import calib
from calib.analyses.explain import explain
from calib.analyses.hypotheses_of_study import modal_hypotheses
from calib.analyses.uncertain import mesh_changes
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.mesh_error import MeshError
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.missing.linearised_fit import least_squares_fit
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

BAR = module_of(Path(__file__).parents[1] / "template/bar.py")
COARSE, FINER = 2.0, 1.0
"""Element sizes, m; a half of the frequencies of the coarse mast is off by more than their standard deviation."""
MULTIPLE = 16 / 15
"""Of halved elements with predictions of the fourth order, as cubic beam elements have (see `MeshError`)."""


@pytest.fixture
def asked(mast, edited, tmp_path):
    """The explanation of a coarse mast, and its results."""

    def ask(mesh_sd, hidden=None, finer=FINER):
        own = f"model_options = {{ element_size = {COARSE} }}\n"
        folder = edited(mast.write_study(tmp_path / "mast", hidden), "effects = ", f"{own}effects = ")
        keys = "" if finer is None else f"finer_options = {{ element_size = {finer} }}\n"
        keys += "" if mesh_sd is None else f"mesh_sd = {mesh_sd}\n"
        edited(folder, "[calibration]", f"[explain]\n{keys}\n[calibration]")
        study, results = (
            LoadedStudy.load(edited(folder, "modes = []", 'modes = ["B3x"]')),
            Results.at(tmp_path / "r", "mast"),
        )
        return study, explain(study, results), results

    return ask


@pytest.mark.medium
def test_a_mesh_that_is_too_coarse_is_taken_for_something_missing(asked):
    assert asked(None)[1].verdict != "nothing_detectable"


@pytest.mark.medium
def test_nothing_seems_missing_where_the_error_of_the_mesh_is_uncertain(asked):
    _, answer, results = asked(MULTIPLE)
    assert answer.verdict == "nothing_detectable" and answer.figures["discretisation"] < 1
    pulls = pd.read_csv(results.path / "pulls.csv").set_index("parameter")
    assert pulls.loc["mesh_error", "prior_sd"] == pytest.approx(MULTIPLE)
    assert pulls.loc["mesh_error", "value"] == pytest.approx(MULTIPLE, abs=0.35)
    words = "The error of the mesh counts as uncertain, by 1.07 times the change to a finer mesh."
    assert words in answer.answer.sure and words in answer.sentences[1]
    record = json.loads((results.path / "record.json").read_text())["analyses"]["explain"]
    assert words in record["answer"]["sure"]
    assert json.loads((results.path / "explanation.json").read_text())["mesh_sd"] == pytest.approx(MULTIPLE)


@pytest.mark.slow
def test_an_effect_is_still_named_and_held_out_data_agree(asked):
    _, answer, _ = asked(MULTIPLE, {"guy": 12000.0})
    assert answer.verdict == "effect" and answer.explanation.credible == ("guy",)
    low, high = answer.effects.set_index("name").loc["guy", ["magnitude_low", "magnitude_high"]]
    assert low < 12000.0 < high
    held_out = answer.errors.set_index(["group", "stage"]).loc["held_out_modes"]
    assert held_out.loc["after", "p"] > 0.05 > held_out.loc["before", "p"]


@pytest.mark.medium
def test_the_fitted_multiple_counts_like_a_term_of_the_covariance(mast, tmp_path):
    """Sum of squares and covariance of generalised least squares with ``I + s^2 w w^T``, by hand at the same slope."""
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    hypotheses, _ = modal_hypotheses(study, Results.at(tmp_path / "r", "mast"))
    at = least_squares_fit(hypotheses.fit_problem(()), (), hypotheses.space.values).values
    mesh = MeshError(mast.mast(), mast.mast(2.0), at, 0.8)
    pair = replace(hypotheses.pair, problem=replace(hypotheses.pair.problem, mesh=mesh))
    space = ParameterSpace((*hypotheses.space.parameters, mesh.parameter))
    fit = least_squares_fit(replace(hypotheses, pair=pair, space=space).fit_problem(()), (), space.values)
    own = [name != "mesh_error" for name in fit.names]
    plain = fit.residual + pair.mesh_change * fit.values["mesh_error"]
    weight = la.inv(np.eye(len(plain)) + 0.8**2 * np.outer(pair.mesh_change, pair.mesh_change))
    information = fit.slope[:, own].T @ weight @ fit.slope[:, own] + np.diag(fit.prior_sd[own] ** -2.0)
    np.testing.assert_allclose(fit.covariance[np.ix_(own, own)], la.inv(information), rtol=1e-6)
    assert plain @ weight @ plain + fit.shift[own] @ fit.shift[own] == pytest.approx(fit.misfit, rel=1e-3)


def test_mesh_sd_without_a_finer_mesh_is_refused_with_its_line(asked):
    with pytest.raises(InputError, match="no finer mesh is known") as refused:
        asked(1.0, finer=None)
    assert "mesh_sd" in str(refused.value) and "line" in str(refused.value)


# -- in Python ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shaken():
    """FRFs of a bar of 128 elements with 1 % of noise and a floor, against one of 16, by the mass at its middle."""
    freq, sensors = np.linspace(100.0, 3400.0, 120), tuple(Sensor(node, "x") for node in BAR.PLACES)
    known = np.ones((len(freq), len(sensors), 1), complex)
    bare = MeasuredFRFs(freq, sensors, sensors[-1:], "receptance", known, known.real, synthetic=True)

    def measured(lump):
        twin = calib.Problem(BAR.bar(128), calib.FRFTest(bare)).with_effects([BAR.heavier()]).model
        exact = FRFProblem(twin, bare).functions({"EA": 1.02, "lump": lump})
        std, rng = 0.01 * np.abs(exact) + 0.002 * np.abs(exact).max(), np.random.default_rng(4)
        noise = rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape)
        return calib.Problem(BAR.bar(16), calib.FRFTest(replace(bare, values=exact + std * noise, std=std)))

    return measured


@pytest.mark.slow
def test_frfs_of_a_coarse_mesh_likewise(shaken):
    """Linear elements: Richardson's multiple is 4/3. The mesh shifts resonances by up to 1 %, with damping of 4 %."""
    complete, lacking = shaken(0.0), shaken(0.1)
    stated = {"finer": BAR.bar(32), "mesh_sd": 4 / 3}
    assert complete.explain([BAR.heavier()], progress=False).verdict != "nothing_detectable"
    told = complete.explain([BAR.heavier()], progress=False, **stated)
    assert told.verdict == "nothing_detectable"
    assert told.explanation.explanation.base.fit.values["mesh_error"] == pytest.approx(4 / 3, abs=0.35)
    named = lacking.explain([BAR.heavier()], progress=False, **stated)
    assert named.verdict == "effect" and [e.name for e in named.named] == ["lump"]
    low, high = named.table.set_index("name").loc["lump", ["magnitude_low", "magnitude_high"]]
    assert low < 0.1 < high


@pytest.mark.slow
def test_a_finer_mesh_alone_tells_its_scores_and_changes_nothing_else(mast, tmp_path):
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast", {"guy": 12000.0}))
    problem = calib.Problem(study.model, calib.ModalTest(study.experiment.modes)).keep(["E", "m_top", "K_base"])
    alone = problem.explain(mast.library(), progress=False)
    told = problem.explain(mast.library(), progress=False, finer=mast.mast(0.25))
    assert "discretisation" in told.explanation.tables and "discretisation" not in alone.explanation.tables
    pd.testing.assert_frame_equal(alone.table, told.table, check_exact=True)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"mesh_sd": 1.0}, "no finer mesh is given"),
        ({"mesh_sd": 0.0, "finer": True}, "mesh_sd: it is 0"),
        ({"fixed_sd": "3 %"}, "fixed_sd: there is no such argument any more.*prior_sd"),
        ({"finer": "other"}, "no model is named 'other'"),
    ],
)
def test_a_stated_error_that_is_none_is_refused(mast, tmp_path, given, words):
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    problem, fine = calib.Problem(study.model, calib.ModalTest(study.experiment.modes)), mast.mast(0.25)
    finer = {True: fine, "other": {"other": fine}}.get(given.get("finer"))
    with pytest.raises(InputError, match=words):
        problem.explain((), progress=False, **{**given, "finer": finer})


@pytest.mark.slow
def test_parameters_left_out_of_a_selection_are_uncertain_as_in_a_study(mast, edited, tmp_path):
    """The same probabilities as a study, and the note that it has."""
    folder = mast.write_study(tmp_path / "mast")
    study = LoadedStudy.load(edited(folder, '"m_top", "K_base"]', '"K_base"]'))
    asked = explain(study, Results.at(tmp_path / "r", "mast"))
    space = study.search_space.replace("m_top", distribution="uniform")
    test = calib.ModalTest(study.experiment.modes, **_pairing(study))
    held = calib.Problem(replace(study.model, space=space), test).keep(["E", "K_base"])
    assert held.unselected == ("m_top",)
    told = held.explain(study.candidates, progress=False).explanation
    assert told.notes[-1] == asked.notes[-1] and "m_top" in told.notes[-1]
    assert told.verdict == asked.verdict == "nothing_detectable"
    assert told.explanation.base.fit.misfit == pytest.approx(asked.explanation.base.fit.misfit, rel=1e-3)
    fixed = replace(study.model, space=space.freeze({"m_top": space["m_top"].value}))
    exact = calib.Problem(fixed, test)
    assert exact.keep(["E", "K_base"]).explain(study.candidates, progress=False).verdict != "nothing_detectable"


def _pairing(study):
    own = study.settings.pairing
    return {"mode_count": own.mode_count, "freq_window": own.freq_window, "clusters": own.clusters}


# -- in a calibration --------------------------------------------------------------------------------------------------


def scaled(by=1.0):
    """Four numbers proportional to a stiffness k; a coarse mesh is off by a factor."""
    space = calib.ParameterSpace((calib.Parameter("k", 10.0, 1.0, 20.0, "kN/m"),))
    return calib.FunctionModel("scale", space, lambda v: {f"y_{n}": by * v["k"] / 2**n for n in range(4)})


def pressed(n=1, **finer):
    """A problem with ``n`` tests of 1 %; alone they tell k = 10 within 0.05 over the root of n."""
    tests = [calib.ResponseTest({f"y_{k}": (10 / 2**k, 0.1 / 2**k) for k in range(4)}, name=f"t{j}") for j in range(n)]
    return calib.Problem(scaled(), tests, **finer)


@pytest.mark.medium
def test_an_error_of_the_mesh_is_one_of_all_data():
    """A mesh that is off by 3 % moves k by 3 %, however many tests there are."""
    finer = {"finer": {"scale": scaled(1.03)}}
    for n in (1, 4):
        exact = pressed(n).calibrate(progress=False)
        told = pressed(n, **finer).calibrate(progress=False, mesh_sd=2.0)
        alone = exact.parameters.loc["k", "std"]
        assert alone == pytest.approx(0.05 / np.sqrt(n), rel=0.01)
        assert told.values["k"] == pytest.approx(exact.values["k"])
        assert told.parameters.loc["k", "std"] == pytest.approx(np.hypot(alone, 2.0 * 0.03 * 10), rel=0.02)
        row = told.statistics.considered.iloc[0]
        assert row["parameter"] == "mesh_error" and row["std"] == 2.0 and row["adds_to"] == "k" and row["matters"]
        assert any("error of the mesh" in words and "k from" in words for words in told.sentences)


def test_estimates_that_a_finer_mesh_would_move_are_named_where_its_error_is_not_stated():
    moved = pressed(finer={"scale": scaled(1.03)}).calibrate(progress=False)
    assert moved.parameters.loc["k", "std"] == pytest.approx(0.05, rel=0.01)
    (said,) = (words for words in moved.sentences if "finer mesh would move" in words)
    assert "k by 6" in said and "mesh_sd" in said and said in moved.calibration.answer.sure
    still = pressed(finer={"scale": scaled(1.001)}).calibrate(progress=False)
    assert not any("finer mesh" in words for words in still.sentences)


def test_the_fit_is_tested_with_the_error_of_the_mesh():
    """What the coarse mesh cannot fit, its error explains."""
    test = calib.ResponseTest({f"y_{n}": (10 * (1 + 0.05 * n) / 2**n, 0.1 / 2**n) for n in range(4)})
    space = scaled().space
    tilted = calib.FunctionModel("scale", space, lambda v: {f"y_{n}": v["k"] * (1 + 0.05 * n) / 2**n for n in range(4)})
    exact = calib.Problem(scaled(), test).calibrate(progress=False)
    told = calib.Problem(scaled(), test, finer={"scale": tilted}).calibrate(progress=False, mesh_sd=1.5)
    assert exact.statistics.fits is False and told.statistics.fits is True
    assert told.statistics.considered_misfit < 1 < exact.statistics.misfit


@pytest.mark.medium
def test_modes_of_a_coarse_mesh_likewise_from_a_folder_and_in_python(mast, edited, tmp_path, monkeypatch):
    """The coarse mast is off by half of its standard deviations and more; both doors say the same."""
    own = f"model_options = {{ element_size = {COARSE} }}\n"
    folder = edited(mast.write_study(tmp_path / "mast"), "effects = ", f"{own}effects = ")
    edited(folder, "[calibration]", f"[explain]\nfiner_options = {{ element_size = {FINER} }}\n\n[calibration]")
    study = LoadedStudy.load(folder)
    change = mesh_changes(study, study.model.space.values)
    by_hand = study.experiment.residual(study.problem.with_model(mast.mast(FINER))).residual(study.problem.space.values)
    assert change[:, 0] == pytest.approx(by_hand - study.pair.residual(study.problem.space.values), abs=1e-6)
    assert np.abs(change).max() > 0.5
    built, further = (
        {},
        {**study.model.space.values, study.search_space.free_names[0]: 1.01 * study.search_space.free[0].value},
    )
    assert mesh_changes(study, study.model.space.values, built).tobytes() == change.tobytes()
    with monkeypatch.context() as patched:
        patched.setattr(LoadedStudy, "on_finer_mesh", lambda self: pytest.fail("the finer mesh is built once more"))
        again = mesh_changes(study, further, built)
    assert again.tobytes() == mesh_changes(study, further).tobytes() != change.tobytes()
    found = calib.Study.load(folder, results=tmp_path / "r", progress=False).problem.calibrate(starts=1, progress=False)
    assert any("finer mesh would move" in words for words in found.sentences)


def test_mesh_sd_in_a_calibration_needs_a_finer_mesh():
    with pytest.raises(InputError, match="no finer mesh is known"):
        pressed().calibrate(progress=False, mesh_sd=1.0)


def test_a_finer_mesh_with_other_parameters_is_told():
    space = calib.ParameterSpace((calib.Parameter("q", 10.0, 1.0, 20.0),))
    other = calib.FunctionModel("scale", space, lambda v: {f"y_{n}": v["q"] for n in range(4)})
    with pytest.raises(InputError, match="only one of model and finer model has the parameter k"):
        pressed(finer={"scale": other}).calibrate(progress=False, mesh_sd=1.0)
    told = pressed(finer={"scale": other}).calibrate(progress=False)
    assert any("only one of model and finer model" in words for words in told.sentences)
