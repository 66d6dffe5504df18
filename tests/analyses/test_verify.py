"""Errors on used, left-out and held-out data, against refits and direct calculations."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calib.analyses.every_mode import errors_at
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import USUAL, Floors, dof_behind, std_for
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.verify import ERROR_COLUMNS, _scaled, group_errors, modal_errors
from calib.missing.linearised_fit import least_squares_fit
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from calib.study.study import LoadedStudy

PLAIN = Floors()
NO_FLOORS = Floors(0.0, 0.0, 0.0)
KNOWN = {"frequency": math.inf, "shape": math.inf}
HELD = '[held_out]\nmodes = ["B2z"]\nsensors = ["2x", "4z"]\n'
BARE = "[held_out]\nmodes = []\nsensors = []\n"


def held(folder):
    file = folder / "study.toml"
    text = file.read_text()
    assert BARE in text
    file.write_text(text.replace(BARE, HELD))
    return folder


@pytest.fixture(scope="module")
def study(mast, tmp_path_factory):
    """A correctly specified model with one mode and two sensors held out."""
    return LoadedStudy.load(held(mast.write_study(tmp_path_factory.mktemp("verify") / "mast", seed=3)))


def calibrated(study, problem=None):
    """The linearised fit."""
    hypotheses = ModelHypotheses(
        ModalResidual(problem or study.problem), Variants(study.model, (), ()), study.search_space
    )
    fit_problem = hypotheses.fit_problem(())
    return least_squares_fit(fit_problem, (), fit_problem.space.values)


@pytest.fixture(scope="module")
def fit(study):
    return calibrated(study)


def errors(study, fit, scale=1.0, fitted_problem=None, whole=None, dof=KNOWN, floors=PLAIN):
    return modal_errors(
        fitted_problem or study.problem, study.whole_problem() if whole is None else whole, fit.values, fit.names,
        fit.prior_sd, floors, dof, scale,
    ).set_index("group")  # fmt: skip


# -- modal -------------------------------------------------------------------------------------------------------------


def test_the_table_has_a_row_for_every_group_of_data(study, fit):
    table = errors(study, fit)
    assert list(table.reset_index().columns) == list(ERROR_COLUMNS)
    assert list(table.index) == ["fit", "left_out", "held_out_sensors", "held_out_modes"]
    modes, sensors = 5, 10  # used of 6 and 12
    assert table["rows"].to_dict() == {
        "fit": modes * (1 + sensors), "left_out": modes * (1 + sensors), "held_out_sensors": modes * 2,
        "held_out_modes": 1 + 12,
    }  # fmt: skip
    assert (table["unpaired"] == 0).all() and table["p"].between(0, 1).all()


def test_a_model_that_has_been_solved_is_not_solved_again(study, fit, monkeypatch):
    expected, modes = errors(study, fit), study.problem.solve(fit.values)
    asked, solve = [], StructuralModel.modes
    monkeypatch.setattr(StructuralModel, "modes", lambda *given: asked.append(given) or solve(*given))
    found = modal_errors(
        study.problem, study.whole_problem(), fit.values, fit.names, fit.prior_sd, PLAIN, KNOWN, solved=modes
    )  # fmt: skip
    pd.testing.assert_frame_equal(found.set_index("group"), expected, check_exact=True)
    assert not asked
    errors(study, fit)
    assert len(asked) == 1


def test_a_study_without_held_out_data_has_two_groups(mast, tmp_path):
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    fit = calibrated(study)
    assert list(errors(study, fit).index) == ["fit", "left_out"]
    assert list(modal_errors(
        study.problem, None, fit.values, fit.names, fit.prior_sd, Floors(), KNOWN
    )["group"]) == ["fit", "left_out"]  # fmt: skip


def test_errors_of_the_fit_match_a_direct_calculation(study, fit):
    row = errors(study, fit).loc["fit"]
    n = len(fit.residual)
    g = fit.slope
    hat = g @ np.linalg.inv(g.T @ g + np.diag(1 / fit.prior_sd**2)) @ g.T
    dof = n - 5 - np.trace(hat)  # one factor a mode
    square = n - 5 - 2 * np.trace(hat) + np.sum(hat**2)
    assert row["rms"] == pytest.approx(np.sqrt(np.mean(fit.residual**2)))
    assert row["expected"] == pytest.approx(math.sqrt(dof / n))
    matched = stats.chi2.sf(fit.residual @ fit.residual * dof / square, dof**2 / square)
    assert row["p"] == pytest.approx(matched)


def test_a_standard_deviation_from_few_repeats_is_uncertain(study, fit):
    known = errors(study, fit).loc["fit", "p"]
    few = errors(study, fit, dof={"frequency": 4.0, "shape": 6.0})
    e, (n, dof) = (
        fit.residual,
        (len(fit.residual), len(fit.residual) * errors(study, fit).loc["fit", "expected"] ** 2),
    )
    behind = n**2 / (5**2 / 4.0 + 50**2 / 6.0)  # frequencies and shapes, by their number (Satterthwaite)
    # The priors say little here: the variate of the sum of squares has nearly the scale one.
    assert few.loc["fit", "p"] == pytest.approx(stats.f.sf(e @ e / dof, dof, behind), rel=1e-3)
    assert few.loc["fit", "p"] != pytest.approx(known, abs=0.01)


@pytest.mark.medium
def test_leave_one_mode_out_errors_match_refits(study, fit):
    """Five refits, each mode predicted by the fit to the other four."""
    total, count = 0.0, 0
    whole = ModalResidual(study.problem)
    for mode in study.problem.measured.names:
        used = study.problem.measured.without((mode,), ())
        clusters = {m: c for m, c in study.problem.mode_clusters.items() if m != mode}
        there = calibrated(study, replace(study.problem, measured=used, mode_clusters=clusters))
        predicted = whole.residual({**fit.values, **{n: there.values[n] for n in there.names}})
        own = [k for k, row in enumerate(whole.rows) if row.mode == mode]
        total, count = total + float(np.sum(predicted[own] ** 2)), count + len(own)
    assert count == whole.n_rows
    table = errors(study, fit)
    assert table.loc["left_out", "rms"] == pytest.approx(math.sqrt(total / count), rel=0.02)
    assert table.loc["left_out", "rms"] > 1.01 * table.loc["fit", "rms"]


def test_a_correct_model_shows_about_what_is_expected_in_all_groups(study, fit):
    table = errors(study, fit)
    assert (abs(table["rms"] / table["expected"] - 1) < 0.5).all() and (table["p"] > 0.001).all()


@pytest.mark.medium
def test_a_wrong_model_shows_more_than_expected(mast, tmp_path):
    """Shapes at two held-out sensors are insensitive to a platform; all other data are not."""
    study = LoadedStudy.load(held(mast.write_study(tmp_path / "mast", {"platform": 30.0}, seed=3)))
    table = errors(study, calibrated(study))
    sensitive = table.drop("held_out_sensors")
    assert (sensitive["rms"] > 2 * sensitive["expected"]).all() and (sensitive["p"] < 1e-3).all()


def test_a_factor_on_the_standard_deviation_divides_the_errors(study, fit):
    """Exact for used and held-out data; left-out data also depend slightly on the prior."""
    one, two = errors(study, fit), errors(study, fit, scale=2.0)
    groups = ["fit", "held_out_sensors", "held_out_modes"]
    np.testing.assert_allclose(two.loc[groups, "rms"], one.loc[groups, "rms"] / 2)
    assert two.loc["left_out", "rms"] == pytest.approx(one.loc["left_out", "rms"] / 2, rel=0.05)
    assert (two["p"] >= one["p"] - 1e-12).all()


def test_a_factor_equals_a_measurement_with_a_scaled_standard_deviation(study, fit):
    def wide(measured):
        return replace(measured, freq_std=3 * measured.freq_std, shape_std=3 * measured.shape_std)

    bare = NO_FLOORS
    other = replace(study.problem, measured=wide(study.problem.measured))
    whole = study.whole_problem()
    there = errors(study, fit, 1.0, other, replace(whole, measured=wide(whole.measured)), floors=bare)
    here = errors(study, fit, 3.0, floors=bare)
    for column in ("rms", "expected", "p"):
        np.testing.assert_allclose(here[column], there[column], rtol=1e-6, err_msg=column)


def test_an_unpaired_mode_is_counted_and_raises_the_misfit(study, fit):
    narrow = replace(study.problem, freq_window=(0.5, 30.0))
    lost = [m for m, f in zip(study.measured.names, study.measured.natural_freq, strict=True) if f > 30.0]
    assert lost
    table = errors(study, fit, fitted_problem=narrow)
    assert table.loc["fit", "unpaired"] == table.loc["left_out", "unpaired"] == len(lost)
    assert table.loc["fit", "rms"] > 10 and table.loc["fit", "p"] < 1e-6


def test_errors_of_a_study_are_those_at_its_values(study, fit):
    table = errors_at(study, fit.values).set_index("group")
    other = errors(study, fit, dof=ModalResidual(study.problem).std_dof)
    np.testing.assert_allclose(
        table[["rms", "expected", "p"]].to_numpy(float), other[["rms", "expected", "p"]].to_numpy(float)
    )


def test_degrees_of_freedom_of_the_standard_deviation_are_those_of_the_repeats_less_the_factors(study):
    measured = study.problem.measured
    assert ModalResidual(study.problem).std_dof == KNOWN
    repeated = replace(study.problem, measured=replace(measured, n_repeats=5))
    none = ModalResidual(repeated, NO_FLOORS).std_dof
    assert none == {"frequency": 4 * 5.0, "shape": 4 * (50.0 - 5.0)}
    own, whole = std_for(repeated.measured, NO_FLOORS), std_for(repeated.measured)
    beside = ModalResidual(repeated).std_dof
    for kind, a, b in (("frequency", own.freq, whole.freq), ("shape", own.shape, whole.shape)):
        assert beside[kind] > none[kind]
        assert beside[kind] == pytest.approx(none[kind] / np.mean((a / b) ** 2) ** 2)


def test_degrees_of_freedom_are_the_same_for_the_fit_and_for_the_comparison(study):
    """With missing repeats, the degrees of freedom count the repeats of each value.

    From ten repeats on each value has its own standard deviation, and its residual is a t variate with nu degrees of
    freedom; the mean square of such residuals is as uncertain as one with (nu - 4)/3 degrees of freedom.
    """
    measured = study.problem.measured
    held = np.array([3] + [10] * (measured.n_modes - 1))
    few = np.minimum(held, 5)
    own = measured.n_modes * (np.mean(held - 1.0) - 4) / 3
    for repeats, counts, expected in ((10, held, own), (5, few, np.sum(few - 1.0))):
        repeated = replace(measured, n_repeats=repeats, freq_count=counts)
        for floors in (NO_FLOORS, USUAL):
            found = ModalResidual(replace(study.problem, measured=repeated), floors).std_dof
            assert found["frequency"] == dof_behind(repeated, "frequency", measured.n_modes, floors)
            assert floors is USUAL or found["frequency"] == pytest.approx(expected)


# -- scalar responses --------------------------------------------------------------------------------------------------


N, P = 12, 3


@pytest.fixture(scope="module")
def linear():
    """Data of a linear model with the last three responses held out."""
    rng = np.random.default_rng(4)
    a, s = rng.standard_normal((N + 3, P)), np.array([1.0, 2.0, 0.5])
    y = a @ (s * rng.standard_normal(P)) + rng.standard_normal(N + 3)
    information = a[:N].T @ a[:N] + np.diag(1 / s**2)
    theta = np.linalg.solve(information, a[:N].T @ y[:N])
    labels = [f"r{k}" for k in range(N)]
    parts = {
        "held_out_sensors": slice(N, N + 2),
        "held_out_modes": slice(N + 2, N + 3),
        "held_out_nothing": slice(0, 0),
    }
    held_out = {group: (y[part] - a[part] @ theta, -a[part]) for group, part in parts.items()}
    table = group_errors(y[:N] - a[:N] @ theta, -a[:N], ("a", "b", "c"), s, labels, held_out).set_index("group")
    return a, y, s, theta, information, table


def test_scalar_responses_have_the_same_table(linear):
    *_, table = linear
    assert list(table.reset_index().columns) == list(ERROR_COLUMNS)
    assert table["rows"].to_dict() == {"fit": N, "left_out": N, "held_out_sensors": 2, "held_out_modes": 1}
    assert (table["unpaired"] == 0).all()


def test_errors_of_a_scalar_fit_match_a_direct_calculation(linear):
    a, y, _, theta, information, table = linear
    e = y[:N] - a[:N] @ theta
    dof = N - np.trace(a[:N] @ np.linalg.inv(information) @ a[:N].T)
    assert table.loc["fit", "rms"] == pytest.approx(np.sqrt(np.mean(e**2)))
    assert table.loc["fit", "expected"] == pytest.approx(math.sqrt(dof / N))
    hat = a[:N] @ np.linalg.inv(information) @ a[:N].T
    square = np.sum((np.eye(N) - hat) ** 2)
    assert table.loc["fit", "p"] == pytest.approx(stats.chi2.sf(e @ e * dof / square, dof**2 / square))


def test_leave_one_response_out_errors_match_refits(linear):
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


def test_held_out_errors_include_the_uncertainty_of_the_parameters(linear):
    a, y, _, theta, information, table = linear
    for group, part in (("held_out_sensors", slice(N, N + 2)), ("held_out_modes", slice(N + 2, N + 3))):
        e, g = y[part] - a[part] @ theta, a[part]
        c = np.eye(len(e)) + g @ np.linalg.inv(information) @ g.T
        assert table.loc[group, "rms"] == pytest.approx(np.sqrt(np.mean(e**2)))
        assert table.loc[group, "expected"] == pytest.approx(np.sqrt(np.mean(np.diag(c))))
        assert table.loc[group, "p"] == pytest.approx(stats.chi2.sf(e @ np.linalg.solve(c, e), len(e)))


@pytest.mark.slow
def test_held_out_errors_include_the_uncertainty_of_held_parameters():
    """Held parameters are sampled in every trial but held at their mean: errors have the covariance behind p."""
    rng = np.random.default_rng(6)
    a, h, s = rng.standard_normal((8, 2)), 3.0 * rng.standard_normal((8, 2)), np.array([2.0, 1.0])
    used, unseen = slice(0, 5), slice(5, 8)
    v = np.linalg.inv(a[used].T @ a[used] + np.diag(1 / s**2))
    truth, sampled = s * rng.standard_normal((4000, 2)), rng.standard_normal((4000, 2))
    y = truth @ a.T + sampled @ h.T + rng.standard_normal((4000, 8))
    e = y[:, unseen] - y[:, used] @ (a[unseen] @ v @ a[used].T).T
    g = -np.hstack([a, h])
    labels = [f"r{k}" for k in range(5)]

    def row_of(error, jacobian=g):
        own = {"held_out_responses": (error, jacobian[unseen])}
        table = group_errors(np.zeros(5), jacobian[used], ("a", "b"), s, labels, own)
        return table.set_index("group").loc["held_out_responses"]

    assert row_of(e[0])["expected"] == pytest.approx(math.sqrt(np.mean(e**2)), rel=0.03)
    p = np.array([row_of(error)["p"] for error in e[:400]])
    assert stats.kstest(p, "uniform").pvalue > 0.01
    ignored = np.array([row_of(error, g[:, :2])["p"] for error in e[:400]])
    assert np.mean(ignored < 1e-3) > 0.1  # correctly specified models that would be rejected


def test_a_mode_that_depends_on_an_uncertain_held_parameter_does_not_contradict(study, fit):
    """A parameter is held one standard deviation away from its fitted value."""
    name = fit.names[0]
    sd = 0.5 * abs(fit.values[name])
    values = {**fit.values, name: fit.values[name] + sd}
    others = fit.names[1:]

    def table(held_sd):
        return modal_errors(
            study.problem, study.whole_problem(), values, others, fit.prior_sd[1:], PLAIN, KNOWN, held_sd=held_sd
        ).set_index("group")

    bare, wide = table({}), table({name: sd})
    groups = ["held_out_sensors", "held_out_modes"]
    assert (wide.loc[groups, "p"] > bare.loc[groups, "p"]).all() and bare.loc["held_out_modes", "p"] < 1e-3
    assert (wide.loc[groups, "expected"] > bare.loc[groups, "expected"]).all()
    np.testing.assert_allclose(wide.loc[groups, "rms"], bare.loc[groups, "rms"])
    own = replace(study, search_space=study.search_space.keep(others), adopted_sd={name: sd})
    np.testing.assert_allclose(errors_at(own, values).set_index("group").loc[groups, "expected"],
                               wide.loc[groups, "expected"])  # fmt: skip


def test_with_as_many_unknowns_as_data_the_fit_is_not_tested():
    rng = np.random.default_rng(5)
    a = rng.standard_normal((3, 3))
    table = group_errors(np.zeros(3), -a, ("a", "b", "c"), np.full(3, 1e6), ["x", "y", "z"], {}).set_index("group")
    assert table.loc["fit", "p"] == 1.0 and table.loc["fit", "expected"] == pytest.approx(0.0, abs=1e-3)


def test_a_scalar_study_reports_its_held_out_responses(tmp_path):
    (tmp_path / "model.py").write_text(
        "from calib import FunctionModel, Parameter, ParameterSpace\n"
        "def line():\n"
        "    space = ParameterSpace(tuple(Parameter(name, 0.0, -9.0, 9.0, prior_sd=1.0) for name in 'ab'))\n"
        "    return FunctionModel('line', space, lambda v: {f'y{x}': v['a'] + v['b'] * x for x in range(6)})\n"
    )
    y = np.array([0.1, 1.2, 1.9, 3.1, 4.0, 6.0])
    rows = "\n".join(f"y{x},{v},0.1" for x, v in enumerate(y))
    (tmp_path / "measured.csv").write_text(f"response,value,std\n{rows}\n")
    (tmp_path / "study.toml").write_text(
        'title = "line"\nmodel = "model.py:line"\nselection = ["a", "b"]\n[measurement]\nresponses = "measured.csv"\n'
        '[held_out]\nresponses = ["y1", "y5"]\n[calibration]\nmethod = "gauss-newton"\n'
        'cases = [{ name = "A", seed = 1 }]\n'
    )
    table = errors_at(LoadedStudy.load(tmp_path), {"a": 0.0, "b": 1.0}).set_index("group")
    assert table["rows"].to_dict() == {"fit": 4, "left_out": 4, "held_out_responses": 2}
    assert table.loc["held_out_responses", "rms"] == pytest.approx(math.sqrt((2.0**2 + 10.0**2) / 2))
    assert table.loc["held_out_responses", "p"] < 1e-6
    assert table.loc["fit", "rms"] == pytest.approx(math.sqrt((1 + 1 + 1 + 0) / 4))


def test_a_scaled_standard_deviation_keeps_its_degrees_of_freedom():
    table = pd.DataFrame({"rms": [4.0], "chi2": [64.0], "dof": [4.0], "p": [0.0]})
    found = _scaled(table, 2.0, 8.0).iloc[0]
    assert (found["rms"], found["chi2"]) == (2.0, 16.0)
    assert found["p"] == pytest.approx(stats.f.sf(16.0 / 4, 4, 8))
    assert _scaled(table, 2.0, math.inf)["p"][0] == pytest.approx(stats.chi2.sf(16.0, 4))
