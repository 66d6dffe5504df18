"""The script of docs/ runs in a folder of its own, outside the repository."""

import os
import runpy
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_script_of_the_documents_names_what_is_missing(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "studies/hidden_bogie/measured", tmp_path / "measured")
    (tmp_path / "measured/sensors.csv").rename(tmp_path / "sensors.csv")
    shutil.copytree(ROOT / "studies/bogie", tmp_path / "studies/bogie", ignore=shutil.ignore_patterns("results"))
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(ROOT / "docs/from_python.py"))
    why, fit, better = names["why"], names["fit"], names["better"]
    assert why.verdict == "effect" and [e.name for e in why.named] == ["brake_unit"]
    assert fit.statistics.fits is False and better.statistics.fits
    before, after = (one.errors.set_index("group")["rms"] for one in (fit, better))
    assert after["held_out_modes"] < before["held_out_modes"] and after["left_out"] < before["left_out"]
    assert os.path.getsize("frequency_errors.png") > 10_000 and Path("report.html").stat().st_size > 100_000
    assert Path("results/bogie/quick/verdicts.csv").is_file()
