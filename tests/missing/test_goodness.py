"""Chi-square tests by kind and mode."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calib.missing.goodness import goodness, misfit_factor, noise_scale, overall
from calib.problem.labels import RowLabels


def tables(toy, fit, factors=None, dof=None):
    return goodness(fit, RowLabels(toy.rows, factors or {}, dof or {}))


def redrawn(toy, fit, rng, noise=1.0):
    """Fit to other simulated data; in a linear model its residual is the noise after projection."""
    draw = np.concatenate([noise * rng.standard_normal(len(toy.rows)), rng.standard_normal(len(fit.names))])
    augmented = np.vstack([fit.slope, np.diag(1 / fit.prior_sd)])
    left = draw - augmented @ np.linalg.lstsq(augmented, draw, rcond=None)[0]
    return replace(fit, residual=left[: len(toy.rows)], shift=-left[len(toy.rows) :])


def test_sums_of_squares_and_degrees_of_freedom_add_up(toy):
    toy = toy(modes=5, sensors=6).drawn(np.random.default_rng(1))
    fit = toy.calibrated()
    kinds, modes = tables(toy, fit)
    assert list(kinds["kind"]) == ["frequency", "damping", "shape"] and len(modes) == 15
    hat = fit.slope @ fit.covariance @ fit.slope.T
    assert kinds["chi2"].sum() == pytest.approx(np.sum(fit.residual**2))
    assert kinds["dof"].sum() == pytest.approx(len(toy.rows) - np.trace(hat))
    own = [k for k, row in enumerate(toy.rows) if (row.mode, row.kind) == ("M3", "shape")]
    line = modes[(modes["mode"] == "M3") & (modes["kind"] == "shape")].iloc[0]
    assert line["chi2"] == pytest.approx(np.sum(fit.residual[own] ** 2))
    assert line["dof"] == pytest.approx(6 - np.trace(hat[np.ix_(own, own)]))
    assert line["p"] == pytest.approx(stats.chi2.sf(line["chi2"], line["dof"]), rel=1e-4)
    shapes = modes[modes["kind"] == "shape"]
    assert kinds["chi2"][2] == pytest.approx(shapes["chi2"].sum())
    assert kinds["dof"][2] == pytest.approx(shapes["dof"].sum())


@pytest.mark.slow
def test_a_single_row_is_studentised(toy):
    toy = toy(modes=4, sensors=6, parameters=5, reach=3.0)
    fit = toy.calibrated()
    rng, p, chi2 = np.random.default_rng(12), [], []
    for _ in range(300):
        modes = tables(toy, redrawn(toy, fit, rng))[1]
        lines = modes[modes["kind"] != "shape"]
        assert (lines["dof"] == 1.0).all()
        p.append(lines["p"])
        chi2.append(lines["chi2"])
    np.testing.assert_allclose(np.mean(chi2, axis=0), 1.0, atol=4 * np.sqrt(2 / 300))
    assert stats.kstest(np.ravel(p), "uniform").pvalue > 0.005


def test_a_single_row_absorbed_by_a_parameter_is_not_tested(toy):
    toy = toy(modes=4, sensors=6, parameters=2, reach=1e4)
    column = np.eye(len(toy.rows))[0] * 1e4
    toy = replace(toy, columns={**toy.columns, "P0": column}).drawn(np.random.default_rng(13))
    modes = tables(toy, toy.calibrated())[1]
    assert modes["dof"][0] < 1e-6 and modes["p"][0] > 0.9


def test_factors_fitted_to_shapes_use_degrees_of_freedom(toy):
    toy = toy(modes=4, sensors=6).drawn(np.random.default_rng(2))
    fit = toy.calibrated()
    plain, fitted = tables(toy, fit), tables(toy, fit, {("M0", "shape"): 2, ("M2", "shape"): 5})
    less = plain[1]["dof"] - fitted[1]["dof"]
    assert less[less != 0].tolist() == pytest.approx([2, 5])
    assert plain[0].set_index("kind")["dof"]["shape"] - 7 == pytest.approx(fitted[0].set_index("kind")["dof"]["shape"])


@pytest.mark.slow
def test_the_expected_sum_of_squares_is_the_degrees_of_freedom(toy):
    toy = toy(modes=4, sensors=4, parameters=9, reach=1.0)
    fit = toy.calibrated()
    rng, chi2 = np.random.default_rng(3), []
    for _ in range(400):
        chi2.append(tables(toy, redrawn(toy, fit, rng))[1]["chi2"])
    dof = tables(toy, fit)[1]["dof"].to_numpy()
    np.testing.assert_allclose(np.mean(chi2, axis=0), dof, atol=4 * np.sqrt(2 * dof.max() / 400))
    assert dof.sum() < len(toy.rows) - 3


@pytest.mark.slow
@pytest.mark.parametrize("known", [np.inf, 6.0])
def test_p_is_uniform_when_nothing_is_missing(toy, known):
    toy = toy(modes=6, sensors=4, parameters=3, reach=1e3)
    fit = toy.calibrated()
    rng, p = np.random.default_rng(4), []
    for _ in range(400):
        one = redrawn(toy, fit, rng)
        scale = np.sqrt(rng.chisquare(known) / known) if np.isfinite(known) else 1.0
        one = replace(one, residual=one.residual / scale)
        p.append(tables(toy, one, dof=dict.fromkeys(("frequency", "damping", "shape"), known))[0]["p"])
    for values in np.transpose(p):
        assert stats.kstest(values, "uniform").pvalue > 0.005


@pytest.mark.medium
def test_the_overall_test_keeps_its_level(toy):
    toy = toy(modes=8, sensors=6, reach=1e3)
    fit = toy.calibrated()
    rng = np.random.default_rng(5)
    p = np.array([overall(*tables(toy, redrawn(toy, fit, rng))) for _ in range(400)])
    for level in (0.02, 0.05, 0.2):
        assert 0.5 * level < np.mean(p < level) < 1.4 * level


def test_one_bad_shape_is_seen_among_many_good_ones():
    modes = pd.DataFrame({"kind": ["frequency"] * 2 + ["shape"] * 5, "p": [0.5, 1e-9, 0.3, 0.4, 0.002, 0.9, 0.2]})
    kinds = pd.DataFrame({"kind": ["frequency", "shape"], "p": [0.6, 0.5]})
    assert overall(kinds, modes) == pytest.approx(3 * 5 * 0.002)
    assert overall(kinds.assign(p=[0.001, 0.5]), modes) == pytest.approx(3 * 0.001)
    assert overall(kinds[:1], modes[:2]) == pytest.approx(1.0)
    assert overall(kinds.assign(p=[0.9, 0.8]), modes.assign(p=0.7)) == 1.0


def test_without_degrees_of_freedom_only_a_bad_fit_is_significant(toy):
    toy = toy(modes=4, sensors=5, parameters=3, reach=1e3).drawn(np.random.default_rng(6), {"E0": 9.0})
    fit, factors = toy.calibrated(), {(f"M{k}", "shape"): 5 for k in range(4)}
    of_shape = np.array([row.kind == "shape" for row in toy.rows])
    perfect = replace(fit, residual=np.where(of_shape, 0.0, fit.residual))
    kinds, modes = tables(toy, perfect, factors)
    assert (modes[modes["kind"] == "shape"]["p"] == 1.0).all() and (kinds[kinds["kind"] == "shape"]["p"] == 1.0).all()
    kinds, modes = tables(toy, fit, factors)
    assert (kinds[kinds["kind"] == "shape"]["dof"] < 1).all() and (kinds[kinds["kind"] == "shape"]["p"] < 0.01).all()


@pytest.mark.parametrize("noise", [1.0, 1.3, 2.0])
def test_the_common_factor_of_the_standard_deviation(toy, noise):
    toy = toy(modes=12, sensors=40)
    fit = toy.calibrated()
    rng = np.random.default_rng(7)
    found = [noise_scale(tables(toy, redrawn(toy, fit, rng, noise))[1]) for _ in range(60)]
    # At a level of 1 %, modes with a common factor test as different once in 100 times.
    assert np.mean(np.array(found) == 1.0) < 0.06
    found = [f for f in found if f != 1.0]
    assert np.mean(found) == pytest.approx(noise, rel=0.015)
    assert np.std(found) < 0.06 * noise


@pytest.mark.medium
@pytest.mark.parametrize(
    ("modes", "dof"), [(5, 60), *(pytest.param(*two, marks=pytest.mark.slow) for two in ((8, 20), (10, 62)))]
)
def test_modes_that_share_a_factor_rarely_test_as_different(modes, dof):
    rng = np.random.default_rng(11)
    table = pd.DataFrame({"kind": "shape", "dof": float(dof), "chi2": np.nan}, index=range(modes))
    found = [noise_scale(table.assign(chi2=4.0 * rng.chisquare(dof, modes))) for _ in range(1500)]
    assert 0.001 < np.mean(np.array(found) == 1.0) < 0.01


def test_one_spoiled_mode_does_not_raise_the_factor(toy):
    toy = toy(modes=9, sensors=30).drawn(np.random.default_rng(8))
    fit = toy.calibrated()
    before = noise_scale(tables(toy, fit)[1])
    spoiled = np.array([row.mode == "M4" for row in toy.rows])

    def after(one, all_of_them):
        factor = np.where(spoiled, one, all_of_them)
        return noise_scale(tables(toy, replace(fit, residual=fit.residual * factor))[1])

    assert (
        after(1.0, 20.0) == 1.0 and after(20.0, 2.0) == 1.0
    )  # a factor not common to all modes is not attributed to the standard deviation
    assert after(20.0, 1.0) == pytest.approx(before, rel=0.06) or after(20.0, 1.0) == 1.0
    assert after(20.0, 20.0) == pytest.approx(20 * before)
    assert after(1.5, 1.5) == pytest.approx(1.5 * before)


@pytest.mark.parametrize(
    ("more", "factors"), [({"modes": 3}, {}), ({"modes": 8, "sensors": 4}, {}), ({"modes": 0, "sensors": 50}, {})]
)
def test_few_shapes_give_no_factor(toy, more, factors):
    toy = toy(**more).drawn(np.random.default_rng(9))
    assert np.isnan(noise_scale(tables(toy, toy.calibrated(), factors)[1]))


def test_the_factor_is_that_of_the_worst_failing_part(toy):
    """Frequencies fail while many shapes fit too well: the total is as in a correctly specified model."""
    toy = toy(modes=6, sensors=6).drawn(np.random.default_rng(1))
    fit = toy.calibrated()
    kind = np.array([row.kind for row in toy.rows])
    size = np.select([kind == "frequency", kind == "shape"], [6.0, 0.3], 1.0)
    unit = np.where(np.arange(len(kind)) % 2, size, -size)
    kinds, modes = tables(toy, replace(fit, residual=unit))
    assert overall(kinds, modes) < 0.01 and kinds["chi2"].sum() < 6 * kinds["dof"].sum()
    line = kinds.set_index("kind").loc["frequency"]
    assert misfit_factor(kinds, modes, 0.01) == pytest.approx(np.sqrt(line["chi2"] / line["dof"]))
    fine = tables(toy, replace(fit, residual=0.5 * np.sign(unit)))
    assert misfit_factor(*fine, 0.01) == 1.0 and overall(*fine) > 0.01
    shapes = modes.assign(
        p=np.where((modes["mode"] == "M2") & (modes["kind"] == "shape"), 1e-9, 1.0), chi2=30.0, dof=3.0
    )
    assert misfit_factor(kinds.assign(p=1.0), shapes, 0.01) == pytest.approx(np.sqrt(10.0))
