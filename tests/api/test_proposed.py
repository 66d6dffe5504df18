"""Proposals for a chain of masses whose truth is known; measurements are synthetic, with noise."""

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.hypotheses.proposals.code import library_text
from calib.hypotheses.proposals.proposal import Proposal
from calib.structure.effects.composition import Names
from calib.structure.effects.compositions import compositions
from calib.structure.effects.extend import addition_of, extend
from calib.structure.effects.point_compositions import hung_at
from tests.api.storeys import DAMPING, FLOORS, MASS, STIFF, chain, measured, posed

CASES = {
    "mass": ({"mass": [(4, 300.0)]}, ("added mass", "mass"), "floor 4", {"added mass": 300.0, "mass": 15.0}, 12.0),
    "spring": ({"stiffness": [(3, -0.25)]}, ("stiffness",), "storey 3", {"stiffness": -25.0}, None),
    "damper": ({"damping": [(2, 1.5)]}, ("damping", "dissipation", "damper between"), "damper 2",
               {"damping": 150.0, "dissipation": 1e3 * 1.5 * 1.1 * DAMPING / (1.04 * STIFF)}, None),
    "hung": ({"hung": (5, 150.0, 6.0)}, ("hung mass",), "sensor 5x", {"hung mass": 150.0}, 15.0),
}  # fmt: skip


FIRST, *OTHERS = CASES


@pytest.fixture(scope="module", params=[FIRST, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)])
def case(request):
    changed, *right = CASES[request.param]
    problem = posed(**changed)
    why = problem.explain([], seed=1)
    return problem, why, why.propose(), right


@pytest.mark.medium
def test_kind_place_and_magnitude_are_those_of_the_truth(case):
    _, why, proposed, (kinds, at, true, height) = case
    assert why.verdict == "none_explains"
    first = proposed.table.iloc[0]
    assert first["kind"] in kinds
    alike = [other.partition(" of ")[2] for other in first["alike"].split("; ")]
    assert at in [*proposed.table["at"][:3], *alike]  # three kinds of damper there do the same
    size = true.get(first["kind"])
    assert size is not None and first["lower"] <= size <= first["upper"]
    assert height is None or first["z"] == pytest.approx(height)
    assert "Proposed: " in str(proposed) and first["title"][1:] in str(proposed)


@pytest.mark.medium
def test_the_extended_model_fits_and_predicts_what_was_held_out(case):
    problem, _, proposed, _ = case
    (first, *_) = proposed.effects
    again = problem.explain([first], seed=1)
    assert [e.name for e in again.named] == [first.name]
    rms = again.errors.pivot(index="group", columns="stage", values="rms")
    for group in {"fit", "left_out", "held_out_modes"} & set(rms.index):
        assert rms.loc[group, "after"] < 0.7 * rms.loc[group, "before"]


@pytest.mark.medium
def test_the_written_code_builds_what_was_fitted(case):
    _, _, proposed, _ = case
    scope = {}
    exec(proposed.code, scope)
    written, model = scope["proposed_effects"](), chain()
    assert [e.name for e in written] == [e.name for e in proposed.effects]
    for one, other in zip(written, proposed.effects, strict=True):
        assert_same(model, one, other)


def assert_same(model, one, other):
    """The same matrices at the same magnitude."""
    values = {p.name: other.magnitude.upper / 7 if p is other.magnitude else p.value for p in other.parameters}
    for a, b in zip(extend(model, [one]).matrices(values), extend(model, [other]).matrices(values), strict=True):
        assert abs(a - b).max() == 0 and a.shape == b.shape
    assert (
        max(abs(a - b).max() for a, b in zip(extend(model, [one]).matrices(values), padded(model, a), strict=True)) > 0
    )


def padded(model, like):
    """The base model's matrices on as many degrees of freedom."""
    more = like.shape[0] - model.n_dof
    return [np.pad(m.toarray(), (0, more)) for m in model.matrices({})]


@pytest.mark.medium
def test_every_kind_of_composition_is_written_as_it_is_built():
    model, seen = chain(), measured(mass=[(4, 300.0)])
    own = compositions(model, [seen], model.space.values)
    every = {c.kind: c for c in (*own.plain, *own.mounts, *(one.composed for one in own.hung))}
    assert set(every) == {
        "stiffness", "damping", "mass", "dissipation", "damper mount", "added mass", "hung mass", "spring to ground",
        "damper to ground", "spring between", "damper between", "soft support",
    }  # fmt: skip
    proposals = [Proposal(c, _Fitted(c), 1.0, 1.0, 1) for c in every.values()]
    scope = {}
    exec(library_text(proposals, 'a "strange" title\\', ["other"]), scope)
    for one, composed in zip(scope["proposed_effects"](), every.values(), strict=True):
        assert_same(model, one, composed.effect)


class _Fitted:
    """As much of a fit as the code needs."""

    def __init__(self, composed):
        self.fit = self
        self.values = {composed.effect.name: composed.effect.magnitude.upper / 9}


@pytest.mark.medium
def test_nothing_is_proposed_where_nothing_is_missing():
    why = posed().explain([], seed=1)
    proposed = why.propose()
    assert why.verdict == "nothing_detectable"
    assert proposed.effects == () and proposed.code == "" and proposed.table.empty
    assert "Nothing is proposed: nothing seems missing." in str(proposed)


@pytest.mark.medium
def test_nothing_is_proposed_where_the_measurement_is_to_blame():
    modes = measured()
    shapes = modes.shapes.copy()
    shapes[2] *= 1.2
    test = calib.ModalTest(calib.MeasuredModes(**{**vars(modes), "shapes": shapes}))
    why = calib.Problem(chain(), test).explain([], seed=1)
    assert why.verdict == "measurement"
    proposed = why.propose()
    assert proposed.effects == () and "the measurement is the suspect, gain of sensor 3x" in str(proposed)


@pytest.mark.medium
def test_a_named_effect_leaves_nothing_to_propose(case):
    problem, _, proposed, _ = case
    again = problem.explain(proposed.effects[:1], seed=1).propose()
    assert again.effects == () and re.search(r"listed causes explain the data, \w+\.", str(again))


def test_names_are_free_and_identifiers():
    names = Names({"added_mass_4", "spring_3"})
    assert names.free("added mass 4") == "added_mass_4_2"
    assert names.free("4 springs").isidentifier() and names.free("Spring, 3") == "spring_3_2"
    assert names.free("hung", "_freq") == "hung" and names.free("hung freq") == "hung_freq_2"


def test_a_hung_mass_is_neutral_without_mass():
    model = chain()
    sensor = measured().sensors[2]
    hung = hung_at(model, sensor, 0, {}, Names(()), (1.0, 10.0)).effect
    assert addition_of(model, hung).n_added == 1
    found = extend(model, [hung]).modes({hung.name: hung.magnitude.lower, f"{hung.name}_freq": 30.0}, FLOORS)
    assert found.natural_freq[:4] == pytest.approx(model.modes({}, 4).natural_freq, rel=1e-3)


@pytest.mark.medium
def test_several_models_are_refused():
    one = calib.Problem(chain(), calib.ModalTest(measured(mass=[(4, 300.0)]), name="one"))
    two = calib.Problem(
        replace(chain(1.01 * MASS), name="other"),
        calib.ModalTest(measured(mass=[(4, 300.0)], seed=6), name="two"),
    )
    why = replace(one, beside=(two,)).explain({}, seed=1)
    assert why.verdict == "none_explains"
    with pytest.raises(calib.InputError, match="several models"):
        why.propose()


@pytest.mark.slow
def test_several_tests_of_one_model_are_proposed_for_together():
    one, two = (
        calib.Problem(chain(), calib.ModalTest(measured(mass=[(4, 300.0)], seed=seed), name=f"test {seed}"))
        for seed in (5, 6)
    )
    proposed = replace(one, beside=(two,)).explain([], seed=1).propose(1)
    (first,) = proposed.table.to_dict("records")
    true = {("added mass", "node 4"): 300.0, ("mass", "floor 4"): 100.0 * 300.0 / MASS}[first["kind"], first["at"]]
    assert first["lower"] <= true <= first["upper"]
