"""Errors on data that were used, left out and withheld, against refits and direct calculations."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calib.correlation.residual import ModalResidual
from calib.correlation.scatter import USUAL, Floors, freedom_behind, scatter_of
from calib.missing.state import fitted
from calib.questions.hypotheses import ModelHypotheses
from calib.questions.verify import ERROR_COLUMNS, _scaled, errors_at, modal_errors, plain_errors
from calib.structure.variants import Variants
from calib.study import Study

PLAIN = Floors()
NO_FLOORS = Floors(0.0, 0.0, 0.0)
KNOWN = {"frequency": math.inf, "shape": math.inf}
HELD = '[withheld]\nmodes = ["B2z"]\nsensors = ["2x", "4z"]\n'
BARE = "[withheld]\nmodes = []\nsensors = []\n"


def held(folder):
    file = folder / "study.toml"
    text = file.read_text()
    assert BARE in text
    file.write_text(text.replace(BARE, HELD))
    return folder


@pytest.fixture(scope="module")
def study(mast, tmp_path_factory):
    """A right model with one mode and two sensors withheld."""
    return Study.load(held(mast.write_study(tmp_path_factory.mktemp("verify") / "mast", seed=3)))


def calibrated(study, problem=None):
    """The state of a fit."""
    hypotheses = ModelHypotheses(
        ModalResidual(problem or study.problem), Variants(study.model, (), ()), study.search_space
    )
    question = hypotheses.question(())
    return fitted(question, (), question.space.values)


@pytest.fixture(scope="module")
def state(study):
    return calibrated(study)


def errors(study, state, scale=1.0, fitted_problem=None, whole=None, freedom=KNOWN, floors=PLAIN):
    return modal_errors(
        fitted_problem or study.problem, study.whole_problem() if whole is None else whole, state.values, state.names,
        state.prior_sd, floors, freedom, scale,
    ).set_index("group")  # fmt: skip


# -- modal -------------------------------------------------------------------------------------------------------------


def test_the_table_has_a_row_for_every_group_of_data(study, state):
    table = errors(study, state)
    assert list(table.reset_index().columns) == list(ERROR_COLUMNS)
    assert list(table.index) == ["fit", "left_out", "withheld_sensors", "withheld_modes"]
    modes, sensors = 5, 10  # used of 6 and 12
    assert table["rows"].to_dict() == {
        "fit": modes * (1 + sensors), "left_out": modes * (1 + sensors), "withheld_sensors": modes * 2,
        "withheld_modes": 1 + 12,
    }  # fmt: skip
    assert (table["unpaired"] == 0).all() and table["p"].between(0, 1).all()


def test_a_study_that_withholds_nothing_has_two_groups(mast, tmp_path):
    study = Study.load(mast.write_study(tmp_path / "mast"))
    state = calibrated(study)
    assert list(errors(study, state).index) == ["fit", "left_out"]
    assert list(modal_errors(
        study.problem, None, state.values, state.names, state.prior_sd, Floors(), KNOWN
    )["group"]) == ["fit", "left_out"]  # fmt: skip


def test_the_fit_is_told_as_it_is(study, state):
    row = errors(study, state).loc["fit"]
    n = len(state.residual)
    g = state.slope
    freedom = n - 5 - np.trace(g @ np.linalg.inv(g.T @ g + np.diag(1 / state.prior_sd**2)) @ g.T)  # one factor a mode
    assert row["rms"] == pytest.approx(np.sqrt(np.mean(state.residual**2)))
    assert row["expected"] == pytest.approx(math.sqrt(freedom / n))
    assert row["p"] == pytest.approx(stats.chi2.sf(state.residual @ state.residual, freedom))


def test_a_scatter_from_few_repeats_is_no_certainty(study, state):
    known = errors(study, state).loc["fit", "p"]
    few = errors(study, state, freedom={"frequency": 4.0, "shape": 6.0})
    e, (n, freedom) = (
        state.residual,
        (len(state.residual), len(state.residual) * errors(study, state).loc["fit", "expected"] ** 2),
    )
    behind = n**2 / (5**2 / 4.0 + 50**2 / 6.0)  # frequencies and shapes, by their number (Satterthwaite)
    assert few.loc["fit", "p"] == pytest.approx(stats.f.sf(e @ e / freedom, freedom, behind))
    assert few.loc["fit", "p"] != pytest.approx(known, abs=0.01)


def test_every_mode_is_left_out_as_a_fit_without_it_would(study, state):
    """Refitted five times, each mode predicted by the fit to the other four."""
    total, count = 0.0, 0
    whole = ModalResidual(study.problem)
    for mode in study.problem.measured.names:
        used = study.problem.measured.without((mode,), ())
        clusters = {m: c for m, c in study.problem.mode_clusters.items() if m != mode}
        there = calibrated(study, replace(study.problem, measured=used, mode_clusters=clusters))
        predicted = whole.residual({**state.values, **{n: there.values[n] for n in there.names}})
        own = [k for k, row in enumerate(whole.rows) if row.mode == mode]
        total, count = total + float(np.sum(predicted[own] ** 2)), count + len(own)
    assert count == whole.n_rows
    table = errors(study, state)
    assert table.loc["left_out", "rms"] == pytest.approx(math.sqrt(total / count), rel=0.02)
    assert table.loc["left_out", "rms"] > 1.01 * table.loc["fit", "rms"]


def test_a_right_model_shows_about_what_is_expected_in_all_groups(study, state):
    table = errors(study, state)
    assert (abs(table["rms"] / table["expected"] - 1) < 0.5).all() and (table["p"] > 0.001).all()


def test_a_wrong_model_shows_more_than_expected(mast, tmp_path):
    """Shapes at two withheld sensors hardly know of a platform; all other data do."""
    study = Study.load(held(mast.write_study(tmp_path / "mast", {"platform": 30.0}, seed=3)))
    table = errors(study, calibrated(study))
    told = table.drop("withheld_sensors")
    assert (told["rms"] > 2 * told["expected"]).all() and (told["p"] < 1e-3).all()


def test_a_factor_on_the_scatter_divides_the_errors(study, state):
    """Fit and withheld data exactly; data left out follow the prior a little too."""
    one, two = errors(study, state), errors(study, state, scale=2.0)
    groups = ["fit", "withheld_sensors", "withheld_modes"]
    np.testing.assert_allclose(two.loc[groups, "rms"], one.loc[groups, "rms"] / 2)
    assert two.loc["left_out", "rms"] == pytest.approx(one.loc["left_out", "rms"] / 2, rel=0.05)
    assert (two["p"] >= one["p"] - 1e-12).all()


def test_a_factor_is_the_same_as_a_measurement_with_so_much_more_scatter(study, state):
    def wide(measured):
        return replace(measured, freq_std=3 * measured.freq_std, shape_std=3 * measured.shape_std)

    bare = NO_FLOORS
    other = replace(study.problem, measured=wide(study.problem.measured))
    whole = study.whole_problem()
    there = errors(study, state, 1.0, other, replace(whole, measured=wide(whole.measured)), floors=bare)
    here = errors(study, state, 3.0, floors=bare)
    for column in ("rms", "expected", "p"):
        np.testing.assert_allclose(here[column], there[column], rtol=1e-6, err_msg=column)


def test_a_mode_without_partner_is_counted_and_spoils_the_fit(study, state):
    narrow = replace(study.problem, freq_window=(0.5, 30.0))
    lost = [m for m, f in zip(study.measured.names, study.measured.natural_freq, strict=True) if f > 30.0]
    assert lost
    table = errors(study, state, fitted_problem=narrow)
    assert table.loc["fit", "unpaired"] == table.loc["left_out", "unpaired"] == len(lost)
    assert table.loc["fit", "rms"] > 10 and table.loc["fit", "p"] < 1e-6


def test_errors_of_a_study_are_those_at_its_values(study, state):
    table = errors_at(study, state.values).set_index("group")
    other = errors(study, state, freedom=ModalResidual(study.problem).scatter_freedom)
    np.testing.assert_allclose(
        table[["rms", "expected", "p"]].to_numpy(float), other[["rms", "expected", "p"]].to_numpy(float)
    )


def test_freedom_behind_the_scatter_is_that_of_the_repeats_less_the_factors(study):
    measured = study.problem.measured
    assert ModalResidual(study.problem).scatter_freedom == KNOWN
    repeated = replace(study.problem, measured=replace(measured, n_repeats=5))
    none = ModalResidual(repeated, NO_FLOORS).scatter_freedom
    assert none == {"frequency": 4 * 5.0, "shape": 4 * (50.0 - 5.0)}
    own, whole = scatter_of(repeated.measured, NO_FLOORS), scatter_of(repeated.measured)
    beside = ModalResidual(repeated).scatter_freedom
    for kind, a, b in (("frequency", own.freq, whole.freq), ("shape", own.shape, whole.shape)):
        assert beside[kind] > none[kind]
        assert beside[kind] == pytest.approx(none[kind] / np.mean((a / b) ** 2) ** 2)


def test_freedom_behind_is_the_same_for_the_fit_and_for_the_comparison(study):
    """Ten repeats, of which some values have fewer: what stands behind the fit counts the repeats of each value.

    From ten on each value has its own standard deviation, that of a t variate of nu; such a mean square is as uncertain
    as one of (nu - 4)/3 degrees of freedom.
    """
    measured = study.problem.measured
    held = np.array([3] + [10] * (measured.n_modes - 1))
    few = np.minimum(held, 5)
    own = measured.n_modes * (np.mean(held - 1.0) - 4) / 3
    for repeats, counts, expected in ((10, held, own), (5, few, np.sum(few - 1.0))):
        told = replace(measured, n_repeats=repeats, freq_count=counts)
        for floors in (NO_FLOORS, USUAL):
            found = ModalResidual(replace(study.problem, measured=told), floors).scatter_freedom
            assert found["frequency"] == freedom_behind(told, "frequency", measured.n_modes, floors)
            assert floors is USUAL or found["frequency"] == pytest.approx(expected)


# -- plain -------------------------------------------------------------------------------------------------------------


N, P = 12, 3


@pytest.fixture(scope="module")
def linear():
    """Data of a linear model whose last three responses are withheld."""
    rng = np.random.default_rng(4)
    a, s = rng.standard_normal((N + 3, P)), np.array([1.0, 2.0, 0.5])
    y = a @ (s * rng.standard_normal(P)) + rng.standard_normal(N + 3)
    information = a[:N].T @ a[:N] + np.diag(1 / s**2)
    theta = np.linalg.solve(information, a[:N].T @ y[:N])
    labels = [f"r{k}" for k in range(N)]
    parts = {
        "withheld_sensors": slice(N, N + 2),
        "withheld_modes": slice(N + 2, N + 3),
        "withheld_nothing": slice(0, 0),
    }
    withheld = {group: (y[part] - a[part] @ theta, -a[part]) for group, part in parts.items()}
    table = plain_errors(y[:N] - a[:N] @ theta, -a[:N], ("a", "b", "c"), s, labels, withheld).set_index("group")
    return a, y, s, theta, information, table


def test_plain_responses_have_the_same_table(linear):
    *_, table = linear
    assert list(table.reset_index().columns) == list(ERROR_COLUMNS)
    assert table["rows"].to_dict() == {"fit": N, "left_out": N, "withheld_sensors": 2, "withheld_modes": 1}
    assert (table["unpaired"] == 0).all()


def test_a_plain_fit_is_told_as_it_is(linear):
    a, y, _, theta, information, table = linear
    e = y[:N] - a[:N] @ theta
    freedom = N - np.trace(a[:N] @ np.linalg.inv(information) @ a[:N].T)
    assert table.loc["fit", "rms"] == pytest.approx(np.sqrt(np.mean(e**2)))
    assert table.loc["fit", "expected"] == pytest.approx(math.sqrt(freedom / N))
    assert table.loc["fit", "p"] == pytest.approx(stats.chi2.sf(e @ e, freedom))


def test_every_response_is_predicted_from_all_others(linear):
    a, y, s, _, _, table = linear
    out, variance = [], []
    for k in range(N):
        rest = [j for j in range(N) if j != k]
        v = np.linalg.inv(a[rest].T @ a[rest] + np.diag(1 / s**2))
        out.append(y[k] - a[k] @ v @ a[rest].T @ y[rest])
        variance.append(1 + a[k] @ v @ a[k])
    assert table.loc["left_out", "rms"] == pytest.approx(np.sqrt(np.mean(np.square(out))))
    assert table.loc["left_out", "expected"] == pytest.approx(np.sqrt(np.mean(variance)))
    p = stats.chi2.sf(np.square(out) / variance, 1)
    assert table.loc["left_out", "p"] == pytest.approx(min(1.0, N * p.min()))


def test_withheld_responses_are_judged_with_what_the_parameters_leave_open(linear):
    a, y, _, theta, information, table = linear
    for group, part in (("withheld_sensors", slice(N, N + 2)), ("withheld_modes", slice(N + 2, N + 3))):
        e, g = y[part] - a[part] @ theta, a[part]
        c = np.eye(len(e)) + g @ np.linalg.inv(information) @ g.T
        assert table.loc[group, "rms"] == pytest.approx(np.sqrt(np.mean(e**2)))
        assert table.loc[group, "expected"] == pytest.approx(np.sqrt(np.mean(np.diag(c))))
        assert table.loc[group, "p"] == pytest.approx(stats.chi2.sf(e @ np.linalg.solve(c, e), len(e)))


def test_held_parameters_known_with_a_scatter_move_withheld_responses_too():
    """Drawn anew each time, but held at their expectation: errors scatter by the covariance that p is of."""
    rng = np.random.default_rng(6)
    a, h, s = rng.standard_normal((8, 2)), 3.0 * rng.standard_normal((8, 2)), np.array([2.0, 1.0])
    used, unseen = slice(0, 5), slice(5, 8)
    v = np.linalg.inv(a[used].T @ a[used] + np.diag(1 / s**2))
    truth, drawn = s * rng.standard_normal((4000, 2)), rng.standard_normal((4000, 2))
    y = truth @ a.T + drawn @ h.T + rng.standard_normal((4000, 8))
    e = y[:, unseen] - y[:, used] @ (a[unseen] @ v @ a[used].T).T
    g = -np.hstack([a, h])
    labels = [f"r{k}" for k in range(5)]

    def told(error, jacobian=g):
        own = {"withheld_responses": (error, jacobian[unseen])}
        table = plain_errors(np.zeros(5), jacobian[used], ("a", "b"), s, labels, own)
        return table.set_index("group").loc["withheld_responses"]

    assert told(e[0])["expected"] == pytest.approx(math.sqrt(np.mean(e**2)), rel=0.03)
    p = np.array([told(error)["p"] for error in e[:400]])
    assert stats.kstest(p, "uniform").pvalue > 0.01
    ignored = np.array([told(error, g[:, :2])["p"] for error in e[:400]])
    assert np.mean(ignored < 1e-3) > 0.1  # of right models, each of which would stand accused


def test_a_mode_that_a_held_parameter_governs_does_not_contradict(study, state):
    """One that the search fits otherwise is held off its true value, within a standard deviation of that size."""
    name = state.names[0]
    sd = 0.5 * abs(state.values[name])
    values = {**state.values, name: state.values[name] + sd}
    others = state.names[1:]

    def table(held_sd):
        return modal_errors(
            study.problem, study.whole_problem(), values, others, state.prior_sd[1:], PLAIN, KNOWN, held_sd=held_sd
        ).set_index("group")

    bare, wide = table({}), table({name: sd})
    groups = ["withheld_sensors", "withheld_modes"]
    assert (wide.loc[groups, "p"] > bare.loc[groups, "p"]).all() and bare.loc["withheld_modes", "p"] < 1e-3
    assert (wide.loc[groups, "expected"] > bare.loc[groups, "expected"]).all()
    np.testing.assert_allclose(wide.loc[groups, "rms"], bare.loc[groups, "rms"])
    own = replace(study, search_space=study.search_space.keep(others), adopted_sd={name: sd})
    np.testing.assert_allclose(errors_at(own, values).set_index("group").loc[groups, "expected"],
                               wide.loc[groups, "expected"])  # fmt: skip


def test_as_many_unknowns_as_data_say_nothing_about_the_fit():
    rng = np.random.default_rng(5)
    a = rng.standard_normal((3, 3))
    table = plain_errors(np.zeros(3), -a, ("a", "b", "c"), np.full(3, 1e6), ["x", "y", "z"], {}).set_index("group")
    assert table.loc["fit", "p"] == 1.0 and table.loc["fit", "expected"] == pytest.approx(0.0, abs=1e-3)


def test_a_plain_study_tells_its_withheld_responses(tmp_path):
    (tmp_path / "model.py").write_text(
        "from calib.function import FunctionModel\nfrom calib.space import Parameter, ParameterSpace\n"
        "def line():\n"
        "    space = ParameterSpace(tuple(Parameter(name, 0.0, -9.0, 9.0, prior_sd=1.0) for name in 'ab'))\n"
        "    return FunctionModel('line', space, lambda v: {f'y{x}': v['a'] + v['b'] * x for x in range(6)})\n"
    )
    y = np.array([0.1, 1.2, 1.9, 3.1, 4.0, 6.0])
    rows = "\n".join(f"y{x},{v},0.1" for x, v in enumerate(y))
    (tmp_path / "measured.csv").write_text(f"response,value,std\n{rows}\n")
    (tmp_path / "study.toml").write_text(
        'title = "line"\nmodel = "model.py:line"\nselection = ["a", "b"]\n[measurement]\nresponses = "measured.csv"\n'
        '[withheld]\nresponses = ["y1", "y5"]\n[calibration]\nmethod = "gauss-newton"\n'
        'cases = [{ name = "A", seed = 1 }]\n'
    )
    table = errors_at(Study.load(tmp_path), {"a": 0.0, "b": 1.0}).set_index("group")
    assert table["rows"].to_dict() == {"fit": 4, "left_out": 4, "withheld_responses": 2}
    assert table.loc["withheld_responses", "rms"] == pytest.approx(math.sqrt((2.0**2 + 10.0**2) / 2))
    assert table.loc["withheld_responses", "p"] < 1e-6
    assert table.loc["fit", "rms"] == pytest.approx(math.sqrt((1 + 1 + 1 + 0) / 4))


def test_a_scaled_scatter_is_no_better_known_than_before():
    table = pd.DataFrame({"rms": [4.0], "chi2": [64.0], "freedom": [4.0], "p": [0.0]})
    found = _scaled(table, 2.0, 8.0).iloc[0]
    assert (found["rms"], found["chi2"]) == (2.0, 16.0)
    assert found["p"] == pytest.approx(stats.f.sf(16.0 / 4, 4, 8))
    assert _scaled(table, 2.0, math.inf)["p"][0] == pytest.approx(stats.chi2.sf(16.0, 4))
