"""Effects missing in a function of modes are found as in a model of matrices."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.hypotheses.function_perturbations import modal_function_perturbations
from calib.hypotheses.function_variants import FunctionVariants
from tests.api.cantilever import (
    ADOPTED,
    SENSORS,
    as_function,
    as_matrices,
    bends,
    effects_of_function,
    effects_of_matrices,
    measured,
    space,
)

PROP = 2500.0


@pytest.fixture(scope="module")
def explained():
    test = calib.ModalTest(measured(prop=PROP), mode_count=14)
    sides = {"function": (as_function(), effects_of_function()), "matrices": (as_matrices(), effects_of_matrices())}
    return {adapter: calib.Problem(model, test).explain(effects) for adapter, (model, effects) in sides.items()}


@pytest.mark.slow
def test_a_missing_prop_is_found_as_with_matrices(explained):
    own, theirs = explained["function"], explained["matrices"]
    assert own.verdict == theirs.verdict == "effect"
    assert [e.name for e in own.named] == [e.name for e in theirs.named] == ["prop"]
    mine, other = (why.table.set_index("name") for why in (own, theirs))
    for column in ("magnitude", "magnitude_low", "magnitude_high", "ln_bayes", "z"):
        assert mine.loc["prop", column] == pytest.approx(other.loc["prop", column], rel=1e-3)
    assert mine.loc["prop", "magnitude_low"] < PROP < mine.loc["prop", "magnitude_high"]
    assert mine.loc["m_mid", "z"] == pytest.approx(other.loc["m_mid", "z"], rel=1e-2)
    # A fit of a costly model ends where its steps gain little: one that is 18 standard deviations off a little short.
    np.testing.assert_allclose(own.errors["rms"], theirs.errors["rms"], rtol=3e-3)


@pytest.mark.slow
def test_with_the_prop_the_function_is_fitted_as_the_matrices_are(explained):
    own, theirs = (explained[adapter].with_named().calibrate(starts=1) for adapter in ("function", "matrices"))
    assert "prop" in own.parameters.index
    for name in (*ADOPTED, "prop"):
        std = theirs.parameters.loc[name, "std"]
        assert own.values[name] == pytest.approx(theirs.values[name], abs=1e-2 * std)
        assert own.parameters.loc[name, "std"] == pytest.approx(std, rel=1e-3)


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing():
    problem = calib.Problem(as_function(), calib.ModalTest(measured(), mode_count=14))
    assert problem.explain(effects_of_function()).verdict == "nothing_detectable"


def test_an_effect_may_wrap_the_function_instead():
    """As a user would write it: what the model's function gives, changed."""

    def build(model):
        def stiffer(v):
            answer = model.function({n: x for n, x in v.items() if n != "seen"})
            answer["natural_freq"] *= 1 + v["seen"]  # in place: what was kept must not be changed by it
            return answer

        return stiffer

    magnitude = calib.Parameter("seen", 0.0, -0.1, 0.5, "-", prior_sd=0.01)
    effect = calib.Effect("seen", "seen", "it is not", "it", magnitude, build)
    variants = FunctionVariants(as_function(), (effect,), ())
    model = variants.with_effects(["seen"])
    for magnitude in (0.0, 0.02, 0.02, 0.0, 0.04):
        found = model.modes({"seen": magnitude}, 14).natural_freq / as_function().modes({}, 14).natural_freq
        assert found == pytest.approx(1 + magnitude)


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    "changed",
    [
        lambda v: bends({**v, "m_tip": v["m_tip"] + 0.1 + v["heavier"]}),
        lambda v: {**bends(v), "damping_ratio": bends(v)["damping_ratio"] + 0.01},
        lambda v: {**bends(v), "shapes": bends(v)["shapes"] * np.arange(1, 9)[:, None]},
    ],
)
def test_an_effect_that_changes_the_base_model_is_refused(changed):
    def build(model):
        return changed

    magnitude = calib.Parameter("heavier", 0.0, 0.0, 5.0, "kg", prior_sd=0.1)
    effect = calib.Effect("heavier", "heavier", "it is not", "it", magnitude, build)
    with pytest.raises(calib.InputError, match="magnitude 0"):
        calib.Problem(as_function(), calib.ModalTest(measured(), mode_count=14)).explain([effect])


def test_an_effect_that_builds_no_function_is_refused():
    magnitude = calib.Parameter("heavier", 0.0, 0.0, 5.0, "kg", prior_sd=0.1)
    effect = calib.Effect("heavier", "heavier", "it is not", "it", magnitude, lambda model: 3.0)
    problem = calib.Problem(as_function(), calib.ModalTest(measured(), mode_count=14))
    for ask in (problem.explain, problem.with_effects):
        with pytest.raises(calib.InputError, match="heavier"):
            ask([effect])


@pytest.mark.slow
def test_points_at_which_an_effect_fails_are_told():
    def build(model):
        def failing(v):
            if v["m_mid"] != 0:
                raise RuntimeError("no convergence with it")
            return model.function({n: x for n, x in v.items() if n != "m_mid"})

        return failing

    prop, mass = effects_of_function()
    held = {name: ADOPTED[name] for name in ("k_root", "c_tip")}
    test = calib.ModalTest(measured(prop=PROP, **held), mode_count=14)
    problem = calib.Problem(as_function(), test).keep(["EI_y", "EI_z", "m_tip"])
    why = problem.explain([prop, replace(mass, build=build)])
    assert [e.name for e in why.named] == ["prop"]
    told = why.explanation
    assert told.figures["failed"] >= 2 and any("no convergence with it" in trace for trace in told.traces)
    row = told.effects.set_index("name").loc["m_mid"]
    assert not row["visible"] and np.isnan(row["z"]) and "fails" in row["implausible"]


@pytest.mark.slow
def test_the_calls_of_a_function_are_counted_and_none_is_made_twice():
    asked = []

    def bending(v):
        asked.append(tuple(sorted(v.items())))
        return bends(v)

    model = replace(as_function(), function=bending)
    held = {name: ADOPTED[name] for name in ("EI_z", "k_root", "c_tip")}
    test = calib.ModalTest(measured(prop=PROP, **held), mode_count=14, held_out=["m3", "2y"])
    told = calib.Problem(model, test).keep(["EI_y", "m_tip"]).explain(effects_of_function()).explanation
    later = told.figures["evaluations_intervals"] + told.figures["evaluations_recommendation"]
    assert len(asked) == len(set(asked)) >= told.explanation.evaluations + later > 50


# -- what may be off by itself -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def local():
    own = space().freeze({"c_tip": 4.0})
    model = replace(as_function(), space=own)
    perturbations = modal_function_perturbations(model, own)
    return FunctionVariants(model, (), tuple(a.effect for a in perturbations)), perturbations


def test_local_perturbations_of_a_function_are_held_parameters_kinds_and_faults_of_the_measurement(local):
    names = {a.effect.name for a in local[1]}
    assert "change of c_tip" in names and "change of m_tip" not in names
    assert {"change of m_tip in frequency", "change of m_tip in shape", "scale of damping"} <= names
    assert all(a.effect.of_measurement == (a.kind == "response") for a in local[1])


def test_each_local_perturbation_does_what_it_says(local):
    variants, _ = local
    model = variants.with_effects(())
    base, heavier = model.modes({}, 14), as_function().modes({"m_tip": 1.2 * ADOPTED["m_tip"]}, 14)
    moved = model.modes({"change of m_tip in frequency": 0.2}, 14)
    np.testing.assert_allclose(moved.natural_freq, heavier.natural_freq)
    np.testing.assert_allclose(moved.shapes, base.shapes)
    moved = model.modes({"change of m_tip in shape": 0.2}, 14)
    np.testing.assert_allclose(moved.natural_freq, base.natural_freq)
    np.testing.assert_allclose(moved.shapes, heavier.shapes)
    moved = model.modes({"change of m_tip in damping": 0.2}, 14)
    np.testing.assert_allclose(moved.damping_ratio, heavier.damping_ratio)
    moved = model.modes({"scale of frequency": 0.05}, 14)
    np.testing.assert_allclose(moved.natural_freq, 1.05 * base.natural_freq)
    np.testing.assert_allclose(moved.shapes, base.shapes)
    moved = model.modes({"change of c_tip": 0.5}, 14)
    np.testing.assert_allclose(moved.damping_ratio, as_function().modes({"c_tip": 6.0}, 14).damping_ratio)


def test_a_change_for_one_kind_follows_modes_over_a_crossing():
    """Where bending in y and in z cross, the frequencies of a stiffer plane go with the shapes of that plane."""
    values = {"EI_y": 6900.0, "EI_z": 7000.0}
    model = as_function(**values)
    perturbations = modal_function_perturbations(model, model.space)
    variants = FunctionVariants(model, (), tuple(a.effect for a in perturbations))
    base, moved = (variants.with_effects(()).modes({"change of EI_y in shape": by}, 2) for by in (0.0, 0.05))
    np.testing.assert_allclose(moved.natural_freq, base.natural_freq)
    in_z = [k for k, s in enumerate(SENSORS) if s.direction == "z"]
    for modes in (base, moved):
        share = (np.abs(modes.shapes[in_z]) ** 2).sum(axis=0) / (np.abs(modes.shapes) ** 2).sum(axis=0)
        assert share == pytest.approx([1.0, 0.0], abs=1e-6)


def test_derivatives_by_a_change_of_one_kind_are_those_by_the_parameter(local):
    """So they cost no calls of their own: as differences do, but of the parameter that is known already."""
    variants, perturbations = local
    model = variants.with_effects(())
    names = [a.effect.name for a in perturbations if " in " in a.effect.name]
    values, rows = model.space.complete({"m_tip": 1.1 * ADOPTED["m_tip"]}), np.eye(len(SENSORS))
    modes = model.modes(values, 14)
    parameters = [p.name for p in variants.model.space.free]
    model.derivatives(values, modes, parameters, range(6), rows)
    before = variants.calls
    found = model.derivatives(values, modes, [*parameters, *names], range(6), rows)
    assert variants.calls == before and found.names == (*parameters, *names)
    near = replace(model, function=model.function.__call__)  # which says nothing of what a change moves
    expected = near.derivatives(values, modes, [*parameters, *names], range(6), rows)
    for what in ("natural_freq", "damping_ratio", "eigenvalue", "damped_freq", "shapes"):
        own, other = getattr(found, what), getattr(expected, what)
        np.testing.assert_allclose(own, other, atol=1e-5 * np.abs(other).max())
    there = {**values, names[0]: 0.1}  # a change that is there is differenced itself
    assert not model.function.moving(there) and set(model.function.moving(values)) == {*names}
