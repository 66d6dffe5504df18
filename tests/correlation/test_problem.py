import dataclasses
import math
import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from calib.correlation.basis import is_large
from calib.correlation.modal.problem import RESPONSES, ModalProblem
from calib.correlation.response.problem import FunctionProblem
from calib.errors.errors import EvaluationError, InputError
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import train_basis

TRUTH = {"k_along": 52.0, "k_across": 9.0, "c_end": 800.0}
CLUSTERS = {"M1": ("across",), "M2": ("along", "across")}


def test_a_perfect_model_returns_the_truth(build, twin):
    model = build()
    measured = twin(model, TRUTH, order=(2, 0, 1, 4))
    problem = ModalProblem(model, measured, mode_count=6)
    found = problem.evaluate(TRUTH)
    assert list(found) == [f"{kind}_{mode}" for mode in measured.names for kind in RESPONSES]
    assert len(found) == 4 * len(RESPONSES)
    modes = model.modes(TRUTH, 6)
    for name, j in zip(measured.names, (2, 0, 1, 4), strict=True):
        assert found[f"natural_freq_{name}"] == pytest.approx(modes.natural_freq[j])
        assert found[f"damped_freq_{name}"] == pytest.approx(modes.damped_freq[j])
        assert found[f"damping_ratio_{name}"] == pytest.approx(modes.damping_ratio[j])
        assert found[f"mac_{name}"] == pytest.approx(1.0)
        assert found[f"emac_{name}"] == pytest.approx(1.0)  # no clusters named: EMAC is MAC
    assert problem.evaluate({})["natural_freq_M1"] != pytest.approx(found["natural_freq_M1"], rel=1e-3)


def test_modes_that_are_solved_already_are_solved_again_only_where_more_are_requested(build, twin, monkeypatch):
    model = build()
    problem = ModalProblem(model, twin(model, TRUTH, order=(2, 0, 1, 4)), mode_count=6)
    solved, found = model.modes(TRUTH, 6), problem.compare(TRUTH)
    fewer, requested = model.modes(TRUTH, 5), []
    modes = type(model).modes
    monkeypatch.setattr(type(model), "modes", lambda *given: requested.append(given[2]) or modes(*given))
    same, more = problem.compare(TRUTH, solved), problem.compare(TRUTH, fewer)
    assert requested == [6] and same.modes is solved and more.modes.n_modes == 6
    for one in (same, more):
        assert one.comparison_table().equals(found.comparison_table())


@pytest.mark.medium
def test_a_reduced_model_returns_the_responses_of_the_full_one(build, twin):
    model = build(n=20)
    measured = twin(model, TRUTH, order=(2, 0, 1, 4))
    reduced = ReducedModel(model, train_basis(model, model.space, 6, seed=1, tolerance=1e-6))
    assert reduced.n_dof < model.n_dof
    clusters = {"M1": ("across",), "M2": ("along", "across")}
    problems = [ModalProblem(m, measured, clusters, mode_count=6) for m in (model, reduced)]
    full, small = (problem.evaluate(TRUTH) for problem in problems)
    assert small == pytest.approx(full, rel=1e-4, abs=1e-4)
    assert problems[0].fingerprint != problems[1].fingerprint
    tables = [problem.compare(TRUTH).deflection_table() for problem in problems]
    np.testing.assert_allclose(tables[1].iloc[:, 2:], tables[0].iloc[:, 2:], atol=1e-3)


def test_energy_distinguishes_modes_that_a_single_direction_cannot(build, twin):
    """Measured only transversely, a longitudinal mode of the chain resembles a transverse one."""
    model = build()
    measured = twin(model, TRUTH, order=(0, 1, 2), directions="y")
    default = ModalProblem(model, measured, mode_count=6).compare(TRUTH)
    energy = ModalProblem(
        model, measured, mode_clusters={m: ("across",) for m in measured.names}, mode_count=6
    ).compare(TRUTH)
    share = np.divide(energy.emac, energy.mac)
    np.testing.assert_allclose(default.emac, default.mac)
    assert np.allclose(share, share[0])  # the same clusters for every measured mode
    along = share[0] < 0.5
    assert along.any() and not along.all()
    assert not np.any(along[energy.pairing.model_index[energy.pairing.paired]])
    both = ModalProblem(
        model, measured, mode_clusters={m: ("across", "along") for m in measured.names}, mode_count=6
    ).compare(TRUTH)
    np.testing.assert_allclose(both.emac, both.mac)


def test_unpaired_modes_are_nan_and_not_a_guess(build, twin):
    model = build()
    measured = twin(model, TRUTH, order=(0, 1, 2))
    lost = dataclasses.replace(measured, shapes=measured.shapes * np.array([1.0, np.nan, 1.0]))
    found = ModalProblem(model, lost, mode_count=5).evaluate(TRUTH)
    assert all(math.isnan(found[f"{kind}_M2"]) for kind in RESPONSES)
    assert all(math.isfinite(found[f"{kind}_M{k}"]) for kind in RESPONSES for k in (1, 3))


def test_the_window_keeps_model_modes_out(build, twin):
    model = build()
    measured = twin(model, TRUTH, order=(0, 1, 2))
    freq = measured.natural_freq
    window = (0.5 * (freq[0] + freq[1]), 2 * freq[2])
    found = ModalProblem(model, measured, mode_count=5, freq_window=window).compare(TRUTH).pairing
    assert found.model_index.tolist() == [-1, 1, 2]


def test_frequencies_alone_are_paired_in_order(build, twin):
    model = build(damped=False)
    measured = twin(model, TRUTH, order=(0, 1, 2), shapes=False)
    problem = ModalProblem(model, measured, mode_count=4, override={"M3": 4})
    assert problem.sensor_rows.shape == (0, model.n_dof)
    found = problem.evaluate(TRUTH)
    modes = model.modes(TRUTH, 4)
    assert [found[f"natural_freq_M{k}"] for k in (1, 2, 3)] == pytest.approx(modes.natural_freq[[0, 1, 3]].tolist())
    assert math.isnan(found["mac_M1"]) and math.isnan(found["emac_M1"]) and math.isnan(found["margin_M1"])


def test_too_few_model_modes_fail_the_point(build, twin):
    model = build(n=3)
    measured = twin(model, {}, order=(0, 1))
    with pytest.raises(EvaluationError, match="only 6 vibration modes, 7 were requested"):
        ModalProblem(model, measured, mode_count=7).evaluate({})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mode_clusters": {"M1": ("sideways",)}}, "sideways.*its clusters are along, across"),
        ({"mode_clusters": {"M9": ("along",)}}, "M9.*the measured modes are M1, M2"),
        ({"mode_clusters": {"M1": ()}}, "no cluster is named"),
        ({"mode_count": 3}, "at least as many.*4"),
        ({"threshold": 1.5}, "between 0 and 1"),
        ({"threshold": math.nan}, "between 0 and 1"),
        ({"freq_window": (9.0, 3.0)}, "low first"),
        ({"override": {"M1": 21}}, "from 1 to 20"),
        ({"override": {"M1": 2, "M2": 2}}, "chosen for two"),
    ],
)
def test_settings_that_do_not_fit_are_refused_at_once(build, twin, options, words):
    model = build()
    with pytest.raises(InputError, match=words):
        ModalProblem(model, twin(model, TRUTH), **options)


def test_a_sensor_off_the_model_is_refused_at_once(build, twin):
    model = build()
    measured = twin(model, TRUTH)
    far = (dataclasses.replace(measured.sensors[0], point=(0.0, 5.0, 0.0)), *measured.sensors[1:])
    with pytest.raises(InputError, match="off the model"):
        ModalProblem(model, dataclasses.replace(measured, sensors=far))


class OtherLocator:
    """Another geometry on the same matrices."""

    def row(self, point, direction, on=None):
        return np.full(12, 1.0 + direction), 0.0


def test_the_fingerprint_changes_with_everything_that_matters_and_nothing_else(build, twin):
    model = build()
    measured = twin(model, TRUTH)
    default = ModalProblem(model, measured, CLUSTERS)
    assert (
        default.fingerprint == ModalProblem(build(), twin(build(), TRUTH), dict(reversed(CLUSTERS.items()))).fingerprint
    )
    others = [
        ModalProblem(build(n=5), twin(build(n=5), TRUTH), CLUSTERS),
        ModalProblem(model, twin(model, {}), CLUSTERS),
        ModalProblem(model, measured),
        ModalProblem(model, measured, CLUSTERS, mode_count=21),
        ModalProblem(model, measured, CLUSTERS, threshold=0.2),
        ModalProblem(model, measured, CLUSTERS, freq_window=(0.0, 50.0)),
        ModalProblem(model, measured, CLUSTERS, override={"M1": 2}),
    ]
    shifted = tuple(dataclasses.replace(s, on="here") for s in measured.sensors)
    moved = dataclasses.replace(model, locator=OtherLocator())
    others.append(ModalProblem(moved, measured, CLUSTERS))
    others.append(ModalProblem(model, dataclasses.replace(measured, sensors=shifted), CLUSTERS))
    units = model.space.replace("k_along", unit="N/m", value=4e4, lower=2e4, upper=8e4)
    others.append(ModalProblem(dataclasses.replace(model, space=units), measured, CLUSTERS))
    assert len({p.fingerprint for p in [default, *others]}) == len(others) + 1


def test_a_problem_can_be_pickled(build, twin):
    model = build()
    problem = ModalProblem(dataclasses.replace(model, locator=None), twin(model, {}, shapes=False), mode_count=5)
    copy = pickle.loads(pickle.dumps(problem))
    assert copy.fingerprint == problem.fingerprint
    assert str(copy.evaluate({})) == str(problem.evaluate({}))


# -- functions ---------------------------------------------------------------------------------------------------------

SPACE = ParameterSpace((Parameter("a", 2.0, 0.0, 5.0, "mm"), Parameter("b", 3.0, 0.0, 5.0)))


def function_problem(function, targets=None):
    return FunctionProblem(SPACE, function, targets or {"sum": (4.0, 0.1), "product": (5.0, None)}, "v1")


def test_a_function_receives_complete_values_in_their_own_units():
    problem = function_problem(lambda v: {"product": v["a"] * v["b"], "sum": v["a"] + v["b"], "more": np.float64(1)})
    assert problem.evaluate({"b": 4.0}) == {"product": 8.0, "sum": 6.0, "more": 1.0}
    assert problem.fingerprint == "v1"
    with pytest.raises(InputError, match="unknown parameter 'c'"):
        problem.evaluate({"c": 1.0})


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ({"sum": 1.0}, "gave no product"),
        ({"sum": 1.0, "product": math.inf}, "'product' is inf"),
        ({"sum": math.nan, "product": 1.0}, "'sum' is nan"),
        ({"sum": "fast", "product": 1.0}, "not a number"),
    ],
)
def test_an_incomplete_result_fails_the_point(answer, words):
    with pytest.raises(EvaluationError, match=words):
        function_problem(lambda v: answer).evaluate({})


@pytest.mark.parametrize("targets", [{"sum": (math.nan, None)}, {"sum": (1.0, 0.0)}, {"sum": (1.0, -1.0)}])
def test_targets_must_be_numbers_with_a_positive_standard_deviation(targets):
    with pytest.raises(InputError):
        function_problem(lambda v: v, targets)
    with pytest.raises(InputError, match="no target"):
        FunctionProblem(SPACE, lambda v: v, {}, "")


def test_a_basis_saves_time_for_few_modes_of_a_large_model_alone():
    sizes = [(200, 20), (2000, 0), (2000, 20), (2000, 200)]
    large = [is_large(SimpleNamespace(n_dof=n_dof), count) for n_dof, count in sizes]
    assert large == [False, True, True, False]
