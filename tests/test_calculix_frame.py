"""The study of a frame in CalculiX: imported from runs, calibrated, and its values back in the deck of CalculiX."""

import json
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.api import steps
from calib.imports.fe_modes import read_fe_modes
from calib.study.study import LoadedStudy
from studies.calculix_frame.make_frame import frame
from studies.calculix_frame.refine_mesh import change

HERE = Path(__file__).resolve().parent.parent / "studies/calculix_frame"
TRUTH = Path(__file__).resolve().parent / "truth/calculix_frame.json"


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
    # With the mass that explain finds, validation data agree, and so does the deck with that mass.
    extended = study.extend(["added_mass_748"], tmp_path / "extended")
    found = steps.calibrate_step(extended).best.statistics
    assert found.fits and validation_mac(extended, found.values) > 0.99 > 0.7 > validation_mac(study, {})
    extended.decks(tmp_path / "mass")
    true, std = json.loads(TRUTH.read_text("utf-8")), pd.read_csv(tmp_path / "mass/calibrated.csv", index_col=0)["std"]
    known = {**true["parameters"], "added_mass_748": 1e3 * true["motor"]["mass"]}
    assert all(abs(found.values[name] - value) < 3 * std[name] for name, value in known.items())
    deck = (tmp_path / "mass/frame.inp").read_text("utf-8")
    mass = f"*ELEMENT, TYPE=MASS, ELSET=M\n900001,748\n*MASS, ELSET=M\n{found.values['added_mass_748'] / 1e3}\n*STEP"
    (tmp_path / "mass/frame.inp").write_text(deck.replace("*STEP", mass, 1), encoding="utf-8")
    subprocess.run(["ccx", "-i", "frame"], cwd=tmp_path / "mass", check=True, capture_output=True)
    own = read_fe_modes(tmp_path / "mass/frame.dat").natural_freq
    np.testing.assert_allclose(extended.one.model.modes(found.values, len(own)).natural_freq, own, rtol=1.5e-4)


def validation_mac(study, values):
    """Largest MAC of a model mode with M9, which no fit uses."""
    model, measured = study.one.model, study.one.whole
    shapes = (model.sensor_rows(measured.sensors) @ model.modes(values, 14).shapes).real
    m9 = measured.shapes[:, measured.names.index("M9")].real
    return max((m9 @ shapes) ** 2 / (m9 @ m9) / (shapes**2).sum(axis=0))


@pytest.mark.whole
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
def test_the_study_claims_of_its_mesh_what_a_finer_one_changes():
    table = change()
    for kind, claim in study_claims().items():
        assert 0.9 * claim < table[kind].abs().max() < claim


def study_claims():
    accuracy = tomllib.loads((HERE / "study.toml").read_text("utf-8"))["measurement"]["accuracy"]
    return {kind: float(claim.removesuffix("%")) / 100 for kind, claim in accuracy.items()}
