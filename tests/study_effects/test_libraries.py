"""Libraries of effects in a study: what is refused, several functions, families."""

import re

import pytest

from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.problem.parameter import Parameter
from calib.study.loading import pick
from calib.study.study import LoadedStudy
from tests.study_effects.studies import RIG_EFFECTS, changed, complaint, names, with_keys

# -- complaints --------------------------------------------------------------------------------------------------------

BAD = [
    ("unknown effect", ['with_effects = ["hung_mas"]'], "unknown effect 'hung_mas' (did you mean 'hung_mass'?)"),
    ("nothing near", ['with_effects = ["qqq"]'], "unknown effect 'qqq'; the listed effects are top_mass, hung_mass"),
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


def test_of_many_effects_the_nearest_are_listed():
    names = [f"added_mass_{k}" for k in range(1, 700)]
    magnitudes = [Parameter(name, 0.0, 0.0, 1.0, "kg", prior_sd=0.1) for name in names]
    many = [Effect(p.name, "mass", "None.", "A mass.", p, lambda model: None) for p in magnitudes]
    with pytest.raises(InputError) as refused:
        pick(many, "added_mas_77", "study.toml")
    said = str(refused.value)
    assert "the nearest of 699 listed effects are added_mass_77, " in said and said.count("added_mass_") < 30


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
    assert "no list that holds them" in complaint(rig)


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
    whole = names(LoadedStudy.load(rig).library)
    changed(rig, '"effects.py:library"', '["effects.py:first", "more.py:second"]')
    assert len(whole) > 1 and names(LoadedStudy.load(rig).library) == whole
    changed(rig, '"more.py:second"', '"effects.py:library"')
    with pytest.raises(InputError, match=f"the effects '{whole[0]}' and '{whole[0]}' both have a parameter"):
        LoadedStudy.load(rig)
    changed(rig, '"effects.py:library"', '"effects"')
    with pytest.raises(InputError, match="names no function"):
        LoadedStudy.load(rig)


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
    study = LoadedStudy.load(family)
    assert names(study.library) == names(study.candidates) == ("bend", "known")
    study = LoadedStudy.load(with_keys(family, 'with_effects = ["bow"]'))
    assert names(study.included) == ("bow",) and names(study.candidates) == ("known",)
    assert study.problem.evaluate({"a": 2.0, "b": 1.0, "bow": 0.5})["s"] == 3.0 + 0.5 * 8.0


def test_two_members_of_a_family_are_not_in_one_model(family):
    words = complaint(with_keys(family, 'with_effects = ["known", "bend", "bow"]'))
    assert "'bend' and 'bow' are the same effect in less and in more detail" in words and "study.toml" in words


def test_a_changed_richer_member_is_noticed(family):
    before = LoadedStudy.load(family).library_digest
    assert LoadedStudy.load(changed(family, "** 3", "** 4", "effects.py")).library_digest != before
