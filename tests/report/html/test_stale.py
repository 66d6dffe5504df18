"""Results of different states of a study never share a report, a figure or a folder without a warning."""

import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import calib
from calib.analyses.provenance.record import write_record
from calib.analyses.provenance.stale import stale_answers
from calib.analyses.provenance.state import WRITES, made_from, state_differences
from calib.command import cli
from calib.errors.errors import InputError
from calib.errors.own_code import CALIB
from calib.report.html.study_results import REPORT, StudyResults
from calib.report.html.summary import page_summary
from calib.report.html.write import sections
from calib.report.tables import CurrentFolder
from calib.results.results import OWNER, Results
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile
from tests.report.html.page_blocks import section_blocks
from tests.template import plain

FUNCTION = """
def answer(values):
    return {"y": values["a"] + values["b"] / 2, "z": values["a"] - values["b"] / 2}
"""
ASKED = """
[sensitivity]
samples = 12
[calibration]
population = 6
generations = 3
cases = [{ name = "A1", seed = 1 }]
"""
ROOT = Path("results")


pytestmark = pytest.mark.usefixtures("functions_in_this_process")


@pytest.fixture(scope="module")
def analysed(functions_in_this_process, tmp_path_factory):
    """Home of a small study of scalar responses, ``sums``, that was compared, screened and calibrated."""
    home = tmp_path_factory.mktemp("analysed")
    plain.write(home / "sums", FUNCTION, ASKED, y=(3.1, 0.1), z=(1.0, 0.1))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        patch.setattr("calib.report.figures.Figures.save", lambda *given: [])
        run("sensitivity", "calibrate")
    return home


@pytest.fixture
def sums(analysed, tmp_path, monkeypatch):
    """A copy of that study and its results that a test may change."""
    shutil.copytree(analysed, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path)
    return Path("sums")


def run(*verbs):
    with contextlib.redirect_stdout(io.StringIO()) as output:
        for verb in verbs:
            assert (
                cli.execute([verb, "sums", *(["--workers", "1"] if verb in ("sensitivity", "calibrate") else [])]) == 0
            )
    return output.getvalue()


def edit(file, old, new):
    text = Path("sums", file).read_text()
    assert old in text
    Path("sums", file).write_text(text.replace(old, new))


def stale():
    return stale_answers(LoadedStudy.load(Path("sums")), Results(ROOT / "sums"))


def results(found):
    return StudyResults(CurrentFolder(ROOT / "sums", found.files), "Plain", False, found.sentences)


@pytest.mark.parametrize(
    ("file", "old", "new", "touched"),
    [
        ("measured.csv", "y,3.1", "y,3.2", {"compare", "sensitivity", "calibrate"}),
        ("measured.csv", "z,1.0,0.1", "z,1.0,0.2", {"compare", "sensitivity", "calibrate"}),
        ("model.py", "/ 2, ", "/ 3, ", {"compare", "sensitivity", "calibrate"}),
        ("study.toml", "generations = 3", "generations = 4", {"calibrate"}),
        ("study.toml", "samples = 12", "samples = 13", {"sensitivity"}),
        ("study.toml", "[sensitivity]", "[parameters]\na = { value = 2.1 }\n[sensitivity]", set(WRITES)),
        ("study.toml", 'title = "Plain"', 'title = "Other words"', set()),
        ("measured.csv", "response,", "# a remark\nresponse,", set()),
    ],
)
def test_what_a_change_makes_stale(sums, file, old, new, touched):
    assert not stale().sentences and not stale().files
    edit(file, old, new)
    found = stale()
    analyses = {"compare", "sensitivity", "calibrate"}
    assert set(found.sentences) == touched & analyses
    assert all(file in words for words in found.sentences.values() if file != "study.toml")
    edit(file, new, old)
    assert not stale().sentences


@pytest.mark.medium
@pytest.mark.usefixtures("undrawn")
def test_a_new_comparison_never_stands_under_an_old_calibration(sums):
    before = page_summary(results(stale()))
    assert {"cases" in s.title.lower() for s in sections(results(stale()))} == {True, False}
    edit("measured.csv", "y,3.1", "y,2.2")
    output = run("compare")
    found = stale()
    assert set(found.sentences) == {"sensitivity", "calibrate"}
    assert {"parameters.csv", "summary.json", "comparison_after.csv", "verdicts.csv"} <= found.files
    assert not {"comparison_before.csv", "measured.csv"} & found.files
    for words in found.sentences.values():
        assert "measured.csv" in words and words in " ".join(output.split("\n"))
    shown = {s.name: s for s in sections(results(found))}
    assert {block.text.rstrip(".") for block in section_blocks(shown["stale"])} == set(found.sentences.values())
    assert not {"calibrated", "sensitivity"} & set(shown) and "compared" in shown
    now = page_summary(results(found))
    assert now.found != before.found and "calibrated" not in " ".join(what for what, _ in now.facts)
    run("sensitivity", "calibrate")
    assert not stale().sentences
    assert "stale" not in {s.name for s in sections(results(stale()))}


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("run_before", [True, False])
def test_tables_of_an_interrupted_analysis_are_not_shown(sums, monkeypatch, run_before):
    """Interrupted between its tables at another state of the study, which is then restored."""
    if not run_before:
        shutil.rmtree(ROOT)
    edit("measured.csv", "y,3.1", "y,2.2")

    def stop(*given, **more):
        raise InputError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr("calib.analyses.calibrate.write_record", stop)
        assert cli.execute(["calibrate", "sums"]) == 2
    edit("measured.csv", "y,2.2", "y,3.1")
    run("compare")
    assert (ROOT / "sums/parameters.csv").is_file()
    for study in (LoadedStudy.load(Path("sums")), StudyFile.read(Path("sums"))):
        found = stale_answers(study, Results(ROOT / "sums"))
        assert set(found.sentences) == {"calibrate"}
        assert {"parameters.csv", "comparison_after.csv", "summary.json"} <= found.files
        assert not {"comparison_before.csv", "measured.csv"} & found.files
    assert "calibrated" not in {s.name for s in sections(results(stale()))}
    run("calibrate")
    assert not stale().sentences and not stale().files


@pytest.mark.slow
def test_the_report_alone_names_what_is_stale_and_keeps_the_tables(sums, unrendered):
    run("report")
    tables = {p.name: p.read_bytes() for p in (ROOT / "sums").glob("*.csv")}
    pictures = {p.name for p in (ROOT / "sums").glob("*.png")}
    assert "parameters.png" in pictures
    edit("measured.csv", "y,3.1", "y,2.2")
    output = " ".join(run("report").split("\n"))
    assert all(words in output for words in stale().sentences.values()) and len(stale().sentences) == 3
    assert {p.name: p.read_bytes() for p in (ROOT / "sums").glob("*.csv")} == tables
    assert not list((ROOT / "sums").glob("*.png")) and (ROOT / "sums" / REPORT).exists()
    edit("measured.csv", "y,2.2", "y,3.1")
    run("report")
    assert {p.name for p in (ROOT / "sums").glob("*.png")} == pictures


SEARCH = "inference/gauss_newton.py"
OTHER = "'{}' were computed by other code of calib than the present one; a new run may change them"
LOOK = """
from pathlib import Path
from calib.analyses.provenance.stale import stale_answers
from calib.results.results import Results
from calib.study.study_file import StudyFile
found = stale_answers(StudyFile.read(Path("sums")), Results(Path("results/sums")))
print("".join(f"{one}\\n" for one in found.told), end="")
"""


@pytest.fixture
def found_by(sums, tmp_path):
    """What a copy of calib, edited in one file, says of the results."""
    copy = tmp_path / "installed/calib"
    shutil.copytree(CALIB, copy, ignore=shutil.ignore_patterns("__pycache__"))

    def told(file: str, old: str, new: str) -> list[str]:
        text = (copy / file).read_text()
        assert old in text
        (copy / file).write_text(text.replace(old, new, 1))
        ran = subprocess.run(
            [sys.executable, "-c", LOOK], capture_output=True, text=True, check=True,
            env={**os.environ, "PYTHONPATH": str(copy.parent), "PYTHONDONTWRITEBYTECODE": "1"},
        )  # fmt: skip
        (copy / file).write_text(text)
        return ran.stdout.split("\n")[:-1]

    return told


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize(
    ("file", "old", "new", "analyses"),
    [
        (SEARCH, "\n\n\n", "\n\n\nLATER = 1\n", "calibrate"),
        ("sensitivity/variance_share.py", "\n\n\n", "\n\n\nLATER = 1\n", "sensitivity' and 'calibrate"),
        (SEARCH, '"""', '"""Another sentence. ', ""),
        (SEARCH, "from __future__", "# a remark\n\nfrom __future__", ""),
        ("report/style.py", "\n\n\n", "\n\n\nLATER = 1\n", ""),
    ],
)
def test_other_code_of_calib_is_told_of_the_analyses_that_run_it(found_by, file, old, new, analyses):
    """Words and code that an analysis does not run are no other code; nothing is refused."""
    assert found_by(file, old, new) == ([f"Results of {OTHER.format(analyses)}"] if analyses else [])


@pytest.mark.medium
def test_other_rules_of_calib_are_refused_and_no_other_code(found_by):
    (words,) = found_by("sensitivity/rules.py", "bound: float = 0.1", "bound: float = 0.2")
    assert "'sensitivity' was run on an earlier state of the rules of calib" in words


@pytest.mark.medium
@pytest.mark.usefixtures("undrawn")
def test_command_python_and_report_tell_the_same_of_other_code(sums, monkeypatch):
    monkeypatch.setattr("calib.analyses.provenance.stale.code_of", lambda analysis: "other")
    found = stale()
    assert not found.sentences and not found.files and "'compare', 'sensitivity' and 'calibrate'" in found.other_code
    assert found.other_code in " ".join(run("report").split())
    with pytest.warns(UserWarning, match="other code of calib") as caught:
        calib.Study.load(sums, results=ROOT, progress=False).report()
    assert [str(one.message) for one in caught] == [f"{found.other_code}."]
    shown = {s.name: s for s in sections(replace(results(found), other_code=found.other_code))}
    assert section_blocks(shown["versions"])[0].text == f"{found.other_code}." and "calibrated" in shown


def test_a_file_of_the_user_is_no_interrupted_analysis(sums):
    Path("results/sums/effects.csv").write_text("mine\n")
    assert not stale().sentences


@pytest.mark.medium
def test_every_table_belongs_to_an_analysis_that_was_run(everything, scalar):
    for folder in (everything, scalar):
        analyses = json.loads((folder / "record.json").read_text())["analyses"]
        known = {name for analysis in analyses for name in WRITES[analysis]}
        assert {p.name for p in folder.glob("*.csv")} | {p.name for p in folder.glob("*.json")} <= {
            *known, "record.json", OWNER,
        }  # fmt: skip


def test_nothing_of_a_complete_run_is_stale(everything, tmp_path):
    assert not stale_answers(LoadedStudy.load(everything.parent.parent / "mast"), Results(everything)).sentences
    shutil.copytree(everything.parent.parent, tmp_path / "all")
    study = tmp_path / "all/mast"
    text = (study / "modes.csv").read_text()
    row = next(line for line in text.splitlines() if line.startswith("B1x"))
    cells = row.split(",")
    cells[1] = f"{1.05 * float(cells[1]):.6g}"
    (study / "modes.csv").write_text(text.replace(row, ",".join(cells)))
    found = stale_answers(LoadedStudy.load(study), Results(tmp_path / "all/results/mast"))
    assert set(found.sentences) == {"compare", "sensitivity", "calibrate", "explain", "extend"}
    assert all("modes.csv" in words for words in found.sentences.values())
    shown = sections(
        StudyResults(CurrentFolder(tmp_path / "all/results/mast", found.files), "A mast", False, found.sentences)
    )
    assert {s.name for s in shown} <= {"stale", "versions", "not_run"}


@pytest.mark.medium
def test_the_report_runs_no_code_of_the_study(sums, unrendered):
    """The results of a received study can be viewed before its code is trusted."""
    run("report")
    before = {s.name for s in sections(results(stale()))}
    edit("model.py", "/ 2, ", "/ 3, ")
    changed = stale()
    text = Path("sums/model.py").read_text()
    Path("sums/model.py").write_text('raise SystemExit("the code of the study was run")\n')
    output = " ".join(run("report").split("\n"))
    assert all(words.split(" of ")[0] in output for words in changed.sentences.values())
    Path("sums/model.py").write_text(text)
    edit("model.py", "/ 3, ", "/ 2, ")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.study.loading.Sources.model", lambda self: pytest.fail("the code of the study was run"))
        run("report")
    assert {s.name for s in sections(results(stale()))} == before
    assert (ROOT / "sums" / "parameters.png").exists()


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("measured.csv", "y,3.1", "y,3.2"),
        ("model.py", "/ 2, ", "/ 3, "),
        ("study.toml", "generations = 3", "generations = 4"),
        ("study.toml", "samples = 12", "samples = 13"),
        ("study.toml", "[sensitivity]", "[parameters]\na = { value = 2.1 }\n[sensitivity]"),
        ("study.toml", 'title = "Plain"', 'title = "Other words"'),
        ("measured.csv", "response,", "# a remark\nresponse,"),
    ],
)
def test_what_is_stale_is_known_without_the_code(sums, file, old, new):
    def from_files():
        return stale_answers(StudyFile.read(Path("sums")), Results(ROOT / "sums"))

    assert not from_files().sentences
    edit(file, old, new)
    assert set(from_files().sentences) == set(stale().sentences) and from_files().files == stale().files


@pytest.mark.medium
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("gone", ["model.py", "deck.inp"])
def test_a_named_file_that_is_gone_counts_as_changed(sums, gone):
    Path("sums/deck.inp").write_text("1.0")
    edit("study.toml", "selection", 'depends_on = ["deck.inp"]\nselection')
    run("compare")
    Path("sums", gone).unlink()
    run("report")
    found = stale_answers(StudyFile.read(Path("sums")), Results(ROOT / "sums"))
    assert gone in found.sentences["compare"]


@pytest.mark.parametrize(
    "change", [lambda file: file.unlink(), lambda file: file.write_text(file.read_text() + "LATER = 1\n")]
)
def test_results_record_the_files_as_they_were_read(sums, change):
    study, results = LoadedStudy.load(Path("sums")), Results(ROOT / "sums")
    model = Path("sums/model.py")
    text = model.read_text()
    change(model)
    write_record(study, results, "compare", {})
    assert "compare" in stale_answers(StudyFile.read(Path("sums")), results).sentences
    model.write_text(text)
    assert "compare" not in stale_answers(StudyFile.read(Path("sums")), results).sentences


def test_a_module_beside_the_model_is_an_input_of_an_analysis(sums):
    study, results = LoadedStudy.load(Path("sums")), Results(ROOT / "sums")
    assert "compare" not in stale_answers(study, results).sentences
    Path("sums/parts").mkdir()
    Path("sums/parts/shape.py").write_text("SIZE = 1\n")
    write_record(LoadedStudy.load(Path("sums")), results, "compare", {})
    assert "compare" not in stale_answers(StudyFile.read(Path("sums")), results).sentences
    Path("sums/parts/shape.py").write_text("SIZE = 2\n")
    found = stale_answers(StudyFile.read(Path("sums")), results)
    assert "parts/shape.py" in found.sentences["compare"]


EFFECTS = """
import os
from calib.problem.effect import Effect
from calib.problem.space import Parameter

def library():
    share = float(os.environ["SHARE"])

    def lever(model):
        return lambda values: {**model.function(values), "z": model.function(values)["z"] + share * values["lever"]}

    magnitude = Parameter("lever", 0.0, 0.0, 1.0, prior_sd=0.1)
    return (Effect("lever", "Lever", "It is left out.", "Look there.", magnitude, lever),)
"""


def test_the_values_an_effect_holds_are_inputs_of_an_explanation(sums, monkeypatch):
    """They may come from elsewhere than the study's files."""
    Path("sums/effects.py").write_text(EFFECTS)
    edit("study.toml", "selection", 'effects = "effects.py:library"\nselection')

    def states(share):
        monkeypatch.setenv("SHARE", share)
        study = LoadedStudy.load(Path("sums"))
        return {analysis: made_from(study, analysis) for analysis in ("calibrate", "explain")}

    one, same, other = states("1.0"), states("1.0"), states("2.0")
    assert one == same
    assert state_differences(one["explain"], other["explain"]) == ["the settings in the study file"]
    assert state_differences(one["calibrate"], other["calibrate"]) == []
