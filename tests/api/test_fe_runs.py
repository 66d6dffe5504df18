"""A study of a solver becomes one of matrices: its modes at fresh points are the solver's own, or it is told."""

import re
import shutil

import numpy as np
import pandas as pd
import pytest

import calib
from calib.api import steps
from calib.errors.errors import InputError
from calib.study.study import LoadedStudy
from tests.study.solver_chain import STUDY, exact, runs, study

NOMINAL = {"k": 2.0, "m": 1.5, "t": 1.0}
FRESH = {"k": 2.9, "m": 1.1, "t": 0.8}


@pytest.mark.medium
def test_the_matrices_of_runs_have_the_modes_of_the_solver(tmp_path):
    folder = study(tmp_path / "chain")
    found = calib.import_matrices(folder, to=tmp_path / "affine")
    assert found.modes["freq_error"].abs().max() < 1e-10 and found.modes["mac"].min() > 1 - 1e-9
    assert not found.warnings and found.study == tmp_path / "affine"
    assert found.at.startswith("k = ") and f"at the fresh point {found.at}:" in str(found)
    with_matrices = [line for line in runs(folder) if line.endswith("True")]
    # k, m one more each, t four; m and t act together in the mass: four more, of which one was the trial.
    assert len(with_matrices) == 1 + 1 + 1 + 4 + 3 + 3 and len(runs(folder)) == len(with_matrices) + 2
    loaded = LoadedStudy.load(tmp_path / "affine")
    solved = loaded.model.modes(FRESH, 2)
    np.testing.assert_allclose(solved.natural_freq, exact(FRESH)[0], rtol=1e-10)
    assert loaded.search_space.free_names == ("k", "m")  # [parameters.t] of the solver's study holds
    assert loaded.settings.decks == ("../chain/solve.py.j2",) and not loaded.settings.deck_files


@pytest.mark.slow
def test_calibrated_values_go_back_into_the_deck(tmp_path, monkeypatch):
    folder = study(tmp_path / "chain", text=STUDY.replace("[model]", '[model]\nfiles = "mesh.bin"'))
    (folder / "mesh.bin").write_bytes(b"\xff\r\n{{ nothing }}")
    calib.import_matrices(folder, to=tmp_path / "affine")
    one = calib.Study.load(tmp_path / "affine", results=tmp_path / "results", progress=False)
    with pytest.raises(InputError, match="calib calibrate"):
        one.decks(tmp_path / "deck")
    steps.calibrate_step(one)
    written = one.decks(tmp_path / "deck")
    assert [path.name for path in written] == ["solve.py", "mesh.bin", "calibrated.csv"]
    assert written[1].read_bytes() == b"\xff\r\n{{ nothing }}"
    values = re.search(r"k, m, t = (\S+), (\S+), (\S+)", written[0].read_text()).groups()
    assert [float(v) for v in values] == pytest.approx([2.3, 1.3, 1.0], rel=1e-4)
    assert "k,2." in written[2].read_text()
    assert pd.read_csv(written[2])["remark"].isna().all()
    doubtful = {"found": "It does not fit: 9 %.", "then": "Find what it lacks."}
    monkeypatch.setattr("calib.analyses.decks.analyses_of", lambda results: {"calibrate": {"answer": doubtful}})
    remarks = pd.read_csv(one.decks(tmp_path / "doubtful")[2])["remark"]
    assert remarks.unique().tolist() == ["It does not fit. Find what it lacks."]


@pytest.mark.medium
def test_a_parameter_without_its_powers_stays_and_is_told(tmp_path):
    folder = study(tmp_path / "chain", text=STUDY.replace("powers = [-1, 1, 2, 3]", "powers = [1]"))
    found = calib.import_matrices(folder, to=tmp_path / "affine")
    (told,) = found.warnings
    assert told.startswith("t stays at 1") and "k" not in told.split()
    loaded = LoadedStudy.load(tmp_path / "affine")
    assert loaded.model.space["t"].distribution == "fixed"
    np.testing.assert_allclose(loaded.model.modes({"k": 2.9}, 2).natural_freq, exact({**NOMINAL, "k": 2.9})[0])


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('matrices = ["K.mtx", "M.mtx", "dofs.csv"]\n', "", "matrices"),
        ('"K.mtx", "M.mtx"', '"K.mtx", "N.mtx"', r"no N\.mtx"),
        ("[-1, 1, 2, 3]", "[1]", "stay with the solver"),
        ('"K.mtx", "M.mtx"', '"solve.py", "M.mtx"', r"run failed: .*solve\.py, M\.mtx, dofs\.csv.*failed_runs"),
    ],
)  # fmt: skip
def test_what_cannot_be_imported_is_refused(tmp_path, old, new, words):
    text = STUDY.replace(old, new)
    assert text != STUDY
    more = ""
    if "stay" in words:  # no parameter is affine
        more = "k, m = k + math.sin(20 * k), m + 0.1 * math.sin(30 * m)"
    with pytest.raises(InputError, match=words):
        calib.import_matrices(study(tmp_path / "chain", more, text), to=tmp_path / "affine")
    assert not (tmp_path / "affine").exists()


def test_only_a_study_of_a_solver_is_imported(tmp_path):
    (tmp_path / "model.py").write_text("import calib\n")
    (tmp_path / "study.toml").write_text('title = "x"\nmodel = "model.py:f"\n[measurement]\nfiles = ["a.csv"]\n')
    with pytest.raises(InputError):
        calib.import_matrices(tmp_path)
    with pytest.raises(InputError, match="--to alone"):
        calib.import_matrices(study(tmp_path / "chain"), units="mm-t-N")


DECK = """*NODE, NSET=NALL
{% for i in range(5) %}{{ 2 * i + 1 }},{{ 10 * i }},0,0
{{ 2 * i + 2 }},{{ 10 * i }},15,0
{% endfor %}*ELEMENT, TYPE=S4, ELSET=PLATE
{% for i in range(4) %}{{ i + 1 }},{{ 2 * i + 1 }},{{ 2 * i + 3 }},{{ 2 * i + 4 }},{{ 2 * i + 2 }}
{% endfor %}*MATERIAL, NAME=STEEL
*ELASTIC
{{ E }},0.3
*DENSITY
{{ rho }}
*SHELL SECTION, ELSET=PLATE, MATERIAL=STEEL
{{ t }}
*BOUNDARY
1,1,3
2,1,3
*STEP
*FREQUENCY{{ ", SOLVER=MATRIXSTORAGE" if matrices }}
{% if not matrices %}6
*NODE PRINT, NSET=NALL
U
{% endif %}*END STEP
"""
PLATE = """title = "plate"
[model]
command = "ccx -i plate"
template = "plate.inp"
modes = "plate.dat"
matrices = "plate.sti"
units = "mm-t-N"
sensors = ["3z", "9z", "10z", "10x"]
n_modes = 4
[model.parameters]
E = { value = 210e3, limits = [180e3, 240e3], unit = "MPa" }
rho = { value = 7.85e-9, limits = [7e-9, 9e-9], unit = "t/mm3" }
t = { value = 2.0, limits = [1.5, 2.5], unit = "mm", powers = [-1, 1, 2, 3] }
[measurement]
responses = "measured.csv"
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
def test_a_plate_of_calculix_is_imported_with_its_thickness(tmp_path):
    (tmp_path / "plate.inp").write_text(DECK)
    (tmp_path / "measured.csv").write_text("response,value,std\nfreq_1,1000.0,1.0\n")
    (tmp_path / "study.toml").write_text(PLATE)
    found = calib.import_matrices(tmp_path, to=tmp_path / "affine")
    assert not found.warnings
    assert found.modes["freq_error"].abs().max() < 1e-4 and found.modes["mac"].min() > 0.9999
    solver = LoadedStudy.load(tmp_path).model
    model = LoadedStudy.load(tmp_path / "affine").model
    at = {"E": 190e3, "rho": 8.1e-9, "t": 1.7}
    own, theirs = solver.modes(at, 4).natural_freq, model.modes(at, 4).natural_freq
    np.testing.assert_allclose(theirs, own, rtol=1e-4)
    assert abs(own / solver.modes({}, 4).natural_freq - 1).min() > 0.02
