"""A small study of which everything was asked, and the page that tells it."""

import contextlib
import io
import shutil
from pathlib import Path

import pytest

from calib import cli
from calib.loading import module_of
from calib.report.html.answers import Answers

ROOT = Path(__file__).resolve().parents[3]
HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')
TITLE = "A mast that may lack something"


def ask(folder, *questions):
    """Ask without drawing pictures, which would take longest; results go beside the study."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()):
        patch.setattr(cli, "draw_all", lambda *a: [])
        patch.setattr(cli, "write_report", lambda folder, *a: folder / "report.html")
        for question, *more in questions:
            assert cli.answer([question, str(folder), "--results", str(folder.parent / "results"), *more]) == 0
    return folder.parent / "results" / folder.name


@pytest.fixture(scope="session")
def everything(tmp_path_factory):
    """Results of a mast with a guy rope that its model lacks; one mode and two sensors are withheld."""
    folder = module_of(ROOT / "tests/template/mast_effects.py").write_study(
        tmp_path_factory.mktemp("told") / "mast", {"guy": 9000.0}
    )
    file = folder / "study.toml"
    file.write_text(file.read_text().replace(*HELD))
    return ask(folder, ["run", "--workers", "1"])


@pytest.fixture(scope="session")
def plain(tmp_path_factory):
    """Results of the five-mass chain, a plain function."""
    folder = tmp_path_factory.mktemp("plain") / "chain"
    shutil.copytree(ROOT / "studies/five_mass_chain", folder)
    return ask(folder, ["compare"], ["explain"])


@pytest.fixture
def folder(everything, tmp_path):
    """A copy of the mast's results that a test may change."""
    return Path(shutil.copytree(everything, tmp_path / "mast"))


@pytest.fixture
def answers(everything):
    return Answers(everything, TITLE, True)
