"""The blind solar array: its mesh is finer, one test is seen in modes and FRFs, and the mesh hides nothing."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.linalg as la

import calib
from calib.command import cli
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.measurement.accuracy import Claim
from calib.measurement.frf import MeasuredFRFs
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parent.parent
MODES, FRFS = (ROOT / "studies" / name for name in ("hidden_panel", "hidden_panel_frf"))
TRUTH = json.loads((ROOT / "tests/truth/hidden_panel.json").read_text("utf-8"))

VALUES = TRUTH["parameters"] | TRUTH["magnitudes"]

make_twin = module_of(MODES / "make_twin.py")
LEAST = 4.0
"""Length of a signature in standard deviations from which an effect is found, see `calib.missing.rules`."""


@pytest.fixture(scope="module")
def twin():
    """The array of the study."""
    built = {effect.name: effect for effect in make_twin.remodelled.remodelled_effects()}
    return make_twin.built([built[name] for name in TRUTH["effects"]], VALUES)


@pytest.fixture(scope="module")
def plain():
    """The array with nothing hidden, at the same parameters."""
    return make_twin.built((), TRUTH["parameters"])


@pytest.mark.medium
def test_shapes_keep_their_signs_whatever_was_solved_before(plain):
    """The noise of a measurement goes with them."""
    again = make_twin.built((), TRUTH["parameters"])
    np.testing.assert_array_equal(make_twin.named_modes(again)[2], make_twin.named_modes(plain)[2])


def noise_free(structure, values):
    """FRFs of a structure as they would be measured without noise, with the standard deviations of the study."""
    test = make_twin.frf_test(structure)
    values = make_twin.frf_twin.functions(structure, values, test)
    std = np.hypot(test.share * np.abs(values), test.floor) / np.sqrt(test.repeats)
    claimed = Claim.of(LoadedStudy.load(FRFS).settings.measurement.accuracy)
    return MeasuredFRFs(
        test.freq, test.responses, test.references, test.quantity, values, std, test.repeats, True, accuracy=claimed
    )


@pytest.fixture(scope="module")
def measured():
    """The FRFs of the study, nothing held out."""
    return calib.read_frfs(f"{FRFS}/measured/*.uff", sensors=f"{FRFS}/measured/sensors.csv", synthetic=True)


def test_modes_and_frfs_are_of_one_array(measured):
    """Measured natural frequencies are those of the truth, and the functions peak there."""
    modes = calib.read_modes(f"{MODES}/measured/*.uff", sensors=f"{MODES}/measured/sensors.csv", synthetic=True)
    assert modes.names == make_twin.MODES and modes.n_repeats == measured.n_repeats == make_twin.REPEATS
    true = np.array([TRUTH["natural_freq"][name] for name in modes.names])
    assert np.abs(modes.natural_freq / true - 1).max() < 4 * make_twin.STD_FREQ
    for freq in true:
        near = np.abs(measured.freq / freq - 1) < 4 * make_twin.RATIO
        assert near.sum() == len(make_twin.STEPS)
        assert abs(measured.freq[near][np.argmax(measured.power[near])] / freq - 1) < make_twin.RATIO


@pytest.mark.slow
def test_the_files_hold_what_the_twin_does(twin, measured):
    """A mean of five repeats against the noise-free array."""
    test = make_twin.frf_test(twin)
    np.testing.assert_allclose(measured.freq, test.freq, rtol=1e-5)
    assert [s.name for s in measured.responses] == [s.name for s in test.responses]
    true = make_twin.frf_twin.functions(twin, VALUES, test)
    std = np.hypot(make_twin.SHARE * np.abs(true), make_twin.FLOOR) / np.sqrt(make_twin.REPEATS)
    off = (measured.values - true) / std
    rows = np.concatenate([off.real.ravel(), off.imag.ravel()])
    assert np.mean(rows**2) == pytest.approx(1, abs=5 * np.sqrt(2 / len(rows)))


@pytest.mark.slow
def test_the_span_of_the_twin_is_as_good_as_its_mesh(twin):
    """Every line solved over the whole finer mesh."""
    test = make_twin.frf_test(twin)
    some = replace(test, freq=test.freq[::20])
    whole, spanned = (make_twin.frf_twin.functions(s, VALUES, some) for s in (twin.structure, twin))
    np.testing.assert_allclose(spanned, whole, rtol=1e-4)


@pytest.mark.slow
def test_the_mesh_alone_is_far_below_the_noise(plain):
    """Natural frequencies, and what of the FRFs the parameters cannot absorb."""
    values = TRUTH["parameters"]
    fitted = make_twin.base()
    off = fitted.modes(values, 6).natural_freq / plain.modes(6).natural_freq - 1
    assert 1e-6 < np.abs(off).max() < 1.5e-4 < make_twin.STD_FREQ / 10
    residual = FRFResidual(FRFProblem(fitted, noise_free(plain, values)))
    names = list(fitted.space.free_names)
    widths = np.array([fitted.space[n].prior_width for n in names])
    wide = np.vstack([residual.jacobian(values, names) * widths, np.eye(len(names))])
    change = np.concatenate([residual.residual(values), np.zeros(len(names))])
    left = change - wide @ la.lstsq(wide, change)[0]
    assert 0.1 < np.linalg.norm(left) < 0.5 * LEAST


@pytest.mark.slow
def test_a_hidden_effect_is_visible_by_the_stated_rule(twin):
    names, modes, shapes = make_twin.named_modes(twin)
    problem = make_twin.modal_problem(make_twin.noiseless(names, modes, shapes))
    library = {effect.name: effect for effect in make_twin.solar_panel_effects()}
    size = make_twin.visible(problem, [library[name] for name in TRUTH["effects"]], VALUES)
    assert size == pytest.approx(TRUTH["visible"], rel=1e-6)
    assert make_twin.VISIBLE[0] <= size <= make_twin.VISIBLE[1]


@pytest.mark.slow
def test_modes_name_the_hidden_effect_and_predict_what_was_held_out(tmp_path, undrawn):
    assert cli.execute(["explain", str(MODES), "--results", str(tmp_path)]) == 0
    results = Results.at(tmp_path, MODES.name).path
    summary = json.loads((results / "explanation.json").read_text("utf-8"))
    assert summary["verdict"] == "effect" and summary["credible_set"] == TRUTH["effects"]
    (name,) = TRUTH["effects"]
    effects = pd.read_csv(results / "effects.csv").set_index("name")
    assert effects.loc[name, "magnitude_low"] <= TRUTH["magnitudes"][name] <= effects.loc[name, "magnitude_high"]
    errors = pd.read_csv(results / "errors.csv").set_index(["group", "stage"])
    for group in ("held_out_sensors", "held_out_modes"):
        assert errors["p"][group, "after"] > 0.01
    assert errors["rms"]["held_out_modes", "after"] < errors["rms"]["held_out_modes", "before"]


@pytest.mark.slow
def test_frfs_name_it_with_an_interval_that_holds_the_truth(tmp_path, undrawn):
    """The error of the model at resonances is a nuisance: without it something systematic is left."""
    assert cli.execute(["explain", str(FRFS), "--results", str(tmp_path)]) == 0
    results = Results.at(tmp_path, FRFS.name).path
    summary = json.loads((results / "explanation.json").read_text("utf-8"))
    assert summary["verdict"] == "effect" and summary["credible_set"] == TRUTH["effects"]
    (name,) = TRUTH["effects"]
    effects = pd.read_csv(results / "effects.csv").set_index("name")
    low, high = effects.loc[name, ["magnitude_low", "magnitude_high"]]
    assert low <= TRUTH["magnitudes"][name] <= high and high - low < 0.1 * TRUTH["magnitudes"][name]
