"""A MAC has one set of sensors wherever it is told, and a frequency error says which frequency it is of."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.analyses.every_mode import all_stages, every_mode
from calib.api.entries.calibrated import calibrated_entries
from calib.api.entries.entry import Rows
from calib.study.loading import module_of
from tests.api.test_modal_responses import chain

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
HELD = ["m4", "2x"]


@pytest.fixture(scope="module")
def fitted():
    test = calib.ModalTest(WORLD.modes(2, responses=(1, 2, 3, 4)), mode_count=4, held_out=HELD)
    problem = calib.Problem(WORLD.chain(), test)
    return problem, problem.calibrate(starts=1, progress=False)


def test_the_mac_of_a_used_mode_is_that_of_the_comparison(fitted):
    """The comparison has the sensors that are used; a held-out mode has no other MAC than that over all."""
    problem, fit = fitted
    (one,) = problem.study().studies
    held = one.settings.held_out.model_copy(update={"modes": ("m4",), "sensors": ("2x",)})
    study = replace(one, settings=one.settings.model_copy(update={"held_out": held}))
    before, after = fit.calibration.before, fit.calibration.best.answer
    stages = all_stages(study, before.comparison, after.comparison)
    table = every_mode(study, stages).set_index("mode")
    assert table["held_out"].to_dict() == {"m1": False, "m2": False, "m3": False, "m4": True}
    for stage, told in (("before", before), ("after", after)):
        used = told.table.set_index("mode")
        np.testing.assert_array_equal(table.loc[used.index, f"mac_{stage}"], used["mac"])
        assert told.mean_mac == table.loc[used.index, f"mac_{stage}"].mean()
    assert table.loc["m4", "mac_after"] > 0.9
    printed = replace(fit.calibration, modes=table.reset_index())
    (title,) = [
        e.title for e in calibrated_entries(study, printed) if isinstance(e, Rows) and "measured mode" in e.title
    ]
    assert "|lambda|/2pi" in title and "over the sensors used" in title
    assert "of natural frequencies" in fit.lines["Found"]


@pytest.mark.parametrize(("keys", "kind"), [({}, "natural"), ({"freq_kind": "damped"}, "damped")])
def test_the_table_of_all_modes_holds_the_frequencies_that_are_asked_for(keys, kind):
    """Two masses with up to 6 % of critical damping, stiffer than assumed."""
    model = chain()
    truth, start = model.modes({"k1": 36.0, "k2": 60.0, "b": 0.05}, 2), model.modes(model.space.values, 2)
    sensors = (calib.Sensor(1, "x"), calib.Sensor(2, "x"))
    shapes = model.sensor_rows(sensors) @ truth.shapes
    modes = calib.MeasuredModes(
        ("A", "B"), truth.natural_freq, truth.damped_freq, 2e-3 * truth.natural_freq, truth.damping_ratio,
        0.02 * truth.damping_ratio, sensors, shapes, np.full(shapes.shape, 0.01),
    )  # fmt: skip
    fit = calib.Problem(model, calib.ModalTest(modes)).calibrate(starts=1, progress=False, **keys)
    table, name = fit.calibration.modes, f"{kind}_freq"
    assert set(table["freq_kind"]) == {kind}
    np.testing.assert_allclose(table["freq_measured"], getattr(truth, name))
    np.testing.assert_allclose(table["error_before"], getattr(start, name) / getattr(truth, name) - 1.0)
    assert np.abs(truth.damped_freq / truth.natural_freq - 1).max() > 1e-3
    (title,) = [e.title for e in fit.entries if isinstance(e, Rows) and "measured mode" in e.title]
    assert title.startswith(kind.capitalize()) and "lambda" in title
