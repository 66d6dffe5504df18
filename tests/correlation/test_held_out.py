"""Errors at held-out sensors and in held-out modes: expectation from noise alone, and detection of a wrong model."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calib.correlation.modal.held_out import group_table, held_out_errors
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.rows import ModalRow
from calib.correlation.modal.whole_solution import WholeSolution
from calib.correlation.standard_deviations import Floors
from calib.errors.errors import InputError

TRUTH = {"k_along": 52.0, "k_across": 9.0, "c_end": 800.0, "mass": 11.0}
NAMES = ("k_along", "k_across", "c_end", "mass")
NONE = Floors(freq=0.0, damping=0.0, shape=0.0)
HELD = {"modes": ("M2", "M5"), "sensors": ("2x", "3y", "6x", "6y")}
NOISE = 0.004


def split(model, measured, held=HELD):
    whole = ModalProblem(model, measured, mode_count=8)
    return dataclasses.replace(whole, measured=measured.without(**held)), whole


def covariance_of(residual, values, names):
    g = residual.jacobian(values, names)
    prior = np.array([residual.problem.space[n].prior_width for n in names])
    return g, np.linalg.inv(g.T @ g + np.diag(prior**-2.0))


def fit(fitted, start, names, steps=2):
    residual, values = ModalResidual(fitted, NONE), dict(start)
    for _ in range(steps):
        g, v = covariance_of(residual, values, names)
        step = -v @ g.T @ residual.residual(values)
        values = {**values, **{n: values[n] + d for n, d in zip(names, step, strict=True)}}
    return values, covariance_of(residual, values, names)[1]


def measured(build, twin, damped=True, noise=NOISE, **options):
    model = build(damped=damped)
    return model, twin(model, TRUTH, order=range(6), noise=noise, real=not damped, **options)


def row(table, group):
    return table.set_index("group").loc[group]


@pytest.mark.parametrize("more", [0, 4])
@pytest.mark.parametrize("damped", [True, False])
def test_one_solution_gives_the_derivatives_of_used_and_of_all_data(build, twin, damped, more):
    """Also where the held-out modes ask for further modes: a solution of another count may give other signs."""
    model, every = measured(build, twin, damped)
    fitted, whole = split(model, every)
    whole = dataclasses.replace(whole, mode_count=whole.mode_count + more)
    names = NAMES if damped else ("k_along", "k_across", "mass")
    residual, values = ModalResidual(fitted, NONE), {**model.space.values, **TRUTH, "mass": 10.7}
    found = residual.solve(values)
    flipped = dataclasses.replace(found.modes, shapes=found.modes.shapes * [-1, 1, -1, 1, 1, -1, 1, 1])
    for used in (found, residual.solve(values, flipped)):
        known = WholeSolution.of(fitted, whole, values, names, NONE, solved=found.modes)
        own, other = residual.derivatives(used, names), known.derivatives_of_used(residual, used)
        for field in ("eigenvalue", "shapes", "natural_freq", "damped_freq", "damping_ratio"):
            expected = getattr(own, field)
            np.testing.assert_allclose(getattr(other, field), expected, atol=1e-6 * np.abs(expected).max())
        assert other.names == own.names and other.regular.tolist() == own.regular.tolist()
    grouped = dataclasses.replace(found, modes=dataclasses.replace(found.modes, groups=((0, 1),)))
    assert known.derivatives_of_used(residual, grouped) is None
    v = np.diag(np.full(len(names), 1e-4))
    one = held_out_errors(fitted, whole, values, names, v, NONE, known=known)
    pd.testing.assert_frame_equal(one, held_out_errors(fitted, whole, values, names, v, NONE), rtol=1e-6)


# -- noise alone -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("damped", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_noise_alone_gives_the_expected_error_and_uniform_p_values(build, twin, damped):
    names = NAMES if damped else ("k_along", "k_across", "mass")
    held = {"modes": ("M2", "M5"), "sensors": ("1x", "1y", "2x", "3y", "4x", "4y", "5x", "6x", "6y")}
    tables = []
    g = v = None
    for seed in range(50):
        model, data = measured(build, twin, damped, seed=seed)
        fitted, whole = split(model, data, held)
        residual = ModalResidual(fitted, NONE)
        if v is None:
            g, v = covariance_of(residual, TRUTH, names)
        step = -v @ g.T @ residual.residual(TRUTH)  # the noise is small enough for one
        values = {**TRUTH, **{n: TRUTH[n] + d for n, d in zip(names, step, strict=True)}}
        tables.append(held_out_errors(fitted, whole, values, names, v, NONE))
    table = pd.concat(tables)
    parts = 2 if damped else 1
    assert set(table["unpaired"]) == {0}
    for group, rows, dof in (
        ("held_out_sensors", parts * 4 * 9, parts * 4 * 9),
        ("held_out_modes", parts * 2 * 12 + 2 * parts, parts * (2 * 12 - 2) + 2 * parts),
    ):
        one = table[table["group"] == group]
        assert set(one["rows"]) == {rows} and set(one["dof"]) == {dof}
        assert np.sqrt(np.mean(one["rms"] ** 2)) == pytest.approx(np.sqrt(np.mean(one["expected"] ** 2)), rel=0.06)
        assert np.mean(one["chi2"]) == pytest.approx(dof, rel=4 * np.sqrt(2 / dof / 50))
        assert stats.kstest(one["p"], "uniform").pvalue > 0.005
        assert np.mean(one["p"] < 0.05) <= 0.14
    # Few used sensors leave the factors uncertain: the noise of the held-out sensors alone would not explain the rms.
    assert row(table, "held_out_sensors")["expected"].mean() > 1.1


@pytest.mark.slow
@pytest.mark.parametrize("damped", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_derivative_and_factor_spread_of_predicted_rows(build, twin, damped):
    model, data = measured(build, twin, damped, noise=0.0)
    fitted, whole = split(model, data)
    used = tuple(s.name for s in fitted.measured.sensors)
    predicted = ModalResidual(whole, NONE, factor_sensors=used)
    assert predicted.rows == ModalResidual(whole, NONE).rows
    names = ("k_along", "k_across", "mass")
    found = predicted.jacobian(TRUTH, names)
    for q, name in enumerate(names):
        half = 1e-5 * TRUTH[name]
        ends = [predicted.residual({**TRUTH, name: TRUTH[name] + s * half}) for s in (1, -1)]
        np.testing.assert_allclose(found[:, q], (ends[0] - ends[1]) / (2 * half), atol=2e-5 * np.abs(found[:, q]).max())
    # Noise at the used sensors moves the predicted rows by F, and by nothing else.
    rows = np.array([r.kind == "shape" and r.sensor not in used for r in predicted.rows])
    spread = predicted.factor_spread(whole.compare(TRUTH))
    np.testing.assert_array_equal(spread[~rows], 0.0)
    at_used = np.array([s.name in used for s in data.sensors])
    rng, draws = np.random.default_rng(0), []
    real = not damped
    for _ in range(600):
        noise = rng.standard_normal(data.shapes.shape) + (0 if real else 1j * rng.standard_normal(data.shapes.shape))
        noisy = dataclasses.replace(data, shapes=data.shapes + 1e-6 * noise * at_used[:, None])
        other = ModalResidual(dataclasses.replace(whole, measured=noisy), NONE, factor_sensors=used)
        if not draws:
            comparison = whole.compare(TRUTH)
            still = predicted.of(comparison)[rows]
        draws.append((other.of(comparison)[rows] - still) * predicted.std.shape[0, 0] / 1e-6)
    expected = spread[rows] @ spread[rows].T
    assert np.abs(np.cov(np.array(draws).T) - expected).max() < 0.19 * np.abs(expected).max()


def test_a_real_shape_is_predicted_from_the_phase_at_the_used_sensors(build, twin):
    values = {**TRUTH, "c_end": 300.0}
    model, data = measured(build, twin, noise=0.0)
    fitted, whole = split(model, data)
    used = tuple(s.name for s in fitted.measured.sensors)
    on = np.array([s.name in used for s in data.sensors])
    found = whole.compare(values)
    seen = found.sensor_shapes[:, found.pairing.model_index]
    rotated = (seen * np.exp(-0.5j * np.angle(np.sum(seen[on] ** 2, axis=0)))).real
    assert np.abs(seen.imag).max() > 0.05 * np.abs(seen).max()
    exact = dataclasses.replace(data, shapes=rotated / np.abs(rotated).max(axis=0) + 0j)
    predicted = ModalResidual(dataclasses.replace(whole, measured=exact), NONE, factor_sensors=used)
    shapes = predicted.kinds == "shape"
    assert sum(shapes) == 6 * 12
    np.testing.assert_allclose(predicted.residual(values)[shapes], 0.0, atol=1e-9)
    slope = predicted.jacobian(values, NAMES)
    for q, name in enumerate(NAMES):
        half = 1e-5 * values[name]
        ends = [predicted.residual({**values, name: values[name] + s * half}) for s in (1, -1)]
        expected = ((ends[0] - ends[1]) / (2 * half))[shapes]
        np.testing.assert_allclose(slope[shapes, q], expected, atol=1e-4 * np.abs(expected).max() + 1e-9)


# -- what must not matter ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damped", [True, False])
def test_scale_and_phase_of_shapes_do_not_matter(build, twin, damped):
    model, data = measured(build, twin, damped)
    fitted, whole = split(model, data)
    values, v = fit(fitted, TRUTH, NAMES if damped else ("k_along", "k_across", "mass"))
    names = NAMES if damped else ("k_along", "k_across", "mass")
    one = held_out_errors(fitted, whole, values, names, v, NONE)
    factors = np.array([0.3, 2.0, -5.0, 0.1, 1.0, 1.0]) * np.exp(1j * np.arange(6))

    def scaled(problem, factor):
        m = problem.measured
        return dataclasses.replace(
            problem,
            measured=dataclasses.replace(m, shapes=m.shapes * factor, shape_std=m.shape_std * np.abs(factor)),
        )

    used = [k for k, name in enumerate(data.names) if name in fitted.measured.names]
    other = held_out_errors(scaled(fitted, factors[used]), whole, values, names, v, NONE)
    pd.testing.assert_frame_equal(one, other)
    other = held_out_errors(fitted, scaled(whole, factors), values, names, v, NONE)
    # A phase rotation mixes real and imaginary rows and leaves every sum unchanged.
    pd.testing.assert_frame_equal(one, other, rtol=1e-7)


def test_units_of_parameters_do_not_matter_and_unknown_ones_widen(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data)
    values, v = fit(fitted, TRUTH, NAMES)
    one = held_out_errors(fitted, whole, values, NAMES, v, NONE)
    flipped = held_out_errors(fitted, whole, values, NAMES[::-1], v[::-1, ::-1], NONE)
    pd.testing.assert_frame_equal(one, flipped, rtol=1e-7)
    wide = held_out_errors(fitted, whole, values, NAMES, 100.0 * v, NONE)
    assert (wide["expected"] > one["expected"]).all() and (wide["p"] > one["p"]).all()
    pd.testing.assert_series_equal(wide["rms"], one["rms"])


def test_covariance_against_the_written_formula(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data, {"modes": ("M2",), "sensors": ()})
    values, v = fit(fitted, TRUTH, NAMES)
    table = held_out_errors(fitted, whole, values, NAMES, 50.0 * v, NONE)
    assert table["group"].tolist() == ["held_out_modes"]
    own = ModalResidual(whole, NONE)
    rows = [k for k, r in enumerate(own.rows) if r.mode == "M2"]
    e, g = own.residual(values)[rows], own.jacobian(values, NAMES)[rows]
    found = whole.compare(values)
    shape = found.sensor_shapes[:, found.pairing.model_index[1]]
    across = np.eye(12) - np.outer(shape, shape.conj()) / np.vdot(shape, shape).real
    c = 50.0 * g @ v @ g.T
    c[:2, :2] += np.eye(2)
    c[2:, 2:] += np.block([[across.real, -across.imag], [across.imag, across.real]])
    assert table["chi2"][0] == pytest.approx(e @ np.linalg.pinv(c, rcond=1e-9) @ e)
    assert table["expected"][0] == pytest.approx(np.sqrt(np.trace(c) / 26))
    assert table["dof"][0] == 24 == np.linalg.matrix_rank(c)


# -- wrong models, lost modes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damped", [True, False])
def test_a_wrong_model_is_detected(build, twin, damped):
    model, data = measured(build, twin, damped)
    names = ("k_along", "k_across")
    fitted, whole = split(model, data)
    wrong = {**TRUTH, "mass": 8.0}
    lighter = dataclasses.replace(model, mass=dataclasses.replace(model.mass, terms=bent(model)))
    values, v = fit(dataclasses.replace(fitted, model=lighter), wrong, names, steps=6)
    table = held_out_errors(
        dataclasses.replace(fitted, model=lighter), dataclasses.replace(whole, model=lighter), values, names, v, NONE
    )
    assert (table["p"] < 1e-10).all()
    assert (table["rms"] > 3 * table["expected"]).all()


def bent(model):
    """Mass terms with a heavy fourth node."""
    term = model.mass.terms[0]
    factor = np.ones(model.n_dof)
    factor[6:8] = 1.3
    matrix = term.matrix.copy().tocsr()
    matrix.setdiag(matrix.diagonal() * factor)
    return (dataclasses.replace(term, matrix=matrix),)


def test_modes_without_partner_are_counted(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data)
    values, v = fit(fitted, TRUTH, NAMES)
    top = 0.5 * (data.natural_freq[4] + data.natural_freq[3])
    whole_window = dataclasses.replace(whole, freq_window=(0.0, top), threshold=0.9)
    table = held_out_errors(fitted, whole_window, values, NAMES, v, NONE)
    assert row(table, "held_out_modes")["unpaired"] == 1
    e = ModalResidual(whole, NONE).std.freq[4]
    assert row(table, "held_out_modes")["chi2"] > e**-2.0
    assert row(table, "held_out_sensors")["unpaired"] == 0
    # A used mode without a partner counts with its full motion at the held-out sensors, and takes no partner there.
    fitted_window = dataclasses.replace(fitted, freq_window=(0.0, top), threshold=0.9)
    table = held_out_errors(fitted_window, whole, values, NAMES, v, NONE)
    assert row(table, "held_out_sensors")["unpaired"] == 1
    assert row(table, "held_out_modes")["unpaired"] == 0
    hidden = [k for k, s in enumerate(data.sensors) if s.name in HELD["sensors"]]
    full = np.sum(np.abs(data.shapes[hidden, 5] / data.shape_std[hidden, 5]) ** 2)
    before = held_out_errors(fitted, whole, values, NAMES, v, NONE)
    n = 2 * 4 * 4
    assert n * row(table, "held_out_sensors")["rms"] ** 2 == pytest.approx(
        full + n * row(before, "held_out_sensors")["rms"] ** 2 - own_share(fitted, whole, values, "M6"), rel=1e-9
    )


def own_share(fitted, whole, values, mode):
    predicted = ModalResidual(whole, NONE, factor_sensors=tuple(s.name for s in fitted.measured.sensors))
    e = predicted.residual(values)
    mine = [r.mode == mode and r.sensor in HELD["sensors"] for r in predicted.rows]
    return float(np.sum(e[mine] ** 2))


def test_used_modes_keep_the_partner_of_the_used_data(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data)
    values, v = fit(fitted, TRUTH, NAMES)
    # The choice that M5 be the third model mode yields: a used mode has it already.
    choice = dataclasses.replace(whole, override={"M5": 3})
    pd.testing.assert_frame_equal(
        held_out_errors(fitted, choice, values, NAMES, v, NONE), held_out_errors(fitted, whole, values, NAMES, v, NONE)
    )
    astray = dataclasses.replace(fitted, override={"M1": 2})
    table = held_out_errors(astray, whole, values, NAMES, v, NONE)
    assert row(table, "held_out_sensors")["p"] < 1e-10


def test_groups_that_are_absent_have_no_row(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data)
    values, v = fit(fitted, TRUTH, NAMES)
    assert held_out_errors(whole, whole, values, NAMES, v, NONE).empty
    only = dataclasses.replace(whole, measured=data.without(sensors=HELD["sensors"]))
    assert held_out_errors(only, whole, values, NAMES, v, NONE)["group"].tolist() == ["held_out_sensors"]
    # No used sensor, no factor: held-out ones cannot be predicted.
    blind = data.without(sensors=[s.name for s in data.sensors])
    by_order = dataclasses.replace(whole, measured=blind)
    assert held_out_errors(by_order, whole, values, NAMES, v, NONE).empty
    part = data.shapes.copy()
    part[[s.name not in HELD["sensors"] for s in data.sensors], 0] = np.nan
    gap = dataclasses.replace(data, shapes=part)
    fitted, whole = split(model, gap)
    table = held_out_errors(fitted, whole, values, NAMES, v, NONE)
    assert row(table, "held_out_sensors")["rows"] == 2 * 3 * 4


def test_a_standard_deviation_from_few_repeats_is_weaker_evidence(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data)
    values, v = fit(fitted, TRUTH, NAMES)
    away = {**values, "k_along": 1.05 * values["k_along"], "k_across": 0.95 * values["k_across"]}
    known = held_out_errors(fitted, whole, away, NAMES, v, NONE)
    few = held_out_errors(fitted, whole, away, NAMES, v, NONE, {"frequency": 8.0, "damping": 8.0, "shape": 20.0})
    assert (few["p"] > known["p"]).all()
    sensors = row(few, "held_out_sensors")
    assert sensors["p"] == pytest.approx(stats.f.sf(sensors["chi2"] / sensors["rows"], sensors["rows"], 20.0))


def test_input_that_does_not_belong_together(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data)
    with pytest.raises(InputError, match="M2, M5, 2x, 3y, 6x, 6y is used but not part"):
        held_out_errors(whole, fitted, TRUTH, NAMES, np.eye(4), NONE)
    with pytest.raises(InputError, match="4 parameters, but a covariance"):
        held_out_errors(fitted, whole, TRUTH, NAMES, np.eye(3), NONE)
    with pytest.raises(InputError, match="is not finite"):
        held_out_errors(fitted, whole, TRUTH, NAMES, np.diag([1.0, 1.0, np.inf, 1.0]), NONE)


# -- the table of all groups -------------------------------------------------------------------------------------------


def test_one_table_of_all_groups(build, twin):
    model, data = measured(build, twin)
    fitted, whole = split(model, data)
    values, v = fit(fitted, TRUTH, NAMES)
    held_out = held_out_errors(fitted, whole, values, NAMES, v, NONE)
    rows = [
        ModalRow("M1", "frequency"),
        ModalRow("M2", "frequency"),
        ModalRow("M1", "shape", "1x", "re"),
        ModalRow("M1", "shape", "2x"),
    ]
    used, out = np.array([1.0, -1.0, 2.0, 0.0]), np.array([2.0, -1.0, 2.0, 0.0])
    table = group_table(rows, used, 3.0, out, np.array([2.0, 1.0, 1.0, 2.0]), held_out, 1, 0.3, 2)
    assert table.columns.tolist() == ["group", "rows", "rms", "expected", "p", "unpaired"]
    assert table["group"].tolist() == ["fit", "left_out", "held_out_sensors", "held_out_modes"]
    assert table["rms"][0] == pytest.approx(np.sqrt(6 / 4)) and table["expected"][0] == pytest.approx(np.sqrt(3 / 4))
    assert table["p"][0] == pytest.approx(stats.chi2.sf(6.0, 3))
    assert table["rms"][1] == pytest.approx(1.5) and table["expected"][1] == pytest.approx(np.sqrt(5 / 4))
    assert table["p"][1] == 0.3 and table["unpaired"].tolist() == [2, 2, 0, 0]
    pd.testing.assert_series_equal(table["rms"][2:], held_out["rms"], check_index=False)
    # Two of four rows with 4 degrees of freedom behind their standard deviation, two with 12 (Satterthwaite 1946).
    few = group_table(rows, used, 3.0, out, np.ones(4), held_out, std_dof={"frequency": 4.0, "shape": 12.0})
    assert few["p"][0] == pytest.approx(stats.f.sf(2.0, 3, 16 / (4 / 4 + 4 / 12)))
    none = group_table(rows, used, 3.0, out, np.ones(4), held_out[:0])
    assert none["group"].tolist() == ["fit", "left_out"] and np.isnan(none["p"][1])
    with pytest.raises(InputError, match="4 rows, but residuals"):
        group_table(rows, used[:3], 3.0, out, np.ones(4), held_out)
