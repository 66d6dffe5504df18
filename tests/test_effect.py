"""Validation of effects, and their addition to function models."""

from dataclasses import replace

import pytest

from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.structure.function_model import FunctionModel, extend_function


def effect(name="gap", lower=0.0, value=0.0, prior_sd=0.5, build=lambda model: None, **more):
    magnitude = Parameter(more.pop("called", name), value, lower, 4.0, "mm", prior_sd=prior_sd, **more.pop("how", {}))
    return Effect(name, "a gap", "no gap", "wear", magnitude, build, **more)


FREQ = Parameter("gap_freq", 5.0, 2.0, 9.0, "Hz")


def test_what_follows_from_the_magnitude():
    one, other = effect(), effect(lower=-1.0, nuisance=(FREQ,), grid=({"gap": 1.0, "gap_freq": 4.0},))
    assert not one.signed and other.signed
    assert one.plausible == 0.5
    assert one.names == ("gap",) and other.names == ("gap", "gap_freq")
    assert other.parameters == (other.magnitude, FREQ)


def test_a_magnitude_without_a_derivative_at_0_starts_at_a_small_limit():
    assert effect(lower=1e-6, value=1e-6).magnitude.value == 1e-6


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"called": "slack"}, "its magnitude is named 'slack'"),
        ({"prior_sd": None}, "no plausible size"),
        ({"value": 0.1}, "its magnitude of 0.1 mm is not that of the base model"),
        ({"lower": 0.5, "value": 0.0}, "is not that of the base model"),
        ({"how": {"distribution": "fixed"}}, "is not that of the base model"),
        ({"nuisance": (FREQ,)}, "no meaning at magnitude 0"),
        ({"grid": ({"gap_freq": 1.0},)}, "its grid has a point"),
        ({"grid": ({"gap": float("nan")},)}, "its grid has a point"),
        ({"nuisance": (FREQ,), "grid": ({"gap": 1.0},)}, "its grid has a point"),
        ({"nuisance": (FREQ,), "grid": ({"gap": 1.0, "gap_freq": 3.0, "other": 1.0},)}, "its grid has a point"),
    ],
)
def test_inconsistent_attributes_are_refused(options, words):
    with pytest.raises(InputError, match=words) as caught:
        effect(**options)
    assert "effect gap" in str(caught.value)


def test_a_grid_point_without_magnitude_is_refused():
    with pytest.raises(InputError, match="its grid has a point"):
        effect(grid=({"gap": 0.0}, {"gap": 1.0}))


# -- function models ---------------------------------------------------------------------------------------------------


def line(values):
    return {"y": values["slope"] * 2.0, "z": values["offset"] + values.get("known", 0.0)}


@pytest.fixture
def model():
    space = ParameterSpace(
        (Parameter("slope", 1.0, 0.0, 3.0), Parameter("offset", 0.5, 0.0, 2.0)),
        (LinearConstraint("both", (("slope", 1.0), ("offset", 1.0)), 0.0, 4.0),),
    )
    return FunctionModel("line", space, line)


def bending(model):
    return lambda values: {**model.function(values), "y": model.function(values)["y"] + values["gap"] ** 2}


def doubling(model):
    return lambda values: {n: v * (1 + values["twice"]) for n, v in model.function(values).items()}


def test_an_effect_is_a_function_of_all_values(model):
    wider = extend_function(model, [effect(build=bending)])
    at = {"slope": 1.0, "offset": 0.25}
    assert wider.function({**at, "gap": 3.0}) == {"y": 11.0, "z": 0.25}
    assert wider.function({**at, "gap": 0.0}) == model.function(at) == {"y": 2.0, "z": 0.25}
    assert wider.space.names == ("slope", "offset", "gap") and model.space.names == ("slope", "offset")
    assert wider.space.constraints == model.space.constraints and wider.name == model.name


def test_each_effect_is_built_on_the_previous_one(model):
    both = extend_function(model, [effect(build=bending), effect("twice", build=doubling)])
    assert both.function({"slope": 1.0, "offset": 0.25, "gap": 3.0, "twice": 1.0}) == {"y": 22.0, "z": 0.5}
    other = extend_function(model, [effect("twice", build=doubling), effect(build=bending)])
    assert other.function({"slope": 1.0, "offset": 0.25, "gap": 3.0, "twice": 1.0}) == {"y": 13.0, "z": 0.5}
    assert extend_function(model, []) is model


def test_a_function_may_accept_the_parameters_of_its_effect(model):
    wider = extend_function(model, [effect("known")])
    assert wider.function is line and wider.space.names[-1] == "known"
    assert wider.function({"slope": 1.0, "offset": 0.25, "known": 1.0})["z"] == 1.25


def test_nuisance_parameters_are_added(model):
    hung = effect(nuisance=(FREQ,), grid=({"gap": 1.0, "gap_freq": 4.0},))
    assert extend_function(model, [hung, effect("twice")]).space.names[2:] == ("gap", "gap_freq", "twice")


def test_an_effect_that_cannot_be_added_is_refused(model):
    with pytest.raises(InputError, match="has 'gap' already"):
        extend_function(model, [effect(), effect()])
    with pytest.raises(InputError, match="has 'slope' already"):
        extend_function(model, [effect("slope")])
    with pytest.raises(InputError, match="it builds dict"):
        extend_function(model, [effect(build=lambda model: {"y": 1.0})])
    own = replace(effect(), nuisance=(replace(FREQ, name="offset"),), grid=({"gap": 1.0, "offset": 1.0},))
    with pytest.raises(InputError, match="has 'offset' already"):
        extend_function(model, [own])


# -- families ----------------------------------------------------------------------------------------------------------


def member(name, richer=None, freq=FREQ):
    return effect(name, nuisance=(freq,), grid=({name: 1.0, freq.name: 4.0},), richer=richer)


def test_a_family_runs_from_simple_to_rich_and_may_share_nuisance_parameters():
    third = member("third")
    first = member("first", member("second", third))
    assert [e.name for e in first.family] == ["first", "second", "third"] and third.family == (third,)


@pytest.mark.parametrize(
    ("richer", "words"),
    [
        (member("gap"), "the parameter 'gap' twice"),
        (member("wide", freq=replace(FREQ, upper=12.0)), "different parameters 'gap_freq'"),
    ],
)
def test_a_family_whose_members_mean_different_things_by_one_name_is_refused(richer, words):
    with pytest.raises(InputError, match=words):
        member("gap", richer)
