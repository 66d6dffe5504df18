"""The five-mass chain against closed forms and its twin, and the search for its missing effect."""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import EvaluationError
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.hypotheses.function_perturbations import function_hypotheses
from calib.missing.decision import decide
from calib.structure import extend
from calib.structure.eigenproblem.derivatives import mode_derivatives
from calib.structure.function_model import extend_function
from calib.study.loading import module_of
from calib.study.study import LoadedStudy
from models import five_mass_chain as chain
from models.five_mass_chain import REFERENCE, chain_effects, chain_responses, five_mass_chain
from models.railway import bogie_on_rig

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "studies/five_mass_chain"
TRUTH = json.loads((ROOT / "tests/truth/five_mass_chain.json").read_text("utf-8"))
EFFECTS = {e.name: e for e in chain_effects()}
NOMINAL = five_mass_chain().space.values
VISIBLE = ("ground_spring_3", "extra_mass_2", "cross_spring_2_4", "hung_mass_5")


@pytest.fixture(scope="module")
def twin():
    return module_of(FOLDER / "make_twin.py")


def some_magnitude(effect):
    return dict(effect.grid[0]) if effect.grid else {effect.name: effect.plausible}


# -- the model ---------------------------------------------------------------------------------------------------------


def test_equal_springs_give_the_closed_form_of_a_chain_that_is_held_at_one_end():
    found = chain_responses(NOMINAL)
    for j in range(1, 6):
        angle = (2 * j - 1) * np.pi / 11
        omega = 2 * np.sqrt(chain.STIFFNESS / chain.MASS) * np.sin(angle / 2)
        assert found[f"freq_{j}"] == pytest.approx(omega / (2 * np.pi), rel=1e-10)
        assert found[f"damping_{j}"] == pytest.approx(chain.DAMPING / chain.STIFFNESS * omega / 2, rel=1e-8)
        for i in set(range(1, 6)) - {REFERENCE[j - 1]}:
            ratio = np.sin(i * angle) / np.sin(REFERENCE[j - 1] * angle)
            assert found[f"shape_{j}_{i}"] == pytest.approx(ratio, abs=1e-8)
    assert len(found) == 30


def test_scaling_all_stiffness_and_mass_alike_changes_nothing_but_damping():
    scaled = NOMINAL | {f"{letter}{i}": 1.3 * NOMINAL[f"{letter}{i}"] for letter in "km" for i in range(1, 6)}
    one, other = chain_responses(NOMINAL), chain_responses(scaled)
    for name, value in one.items():
        assert other[name] == pytest.approx(value / 1.3 if name.startswith("damping") else value, rel=1e-8)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_magnitude_0_is_the_base_model_and_one_of_plausible_magnitude_is_not(name):
    model = extend_function(five_mass_chain(), [EFFECTS[name]])
    base, nothing = chain_responses(NOMINAL), model.function(model.space.values)
    some = model.function(model.space.values | some_magnitude(EFFECTS[name]))
    assert nothing == base
    assert max(abs(some[n] / base[n] - 1) for n in base) > 1e-3


def test_a_soft_foundation_is_a_softer_spring_1():
    soft = chain_responses(NOMINAL | {"soft_foundation": 10.0})
    spring = 1 / (1 + chain.STIFFNESS * 10.0 * 1e-6)
    assert soft == pytest.approx(chain_responses(NOMINAL | {"k1": spring}))


def test_what_hangs_stiffly_is_a_mass_that_is_bolted_on():
    hung = chain_responses(NOMINAL | {"hung_mass_5": 0.1, "hung_freq": 3000.0})
    bolted = chain_responses(NOMINAL | {"m5": chain.MASS + 0.1})
    assert hung == pytest.approx(bolted, rel=1e-3)


def test_a_chain_that_hardly_oscillates_is_a_failed_point():
    with pytest.raises(EvaluationError, match="of 5 modes oscillate"):
        chain_responses(NOMINAL | {f"c{i}": 1000.0 for i in range(1, 6)})


# -- the twin ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [n for n in EFFECTS if n != "soft_foundation"])
def test_the_twin_without_mass_in_its_springs_is_the_model(twin, monkeypatch, name):
    monkeypatch.setattr(twin, "SPRING_MASS", 1e-5)
    truth = twin.draw(np.random.default_rng(0), name)
    assert twin.twin_responses(truth) == pytest.approx(chain_responses(NOMINAL | truth), rel=1e-4, abs=1e-4)


def test_the_discretisation_error_of_the_twins_springs_is_small_against_the_standard_deviation(twin):
    for seed in range(5):
        truth = twin.draw(np.random.default_rng(seed))
        exact, model = twin.twin_responses(truth), chain_responses(NOMINAL | truth)
        worst = max(abs(exact[f"freq_{j}"] / model[f"freq_{j}"] - 1) for j in range(1, 6)) / twin.STD_FREQ
        assert 0.02 < worst < 0.25


def test_the_noise_of_the_twin_is_as_stated(twin):
    exact = twin.twin_responses(twin.draw(np.random.default_rng(0), ""))
    unit = {"freq": twin.STD_FREQ, "damping": twin.STD_DAMPING}
    z, stated = [], []
    for seed in range(40):
        for name, (mean, std) in twin.measure(exact, np.random.default_rng(seed)).items():
            kind = name.split("_")[0]
            true = unit[kind] * abs(exact[name]) if kind in unit else twin.STD_SHAPE
            z.append((mean - exact[name]) / true)
            stated.append(std / true)
    assert np.std(z) == pytest.approx(1.0, abs=0.06)
    assert np.mean(stated) == pytest.approx(1.0, abs=0.05)


# -- the search --------------------------------------------------------------------------------------------------------


def hypotheses_of(model, targets, space, effects, repeats):
    """What measured responses ask of the chain."""
    pair = ResponseResidual(FunctionProblem(model.space, model.function, targets, "", repeats))
    return function_hypotheses(model, pair, effects, space)[0]


def explained(twin, seed, hidden):
    rng = np.random.default_rng(seed)
    truth = twin.draw(rng, hidden)
    model = five_mass_chain()
    targets = twin.measure(twin.twin_responses(truth), rng)
    return decide(hypotheses_of(model, targets, model.space, chain_effects(), repeats=twin.REPEATS)), truth


@pytest.mark.medium
def test_nothing_is_named_where_nothing_is_missing(twin):
    for seed in range(4):
        found, _ = explained(twin, seed, "")
        assert found.verdict == "nothing_detectable", seed
        assert found.evaluations < 150


@pytest.mark.medium
@pytest.mark.parametrize("hidden", [VISIBLE[0], *(pytest.param(name, marks=pytest.mark.slow) for name in VISIBLE[1:])])
def test_the_hidden_effect_is_named_with_its_magnitude(twin, hidden):
    for seed in range(20, 23):
        found, truth = explained(twin, seed, hidden)
        assert found.verdict == "effect" and found.credible == (hidden,), seed
        assert found.evaluations < 800
        fitted = found.chosen.fit
        for k, name in enumerate(fitted.names):
            if name in truth:
                assert abs(fitted.values[name] - truth[name]) < 4 * np.sqrt(fitted.covariance[k, k]), (seed, name)


@pytest.mark.slow
def test_no_other_effect_is_named_for_one_that_hardly_shows(twin):
    for seed in range(20, 23):
        found, _ = explained(twin, seed, "weak_damper_4")
        assert found.verdict == "nothing_detectable" or "weak_damper_4" in found.credible, seed


# -- the study and its tutorial ----------------------------------------------------------------------------------------


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", (FOLDER / "README.md").read_text("utf-8"), re.DOTALL)


@pytest.mark.medium
def test_the_study_says_it_is_synthetic_and_finds_what_was_hidden():
    study = LoadedStudy.load(FOLDER)
    assert study.synthetic and "SYNTHETIC" in (FOLDER / "measured.csv").read_text("utf-8")
    assert study.search_space.free_names == ("k1", "k2", "k3", "k4", "k5", "damping")
    found = decide(
        hypotheses_of(study.model, study.targets, study.search_space, study.candidates,
                           repeats=study.settings.measurement.repeats)
    )  # fmt: skip
    assert found.verdict == "effect" and found.credible == (TRUTH["effect"],)
    fitted = found.chosen.fit
    for name, true in (TRUTH["magnitude"] | TRUTH["parameters"]).items():
        k = fitted.names.index(name)
        assert abs(fitted.values[name] - true) < 4 * np.sqrt(fitted.covariance[k, k])


def test_the_measurement_is_the_one_that_the_twin_makes(twin, tmp_path, monkeypatch):
    where = [str(tmp_path / "truth.json"), "--into", str(tmp_path / "measured.csv")]
    monkeypatch.setattr("sys.argv", ["make_twin.py", *where])
    twin.main()
    again = json.loads((tmp_path / "truth.json").read_text("utf-8"))
    assert again["parameters"] == pytest.approx(TRUTH["parameters"]) and again["effect"] == TRUTH["effect"]
    here, made = (np.loadtxt(f, delimiter=",", skiprows=3, usecols=(1, 2)) for f in
                  (FOLDER / "measured.csv", tmp_path / "measured.csv"))  # fmt: skip
    np.testing.assert_allclose(made, here, rtol=1e-4)


@pytest.mark.slow
def test_the_tutorial_shows_the_studys_own_effect_and_what_it_prints(monkeypatch, capsys):
    effects, script, _, _ = blocks("python")
    assert effects == (FOLDER / "effects.py").read_text("utf-8")
    monkeypatch.chdir(ROOT)
    exec(compile(script, "README.md", "exec"), {})
    assert capsys.readouterr().out == blocks("text")[0]


@pytest.mark.medium
def test_the_tutorials_own_effect_is_found_when_it_is_what_is_missing(twin):
    study = LoadedStudy.load(FOLDER)
    rng = np.random.default_rng(0)
    truth = twin.draw(rng, "")
    exact = chain_responses(NOMINAL | truth | {"m1": chain.MASS + 0.2})
    found = decide(
        hypotheses_of(study.model, twin.measure(exact, rng), study.search_space, study.candidates, repeats=10)
    )
    assert found.verdict == "effect" and found.credible == ("bracket_mass_1",)
    assert found.chosen.fit.values["bracket_mass_1"] == pytest.approx(0.2, abs=0.05)


BOGIE = ROOT / "studies/hidden_bogie"


@pytest.fixture
def sling():
    """The tutorial's library of a structural model, of which its own effect is the last."""
    names = {}
    exec(compile(blocks("python")[2], "README.md", "exec"), names)
    return names["library"]()[-1]


@pytest.mark.slow
def test_the_tutorials_structural_effect_runs_in_a_study_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    _, _, effects, use = blocks("python")
    (line,) = blocks("toml")
    shutil.copytree(BOGIE, tmp_path / "my_bogie", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "my_bogie/effects.py").write_text(effects, "utf-8")
    file = tmp_path / "my_bogie/study.toml"
    text, old = file.read_text("utf-8"), 'effects = "models.railway:bogie_effects"'
    assert text.count(old) == 1 and old in (FOLDER / "README.md").read_text("utf-8")
    file.write_text(text.replace(old, line.strip()), "utf-8")
    study = LoadedStudy.load(tmp_path / "my_bogie")
    assert [e.name for e in study.candidates][-1] == "sling" and len(study.candidates) > 10

    monkeypatch.syspath_prepend(tmp_path / "my_bogie")
    monkeypatch.delitem(sys.modules, "effects", raising=False)
    exec(compile(use, "README.md", "exec"), {})
    monkeypatch.delitem(sys.modules, "effects")
    assert capsys.readouterr().out == blocks("text")[1]


@pytest.mark.slow
def test_the_tutorials_structural_effect_is_neutral_at_0_and_has_the_derivative_of_differences(sling):
    base = bogie_on_rig()
    model = extend(base, [sling])
    for one, other in zip(base.matrices(base.space.values), model.matrices(model.space.values), strict=True):
        assert abs(one - other).max() == 0

    def freq(magnitude):
        return model.modes(model.space.values | {"sling": magnitude}, 4)

    here = freq(250.0)
    values = model.space.values | {"sling": 250.0}
    slopes = mode_derivatives(model, values, here, ["sling"], [0, 1, 2, 3], np.zeros((0, model.n_dof)))
    difference = (freq(251.0).natural_freq - freq(249.0).natural_freq) / 2.0
    np.testing.assert_allclose(slopes.natural_freq[0], difference, rtol=1e-4, atol=1e-9)


@pytest.mark.slow
def test_the_tutorials_structural_effect_can_be_seen_with_its_data(sling):
    """A score of 4 at a fifth of the plausible size, about the nominal values: least squares with priors by hand."""
    study = LoadedStudy.load(BOGIE)
    residual = ModalResidual(replace(study.problem, model=extend(study.model, [sling])))
    values = residual.problem.model.space.values
    free = [p for p in study.search_space.free if not p.integer]
    slope = residual.jacobian(values, [p.name for p in free]) * [p.prior_width for p in free]
    a = np.vstack([slope, np.eye(len(free))])
    c = np.append(residual.jacobian(values, ["sling"])[:, 0], np.zeros(len(free)))
    rest = c - a @ np.linalg.lstsq(a, c, rcond=None)[0]
    assert 4.0 / np.linalg.norm(rest) < sling.magnitude.prior_sd / 5
