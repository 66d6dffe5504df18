"""Proposals for a chain of masses whose truth is known; measurements are synthetic, with noise."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import eig

import calib
from calib.analyses.compositions import compositions
from calib.analyses.proposed_code import library_text
from calib.missing.proposal import Proposal
from calib.structure.composition import Names
from calib.structure.extend import addition_of, extend
from calib.structure.point_compositions import hung_at

FLOORS, MASS, STIFF, DAMPING = 6, 2000.0, 4e6, 4e3
HELD = ("M5",)


def spring(k, n=FLOORS):
    """Square of the drift below floor k, from 1."""
    row = np.zeros(n)
    row[k - 1] = 1.0
    if k > 1:
        row[k - 2] = -1.0
    return np.outer(row, row)


def chain(mass=MASS):
    """One stiffness and one damping constant for all storeys; masses are known."""
    named = range(1, FLOORS + 1)
    return calib.StructuralModel.from_matrices(
        stiffness={f"storey {k}": (STIFF * spring(k), "k") for k in named},
        damping={f"damper {k}": (DAMPING * spring(k), "c") for k in named},
        mass={f"floor {k}": mass * np.diag(np.eye(FLOORS)[k - 1]) for k in named},
        dofs=pd.DataFrame(
            [(k, "x", 0.0, 0.0, 3.0 * k) for k in named], columns=["node", "direction", "x", "y", "z"]
        ),
        parameters=[
            calib.Parameter("k", 1.0, 0.7, 1.4, "-", prior_sd=0.15),
            calib.Parameter("c", 1.0, 0.3, 2.0, "-", prior_sd=0.4),
        ],
        name="chain",
    )  # fmt: skip


def truth(mass=(), stiffness=(), damping=(), hung=None):
    """K, C, M, all stiffnesses 4 % higher; changes of floors in kg, of storeys and dampers as shares."""
    k = sum(1.04 * STIFF * (1 + dict(stiffness).get(n, 0.0)) * spring(n) for n in range(1, FLOORS + 1))
    c = sum(1.1 * DAMPING * (1 + dict(damping).get(n, 0.0)) * spring(n) for n in range(1, FLOORS + 1))
    m = np.diag([MASS + dict(mass).get(n, 0.0) for n in range(1, FLOORS + 1)])
    if hung is not None:
        floor, weight, freq = hung
        row = np.zeros(FLOORS + 1)
        row[floor - 1], row[-1] = 1.0, -1.0
        omega = 2 * np.pi * freq
        k, c, m = (np.pad(a, (0, 1)) for a in (k, c, m))
        k, c = k + weight * omega**2 * np.outer(row, row), c + 0.06 * weight * omega * np.outer(row, row)
        m[-1, -1] = weight
    return k, c, m


def measured(seed=5, **changed):
    """The lowest modes of the truth in the order of their frequencies, with noise."""
    k, c, m = truth(**changed)
    n, rng = len(k), np.random.default_rng(seed)
    zero, one = np.zeros((n, n)), np.eye(n)
    values, vectors = eig(np.block([[zero, one], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]]))
    order = [i for i in np.argsort(np.abs(values)) if values[i].imag > 0][:FLOORS]
    values, shapes = values[order], vectors[:FLOORS, order]
    freq, ratio = np.abs(values) / (2 * np.pi), -values.real / np.abs(values)
    shapes = shapes / shapes[np.argmax(np.abs(shapes), axis=0), range(len(order))]
    noise, std = rng.standard_normal((2, *shapes.shape)), 0.005
    return calib.MeasuredModes(
        names=tuple(f"M{j + 1}" for j in range(len(order))),
        natural_freq=freq * (1 + 1e-3 * rng.standard_normal(len(order))),
        damped_freq=freq * np.sqrt(1 - ratio**2), freq_std=1e-3 * freq,
        damping_ratio=ratio * (1 + 0.03 * rng.standard_normal(len(order))), damping_std=0.03 * ratio,
        sensors=tuple(calib.Sensor(k + 1, "x", (0.0, 0.0, 3.0 * (k + 1))) for k in range(FLOORS)),
        shapes=shapes + std * (noise[0] + 1j * noise[1]), shape_std=np.full(shapes.shape, std),
        n_repeats=5, synthetic=True, source="synthetic chain",
    )  # fmt: skip


def posed(**changed):
    held = () if "hung" in changed else HELD
    return calib.Problem(chain(), calib.ModalTest(measured(**changed), held_out=held))


CASES = {
    "mass": ({"mass": [(4, 300.0)]}, ("added mass", "mass"), "floor 4", {"added mass": 300.0, "mass": 0.15}, 12.0),
    "spring": ({"stiffness": [(3, -0.25)]}, ("stiffness",), "storey 3", {"stiffness": -0.25}, None),
    "damper": ({"damping": [(2, 1.5)]}, ("damping", "dissipation", "damper between"), "damper 2",
               {"damping": 1.5, "dissipation": 1e3 * 1.5 * 1.1 * DAMPING / (1.04 * STIFF)}, None),
    "hung": ({"hung": (5, 150.0, 6.0)}, ("hung mass",), "sensor 5x", {"hung mass": 150.0}, 15.0),
}  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def case(request):
    changed, *right = CASES[request.param]
    problem = posed(**changed)
    why = problem.explain([], seed=1)
    return problem, why, why.propose(), right


def test_kind_place_and_magnitude_are_those_of_the_truth(case):
    _, why, proposed, (kinds, at, true, height) = case
    assert why.verdict == "none_explains"
    first = proposed.table.iloc[0]
    assert first["kind"] in kinds
    told = [first["at"], *(other.partition(" of ")[2] for other in first["alike"].split("; "))]
    assert at in told
    size = true.get(first["kind"])
    assert size is not None and first["lower"] <= size <= first["upper"]
    assert height is None or first["z"] == pytest.approx(height)
    assert "Proposed: " in str(proposed) and first["title"][1:] in str(proposed)


def test_the_extended_model_fits_and_predicts_what_was_held_out(case):
    problem, _, proposed, _ = case
    (first, *_) = proposed.effects
    again = problem.explain([first], seed=1)
    assert [e.name for e in again.named] == [first.name]
    rms = again.errors.pivot(index="group", columns="stage", values="rms")
    for group in {"fit", "left_out", "held_out_modes"} & set(rms.index):
        assert rms.loc[group, "after"] < 0.7 * rms.loc[group, "before"]


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


def test_every_kind_of_composition_is_written_as_it_is_built():
    model, seen = chain(), measured(mass=[(4, 300.0)])
    own = compositions(model, [seen], model.space.values)
    every = {c.kind: c for c in (*own.plain, *own.mounts, *(one.composed for one in own.hung))}
    assert set(every) == {
        "stiffness", "damping", "mass", "dissipation", "damper mount", "added mass", "hung mass", "spring to ground",
        "damper to ground", "spring between", "damper between",
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


def test_nothing_is_proposed_where_nothing_is_missing():
    why = posed().explain([], seed=1)
    proposed = why.propose()
    assert why.verdict == "nothing_detectable"
    assert proposed.effects == () and proposed.code == "" and proposed.table.empty
    assert "Nothing is proposed: nothing seems missing." in str(proposed)


def test_nothing_is_proposed_where_the_measurement_is_to_blame():
    modes = measured()
    shapes = modes.shapes.copy()
    shapes[2] *= 1.2
    test = calib.ModalTest(calib.MeasuredModes(**{**vars(modes), "shapes": shapes}))
    why = calib.Problem(chain(), test).explain([], seed=1)
    assert why.verdict == "measurement"
    proposed = why.propose()
    assert proposed.effects == () and "the measurement is the suspect, gain of sensor 3x" in str(proposed)


def test_a_named_effect_leaves_nothing_to_propose(case):
    problem, _, proposed, _ = case
    again = problem.explain(proposed.effects[:1], seed=1).propose()
    assert again.effects == () and re.search(r"effects of the library explain the data, \w+\.", str(again))


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


def test_several_tests_of_one_model_are_proposed_for_together():
    one, two = (
        calib.Problem(chain(), calib.ModalTest(measured(mass=[(4, 300.0)], seed=seed), name=f"test {seed}"))
        for seed in (5, 6)
    )
    proposed = replace(one, beside=(two,)).explain([], seed=1).propose(1)
    (first,) = proposed.table.to_dict("records")
    true = {("added mass", "node 4"): 300.0, ("mass", "floor 4"): 300.0 / MASS}[first["kind"], first["at"]]
    assert first["lower"] <= true <= first["upper"]
