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
    assert "Im lambda/2pi" in title and "over the sensors used" in title
    assert "(|lambda|/2pi)" in fit.lines["Found"]
