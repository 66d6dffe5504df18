"""Errors of one of several tests: real refits of all tests, a test apart, and a test divided in two."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.explain import by_test, decision
from calib.analyses.hypotheses_of_study import adapters_for
from calib.api.pairs import library_of
from calib.hypotheses.joint import joined_adapter
from calib.missing.findings import findings
from calib.missing.hypotheses import Altered
from calib.missing.linearised_fit import least_squares_fit
from calib.problem.effect import Effect
from calib.study.settings import ExplainSettings

pytestmark = pytest.mark.slow

STD, N = 0.02, 12
NAMES = [f"r_{k}" for k in range(N)]
TRUTH = {"a": 0.4, "b": -0.3, "c": 0.2, "lack": 0.5}
NUMBERS = ["rows", "rms", "expected", "p"]


def effect(name):
    size = calib.Parameter(name, 0.0, -5.0, 5.0, prior_sd=0.5)
    return Effect(name, name, "", "", size, lambda model: None)


EFFECTS = [effect("lack"), effect("other")]


def curved(seed=1, upper=4.0):
    """Twelve responses of three parameters and two effects, slightly curved; ``load`` is a condition."""
    columns = np.random.default_rng(seed).standard_normal((N, 6))
    columns[9:, 2] = 0.0

    def function(values):
        inner = sum(columns[:, k] * values.get(n, 0.0) for k, n in enumerate(("a", "b", "c", "lack", "other")))
        bent = inner + 0.02 * inner**2 + 0.3 * values["load"] * columns[:, 5] * values["a"]
        return dict(zip(NAMES, bent, strict=True))

    space = [calib.Parameter(n, 0.0, -4.0, upper, prior_sd=0.5) for n in "abc"]
    space.append(calib.Parameter("load", 0.0, 0.0, 2.0))
    return calib.FunctionModel("curved", calib.ParameterSpace(tuple(space)), function)


def measured(model, names, name, load=0.0, seed=2):
    told, rng = model.function({**TRUTH, "load": load}), np.random.default_rng(seed)
    targets = {n: (float(value + STD * rng.standard_normal()), STD) for n, value in told.items()}
    return calib.ResponseTest({n: targets[n] for n in names}, name=name, condition={"load": load})


def explained(problem, effects=EFFECTS):
    adapter = joined_adapter(adapters_for(problem.study(effects=library_of(problem, effects))))
    found = decision(adapter, ExplainSettings().model_copy(update={"seed": 1}), "explain")
    return SimpleNamespace(adapter=adapter, found=found, answer=findings(adapter, found, 0.0))


def by_group(errors):
    return errors.set_index(["group", "stage"])


@pytest.fixture(scope="module")
def joint():
    model = curved()
    few = [measured(model, NAMES, "empty"), measured(model, NAMES[8:], "loaded", 1.0, seed=3)]
    return explained(calib.Problem(model, few))


@pytest.fixture(scope="module")
def limited():
    """The same with a limit below the true value of one parameter, so that both fits end on it."""
    model, free = curved(upper=0.25), curved()
    few = [measured(free, NAMES, "empty"), measured(free, NAMES[8:], "loaded", 1.0, seed=3)]
    return explained(calib.Problem(model, few))


@pytest.mark.parametrize("stage", ["before", "after"])
@pytest.mark.parametrize("test", ["empty", "loaded"])
@pytest.mark.parametrize("limit", [False, True])
def test_left_out_errors_are_those_of_real_refits_of_all_tests(joint, limited, test, stage, limit):
    """Every response in turn; the curvature of the model is what the closed form leaves out."""
    joint = limited if limit else joint
    found, hypotheses = joint.found, joint.adapter.hypotheses
    fit = (found.base if stage == "before" else found.chosen).fit
    assert ("a" in fit.active) == limit
    out = []
    for k, row in enumerate(hypotheses.rows):
        if row.test == test:
            kept = np.setdiff1d(np.arange(len(hypotheses.rows)), [k])
            rest = least_squares_fit(Altered(fit.fit_problem, kept=kept), fit.effects, fit.values)
            out.append(fit.fit_problem.residual(rest.values)[k])
    errors = by_group(by_test(joint.adapter, joint.answer)[test].errors.replace({"stage": {"attempt": "after"}}))
    assert errors.loc[("left_out", stage), "rms"] == pytest.approx(np.sqrt(np.mean(np.square(out))), rel=0.04)


def test_a_test_of_few_rows_is_predicted_by_the_others(joint):
    """Four responses do not determine three parameters and an effect: with the others they are predicted."""
    assert joint.found.verdict == "effect" and joint.found.credible == ("lack",)
    errors = by_group(by_test(joint.adapter, joint.answer)["loaded"].errors)
    assert errors.loc[("left_out", "after"), "expected"] < 2.5
    alone = joint.adapter.adapters["loaded"].hypotheses.fit_problem(("lack",))
    single = least_squares_fit(alone, ("lack",), joint.found.chosen.fit.values)
    part = joint.adapter.hypotheses.of("loaded", joint.found.chosen).fit
    assert (np.diag(single.covariance) > 4 * np.diag(part.covariance)).any()


def test_a_test_without_a_common_parameter_changes_nothing():
    model, rng = curved(), np.random.default_rng(4)
    test, row = measured(model, NAMES, "empty"), rng.standard_normal(6)
    space = calib.ParameterSpace((calib.Parameter("stiff", 1.0, 0.0, 3.0, prior_sd=0.3),))
    bench = calib.FunctionModel("bench", space, lambda v: {f"b_{k}": v["stiff"] * x for k, x in enumerate(row)})
    noisy = {f"b_{k}": (float(1.1 * x + STD * rng.standard_normal()), STD) for k, x in enumerate(row)}
    beside = calib.Problem(model, test, beside=(calib.Problem(bench, calib.ResponseTest(noisy, name="bench")),))
    joint, single = explained(beside), explained(calib.Problem(model, test))
    assert joint.found.verdict == single.found.verdict == "effect"
    own = by_group(by_test(joint.adapter, joint.answer)["empty"].errors)[NUMBERS]
    # Each fit ends within its tolerance.
    pd.testing.assert_frame_equal(own, by_group(single.answer.errors)[NUMBERS], rtol=2e-3)


def test_a_test_divided_in_two_gives_the_same(joint):
    model = curved()
    whole = measured(model, NAMES, "whole")
    parts = [measured(model, NAMES[:5], "one"), measured(model, NAMES[5:], "two")]
    single, divided = explained(calib.Problem(model, whole)), explained(calib.Problem(model, parts))
    assert divided.found.verdict == single.found.verdict
    assert divided.found.credible == single.found.credible
    own, other = (by_group(x.answer.errors)[NUMBERS] for x in (divided, single))
    pd.testing.assert_frame_equal(own, other, rtol=2e-3)
    each = [by_group(by_test(divided.adapter, divided.answer)[test].errors) for test in ("one", "two")]
    for group in ("fit", "left_out"):
        rows = pd.DataFrame([one.loc[(group, "after")] for one in each])
        for number in ("rms", "expected"):
            squares = float((rows["rows"] * rows[number] ** 2).sum())
            assert squares == pytest.approx(N * other.loc[(group, "after"), number] ** 2, rel=4e-3)
    tables = [x.answer.effects.set_index("name")["ln_bayes"] for x in (divided, single)]
    assert tables[0]["lack"] == pytest.approx(tables[1]["lack"], abs=0.02)
