"""Simulated FRF tests: structure, transducers, noise and errors as stated, and the files of the solar array."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import CmcfSettings, MeasuredReceptance
from calib.measurement.files.uff_frf import read_uff_frfs
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_repeats import repeatability
from calib.measurement.modal import Sensor
from calib.structure.frf import frf
from calib.study.loading import module_of
from models.four_storey_rig import MASS, four_storey_rig
from models.railway import bogie_on_rig
from models.solar_panel import GROUPS, solar_panel

ROOT = Path(__file__).resolve().parent.parent
STUDY = ROOT / "studies/solar_panel"
TRUTH = json.loads((ROOT / "tests/truth/solar_panel.json").read_text("utf-8"))

twin = module_of(ROOT / "studies/frf_twin.py")
make_twin = module_of(STUDY / "make_twin.py")

FREQ = np.linspace(2.0, 30.0, 40)


@pytest.fixture(scope="module")
def rig():
    return four_storey_rig()


def storeys(rig, *numbers):
    return tuple(Sensor(k, "x", tuple(rig.mesh.points[k])) for k in numbers)


def a_test(rig, **changes):
    return twin.FRFTest(FREQ, storeys(rig, 1, 2, 3, 4), storeys(rig, 4), **changes)


# -- the structure -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
def test_structural_damping_is_that_of_the_sum_over_modes(rig, quantity):
    modes = rig.modes({}, 4)
    shapes = modes.shapes.real / np.sqrt(MASS * np.sum(modes.shapes.real**2, axis=0))
    omega, eta = 2 * np.pi * FREQ, 0.02
    squares = (2 * np.pi * modes.natural_freq) ** 2 * (1 + 1j * eta)
    expected = np.einsum("ir,r,kr->ki", shapes, shapes[3], 1 / (squares - omega[:, None] ** 2))
    expected *= ((1j * omega) ** {"receptance": 0, "mobility": 1, "accelerance": 2}[quantity])[:, None]
    found = twin.functions(rig, {}, a_test(rig, quantity=quantity, loss_factor=eta))
    np.testing.assert_allclose(found[:, :, 0], expected, rtol=1e-9)


@pytest.mark.slow
def test_dashpots_are_the_structures_own():
    panel = solar_panel(damping_ratio=0.02)
    sensors = tuple(Sensor(n, "z", tuple(panel.mesh.points[n - 1])) for n in (1, 30))
    test = twin.FRFTest(FREQ, sensors, sensors[:1])
    rows = panel.sensor_rows(sensors)
    expected = frf(panel, {"E_panel_1": 150.0}, FREQ, rows, rows[:1], "accelerance")
    np.testing.assert_allclose(twin.functions(panel, {"E_panel_1": 150.0}, test), expected, rtol=1e-8)


def test_accelerometers_load_the_structure_at_every_place(rig):
    loaded = twin.functions(rig, {}, a_test(rig, accelerometer=0.1 * MASS, quantity="receptance"))
    heavier = four_storey_rig(masses_known=False)
    rows = heavier.sensor_rows(storeys(heavier, 1, 2, 3, 4))
    expected = frf(heavier, {f"m{k}": 1.1 for k in range(1, 5)}, FREQ, rows, rows[3:])
    np.testing.assert_allclose(loaded, expected, rtol=1e-9)


def test_one_node_carries_one_accelerometer_whatever_it_measures():
    panel = solar_panel()
    sensors = tuple(Sensor(n, d, tuple(panel.mesh.points[n - 1])) for n in (1, 30) for d in ("z", "rx"))
    lifted = (panel.dofs.direction == 2).astype(float)
    assert lifted @ twin._carried(panel, sensors) @ lifted == pytest.approx(2.0)


# -- noise and errors --------------------------------------------------------------------------------------------------


def test_the_noise_of_each_repeat_is_the_stated_share_and_floor(rig):
    test = a_test(rig, share=0.03, floor=0.5, repeats=200)
    found = twin.simulate(rig, {}, test, np.random.default_rng(1))
    every = np.array([repeat.values for repeat in found.repeats])
    expected = np.hypot(0.03 * np.abs(found.noise_free), 0.5)
    for part, true in ((every.real, found.noise_free.real), (every.imag, found.noise_free.imag)):
        ratio = part.std(axis=0, ddof=1) / expected
        assert np.abs(ratio - 1).max() < 0.25 and ratio.mean() == pytest.approx(1, abs=0.01)
        off = (part.mean(axis=0) - true) / expected
        assert np.abs(off).max() < 4.5 / np.sqrt(200)
    parts = np.corrcoef(every.real[:, 3, 1, 0], every.imag[:, 3, 1, 0])[0, 1]
    assert abs(parts) < 0.3
    assert repeatability(every[:, :, 0, 0]) == pytest.approx(expected[:, 0, 0], rel=0.05)


def test_gain_and_phase_are_shared_by_all_repeats_and_told_in_the_truth(rig):
    test = a_test(rig, share=0.0, gain=0.1, phase=5.0, repeats=2)
    found = twin.simulate(rig, {}, test, np.random.default_rng(2))
    truth = json.loads(json.dumps(found.truth()))
    for repeat in found.repeats:
        factor = repeat.values / found.noise_free
        np.testing.assert_allclose(factor, np.broadcast_to(factor[:1], factor.shape), rtol=1e-9)
        for i, response in enumerate(test.responses):
            ends = f"response {response.name}", "reference 4x"
            gain = np.prod([1 + truth["gain"][end] for end in ends])
            phase = np.radians(sum(truth["phase"][end] for end in ends))
            assert factor[0, i, 0] == pytest.approx(gain * np.exp(1j * phase))
    assert 0.02 < np.std(list(truth["gain"].values())) < 0.3
    assert 1.0 < np.std(list(truth["phase"].values())) < 15.0
    again = twin.simulate(rig, {}, test, np.random.default_rng(2))
    np.testing.assert_array_equal(again.repeats[1].values, found.repeats[1].values)


def test_files_hold_every_repeat_and_the_nominal_places(rig, tmp_path):
    test = a_test(rig, repeats=3)
    aside = [replace(s, point=(0.0, s.point[1] + 1e-3, 0.0)) for s in test.responses]
    found = twin.simulate(rig, {}, test, np.random.default_rng(3), aside)
    twin.write(found, tmp_path, "rig")
    assert sorted(p.name for p in tmp_path.iterdir()) == [*(f"repeat_{k}.uff" for k in (1, 2, 3)), "sensors.csv"]
    for k, repeat in enumerate(found.repeats, start=1):
        read = read_uff_frfs(tmp_path / f"repeat_{k}.uff")
        assert read.quantity == "accelerance" and b"SYNTHETIC" in (tmp_path / f"repeat_{k}.uff").read_bytes()
        np.testing.assert_allclose(read.functions[(2, "x"), (4, "x")], repeat.values[:, 1, 0], rtol=1e-5)
    table = pd.read_csv(tmp_path / "sensors.csv")
    assert list(table.columns) == ["node", "x", "y", "z"]
    np.testing.assert_allclose(table.set_index("node").loc[3], test.responses[2].point)


@pytest.mark.slow
def test_the_bogies_finer_mesh_is_measured_too():
    """At true places beside the nominal ones, as the modes of its blind studies are."""
    bogie = module_of(ROOT / "studies/bogie/make_twin.py")
    structure, layout = bogie_on_rig(element_size=0.025, distributed=True), bogie.sensors()
    test = twin.FRFTest(np.array([11.0, 20.0]), layout, layout[:1], repeats=1, accelerometer=0.05)
    true = bogie.moved(layout, np.random.default_rng(1))
    found = twin.functions(structure, {}, test, true)
    rows = structure.sensor_rows(true), structure.sensor_rows(layout[:1])
    bare = frf(structure, {}, test.freq, *rows, "accelerance")
    assert found.shape == (2, 30, 1)
    change = np.abs(found / bare - 1)
    assert 1e-5 < np.median(change) < 0.05  # 1.5 kg on a bogie of tonnes


# -- the measurement of the solar array --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured():
    return [read_uff_frfs(file) for file in sorted((STUDY / "measured").glob("*.uff"))]


def test_the_files_are_small_and_of_the_articles_nodes(measured):
    assert len(measured) == 5
    assert sum(file.stat().st_size for file in (STUDY / "measured").iterdir()) <= 400_000
    table = pd.read_csv(STUDY / "measured/sensors.csv").set_index("node")
    points = solar_panel().mesh.points
    for repeat in measured:
        assert repeat.quantity == "accelerance" and len(repeat.freq) == 200
        assert {reference for _, reference in repeat.functions} == {(1, "z")}
        assert {node for (node, _), _ in repeat.functions} == set(table.index) == set(make_twin.MASTERS)
    np.testing.assert_allclose(table[["x", "y", "z"]], points[[node - 1 for node in table.index]], atol=1e-9)


def test_the_measurement_varies_about_the_twin_as_stated(measured):
    """A mean of five repeats against the noise-free twin with its gains and phases."""
    structure, test = solar_panel(2), make_twin.test()
    some = np.arange(0, 200, 8)
    true = twin.functions(structure, TRUTH["parameters"], replace(test, freq=test.freq[some]))[:, :, 0]
    assert TRUTH["loss_factor"] == test.loss_factor and TRUTH["accelerometer"] == test.accelerometer
    ends = [[f"response {s.name}", "reference 1z"] for s in test.responses]
    gain = np.array([np.prod([1 + TRUTH["gain"][e] for e in pair]) for pair in ends])
    phase = np.radians([sum(TRUTH["phase"][e] for e in pair) for pair in ends])
    std = np.hypot(TRUTH["noise"]["share"] * np.abs(true), TRUTH["noise"]["floor"])
    keys = [((s.node, "z"), (1, "z")) for s in test.responses]
    every = np.array([[repeat.functions[key][some] for key in keys] for repeat in measured]).transpose(0, 2, 1)
    off = (every.mean(axis=0) - true * gain * np.exp(1j * phase)) / std * np.sqrt(5)
    rows = np.concatenate([off.real.ravel(), off.imag.ravel()])
    assert np.mean(rows**2) == pytest.approx(1, abs=4 * np.sqrt(2 / len(rows)))
    spread = np.concatenate([np.std(part, axis=0, ddof=1) / std for part in (every.real, every.imag)])
    assert np.mean(spread**2) == pytest.approx(1, abs=4 * np.sqrt(2 / (4 * spread.size)))


@pytest.mark.slow
def test_the_twin_is_another_mesh_with_the_articles_moduli():
    own = [TRUTH["parameters"][name] / solar_panel().space[name].value for name in GROUPS]
    assert own == pytest.approx([1.2, 1.2, 1.3, 1.3, 1.5, 1.5])
    coarse = solar_panel().modes(TRUTH["parameters"], 8).natural_freq
    shift = coarse / np.array(TRUTH["natural_freq"]) - 1
    assert shift.min() > 0.002 and 0.02 < shift.max() < 0.04


@pytest.fixture(scope="module")
def mean(measured):
    """Over the repeats, (200, 12)."""
    keys = [((node, "z"), (1, "z")) for node in make_twin.MASTERS]
    return np.mean([[repeat.functions[key] for key in keys] for repeat in measured], axis=0).T


@pytest.fixture(scope="module")
def started(mean):
    """Factors of the moduli by the cross-model equations on all lines under one force."""
    freq = make_twin.LINES
    receptance = (mean / -((2 * np.pi * freq[:, None]) ** 2))[:, :, None]
    settings = CmcfSettings(steps=8, tolerance=0.0)
    measured = MeasuredReceptance(freq, receptance, np.array([0]))
    return cmcf(example().model, measured, settings).changes[-1] + 1


def example():
    return module_of(STUDY / "article.py").Example(solar_panel())


FACTORS = np.array(list(make_twin.FACTORS.values()))


@pytest.mark.medium
def test_the_cross_model_equations_give_a_start_as_good_as_the_study_says(started):
    """Though mesh, damping and gains of the structure are not the model's."""
    moduli = np.abs(started / FACTORS - 1).max()
    freq = np.abs(example().freq(started) / TRUTH["natural_freq"] - 1).max()
    words = f"moduli within {np.ceil(100 * moduli):.0f} % and natural frequencies within {np.ceil(100 * freq):.0f} %"
    assert words in " ".join((STUDY / "README.md").read_text("utf-8").split())
    assert moduli < 0.1 and freq < 0.02


def fitted(mean, density, accuracy, start, every):
    """Factors by least squares on every so many-th line, and the mean square of the whitened residual."""
    model, test, some = solar_panel(density, damping_ratio=0.005), make_twin.test(), slice(None, None, every)
    values = mean[some, :, None]
    noise = TRUTH["noise"]
    std = np.hypot(np.hypot(noise["share"] * np.abs(values), noise["floor"]) / np.sqrt(5), accuracy * np.abs(values))
    frfs = MeasuredFRFs(test.freq[some], test.responses, test.references, "accelerance", values, std, 5, True)
    residual, names = FRFResidual(FRFProblem(model, frfs)), model.space.names
    nominal = np.array([model.space[name].value for name in names])

    def at(x):
        return dict(zip(names, (x * nominal).tolist(), strict=True))

    found = least_squares(
        lambda x: residual.residual(at(x)), [*start, 1.0], lambda x: residual.jacobian(at(x), names) * nominal,
        bounds=(0.2, 4.0), x_scale="jac", max_nfev=30,
    )  # fmt: skip
    return found.x[:6], 2 * found.cost / len(found.fun)


@pytest.mark.slow
def test_least_squares_need_that_start_and_cannot_mend_the_mesh(mean, started):
    far, least = fitted(mean, 1, 0.0, np.ones(6), 2)[1], fitted(mean, 1, 0.0, started, 2)[1]
    assert least > 100 and far > 10 * least
    (near, _), (true, _) = (fitted(mean, 1, 0.1, start, 2) for start in (started, FACTORS))
    np.testing.assert_allclose(near, true, rtol=0.005)
    np.testing.assert_allclose(fitted(mean, 2, 0.0, FACTORS, 8)[0], FACTORS, rtol=0.01)
