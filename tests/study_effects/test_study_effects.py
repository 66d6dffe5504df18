"""Studies with a library of effects, and studies whose model has some of them."""

import pickle

import numpy as np
import pytest
from scipy.linalg import eigh

from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.execution.evaluate import Evaluator
from calib.study.study import EvaluationSource, LoadedStudy
from tests.study_effects.studies import RIG, SUMS_EFFECTS, changed, complaint, names, with_keys

# -- what a study without effects in its model notices: nothing ------------------------------------------------------


def test_a_library_alone_changes_no_answer_and_no_fingerprint(rig, sums):
    plain, knowing = LoadedStudy.load(RIG), LoadedStudy.load(rig)
    assert names(knowing.candidates) == ("top_mass", "hung_mass") and knowing.included == ()
    assert plain.library == plain.candidates == plain.included == ()
    assert knowing.model.space.names == plain.model.space.names
    assert knowing.problem.fingerprint == plain.problem.fingerprint
    with_lib = LoadedStudy.load(sums).problem.fingerprint
    changed(sums, 'effects = "effects.py:library"\n', "")
    with (sums / "study.toml").open("a") as file:
        file.write("[explain]\nalpha = 0.05\nrefits = 3\n")
    study = LoadedStudy.load(sums)
    assert study.problem.fingerprint == with_lib
    assert (study.settings.explain.alpha, study.settings.explain.refits) == (0.05, 3)


def test_explain_has_the_documented_defaults():
    explain = LoadedStudy.load(RIG).settings.explain
    documented = {"alpha": 0.01, "refits": 6, "merge": 0.98, "finer_options": {}, "samples": 10, "seed": 1}
    assert explain.model_dump() == {**documented, "mesh_sd": None}


# -- models with effects -----------------------------------------------------------------------------------------------


def test_an_effect_acts_like_the_parameter_it_stands_for(rig):
    base = LoadedStudy.load(rig)
    study = LoadedStudy.load(with_keys(rig, 'with_effects = ["top_mass"]'))
    assert names(study.included) == ("top_mass",) and names(study.candidates) == ("hung_mass",)
    changed(rig, 'with_effects = ["top_mass"]', "model_options = { masses_known = false }")
    weighed = LoadedStudy.load(rig)
    for factor in (1.0, 1.3):
        more = study.problem.evaluate({"k2": 0.9, "top_mass": (factor - 1) * 0.1122})
        assert more == pytest.approx(weighed.problem.evaluate({"k2": 0.9, "m4": factor}), rel=1e-10, nan_ok=True)
    assert study.problem.evaluate({"k2": 0.9}) == pytest.approx(
        base.problem.evaluate({"k2": 0.9}), rel=1e-12, nan_ok=True
    )
    assert study.problem.fingerprint != base.problem.fingerprint


def test_an_effect_with_its_own_degree_of_freedom_against_a_mass_on_a_spring(rig):
    with_keys(rig, 'with_effects = ["hung_mass"]')
    changed(rig, "mode_count = 4 ", "# ")
    study = LoadedStudy.load(rig)
    m, f = 0.03, 42.0
    base = study.model.stiffness(study.model.space.si(study.model.space.values)).toarray()[:4, :4]
    stiffness, mass = np.zeros((5, 5)), np.diag([0.1122] * 4 + [m])
    stiffness[:4, :4] = base
    stiffness[3:, 3:] += m * (2 * np.pi * f) ** 2 * np.array([[1, -1], [-1, 1]])
    expected = np.sqrt(eigh(stiffness, mass, eigvals_only=True)) / (2 * np.pi)
    found = study.model.modes({"hung_mass": m, "hung_freq": f}, 5).natural_freq
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.parametrize(("given", "alone", "extended"), [("mode_count = 4 ", 4, 5), ("# ", 4, 5)])
def test_the_counted_modes_are_those_of_the_base_model(rig, given, alone, extended):
    changed(rig, "mode_count = 4 ", given)
    assert LoadedStudy.load(rig).problem.mode_count == alone
    assert LoadedStudy.load(with_keys(rig, 'with_effects = ["top_mass", "hung_mass"]')).problem.mode_count == extended


def test_parameters_of_an_effect_are_parameters_of_the_study(rig):
    with_keys(rig, 'with_effects = ["hung_mass"]')
    changed(rig, 'selection = ["k1"', 'selection = ["hung_freq", "hung_mass", "k1"')
    with (rig / "study.toml").open("a") as file:
        file.write("[parameters.hung_mass]\nlimits = [1e-9, 0.05]\nvalue = 0.01\nsearch = [1e-9, 0.08]\n")
    study = LoadedStudy.load(rig)
    assert set(study.search_space.free_names) == {"k1", "k2", "k3", "k4", "hung_freq", "hung_mass"}
    assert study.sensitivity_space["hung_mass"].upper == 0.05 and study.search_space["hung_mass"].upper == 0.08
    assert study.problem.space.values["hung_mass"] == 0.01


def test_effects_of_a_function(sums):
    with_keys(sums, 'with_effects = ["known", "bend"]')
    changed(sums, 'selection = ["a", "b"]', 'selection = ["a", "b", "bend"]')
    study = LoadedStudy.load(sums)
    assert names(study.included) == ("known", "bend") and study.candidates == ()
    assert study.search_space.free_names == ("a", "b", "bend")
    assert study.problem.evaluate({"a": 2.0, "bend": 0.5, "known": 1.0}) == {"s": 13.0, "p": 8.0}


def test_a_change_of_a_functions_effects_or_of_the_function_makes_old_results_stale(sums):
    plain = LoadedStudy.load(sums).problem.fingerprint
    with_keys(sums, 'with_effects = ["bend"]')
    bent = LoadedStudy.load(sums).problem.fingerprint
    assert LoadedStudy.load(sums).problem.fingerprint == bent != plain
    changed(sums, "10.0", "20.0", "effects.py")
    steeper = LoadedStudy.load(sums).problem.fingerprint
    changed(sums, "7.0", "8.0", "model.py")
    other = LoadedStudy.load(sums).problem.fingerprint
    changed(sums, 'with_effects = ["bend"]', 'with_effects = ["bend", "known"]')
    both = LoadedStudy.load(sums).problem.fingerprint
    changed(sums, 'with_effects = ["bend", "known"]', 'with_effects = ["known"]')
    known = LoadedStudy.load(sums).problem.fingerprint  # adds no function of its own
    changed(sums, "20.0", "30.0", "effects.py")
    assert len({plain, bent, steeper, other, both, known, LoadedStudy.load(sums).problem.fingerprint}) == 7


def test_a_functions_fingerprint_is_the_same_in_every_process(sums):
    changed(sums, '"A bend.", size("bend"), bent)', '"A bend.", size("bend"), partial(Bent(), 2))', "effects.py")
    text = (sums / "effects.py").read_text()
    (sums / "effects.py").write_text(
        "from functools import partial\nclass Bent:\n    def __call__(self, n, model):\n"
        f"        return partial(lambda k, v: model.function(v), n)\n{text}"
    )
    with_keys(sums, 'with_effects = ["bend"]')
    assert LoadedStudy.load(sums).problem.fingerprint == LoadedStudy.load(sums).problem.fingerprint


def test_a_file_that_holds_model_and_library_is_run_once(sums):
    text = (sums / "model.py").read_text()
    (sums / "model.py").write_text(
        f"{text}\nclass Own: pass\nbuild.mark = Own()\n"
        + SUMS_EFFECTS.replace("def bent(model):", "def bent(model):\n    assert isinstance(build.mark, Own)")
    )
    changed(sums, "effects.py:library", "model.py:library")
    (sums / "count.txt").write_text("")
    with (sums / "model.py").open("a") as file:
        file.write(
            "from pathlib import Path\nwith (Path(__file__).parent / 'count.txt').open('a') as f:\n    f.write('x')\n"
        )
    assert names(LoadedStudy.load(sums).library) == ("bend", "known")
    assert (sums / "count.txt").read_text() == "x"


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_what_a_worker_starts_from_has_the_effects_too(rig, sums, workers):
    """Unpickled and called here, or by processes."""
    with_keys(rig, 'with_effects = ["hung_mass"]')
    with_keys(sums, 'with_effects = ["bend"]')
    for folder, point in ((rig, {"hung_mass": 0.02}), (sums, {"bend": 0.5})):
        study = LoadedStudy.load(folder)
        source = EvaluationSource(str(study.file), study.problem.fingerprint)
        if workers:
            with Evaluator(source, workers) as evaluator:
                (outcome,) = evaluator.evaluate([point])
            assert outcome.status == "ok", outcome.error
            responses = outcome.responses
        else:
            responses = pickle.loads(pickle.dumps(source))()(point)
        assert responses == pytest.approx(study.problem.evaluate(point), rel=1e-12, nan_ok=True)


# -- held-out data, for verification -----------------------------------------------------------------------------------


@pytest.fixture
def mast(tmp_path):
    write_example(tmp_path / "mast")
    return tmp_path / "mast"


def test_the_whole_measurement_is_kept_for_verification(mast):
    everything = LoadedStudy.load(mast)
    changed(mast, "modes = []\nsensors = []  ", 'modes = ["B2x"]\nsensors = ["4x"]  ')
    part = LoadedStudy.load(mast)
    assert part.whole.fingerprint == everything.measured.fingerprint != part.measured.fingerprint
    assert part.whole_problem().fingerprint == everything.problem.fingerprint
    assert part.whole_problem().evaluate({"E": 200.0}) == everything.problem.evaluate({"E": 200.0})
    assert "B2x" not in part.problem.measured.names
    assert everything.whole_problem() is None


def test_the_whole_problem_solves_as_many_modes_as_it_needs(mast):
    changed(mast, "modes = []", 'modes = ["B2x", "B2z"]')
    changed(mast, "mode_count = 6", "mode_count = 2")
    study = LoadedStudy.load(mast)
    assert (study.problem.mode_count, study.whole_problem().mode_count) == (2, 4)
    changed(mast, "mode_count = 2", "# ")
    study = LoadedStudy.load(mast)
    assert (study.problem.mode_count, study.whole_problem().mode_count) == (4, 8)


def test_choices_for_held_out_modes_hold_in_the_whole_problem_only(mast):
    changed(mast, "modes = []", 'modes = ["B2x"]')
    changed(mast, "override = {}", "override = { B2x = 4 }")
    study = LoadedStudy.load(mast)
    assert study.problem.override == {} and study.whole_problem().override == {"B2x": 4}
    assert "B2x" in study.whole_problem().mode_clusters and "B2x" not in study.problem.mode_clusters
    changed(mast, "override = { B2x = 4 }", "override = { B2x = 40 }")
    with pytest.raises(InputError, match=r"study\.toml.*model mode 40"):
        LoadedStudy.load(mast).whole_problem()


def test_scalar_responses_keep_their_held_out_targets(sums):
    with (sums / "study.toml").open("a") as file:
        file.write('[held_out]\nresponses = ["p"]\n')
    study = LoadedStudy.load(sums)
    assert set(study.targets) == set(study.problem.targets) == {"s"} and study.whole_problem() is None
    assert study.experiment.measured.targets == {"s": (3.0, 0.01), "p": (1.0, None)} and study.whole is None


def test_holding_everything_out_is_refused(mast, sums):
    sensors = ", ".join(f'"{node}{axis}"' for node in range(1, 5) for axis in "xz")
    changed(mast, "sensors = []  ", f"sensors = [{sensors}]  ")
    said = complaint(mast)
    assert "every sensor is held out" in said and "line " in said
    changed(mast, f"sensors = [{sensors}]", "sensors = []")
    changed(mast, "modes = []", 'modes = ["B1x", "B1z", "B2x", "B2z"]')
    assert "every measured mode is held out" in complaint(mast)
    with (sums / "study.toml").open("a") as file:
        file.write('[held_out]\nresponses = ["p", "s"]\n')
    assert "every measured response is held out" in complaint(sums)
