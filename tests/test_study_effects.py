"""Studies with a library of effects, and studies whose model has some of them."""

import os
import pickle
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

from calib.errors import InputError
from calib.evaluate import Evaluator
from calib.example import write_example
from calib.study import EvaluationSource, Study

RIG = Path(__file__).resolve().parent.parent / "studies/four_storey_rig"

RIG_EFFECTS = """\
import math
import scipy.sparse as sp
from calib.effect import Effect
from calib.space import Parameter
from calib.structure.affine import Monomial, Term, parameter
from calib.structure.extend import Addition

def at(n, entries):
    rows, columns, values = zip(*((i, j, v) for (i, j), v in entries.items()))
    return sp.csr_array((values, (rows, columns)), shape=(n, n))

def more_mass(model):
    return Addition(mass=(Term("more", at(4, {(3, 3): 1.0}), parameter("top_mass")),))

def hung(model):
    # Relative motion of the hung mass times the root of its mass: regular at no mass.
    mass = (
        Term("carried", at(5, {(3, 3): 1.0}), parameter("hung_mass")),
        Term("coupling", at(5, {(3, 4): 1.0, (4, 3): 1.0}), Monomial(1.0, (("hung_mass", 0.5),))),
        Term("own", at(5, {(4, 4): 1.0})),
    )
    spring = Term("spring", at(5, {(4, 4): (2 * math.pi) ** 2}), Monomial(1.0, (("hung_freq", 2.0),)))
    return Addition(stiffness=(spring,), mass=mass, n_added=1)

def library():
    return (
        Effect("top_mass", "mass on top", "Top weighed without cables.", "Cables.",
               Parameter("top_mass", 0.0, 0.0, 0.1, "kg", prior_sd=0.02), more_mass),
        Effect("hung_mass", "hung mass", "Nothing hangs.", "Something that swings.",
               Parameter("hung_mass", 1e-9, 1e-9, 0.1, "kg", prior_sd=0.02), hung,
               nuisance=(Parameter("hung_freq", 30.0, 10.0, 90.0, "Hz"),),
               grid=({"hung_mass": 0.01, "hung_freq": 20.0}, {"hung_mass": 0.01, "hung_freq": 60.0})),
    )
"""

SUMS = """\
from calib.effect import Effect
from calib.function import FunctionModel
from calib.space import Parameter, ParameterSpace

def sums(v):
    return {"s": v["a"] + v["b"], "p": v["a"] - v["b"] + 7.0 * v.get("known", 0.0)}

def build():
    return FunctionModel("sums", ParameterSpace((Parameter("a", 1.0, 0.0, 3.0), Parameter("b", 1.0, 0.0, 3.0))), sums)
"""

SUMS_EFFECTS = """\
from calib.effect import Effect
from calib.space import Parameter

def bent(model):
    def bend(v):
        base = model.function(v)
        return base | {"s": base["s"] + 10.0 * v["bend"] * v["a"]}
    return bend

def size(name):
    return Parameter(name, 0.0, -1.0, 1.0, prior_sd=0.5)

def library():
    return (
        Effect("bend", "bend", "It is straight.", "A bend.", size("bend"), bent),
        Effect("known", "known", "It is left out.", "A lot.", size("known"), lambda model: None),
    )
"""


@pytest.fixture
def rig(tmp_path):
    folder = tmp_path / "rig"
    shutil.copytree(RIG, folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "effects.py").write_text(RIG_EFFECTS)
    return with_keys(folder, 'effects = "effects.py:library"')


@pytest.fixture
def sums(tmp_path):
    folder = tmp_path / "sums"
    folder.mkdir()
    (folder / "model.py").write_text(SUMS)
    (folder / "effects.py").write_text(SUMS_EFFECTS)
    (folder / "measured.csv").write_text("response,value,std\ns,3.0,0.01\np,1.0,\n")
    (folder / "study.toml").write_text(
        'title = "sums"\nmodel = "model.py:build"\neffects = "effects.py:library"\nselection = ["a", "b"]\n'
        '[measurement]\nresponses = "measured.csv"\n[calibration]\ncases = [{ name = "F1", seed = 1 }]\n'
    )
    return folder


def with_keys(folder: Path, *lines: str) -> Path:
    """Top-level keys in front of all others."""
    file = folder / "study.toml"
    file.write_text("\n".join(lines) + "\n" + file.read_text("utf-8"), "utf-8")
    return folder


def changed(folder: Path, old: str, new: str, name: str = "study.toml") -> Path:
    """One change to a file whose length may stay the same: its time must not, or Python takes the compiled one."""
    file = folder / name
    text = file.read_text("utf-8")
    assert old in text, old
    later = file.stat().st_mtime + 2
    file.write_text(text.replace(old, new, 1), "utf-8")
    os.utime(file, (later, later))
    return folder


def complaint(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        Study.load(folder)
    return str(caught.value)


def names(effects):
    return tuple(effect.name for effect in effects)


# -- what a study without effects in its model notices: nothing ------------------------------------------------------


def test_a_library_alone_changes_no_answer_and_no_fingerprint(rig, sums):
    plain, knowing = Study.load(RIG), Study.load(rig)
    assert names(knowing.candidates) == ("top_mass", "hung_mass") and knowing.included == ()
    assert plain.library == plain.candidates == plain.included == ()
    assert knowing.model.space.names == plain.model.space.names
    assert knowing.problem.fingerprint == plain.problem.fingerprint
    with_lib = Study.load(sums).problem.fingerprint
    changed(sums, 'effects = "effects.py:library"\n', "")
    with (sums / "study.toml").open("a") as file:
        file.write("[explain]\nalpha = 0.05\nrefits = 3\n")
    study = Study.load(sums)
    assert study.problem.fingerprint == with_lib
    assert (study.settings.explain.alpha, study.settings.explain.refits) == (0.05, 3)


def test_explain_has_the_documented_defaults():
    explain = Study.load(RIG).settings.explain
    documented = {"alpha": 0.01, "refits": 6, "merge": 0.98, "finer_options": {}, "samples": 10, "seed": 1}
    assert explain.model_dump() == {**documented, "fixed_sd": None, "mesh_sd": None}


# -- models with effects -----------------------------------------------------------------------------------------------


def test_an_effect_acts_like_the_parameter_it_stands_for(rig):
    base = Study.load(rig)
    study = Study.load(with_keys(rig, 'with_effects = ["top_mass"]'))
    assert names(study.included) == ("top_mass",) and names(study.candidates) == ("hung_mass",)
    changed(rig, 'with_effects = ["top_mass"]', "model_options = { masses_known = false }")
    weighed = Study.load(rig)
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
    study = Study.load(rig)
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
    assert Study.load(rig).problem.mode_count == alone
    assert Study.load(with_keys(rig, 'with_effects = ["top_mass", "hung_mass"]')).problem.mode_count == extended


def test_parameters_of_an_effect_are_parameters_of_the_study(rig):
    with_keys(rig, 'with_effects = ["hung_mass"]')
    changed(rig, 'selection = ["k1"', 'selection = ["hung_freq", "hung_mass", "k1"')
    with (rig / "study.toml").open("a") as file:
        file.write("[parameters.hung_mass]\nlimits = [1e-9, 0.05]\nvalue = 0.01\nsearch = [1e-9, 0.08]\n")
    study = Study.load(rig)
    assert set(study.search_space.free_names) == {"k1", "k2", "k3", "k4", "hung_freq", "hung_mass"}
    assert study.sensitivity_space["hung_mass"].upper == 0.05 and study.search_space["hung_mass"].upper == 0.08
    assert study.problem.space.values["hung_mass"] == 0.01


def test_effects_of_a_function(sums):
    with_keys(sums, 'with_effects = ["known", "bend"]')
    changed(sums, 'selection = ["a", "b"]', 'selection = ["a", "b", "bend"]')
    study = Study.load(sums)
    assert names(study.included) == ("known", "bend") and study.candidates == ()
    assert study.search_space.free_names == ("a", "b", "bend")
    assert study.problem.evaluate({"a": 2.0, "bend": 0.5, "known": 1.0}) == {"s": 13.0, "p": 8.0}


def test_a_change_of_a_functions_effects_or_of_the_function_makes_old_results_stale(sums):
    plain = Study.load(sums).problem.fingerprint
    with_keys(sums, 'with_effects = ["bend"]')
    bent = Study.load(sums).problem.fingerprint
    assert Study.load(sums).problem.fingerprint == bent != plain
    changed(sums, "10.0", "20.0", "effects.py")
    steeper = Study.load(sums).problem.fingerprint
    changed(sums, "7.0", "8.0", "model.py")
    other = Study.load(sums).problem.fingerprint
    changed(sums, 'with_effects = ["bend"]', 'with_effects = ["bend", "known"]')
    both = Study.load(sums).problem.fingerprint
    changed(sums, 'with_effects = ["bend", "known"]', 'with_effects = ["known"]')
    known = Study.load(sums).problem.fingerprint  # adds no function of its own
    changed(sums, "20.0", "30.0", "effects.py")
    assert len({plain, bent, steeper, other, both, known, Study.load(sums).problem.fingerprint}) == 7


def test_a_functions_fingerprint_is_the_same_in_every_process(sums):
    changed(sums, '"A bend.", size("bend"), bent)', '"A bend.", size("bend"), partial(Bent(), 2))', "effects.py")
    text = (sums / "effects.py").read_text()
    (sums / "effects.py").write_text(
        "from functools import partial\nclass Bent:\n    def __call__(self, n, model):\n"
        f"        return partial(lambda k, v: model.function(v), n)\n{text}"
    )
    with_keys(sums, 'with_effects = ["bend"]')
    assert Study.load(sums).problem.fingerprint == Study.load(sums).problem.fingerprint


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
    assert names(Study.load(sums).library) == ("bend", "known")
    assert (sums / "count.txt").read_text() == "x"


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_what_a_worker_starts_from_has_the_effects_too(rig, sums, workers):
    """Unpickled and called here, or by processes."""
    with_keys(rig, 'with_effects = ["hung_mass"]')
    with_keys(sums, 'with_effects = ["bend"]')
    for folder, point in ((rig, {"hung_mass": 0.02}), (sums, {"bend": 0.5})):
        study = Study.load(folder)
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
    everything = Study.load(mast)
    changed(mast, "modes = []\nsensors = []  ", 'modes = ["B2x"]\nsensors = ["4x"]  ')
    part = Study.load(mast)
    assert part.whole.fingerprint == everything.measured.fingerprint != part.measured.fingerprint
    assert part.whole_problem().fingerprint == everything.problem.fingerprint
    assert part.whole_problem().evaluate({"E": 200.0}) == everything.problem.evaluate({"E": 200.0})
    assert "B2x" not in part.problem.measured.names
    assert everything.whole_problem() is None


def test_the_whole_problem_solves_as_many_modes_as_it_needs(mast):
    changed(mast, "modes = []", 'modes = ["B2x", "B2z"]')
    changed(mast, "mode_count = 6", "mode_count = 2")
    study = Study.load(mast)
    assert (study.problem.mode_count, study.whole_problem().mode_count) == (2, 4)
    changed(mast, "mode_count = 2", "# ")
    study = Study.load(mast)
    assert (study.problem.mode_count, study.whole_problem().mode_count) == (4, 8)


def test_choices_for_held_out_modes_hold_in_the_whole_problem_only(mast):
    changed(mast, "modes = []", 'modes = ["B2x"]')
    changed(mast, "override = {}", "override = { B2x = 4 }")
    study = Study.load(mast)
    assert study.problem.override == {} and study.whole_problem().override == {"B2x": 4}
    assert "B2x" in study.whole_problem().mode_clusters and "B2x" not in study.problem.mode_clusters
    changed(mast, "override = { B2x = 4 }", "override = { B2x = 40 }")
    with pytest.raises(InputError, match=r"study\.toml.*model mode 40"):
        Study.load(mast).whole_problem()


def test_scalar_responses_keep_their_held_out_targets(sums):
    with (sums / "study.toml").open("a") as file:
        file.write('[held_out]\nresponses = ["p"]\n')
    study = Study.load(sums)
    assert set(study.targets) == set(study.problem.targets) == {"s"} and study.whole_problem() is None
    assert study.responses.targets == {"s": (3.0, 0.01), "p": (1.0, None)} and study.whole is None


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


# -- complaints --------------------------------------------------------------------------------------------------------

BAD = [
    ("unknown effect", ['with_effects = ["hung_mas"]'], "unknown effect 'hung_mas' (did you mean 'hung_mass'?)"),
    ("nothing near", ['with_effects = ["qqq"]'], "unknown effect 'qqq'; the library's effects are top_mass, hung_mass"),
    ("twice", ['with_effects = ["top_mass", "top_mass"]'], "the effect 'top_mass' is named twice"),
    ("bad alpha", ["explain.alpha = 0.5"], "explain.alpha = 0.5 is not allowed"),
    ("bad refits", ["explain.refits = 0"], "explain.refits = 0 is not allowed"),
    ("unknown key", ["explain.alfa = 0.1"], "unknown key 'explain.alfa'"),
    ("not a name", ["with_effects = 3"], "with_effects must be a list"),
]


@pytest.mark.parametrize(("lines", "words"), [b[1:] for b in BAD], ids=[b[0] for b in BAD])
def test_bad_keys_are_told_with_their_line(rig, lines, words):
    said = complaint(with_keys(rig, *lines))
    assert words in said and re.search(r"study\.toml, line 1\b", said) and said.endswith(".")


LIBRARIES = [
    ("def other(): pass", "'effects.py' has no function 'library'; correct the key 'effects'"),
    ("def library(): return 7", "library returns int; return a tuple of Effect"),
    ("def library(): return [1]", "library returns list of int; return a tuple of Effect"),
    ("def library(): return (1, 'x')", "library returns tuple of int, str"),
    ("def library(): return 1 / 0", "library failed with ZeroDivisionError"),
    ("def library(n): return ()", "library cannot be called without arguments"),
    ("import not_there_at_all", "'effects.py' needs the module 'not_there_at_all'"),
    (RIG_EFFECTS.replace('"hung_freq", 30.0', '"top_mass", 30.0').replace('"hung_freq": ', '"top_mass": '),
     "the effects 'top_mass' and 'hung_mass' both have a parameter 'top_mass'"),
    (RIG_EFFECTS.replace("hung_freq", "k1"), "the effect 'hung_mass' has a parameter 'k1', as has the model"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), LIBRARIES)
def test_bad_libraries_are_the_users_own_fault(rig, text, words):
    (rig / "effects.py").write_text(text)
    said = complaint(rig)
    assert words in said and "study.toml, line 1" in said and said.endswith(".")


def test_a_library_that_is_not_there_is_told(rig):
    changed(rig, "effects.py:library", "efects.py:library")
    assert "no library of effects file 'efects.py'" in complaint(rig)
    changed(rig, "efects.py:library", "nowhere.at_all:library")
    assert "no module 'nowhere.at_all'" in complaint(rig)
    changed(rig, 'effects = "nowhere.at_all:library"', 'with_effects = ["top_mass"]')
    assert "no library that holds them" in complaint(rig)


def test_an_effect_that_fails_or_does_not_fit_is_told_with_its_name(rig):
    with_keys(rig, 'with_effects = ["top_mass"]')
    changed(rig, "at(4, {(3, 3): 1.0})", "at(5, {(3, 3): 1.0})", "effects.py")
    said = complaint(rig)
    assert "effect top_mass" in said and "(5, 5), not (4, 4)" in said and "line 1" in said
    changed(rig, "at(5, {(3, 3): 1.0}), parameter", "1 / 0, parameter", "effects.py")
    assert "adding 'top_mass' failed with ZeroDivisionError" in complaint(rig)


def test_a_library_may_come_from_several_functions(rig):
    text = (rig / "effects.py").read_text()
    (rig / "more.py").write_text("from effects import library\n\n\ndef second():\n    return library()[1:]\n")
    (rig / "effects.py").write_text(text + "\n\nevery = library\n\n\ndef first():\n    return every()[:1]\n")
    whole = names(Study.load(rig).library)
    changed(rig, '"effects.py:library"', '["effects.py:first", "more.py:second"]')
    assert len(whole) > 1 and names(Study.load(rig).library) == whole
    changed(rig, '"more.py:second"', '"effects.py:library"')
    with pytest.raises(InputError, match=f"the effects '{whole[0]}' and '{whole[0]}' both have a parameter"):
        Study.load(rig)
    changed(rig, '"effects.py:library"', '"effects"')
    with pytest.raises(InputError, match="names no function"):
        Study.load(rig)


# -- families ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def family(sums):
    """The sums, of whose bend there is a richer form."""
    changed(
        sums, '"A bend.", size("bend"), bent)',
        '"A bend.", size("bend"), bent,\n               '
        'richer=Effect("bow", "bow", "It is straight.", "A bow.", size("bow"), lambda model: '
        'lambda v: model.function(v) | {"s": model.function(v)["s"] + v["bow"] * v["a"] ** 3}))', "effects.py",
    )  # fmt: skip
    return sums


def test_a_richer_member_is_no_candidate_but_may_be_in_the_model(family):
    study = Study.load(family)
    assert names(study.library) == names(study.candidates) == ("bend", "known")
    study = Study.load(with_keys(family, 'with_effects = ["bow"]'))
    assert names(study.included) == ("bow",) and names(study.candidates) == ("known",)
    assert study.problem.evaluate({"a": 2.0, "b": 1.0, "bow": 0.5})["s"] == 3.0 + 0.5 * 8.0


def test_two_members_of_a_family_are_not_in_one_model(family):
    words = complaint(with_keys(family, 'with_effects = ["known", "bend", "bow"]'))
    assert "'bend' and 'bow' are the same effect in less and in more detail" in words and "study.toml" in words


def test_a_changed_richer_member_is_noticed(family):
    before = Study.load(family).library_digest
    assert Study.load(changed(family, "** 3", "** 4", "effects.py")).library_digest != before
