import dataclasses

import numpy as np
import pytest

from calib.correlation.modal.comparison import BEYOND, UNKNOWN, UNPAIRED, WITHIN
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import USUAL
from calib.measurement.mac import mac

TRUTH = {"k_along": 52.0, "k_across": 9.0, "c_end": 800.0}
OFF = {"k_along": 40.0, "k_across": 11.0, "c_end": 300.0}


@pytest.fixture
def found(build, twin):
    """A wrong model compared with synthetic measurements whose modes are in another order."""
    model = build()
    return ModalProblem(model, twin(model, TRUTH, order=(2, 0, 1, 4)), mode_count=6).compare(OFF)


def test_comparison_table_has_its_columns_and_signed_errors(found):
    table = found.comparison_table()
    assert list(table.columns) == [
        "mode",
        "model_mode",
        "natural_freq_measured",
        "natural_freq_model",
        "damped_freq_measured",
        "damped_freq_model",
        "freq_error",
        "damping_ratio_measured",
        "damping_ratio_model",
        "mac",
        "emac",
        "margin",
    ]
    assert table["mode"].tolist() == ["M1", "M2", "M3", "M4"]
    modes = found.model.modes(OFF, 6)
    np.testing.assert_allclose(table["natural_freq_model"], modes.natural_freq[found.pairing.model_index])
    np.testing.assert_allclose(
        table["natural_freq_model"], table["natural_freq_measured"] * (1 + table["freq_error"]), rtol=1e-12
    )
    assert (table["freq_error"] > 0.05).any()
    np.testing.assert_allclose(
        table["damped_freq_model"], table["natural_freq_model"] * np.sqrt(1 - table["damping_ratio_model"] ** 2)
    )


def test_the_numbers_of_model_modes_their_order_and_far_pairs_are_reported(build, twin):
    model = build()
    measured = twin(model, TRUTH, order=(2, 0, 1, 4))
    near = ModalProblem(model, measured, mode_count=6).compare(TRUTH)
    assert near.comparison_table()["model_mode"].tolist() == [3, 1, 2, 5]
    assert near.crossings == () and near.far == () and near.shifts == ((4, "M4", 5),)
    chosen = ModalProblem(model, measured, mode_count=6, override={"M2": 4, "M4": 2}).compare(TRUTH)
    assert chosen.crossings == (("M2", "M1"), ("M1", "M4"))
    assert chosen.far == ("M2", "M4")
    lost = ModalProblem(model, measured, mode_count=6, threshold=1.0).compare(OFF).comparison_table()
    assert lost["model_mode"].isna().all()


def test_mac_table_names_modes_and_model_frequencies(found):
    table = found.mac_table()
    assert table["mode"].tolist() == ["M1", "M2", "M3", "M4"]
    assert list(table.columns)[1:] == [f"{k + 1} ({f:.2f} Hz)" for k, f in enumerate(found.modes.natural_freq)]
    np.testing.assert_array_equal(table.drop(columns="mode").to_numpy(), found.mac)


def test_shapes_overlay_and_keep_their_mac(found):
    table = found.shapes_table()
    assert ",".join(table.columns) == "mode,sensor,node,direction,x,y,z,measured_re,measured_im,model_re,model_im"
    for i, name in enumerate(found.measured.names):
        rows = table[table["mode"] == name]
        model = (rows["model_re"] + 1j * rows["model_im"]).to_numpy()
        measured = (rows["measured_re"] + 1j * rows["measured_im"]).to_numpy()
        turn = measured / found.measured.shapes[:, i]
        np.testing.assert_allclose(turn, turn[0])
        assert abs(turn[0]) == pytest.approx(1.0) and measured[np.argmax(np.abs(measured))].real > 0
        # No other phase has a smaller imaginary part: the moments about the real axis are principal ones.
        parts = np.array([measured.real, measured.imag])
        assert np.linalg.norm(measured.imag) ** 2 == pytest.approx(np.linalg.eigvalsh(parts @ parts.T)[0])
        assert mac(measured, model)[0, 0] == pytest.approx(found.pairing.mac[i])
        # Least squares leaves a residual at right angles to the fitted shape.
        assert abs(np.vdot(model, measured - model)) < 1e-12
    assert table.iloc[2][["sensor", "node", "direction", "x"]].tolist() == ["2x", 2, "x", 1.0]


def test_what_is_drawn_does_not_depend_on_the_phase_of_the_measured_shape(found):
    """Only the real part is drawn, which would be little but noise in another phase."""
    shapes = found.measured.shapes * np.exp(1j * np.array([0.3, 1.5, 1.6, -3.0]))
    turned = dataclasses.replace(found, measured=dataclasses.replace(found.measured, shapes=shapes))
    for table in ("shapes_table", "deflection_table"):
        one, other = (getattr(x, table)().select_dtypes("number") for x in (found, turned))
        np.testing.assert_allclose(other, one, atol=1e-12)


def test_deflections_pass_through_the_sensors(found):
    table = found.deflection_table()
    assert ",".join(table.columns) == "mode,point,u,v,w"
    places = found.model.mesh.points
    assert len(table) == 4 * len(places)
    shapes = found.shapes_table()
    for _, row in table.iterrows():
        for direction, motion in (("x", "u"), ("y", "v")):
            seen = shapes[
                (shapes["mode"] == row["mode"])
                & (shapes["x"] == places[row["point"], 0])
                & (shapes["direction"] == direction)
            ]
            assert row[motion] == pytest.approx(seen["model_re"].item(), abs=1e-12)
        assert row["w"] == 0.0


def test_comac_table_leads_with_the_wrong_sensor(build, twin):
    model = build()
    light = {**TRUTH, "c_end": 40.0}
    measured = twin(model, light)
    wrong = measured.shapes.copy()
    wrong[3] *= -1
    table = ModalProblem(model, dataclasses.replace(measured, shapes=wrong), mode_count=6).compare(light).comac_table()
    assert list(table.columns) == ["sensor", "node", "direction", "x", "y", "z", "comac", "motion"]
    assert table.loc[0, "sensor"] == "2y" and table.loc[0, "comac"] < 0.1
    assert table["comac"].is_monotonic_increasing and table["comac"].iloc[-1] > 0.99


def test_unpaired_modes_stay_visible(build, twin):
    model = build()
    measured = twin(model, TRUTH)
    problem = ModalProblem(model, measured, mode_count=6, freq_window=(1.01 * measured.natural_freq[0], 1e3))
    found = problem.compare(TRUTH)
    row = found.comparison_table().iloc[0]
    assert row["natural_freq_measured"] == measured.natural_freq[0]
    assert row[["natural_freq_model", "freq_error", "damping_ratio_model", "mac", "margin"]].isna().all()
    shapes = found.shapes_table()
    assert shapes.loc[shapes["mode"] == "M1", "model_re"].isna().all()
    assert shapes.loc[shapes["mode"] == "M1", "measured_re"].notna().all()
    assert found.deflection_table()["mode"].unique().tolist() == ["M2", "M3", "M4"]
    assert found.where_it_fails().iloc[0].tolist()[:2] == ["shape", "M1"]
    assert found.where_it_fails().loc[0, "verdict"] == UNPAIRED
    assert "3 of 4 measured modes are paired; not M1." in found.sentence()


def test_nothing_paired_is_a_table_too(build, twin):
    model = build()
    found = ModalProblem(model, twin(model, TRUTH), mode_count=6, freq_window=(1e3, 2e3)).compare(TRUTH)
    assert found.deflection_table().empty and "u" in found.deflection_table()
    assert found.comac_table()["comac"].isna().all()
    assert (found.where_it_fails()["verdict"] == UNPAIRED).sum() == 4
    assert "0 of 4" in found.sentence()


def test_frequencies_alone_have_tables(build, twin):
    model = build(damped=False)
    found = ModalProblem(model, twin(model, TRUTH, shapes=False), mode_count=6).compare(TRUTH)
    assert found.shapes_table().empty and found.comac_table().empty
    assert found.mac_table().drop(columns="mode").isna().all(axis=None)
    deflection = found.deflection_table()
    assert np.abs(deflection[["u", "v"]]).groupby(deflection["mode"]).max().max(axis=1).tolist() == (
        pytest.approx([1.0] * 4)
    )
    assert set(found.where_it_fails()["kind"]) == {"frequency"}
    assert np.all(np.isnan(found.noise_mac()))


@pytest.mark.slow
@pytest.mark.parametrize("real", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_correctly_specified_model_stays_within_its_uncertainty(build, twin, real):
    """Over many noisy twins ``in_std`` is 1 on average, and about one comparison in twenty exceeds its limit.

    Of the standard deviations the twins make the first part, the floors of the fit the second.
    """
    model = build(damped=not real)
    made = {
        "frequency": 0.005 / np.hypot(0.005, USUAL.freq),
        "damping": 0.07 / np.hypot(0.07, USUAL.damping),
        "shape": 0.025 / np.hypot(0.025, USUAL.shape),
    }
    made["sensor"] = made["shape"]
    numbers: dict[str, list[float]] = {"frequency": [], "damping": [], "shape": [], "sensor": []}
    beyond: dict[str, list[bool]] = {kind: [] for kind in numbers}
    allowed, reached, solved = [], [], model.modes(TRUTH, 6)
    for seed in range(70):
        measured = twin(model, TRUTH, noise=0.025, seed=seed, real=real)
        found = ModalProblem(model, measured, mode_count=6).compare(TRUTH, solved)
        allowed.append(found.noise_mac())
        reached.append(found.pairing.mac)
        for row in found.where_it_fails().itertuples():
            numbers[row.kind].append(row.in_std)
            beyond[row.kind].append(row.verdict == BEYOND)
    for kind, values in numbers.items():
        if kind == "damping" and real:
            assert not values
            continue
        # Frequencies give four numbers a twin, shapes and sensors average over many parts each.
        tolerance = 0.12 if kind in ("frequency", "damping") else 0.03
        assert np.sqrt(np.mean(np.square(values))) == pytest.approx(made[kind], abs=tolerance), kind
        assert 0.01 < np.mean(beyond[kind]) < 0.09, kind  # fewer where the floor counts
    assert 1 - np.mean(reached) == pytest.approx(made["shape"] ** 2 * (1 - np.mean(allowed)), rel=0.05)


def test_a_wrong_model_is_located(build, twin):
    model = build()
    measured = twin(model, TRUTH, noise=0.02, seed=3)
    wrong = ModalProblem(model, measured, mode_count=6).compare({**TRUTH, "k_across": 10.5})
    table = wrong.where_it_fails()
    ratio = table["in_std"].to_numpy()
    assert list(table.columns) == ["kind", "what", "value", "in_std", "limit", "verdict"]
    tested = table[table["verdict"].isin([BEYOND, WITHIN])]
    assert ((tested["in_std"] > tested["limit"]) == (tested["verdict"] == BEYOND)).all()
    assert (
        tested.loc[tested["kind"] == "sensor", "limit"].max() < tested.loc[tested["kind"] == "frequency", "limit"].min()
    )
    assert np.all(np.diff(ratio) <= 0) and table.loc[0, "kind"] == "frequency" and table.loc[0, "verdict"] == BEYOND
    error = wrong.comparison_table().set_index("mode")["freq_error"]
    worst = table.iloc[0]
    assert worst["value"] == pytest.approx(error[worst["what"]])
    std = np.hypot(0.005, USUAL.freq)
    assert worst["in_std"] == pytest.approx(np.log1p(worst["value"]) / std, rel=0.02)
    assert f"The worst is the frequency of {worst['what']}, {worst['in_std']:.1f} times its standard deviation." in (
        wrong.sentence()
    )


def test_twice_the_damper_is_a_damping_failure(build, twin):
    model = build()
    measured = twin(model, {**TRUTH, "c_end": 20.0}, noise=0.02, seed=3)
    table = ModalProblem(model, measured, mode_count=6).compare({**TRUTH, "c_end": 40.0}).where_it_fails()
    assert table.loc[:3, "kind"].tolist() == ["damping"] * 4  # all four, before everything else
    np.testing.assert_allclose(table.loc[:3, "value"], np.log(2.0), atol=0.3)
    assert (table.loc[:3, "verdict"] == BEYOND).all()
    np.testing.assert_allclose(table.loc[:3, "in_std"], np.log(2.0) / 0.07, rtol=0.4)


def test_few_repeats_raise_the_limit(build, twin):
    model = build()
    measured = twin(model, TRUTH, noise=0.02, seed=3)
    # 2.4 standard deviations: significant for a known standard deviation, not for one pooled from 2 repeats of 4 modes
    # (limit 2.8).
    exact = model.modes(TRUTH, 4).natural_freq
    measured = dataclasses.replace(measured, natural_freq=exact * 1.012, freq_std=0.005 * exact)
    verdicts = []
    for repeats in (1, 2):
        problem = ModalProblem(model, dataclasses.replace(measured, n_repeats=repeats), mode_count=6)
        table = problem.compare(TRUTH).where_it_fails()
        verdicts.append(set(table.loc[table["kind"] == "frequency", "verdict"]))
    assert verdicts == [{BEYOND}, {WITHIN}]


@pytest.mark.parametrize("repeats", [1, 5, 20])
@pytest.mark.parametrize("real", [False, True])
def test_the_tables_and_the_fit_have_the_same_standard_deviation(build, twin, repeats, real):
    """Frequency and damping are the rows of the residual; sensors, with equal standard deviations, its mean squares."""
    model = build(damped=not real)
    measured = twin(model, TRUTH, noise=0.02, seed=3, real=real)
    freq_std = measured.freq_std * np.array([0.5, 1.0, 1.5, 2.0])
    measured = dataclasses.replace(measured, freq_std=freq_std, n_repeats=repeats)
    problem = ModalProblem(model, measured, mode_count=6)
    found, residual = problem.compare(OFF), ModalResidual(problem)
    table = found.where_it_fails().set_index(["kind", "what"])["in_std"]
    whitened = list(zip(residual.rows, residual.of(found), strict=True))
    for row, value in whitened:
        if row.kind != "shape":
            assert table[row.kind, row.mode] == pytest.approx(abs(value))
    assert found.std.shape == pytest.approx(residual.std.shape)
    shares = np.abs(found.aligned_shapes) ** 2
    shares /= shares.sum(axis=0)
    parts = 1 if real else 2
    for s, sensor in enumerate(measured.sensors):
        own = {}
        for row, value in whitened:
            if row.sensor == sensor.name:
                own[row.mode] = own.get(row.mode, 0.0) + value**2
        mean = np.mean([own[m] / parts / (1 - shares[s, i]) for i, m in enumerate(measured.names)])
        assert table["sensor", sensor.name] == pytest.approx(np.sqrt(mean), rel=1e-6)


def test_a_sensor_to_which_shapes_are_scaled_is_not_tested_on_rounding_error(build, twin):
    """Where every repeat is scaled to one sensor, its standard deviation is 0."""
    model = build()
    measured = twin(model, TRUTH, noise=0.02, seed=3)
    shape_std = measured.shape_std.copy()
    shape_std[10] = 1e-16
    for repeats in (5, 20):
        still = dataclasses.replace(measured, shape_std=shape_std, n_repeats=repeats)
        table = ModalProblem(model, still, mode_count=6).compare(OFF).where_it_fails()
        assert table["in_std"].max() < 100


def test_unknown_std_is_reported_and_not_tested(found):
    table = found.where_it_fails()
    assert set(table["verdict"]) == {UNKNOWN} and table["in_std"].isna().all()
    assert "No standard deviation is stated" in found.sentence()


def test_a_sensor_fault_is_found_at_its_sensor(build, twin):
    model = build()
    measured = twin(model, TRUTH, noise=0.02, seed=1)
    shapes = measured.shapes.copy()
    shapes[7] *= 0.5
    found = ModalProblem(model, dataclasses.replace(measured, shapes=shapes), mode_count=6).compare(TRUTH)
    table = found.where_it_fails()
    sensors = table[table["kind"] == "sensor"]
    assert sensors.iloc[0]["what"] == "4y" and sensors.iloc[0]["verdict"] == BEYOND
