"""Parts that a function scales itself are local perturbations: found where they are wrong, and derived where it can."""

import pytest

import calib
from calib.errors.errors import InputError
from calib.hypotheses.function_perturbations import modal_function_perturbations, response_perturbations
from calib.hypotheses.function_variants import FunctionVariants
from calib.structure.function_model import FunctionModel, responses_of, slope_entry
from calib.structure.function_parts import ScaledPart
from models.function_effect import function_effect
from models.tire.modal import tire_modes
from models.tire.model import tire_on_ground
from models.tire.parts import PARTS

ARMS = ("first", "second", "third")
SPRINGS = tuple(ScaledPart(f"the {name} arm", "stiffness") for name in ARMS)
SPACE = calib.ParameterSpace(
    [calib.Parameter("E", 10.0, 5.0, 20.0, "MPa", prior_sd=3.0), calib.Parameter("load", 2.0, 1.0, 3.0, "kN", "fixed")]
)
TOLD = []


def sag(v):
    """Three arms of one modulus, each loaded alone and all together by a beam; with derivatives of what is present."""
    TOLD.append(dict(v))
    out, rest = {}, v.get("slack", 0.0)
    stiff = {name: v["E"] * k * (1 + v.get(p.parameter, 0.0)) for name, k, p in zip(ARMS, (1, 2, 4), SPRINGS)}  # noqa: B905
    for name, stiffness in stiff.items():
        out[f"sag_{name}"] = 10 * v["load"] / stiffness + rest
    out["lift_all"] = sum(v["load"] / s for s in stiff.values())
    slopes = {}
    for name, part in zip(ARMS, SPRINGS, strict=True):
        for response in (f"sag_{name}", "lift_all"):
            share = 10 * v["load"] / stiff[name] if response.startswith("sag") else v["load"] / stiff[name]
            slopes.setdefault("E", {}).setdefault(response, 0.0)
            slopes["E"][response] -= share / v["E"]
            slopes.setdefault("load", {}).setdefault(response, 0.0)
            slopes["load"][response] += share / v["load"]
            if part.parameter in v:
                slopes.setdefault(part.parameter, {})[response] = -share / (1 + v[part.parameter])
    if "slack" in v:
        slopes["slack"] = {f"sag_{name}": 1.0 for name in ARMS}
    every = {slope_entry(r, p): own.get(r, 0.0) for p, own in slopes.items() for r in out}
    return out | every


def slack():
    return function_effect(
        "slack", "Slack", "slack", "Arms carry at once.", "Play at the pins.", 5.0, "mm", 0.3
    )  # fmt: skip


def model():
    return FunctionModel("arms", SPACE, sag, parts=SPRINGS)


def measurement():
    """As measured: the second arm lost 30 %, the others did not."""
    TOLD.clear()
    true = responses_of(sag({"E": 11.0, "load": 2.0, SPRINGS[1].parameter: -0.3}))
    return calib.ResponseTest({name: (value, 0.005 * value) for name, value in true.items()}, name="jack")


def test_the_wrong_part_is_found():
    found = calib.Problem(model(), measurement()).calibrate(starts=1, progress=False).explain([], progress=False)
    best = found.explanation.explanation.base_adequacy.perturbations
    names = [best.owners[k] for k in abs(best.z).argsort()[::-1]]
    assert names[0] == "stiffness of the second arm"
    assert found.verdict == "none_explains"


@pytest.mark.parametrize("held", [{}, {"slack": 0.4}, {"stiffness of the third arm": 0.2}])
def test_derivatives_by_what_is_absent_are_those_of_the_built_function(held):
    measured = {name: 1.0 + k for k, name in enumerate(["sag_first", "sag_second", "sag_third", "lift_all"])}
    perturbations = tuple(p.effect for p in response_perturbations(SPACE, measured, scaled=SPRINGS))
    variants = FunctionVariants(model(), (slack(),), perturbations)
    everything = variants.with_effects(())
    values = everything.space.values | held
    absent = [name for name in variants.names if name not in held]
    out = everything.function.derivatives_by(values, absent)
    errors = {e.name for e in perturbations if e.of_measurement}
    h = 1e-6
    for name in set(absent) - errors:
        for response in measured:
            high, low = (everything.function(values | {name: d})[response] for d in (h, -h))
            assert out[slope_entry(response, name)] == pytest.approx((high - low) / (2 * h), abs=1e-6), (name, response)


def test_asking_for_derivatives_costs_one_call_of_the_function():
    perturbations = response_perturbations(SPACE, {"sag_first": 1.0, "lift_all": 2.0}, scaled=SPRINGS)
    variants = FunctionVariants(model(), (slack(),), tuple(p.effect for p in perturbations))
    function, values = variants.with_effects(()).function, variants.with_effects(()).space.values
    TOLD.clear()
    function(values)
    function.derivatives_by(values, variants.names)
    assert [set(call) - set(SPACE.names) for call in TOLD] == [set(), {"slack", *(p.parameter for p in SPRINGS)}]


@pytest.mark.medium
@pytest.mark.parametrize("wrong", [lambda out: out | {"d(sag_first)/d(slack)": float("nan")}, lambda out: 1 / 0])
def test_a_function_that_fails_to_derive_is_differenced(wrong):
    def failing(v):
        out = sag(v)
        return wrong(out) if "slack" in v and v["slack"] == 0 else out

    problem = calib.Problem(FunctionModel("arms", SPACE, failing, parts=SPRINGS), measurement())
    found = problem.calibrate(starts=1, progress=False).explain([slack()], progress=False)
    as_usual = (
        calib.Problem(model(), measurement()).calibrate(starts=1, progress=False).explain([slack()], progress=False)
    )
    assert found.verdict == as_usual.verdict
    z, usual = (one.explanation.explanation.base_adequacy.named.z for one in (found, as_usual))
    assert z == pytest.approx(usual, rel=1e-4)


def test_a_part_is_the_same_in_all_tests_and_bounded_by_its_kind():
    parts = (*SPRINGS, ScaledPart("the damper", "damping"))
    found = {p.effect.name: p for p in response_perturbations(SPACE, {"x": 1.0}, "soft", ["load"], parts)}
    assert {part.parameter for part in parts} <= set(found)
    assert found["stiffness of the first arm"].effect.magnitude.lower == -0.9
    assert found["damping of the damper"].effect.magnitude.lower == -1.0
    assert "change of load in test soft" in found


def test_the_tire_offers_zones_and_plies():
    assert tire_on_ground(15, 12).parts == tire_modes().parts == PARTS
    names = [p.effect.name for p in modal_function_perturbations(tire_modes(), tire_modes().space)]
    assert {"stiffness of the sidewalls", "mass of the crown", "stiffness of ply 4"} <= set(names)


@pytest.mark.parametrize("name", ["stiffness of the beads", "mass of the crown", "stiffness of ply 1"])
def test_a_part_changes_the_modes_of_a_tire(name):
    model = tire_modes(15, (0, 1, 2), 1, 3)
    own = model.function(model.space.values)["natural_freq"]
    more = model.function(model.space.values | {name: 0.2})["natural_freq"]
    assert ((more < own) if name.startswith("mass") else (more > own)).all()


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (lambda: [ScaledPart("", "mass")], "no name"),
        (lambda: [ScaledPart("rod", "weight")], "weight"),
        (lambda: [*SPRINGS, SPRINGS[0]], "twice"),
        (lambda: ["stiffness"], "no part"),
    ],
)
def test_wrong_parts_are_refused(parts, words):
    with pytest.raises(InputError, match=words):
        FunctionModel("arms", SPACE, sag, parts=parts())


@pytest.mark.medium
def test_the_wrong_part_of_a_function_is_proposed():
    problem = calib.Problem(model(), measurement())
    first = problem.explain([], seed=1, progress=False).propose().table.iloc[0]
    assert (first["kind"], first["at"]) == ("stiffness", "the second arm")
    assert first["unit"] == "%" and first["lower"] <= -30.0 <= first["upper"]
    bare = calib.Problem(FunctionModel("arms", SPACE, sag), measurement())
    nothing = bare.explain([], seed=1, progress=False).propose()
    assert "Nothing can be proposed: the model names no parts" in str(nothing) and not nothing.effects
