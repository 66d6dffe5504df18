"""Analyses without figures: nothing is drawn, and no picture shows older tables."""

import subprocess
import sys
from pathlib import Path

import pytest

from calib.api.study import Study
from calib.command import cli

FOLDER = Path("results/mast")


@pytest.fixture
def mast(guyed):
    return "mast"


def pictures():
    return {file.name for file in FOLDER.glob("*.png")}


@pytest.mark.medium
def test_figures_of_these_tables_stay_and_those_of_older_ones_go(mast, drawn, unrendered, capsys):
    assert cli.execute(["compare", mast]) == 0
    before = pictures()
    assert len(before) >= 4 and "calib report" not in capsys.readouterr().out
    assert cli.execute(["compare", mast, "--no-figures"]) == 0
    assert pictures() == before and "calib report" not in capsys.readouterr().out
    (FOLDER / "mine.png").write_bytes(b"of the user")
    assert cli.execute(["compare", mast, "--undamped", "--no-figures"]) == 0
    assert pictures() == {"mine.png"} and "calib report mast" in capsys.readouterr().out
    assert cli.execute(["compare", mast]) == 0
    assert pictures() == {*before, "mine.png"}


@pytest.mark.medium
def test_a_report_of_older_tables_goes_with_its_figures(mast, drawn, unrendered):
    study = Study.load(mast, results="results", figures=False, progress=False)
    study.compare()
    assert pictures() == set() and not (FOLDER / "report.html").exists()
    study.report()
    before = pictures()
    study.compare()
    assert before and pictures() == before and (FOLDER / "report.html").exists()
    study.compare(undamped=True)
    assert pictures() == set() and not (FOLDER / "report.html").exists()


@pytest.mark.slow
def test_without_figures_matplotlib_is_not_imported(mast):
    script = "import sys; from calib.command import cli; code = cli.execute(sys.argv[1:]); print(*sys.modules)"
    command = [sys.executable, "-c", script, "compare", mast, "--no-figures"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    imported = set(done.stdout.split())
    assert "calib.analyses.compare" in imported and not {"matplotlib", "jinja2"} & imported
