"""A small study with every analysis run, and its page."""

import contextlib
import io
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from calib.command import cli
from calib.report.figures import Figures
from calib.report.html.study_results import StudyResults
from calib.report.html.write import page
from calib.study.loading import module_of
from tests.report.html.page_blocks import page_blocks

ROOT = Path(__file__).resolve().parents[3]
HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')
FEW = ("[calibration]", "[sensitivity]\nsamples = 60\n\n[calibration]")  # the study names its selection itself
TITLE = "A mast that may lack something"


class Reader(HTMLParser):
    """Elements with their attributes, text of the page, tables by caption, and contents of scripts."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.words, self.tables, self.scripts, self.styles = [], [], {}, [], []
        self._open, self._caption, self._rows = [], "", []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "br", "img", "link", "input"):
            self._open.append(tag)
        if tag == "table":
            self._caption, self._rows = "", []
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")
        elif tag == "script":
            self.scripts.append((dict(attrs).get("type", ""), []))

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass
        if tag == "table":
            self.tables[self._caption] = self._rows

    def handle_data(self, data):
        if "script" in self._open:
            self.scripts[-1][1].append(data)
        elif "style" in self._open:
            self.styles.append(data)
        else:
            self.words.append(data)
            if self._open and self._open[-1] == "caption":
                self._caption += data
            if self._open and self._open[-1] in ("td", "th"):
                self._rows[-1][-1] += data

    @staticmethod
    def number(cell):
        return float(cell.replace("−", "-").replace("×", ""))

    def named(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="session")
def run(no_drawing):
    """Function that runs analyses without drawing; results go beside the study."""

    def folder_of_results(folder, *analyses):
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()), no_drawing():
            patch.setattr("calib.api.staged.isolated", lambda study: study)
            for analysis, *more in analyses:
                assert cli.execute([analysis, str(folder), "--results", str(folder.parent / "results"), *more]) == 0
        return folder.parent / "results" / folder.name

    return folder_of_results


@pytest.fixture(scope="session")
def everything(run, tmp_path_factory):
    """Results of a mast with a guy rope that its model lacks; one mode and two sensors are held out."""
    folder = module_of(ROOT / "tests/template/mast_effects.py").write_study(
        tmp_path_factory.mktemp("page") / "mast", {"guy": 12000.0}
    )
    file = folder / "study.toml"
    file.write_text(file.read_text().replace(*HELD).replace(*FEW))
    return run(folder, ["run", "--workers", "1"])


@pytest.fixture(scope="session")
def scalar(run, tmp_path_factory):
    """Results of the five-mass chain, a function with scalar responses."""
    folder = tmp_path_factory.mktemp("scalar") / "chain"
    shutil.copytree(ROOT / "studies/five_mass_chain", folder)
    return run(folder, ["compare"], ["explain"])


@pytest.fixture
def folder(everything, tmp_path):
    """A copy of the mast's results that a test may change."""
    return Path(shutil.copytree(everything, tmp_path / "mast"))


@pytest.fixture
def results(everything):
    return StudyResults(everything, TITLE, True)


PAINTED = ("comparison", "mac_before", "sensor_misfit", "mode_shapes_after")
"""Figures of the page that are painted: bars, cells, dots over lines, and pictures within the drawing."""


def outline(figures, name, identifier=""):
    """A figure without content, which takes longest."""
    return f"<svg><!-- {figures.plan[name].name} --></svg>"


@pytest.fixture
def painted():
    """Requested by tests about what figures show."""


@pytest.fixture(autouse=True)
def unpainted_unless_asked_for(request, monkeypatch):
    """Figures have no content: most tests are about the page around them. Pages of the session have theirs already."""
    if "painted" not in request.fixturenames:
        monkeypatch.setattr("calib.report.figures.Figures.svg", outline)


@pytest.fixture(scope="session")
def reader():
    """Class that parses a page."""
    return Reader


@pytest.fixture(scope="session")
def text(everything):
    """The page; of its figures only `PAINTED` have content."""
    painted = Figures.svg

    def svg(figures, name, identifier=""):
        return (painted if name in PAINTED else outline)(figures, name, identifier)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.report.figures.Figures.svg", svg)
        return page(StudyResults(everything, TITLE, True))


@pytest.fixture(scope="session")
def read(text):
    return Reader(text)


@pytest.fixture(scope="session")
def blocks(everything):
    """Function that returns tables of a page by caption, or figures by name."""
    known = {}

    def blocks_of(folder):
        if folder != everything:  # a copy of it, which the test may have changed
            return page_blocks(StudyResults(folder, TITLE, True))
        if folder not in known:
            known[folder] = page_blocks(StudyResults(folder, TITLE, True))
        return known[folder]

    def of_kind(folder, kind):
        return {getattr(b, "name", getattr(b, "caption", "")): b for b in blocks_of(folder) if isinstance(b, kind)}

    return of_kind
