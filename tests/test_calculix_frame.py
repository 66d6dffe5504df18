"""The study of a frame in CalculiX: imported from runs, calibrated, and its values back in the deck of CalculiX."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.api import steps
from calib.imports.fe_modes import read_fe_modes
from calib.study.study import LoadedStudy
from studies.calculix_frame.make_frame import frame

HERE = Path(__file__).resolve().parent.parent / "studies/calculix_frame"


def test_the_deck_is_that_of_its_maker_and_the_study_asks_it_for_what_was_measured():
    study = LoadedStudy.load(HERE)
    placeholders = {name: f"{{{{ {name} }}}}" for name in study.model.space.names}
    assert (HERE / "frame.inp").read_text("utf-8") == frame(placeholders)
    assert len(study.model.sensors) == 90 and study.whole.n_repeats == 5


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
def test_it_is_imported_calibrated_and_goes_back(tmp_path):
    shutil.copytree(HERE, tmp_path / "frame")
    found = calib.import_matrices(tmp_path / "frame", to=tmp_path / "matrices")
    assert not found.warnings and found.modes["freq_error"].abs().max() < 1e-4 and found.modes["mac"].min() > 0.9999
    study = calib.Study.load(tmp_path / "matrices", results=tmp_path / "results", progress=False)
    fitted = steps.calibrate_step(study)
    assert fitted.best.statistics.fits is False  # the model lacks the motor
    study.decks(tmp_path / "deck")
    subprocess.run(["ccx", "-i", "frame"], cwd=tmp_path / "deck", check=True, capture_output=True)
    own = read_fe_modes(tmp_path / "deck/frame.dat").natural_freq
    model = study.one.model
    np.testing.assert_allclose(model.modes(fitted.best.statistics.values, len(own)).natural_freq, own, rtol=1e-4)
    assert abs(own / model.modes({}, len(own)).natural_freq - 1).max() > 0.02
