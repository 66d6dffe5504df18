"""Options of the model of one test among several."""

import pytest

import calib
from calib.errors.errors import InputError
from calib.study.several import load
from tests.study.test_several import edit

BENCHES = """
import calib

CALLED = []


def bench(lever=1.0, note=""):
    CALLED.append((lever, note))
    space = calib.ParameterSpace((calib.Parameter("k", 4e6, 2e6, 8e6, "N/m"),))
    return calib.FunctionModel("bench", space, lambda v: {"deflection": lever * 1e6 / v["k"]})
"""

TWO_BENCHES = """
title = "Two benches"
model = "model.py:bench"
model_options = { note = "plain" }
selection = ["k"]

[[tests]]
name = "short"
responses = "short.csv"

[[tests]]
name = "long"
model_options = { lever = 3.0 }
responses = "long.csv"
"""


def benches(folder, own=True):
    """Both benches measured at 5e6 N/m, the second with a lever of 3; without the options its model has none."""
    folder.mkdir()
    (folder / "model.py").write_text(BENCHES)
    text = TWO_BENCHES if own else TWO_BENCHES.replace("model_options = { lever = 3.0 }\n", "")
    (folder / "study.toml").write_text(text)
    for name, lever in (("short", 1.0), ("long", 3.0)):
        (folder / f"{name}.csv").write_text(f"response,value,std\ndeflection,{lever * 0.2},{lever * 0.0002}\n")
    return folder


@pytest.mark.slow
def test_options_of_the_model_of_one_test_are_its_own(tmp_path):
    """They replace those of the study in that test only, and the joint fit sees them."""
    study = calib.Study.load(benches(tmp_path / "own"), results=tmp_path / "results", progress=False)
    short, long = study.loaded.studies
    assert short.settings.model_options == {"note": "plain"} and long.settings.model_options == {"lever": 3.0}
    values = short.model.space.values
    assert long.problem.evaluate(values)["deflection"] == 3 * short.problem.evaluate(values)["deflection"] == 0.75
    assert short.problem.fingerprint != long.problem.fingerprint
    fit = study.problem.calibrate(starts=1, progress=False)
    assert fit.values["k"] == pytest.approx(5e6, rel=1e-6) and fit.statistics.fits is not False
    without = calib.Study.load(benches(tmp_path / "none", own=False), results=tmp_path / "results", progress=False)
    torn = without.problem.calibrate(starts=1, progress=False)
    assert not torn.statistics.fits and abs(torn.values["k"] / 5e6 - 1) > 0.1


def test_a_wrong_option_of_one_test_is_refused_with_its_line(tmp_path):
    folder = edit(benches(tmp_path / "wrong"), "lever = 3.0", "colour = 3.0")
    with pytest.raises(InputError) as told:
        load(folder)
    assert "colour" in str(told.value) and told.value.at.line == 1 + (folder / "study.toml").read_text()[
        : (folder / "study.toml").read_text().index("colour")
    ].count("\n")
