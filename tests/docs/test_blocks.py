"""Every code block of the documents and of the README runs."""

import os
import runpy
from pathlib import Path

import pytest

from calib.errors.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
RUN = runpy.run_path(str(Path(__file__).with_name("blocks.py")))
TABLES = runpy.run_path(str(Path(__file__).with_name("tables.py")))
STATEMENTS = runpy.run_path(str(Path(__file__).with_name("statements.py")))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]


def parameters() -> list:
    out = []
    for page in PAGES:
        slow = RUN["SLOW"] in page.read_text("utf-8") or page.name == "README.md"
        out.append(pytest.param(page, id=page.name, marks=[pytest.mark.slow] if slow else []))
    return out


@pytest.mark.parametrize("page", parameters())
def test_every_block_of_a_page_runs(undrawn, tmp_path, monkeypatch, page):
    monkeypatch.chdir(tmp_path)
    names = RUN["run_page"](page, tmp_path)
    if (tmp_path / "results").is_dir():
        assert TABLES["missing"](tmp_path / "results") == {}
    if (tmp_path / "results/hidden_bogie").is_dir():  # its tables of modes have every documented column
        assert TABLES["stale"](tmp_path / "results") == {}
    if page.name == "tutorial.md":  # what README and pages state of the studies that the tutorial runs
        assert STATEMENTS["unstated"](tmp_path / "results") == []
    if page.name == "own_data.md":
        of_frfs(names)
    if "why" in names:
        assert names["why"].verdict == "effect" and [e.name for e in names["why"].named] == ["brake_unit"]
        fit, better = names["fit"], names["better"]
        assert fit.statistics.fits is False and better.statistics.fits
        before, after = (one.errors.set_index("group")["rms"] for one in (fit, better))
        assert after["held_out_sensors"] < before["held_out_sensors"] and after["left_out"] < before["left_out"]
        assert os.path.getsize("report.html") > 100_000


def of_frfs(names: dict) -> None:
    """The fit of FRFs on the page of measurements comes near them; its errors have the groups that the page names."""
    fit = names["fit"]
    before, after = (one.table["frac"].mean() for one in (names["problem"].compare(), fit.compare()))
    assert before < 0.1 and after > 0.8
    assert set(fit.errors["group"]) == {"fit", "left_out", "held_out_sensors", "held_out_bands"}


def page_of(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "page.md"
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        "```python\nraise ValueError\n```\n",
        "```toml\ntitle = 'A'\n```\n",
        "```toml\n# in studies/bogie\n[calibration]\nindividuals = 3\n```\n",
        "```sh\nmake coffee\n```\n",
        "```sh\ncalib calibrate nowhere\n```\n",
        pytest.param("```sh\npython docs/figures.py --colour red\n```\n", marks=pytest.mark.slow),
        "```\nno language\n```\n",
        "```yaml\na: 1\n```\n",
        "```python\nopen\n",
    ],
)
def test_a_block_that_cannot_run_is_found(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((AssertionError, ValueError, InputError)):
        RUN["run_page"](page_of(tmp_path, text), tmp_path)


def test_blocks_share_their_names_and_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written = "```csv\n# file: a/b.csv\nx\n1\n```\n"
    text = f"{written}```python\nn = len(open('a/b.csv').readlines())\n```\n```python\nm = n + 1\n```\n"
    assert RUN["run_page"](page_of(tmp_path, text), tmp_path)["m"] == 4
