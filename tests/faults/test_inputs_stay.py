"""Whatever is run and wherever results go, no file that calib did not write is replaced or deleted."""

import os
import shutil
from pathlib import Path

import pytest

from calib.command import cli
from calib.report.figures import Figures
from calib.report.html.write import write_report
from calib.results.results import OWNER
from calib.results.written import KEPT, LOG
from calib.study.loading import module_of

FUNCTION = """
def answer(values):
    return {"y": values["a"] + values["b"] / 2, "z": values["a"] - values["b"] / 2}
"""
MAST_INPUTS = ("study.toml", "model.py", "modes.csv", "shapes.csv", "sensors.csv")
VERBS = ("compare", "sensitivity", "calibrate", "report", "run")
SAVE = Figures.save
pytestmark = pytest.mark.usefixtures("functions_in_this_process", "undrawn")


@pytest.fixture
def sums(plain) -> Path:
    """A study of scalar responses whose measurement has the name of a result, ``measured.csv``."""
    return plain(FUNCTION)


@pytest.fixture
def library(here) -> Path:
    """A study with a library of effects, as ``mast``."""
    template = Path(__file__).resolve().parents[1] / "template/mast_effects.py"
    return module_of(template).write_study(Path("mast"), {"guy": 9000.0})


def contents(*folders: Path | str) -> dict[Path, bytes]:
    """Every file below with its content, apart from what Python caches."""
    files = (p for folder in folders for p in Path(folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    return {p: p.read_bytes() for p in files}


def refused(capsys, *arguments: str) -> str:
    """The one sentence of a command that must end with code 2."""
    capsys.readouterr()
    assert cli.execute(list(arguments)) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and text.startswith("Error: ") and text.endswith(".\n"), text
    return text


def remedy(text: str) -> str:
    """The value of ``--results`` that a refusal proposes."""
    return text.partition("--results ")[2].removesuffix(".\n")


@pytest.mark.parametrize("verb", VERBS)
def test_results_beside_studies_are_refused(sums, capsys, verb):
    before = contents(".")
    proposed = remedy(refused(capsys, verb, "plain", "--results", "."))
    assert contents(".") == before
    assert cli.execute(["compare", "plain", "--results", proposed]) == 0
    assert {p: b for p, b in contents(".").items() if p in before} == before


@pytest.mark.parametrize("verb", ["compare", "calibrate"])
@pytest.mark.parametrize("way", ["from within", "by a link", "by dots", "file", "link of the study"])
def test_however_the_place_is_spelled(sums, capsys, monkeypatch, verb, way):
    Path("studies").mkdir()
    shutil.move("plain", "studies/plain")
    before = contents("studies")
    arguments = {
        "from within": [".", "--results", ".."],
        "by a link": ["studies/plain", "--results", "elsewhere"],
        "by dots": ["studies/plain", "--results", "studies/plain/../../studies"],
        "file": ["studies/plain/study.toml", "--results", str(Path("studies").resolve())],
        "link of the study": ["linked", "--results", "studies"],
    }[way]
    os.symlink("studies", "elsewhere")
    os.symlink("studies/plain", "linked")
    if way == "from within":
        monkeypatch.chdir("studies/plain")
        refused(capsys, verb, *arguments)
        monkeypatch.chdir("../..")
    else:
        refused(capsys, verb, *arguments)
    assert contents("studies") == before


@pytest.mark.slow
def test_a_study_that_was_extended_into_the_results(library, capsys):
    """Run with all defaults."""
    assert cli.execute(["compare", "mast"]) == 0
    capsys.readouterr()
    assert cli.execute(["extend", "mast", "guy", "--into", "results/mast2"]) == 0
    command = capsys.readouterr().out.splitlines()[-1].partition("calib ")[2].split()
    before = contents("results/mast2", "mast")
    refused(capsys, "report", "results/mast2")
    for verb in ("compare", "calibrate", "run"):
        proposed = remedy(refused(capsys, verb, "results/mast2"))
        assert contents("results/mast2", "mast") == before
    assert command[:2] == ["calibrate", "results/mast2"] and command[-1] == proposed
    assert cli.execute(["compare", *command[1:]]) == 0
    assert contents("results/mast2", "mast") == before
    assert Path(proposed, "mast2", "comparison_before.csv").is_file()


@pytest.mark.medium
def test_files_of_the_user_where_results_would_go(sums, capsys):
    mine = Path("results/plain")
    mine.mkdir(parents=True)
    (mine / "measured.csv").write_text("the only copy")
    (mine / "ledger.sqlite").write_text("mine too")
    before = contents(".")
    for verb in VERBS:
        assert LOG in refused(capsys, verb, "plain")
    shutil.copytree("plain", "results/plain/quick")
    (mine / "measured.csv").unlink()
    (mine / "ledger.sqlite").unlink()
    refused(capsys, "calibrate", "plain", "--quick")
    assert contents("plain") == {p: b for p, b in before.items() if p.parts[0] == "plain"}
    assert contents("results/plain/quick") == {
        Path("results/plain/quick") / p.relative_to("plain"): b for p, b in contents("plain").items()
    }
    assert cli.execute(["compare", "plain"]) == 0


@pytest.mark.medium
def test_inputs_among_the_results(sums, capsys):
    assert cli.execute(["compare", "plain"]) == 0
    shutil.move("plain/measured.csv", "results/plain/mine.csv")
    text = Path("plain/study.toml").read_text()
    Path("plain/study.toml").write_text(text.replace('"measured.csv"', '"../results/plain/mine.csv"'))
    before = contents(".")
    for verb in VERBS:
        assert "mine.csv" in refused(capsys, verb, "plain")
    assert contents(".") == before
    assert cli.execute(["compare", "plain", "--results", "other"]) == 0


@pytest.mark.medium
@pytest.mark.parametrize(
    "name",
    [
        "measured.csv",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("record.json", "parameters.png", "report.html")),
    ],
)
def test_what_the_user_puts_among_results_is_kept(sums, unrendered, capsys, monkeypatch, name):
    if name.endswith(".png"):
        monkeypatch.setattr("calib.report.figures.Figures.save", SAVE)
    if name.endswith(".html"):
        monkeypatch.setattr("calib.report.html.write.write_report", write_report)
    assert cli.execute(["calibrate", "plain", "--workers", "1"]) == 0
    assert cli.execute(["report", "plain"]) == 0
    file = Path("results/plain", name)
    mine = [b"mine, by that name", b"mine again"]
    for content in mine:
        file.write_bytes(content)
        assert cli.execute(["compare", "plain"]) == 0
        assert cli.execute(["report", "plain"]) == 0
        assert file.read_bytes() != content
    kept = {p: p.read_bytes() for p in file.parent.glob(f"*{KEPT}*")}
    assert sorted(kept.values()) == sorted(mine)
    said = capsys.readouterr().out
    assert all(said.count(str(p)) == 1 for p in kept)
    assert cli.execute(["report", "plain"]) == 0
    said = capsys.readouterr().out
    assert not [p for p in kept if str(p) in said]


@pytest.mark.medium
def test_what_calib_wrote_is_replaced(sums):
    assert cli.execute(["calibrate", "plain"]) == 0
    text = Path("plain/measured.csv").read_text()
    Path("plain/measured.csv").write_text(text.replace("3.0", "3.1"))
    names = set(contents("results"))
    assert cli.execute(["calibrate", "plain"]) == 0
    assert set(contents("results")) == names and not list(Path("results/plain").glob(f"*{KEPT}*"))


@pytest.mark.medium
def test_two_studies_of_one_name(sums, capsys):
    shutil.copytree("plain", "other/plain")
    assert cli.execute(["calibrate", "plain"]) == 0
    before = contents("results")
    for verb in VERBS:
        text = refused(capsys, verb, "other/plain")
        assert str(Path("plain/study.toml").resolve()) in text and OWNER in text
    assert contents("results") == before
    assert cli.execute(["compare", "other/plain", "--results", "others"]) == 0


@pytest.mark.medium
def test_a_study_moved_together_with_its_results(sums):
    assert cli.execute(["compare", "plain"]) == 0
    Path("moved").mkdir()
    shutil.move("plain", "moved/plain")
    shutil.move("results", "moved/results")
    assert cli.execute(["compare", "moved/plain", "--results", "moved/results"]) == 0


@pytest.mark.slow
def test_results_of_earlier_versions_stay_as_they_are(sums, capsys):
    assert cli.execute(["calibrate", "plain"]) == 0
    Path("results/plain", LOG).unlink()
    before = contents(".")
    for verb in VERBS:
        assert "move what is there away" in refused(capsys, verb, "plain")
    assert contents(".") == before
