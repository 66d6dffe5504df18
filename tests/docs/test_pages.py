"""The README and the pages of docs/: length, links, figures, and what is made from the code."""

import json
import re
import runpy
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

import calib
import calib.structure
from calib.analyses.provenance.state import every_rule
from calib.missing.coverage import MODES
from calib.results.version import FALLBACK
from calib.study.schema import schema

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PROJECT = [ROOT / name for name in ("CHANGELOG.md", "CONTRIBUTING.md", "findings/README.md")]
PAGES = [page for page in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in page.parts]
STUDIES = sorted((ROOT / "studies").glob("*/README.md"))
LINK = re.compile(r"\]\(([^)\s#:]+)(?:#([\w-]+))?\)")
FIGURES = ROOT / "docs/figures"


def test_the_read_me_has_at_most_700_words_before_its_licences():
    text, _ = README.read_text("utf-8").split("\n## Licences\n")
    assert len(text.split()) <= 700


@pytest.mark.parametrize("page", [README, *PROJECT, *PAGES, *STUDIES], ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for target, _ in LINK.findall(page.read_text("utf-8")):
        assert (page.parent / target).exists(), target


def test_the_page_of_import_paths_names_all_that_is_public():
    rows = (ROOT / "docs/import_paths.md").read_text("utf-8").split("|---|---|\n")[1].split("\n\n")[0]
    named = re.findall(r"`(\w+)`", rows)
    public = {*calib.__all__, *calib.structure.__all__} - {"__version__"}
    assert len(named) == len(set(named)) and set(named) == public


def test_the_citation_is_of_the_version_of_a_clone():
    cited = (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\nversion: {FALLBACK}\n" in cited and cited.startswith("cff-version: 1.2.0\n")
    assert f"## [{FALLBACK}]" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_every_figure_is_small_and_shown_and_every_drawn_one_is_there():
    shown = {
        (page.parent / target).resolve().name
        for page in (README, *PAGES, *STUDIES)
        for target, _ in LINK.findall(page.read_text("utf-8"))
        if target.endswith((".png", ".svg"))
    }
    there = {file.name: file.stat().st_size for file in FIGURES.iterdir()}
    assert set(there) == shown and max(there.values()) <= 400_000  # with every colour
    drawn = runpy.run_path(str(ROOT / "docs/figures.py"))["FIGURES"]
    taken = [f"workbench_{name}" for name in runpy.run_path(str(ROOT / "docs/workbench_pictures.py"))["VIEWS"]]
    assert {f"{name}.png" for name in (*drawn, *taken, "hidden_worst")} == set(there)


def test_a_figure_whose_results_are_not_at_hand_keeps_its_file(tmp_path, monkeypatch):
    figures = runpy.run_path(str(ROOT / "docs/figures.py"))
    for name in ("record.json", "summary.json"):  # calibrated, but without any table
        file = tmp_path / "results/bogie" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text('{"title": "Bogie", "synthetic": true}', "utf-8")
    given = ["figures.py", "--results", str(tmp_path / "results"), "--into", str(tmp_path / "drawn")]
    monkeypatch.setattr(sys, "argv", given)
    figures["main"]()
    assert list((tmp_path / "drawn").iterdir()) == []


def test_a_verdict_and_the_read_me_say_of_intervals_what_was_counted():
    counted = (ROOT / "docs/error_rates.md").read_text("utf-8")
    held, of = map(int, re.search(r"Intervals cover the truth in (\d+) of (\d+)", counted).groups())
    assert (MODES.held, MODES.of) == (held, of) and f"({round(100 * held / of)} %)" in MODES.sentence
    assert MODES.sentence in " ".join(README.read_text("utf-8").split())


def test_the_rates_of_the_read_me_are_those_that_were_counted(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tests/benchmarks"))
    import rates_table

    counted = {(rate.hidden, rate.verdict): rate for rate, *_ in rates_table.read(ROOT / "docs/rates_bogie.csv")}
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in README.read_text("utf-8").splitlines()
            if re.search(r"\| \d+ of \d+ \|", line)]  # fmt: skip
    assert len(rows) == 3
    for hidden, verdict, runs, bound in rows:
        rate = counted[hidden, verdict.removeprefix("wrongly ")]
        assert [int(n) for n in runs.split(" of ")] == [rate.count, rate.n]
        assert float(re.search(r"[\d.]+", bound).group()) == pytest.approx(100 * rates_table.bound_of(rate), abs=0.05)


@pytest.mark.parametrize("subject", ["bogie"])
def test_counts_are_read_as_they_are_written(monkeypatch, tmp_path, subject):
    monkeypatch.syspath_prepend(str(ROOT / "tests/benchmarks"))
    import rates_table

    for rate, _, _ in rates_table.read(ROOT / f"docs/rates_{subject}.csv"):
        assert 0 <= rate.count <= rate.n and (rate.count / rate.n <= rates_table.bound_of(rate)) != rate.at_least
    row = {"group": "nothing", "verdict": "effect", "outcome": "wrong", "visible": []}
    rates_table.write([row, row | {"verdict": "nothing_detectable"}], tmp_path / "a.csv", "c0de", "2026-01-02")
    read = rates_table.read(tmp_path / "a.csv")
    assert [(r.count, r.n) for r, *_ in read] == [(1, 2), (1, 2)] and {told for _, *told in read for told in told} == {
        "c0de",
        "2026-01-02",
    }


@pytest.mark.medium
def test_every_key_has_a_description():
    whole = schema()
    for section in (whole, *whole["$defs"].values()):
        assert section["description"]
        for key, node in section["properties"].items():
            assert node.get("description"), key


@pytest.fixture(scope="module")
def made():
    """The parts of pages that are made from the code."""
    pytest.importorskip("sphinx")
    return runpy.run_path(str(ROOT / "docs/_ext/made_pages.py"))["PARTS"]


@pytest.mark.medium
def test_every_key_and_every_default_is_listed(made):
    text, whole = made["keys"](), schema()
    for section in (whole, *whole["$defs"].values()):
        for key, node in section["properties"].items():
            rows = [line for line in text.splitlines() if line.startswith(f"| `{key}` |")]
            assert rows, key
            if isinstance(node.get("default"), int | float | str | list) and node["default"] not in ("", []):
                assert any(f"| `{json.dumps(node['default'])}` |" in row for row in rows), key


def test_every_command_and_every_option_is_listed(made):
    from typer.main import get_command

    from calib.command.cli import app

    text = made["commands"]()
    for name, command in get_command(app).commands.items():
        assert f"## `calib {name}`" in text
        for param in command.params:
            assert str(param.metavar or param.name).upper() in text or param.opts[0] in text
        options = {option for param in command.params for option in param.opts}
        assert ("--workers" in options) == ("--executor" in options), (
            name
        )  # whoever evaluates points may do it anywhere


def test_every_rule_is_listed_with_its_value_and_a_meaning(made):
    text = made["rules"]()
    for name, rules in every_rule().items():
        section = text.split(f"## `{name}`\n")[1].split("\n## ")[0]
        assert type(rules).__name__ in section
        rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| `")]
        assert [row[0].strip("`") for row in rows] == [field.name for field in fields(rules)]
        for field, (_, value, meaning) in zip(fields(rules), rows, strict=True):
            given = getattr(rules, field.name)
            told = [float(number) for number in value.split(", ")]
            assert told == pytest.approx(list(given) if isinstance(given, tuple) else [given], rel=1e-5)
            assert len(meaning) > 10


@pytest.mark.slow
def test_the_pages_build_without_a_warning(tmp_path):
    pytest.importorskip("sphinx")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d", str(tmp_path / "trees")]
    built = subprocess.run([*command, str(ROOT / "docs"), str(tmp_path / "html")], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    page = (tmp_path / "html/theory.html").read_text("utf-8")
    assert "<math" in page and "\\frac" not in page
    for script in re.findall(r'<(?:script|link)[^>]*(?:src|href)="([^"]+)"', page):
        assert not script.startswith(("http", "//")), script
