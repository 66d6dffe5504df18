"""The rig of four storeys and a function of sums, each with a library, in a folder of its own."""

import shutil

import pytest

from tests.study_effects.studies import RIG, RIG_EFFECTS, SUMS, SUMS_EFFECTS, with_keys


@pytest.fixture
def rig(tmp_path):
    folder = tmp_path / "rig"
    shutil.copytree(RIG, folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "effects.py").write_text(RIG_EFFECTS)
    return with_keys(folder, 'effects = "effects.py:library"')


@pytest.fixture
def sums(tmp_path):
    folder = tmp_path / "sums"
    folder.mkdir()
    (folder / "model.py").write_text(SUMS)
    (folder / "effects.py").write_text(SUMS_EFFECTS)
    (folder / "measured.csv").write_text("response,value,std\ns,3.0,0.01\np,1.0,\n")
    (folder / "study.toml").write_text(
        'title = "sums"\nmodel = "model.py:build"\neffects = "effects.py:library"\nselection = ["a", "b"]\n'
        '[measurement]\nresponses = "measured.csv"\n[calibration]\ncases = [{ name = "F1", seed = 1 }]\n'
    )
    return folder
