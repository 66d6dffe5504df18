"""The selection of parameters is read from a table that the user may have edited in a spreadsheet."""

import io
import re
from pathlib import Path

import pandas as pd
import pytest

from calib.analyses.provenance.record import write_record
from calib.analyses.provenance.stale import stale_answers
from calib.analyses.sensitivity import selected_by_measures
from calib.command import cli
from calib.errors.errors import InputError
from calib.results.results import Results
from calib.results.written import FLAGS, replacing
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile
from tests.template import plain

FUNCTION = """
def answer(values):
    return {"p": values["a"] + values["b"], "q": values["a"] - values["b"], "r": values["c"]}
"""
SPACE = 'tuple(Parameter(name, 2.0, 1.0, 3.0) for name in "abc")'
ASKED = """
[sensitivity]
samples = 20
[calibration]
method = "gauss-newton"
starts = 1
cases = [{ name = "A1", seed = 1 }]
"""

pytestmark = pytest.mark.usefixtures("functions_in_this_process", "undrawn")


@pytest.fixture
def selected(here):
    """Writes ``selection.csv`` and returns the parameters that are then selected."""
    measured = {"p": (3.5, 0.01), "q": (1.1, 0.01), "r": (1.5, 0.01)}
    folder = plain.write(Path("plain"), FUNCTION, ASKED, SPACE, '"from sensitivity"', **measured)
    assert cli.execute(["sensitivity", "plain", "--workers", "1"]) == 0
    home = Results(Path("results/plain"))
    study = LoadedStudy.load(folder)
    columns = (home.path / "selection.csv").read_text().splitlines()[0].split(",")

    def of(flags, names="abc", change=lambda text: text):
        rows = [
            ",".join({"parameter": n, "selected": f}.get(column, "") for column in columns)
            for n, f in zip(names, flags, strict=True)
        ]
        text = "\n".join([",".join(columns), *rows, ""])
        with replacing(home.path / "selection.csv") as draft:  # as calib would have written it
            draft.write_text(re.sub(r"(?<=,)\w+(?=,)", lambda entry: str(FLAGS.get(entry[0].lower(), entry[0])), text))
        (home.path / "selection.csv").write_text(change(text))
        return selected_by_measures(study, home).search_space.free_names

    return of


@pytest.mark.medium
@pytest.mark.parametrize(("yes", "no"), [("WAHR", "FALSCH"), ("TRUE", "FALSE"), ("vrai", "faux"), ("1", "0")])
def test_a_selection_saved_by_a_spreadsheet_is_read(selected, yes, no):
    semicolons = lambda text: "\ufeff" + text.replace(",", ";").replace("\n", "\r\n")  # noqa: E731
    assert selected([no, yes, no], change=semicolons) == ("b",)
    assert selected([yes, no, yes]) == ("a", "c")


@pytest.mark.medium
@pytest.mark.parametrize(
    ("flags", "names"),
    [
        (["True", "", "True"], "abc"),
        (["True", "perhaps", "True"], "abc"),
        (["True", "2", "True"], "abc"),
        (["True", "False"], "ab"),
        (["True", "False", "True"], "abb"),
        (["True", "False", "True"], "abd"),
        (["False", "False", "False"], "abc"),
    ],
)
def test_an_ambiguous_selection_is_refused(selected, flags, names):
    with pytest.raises(InputError, match=r"selection\.csv"):
        selected(flags, names)


@pytest.mark.medium
@pytest.mark.parametrize("quick", [True, False])
def test_a_calibration_of_one_case_is_stale_with_its_selection(selected, quick):
    root, study = Path("results"), LoadedStudy.load(Path("plain"))
    home, other = (Results.at(root, "plain", part) for part in (("quick", "") if quick else ("", "quick")))
    results = Results.at(root, "plain", "quick-case_A1" if quick else "case_A1")
    for place, chosen in ((home, "ab"), (other, "c")):
        rows = "".join(f"{name},{name in chosen}\n" for name in "abc")
        place.write_table("selection", pd.read_csv(io.StringIO(f"parameter,selected\n{rows}")))
        write_record(study, place, "sensitivity", {})
    fitted = selected_by_measures(study, home)
    write_record(fitted, results, "calibrate", {}, (), quick, ["--case", "A1", "--method", "genetic"])
    for now in (study, StudyFile.read(Path("plain"))):
        assert not stale_answers(now, results).sentences
    home.write_table("selection", pd.read_csv(io.StringIO("parameter,selected\na,True\nb,False\nc,False\n")))
    for now in (study, StudyFile.read(Path("plain"))):
        (words,) = stale_answers(now, results).sentences.values()
        assert f"calib calibrate plain --case A1 --method genetic{' --quick' * quick}" in words


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "old", "new"),
    [("measured.csv", "3.5", "3.7"), ("study.toml", "samples = 20", "samples = 30"), ("model.py", 'r": ', 'r": 2 * ')],
)
def test_a_selection_of_an_earlier_state_is_refused(selected, capsys, file, old, new):
    given = Path("plain", file)
    text = given.read_text()
    assert old in text
    given.write_text(text.replace(old, new))
    before = {p.name: p.read_bytes() for p in Path("results/plain").glob("*.csv")}
    capsys.readouterr()
    assert cli.execute(["calibrate", "plain", "--workers", "1"]) == 2
    said = capsys.readouterr().err
    assert "selection.csv" in said and "calib sensitivity plain" in said
    assert {p.name: p.read_bytes() for p in Path("results/plain").glob("*.csv")} == before
    assert cli.execute(["sensitivity", "plain", "--workers", "1"]) == 0
    assert cli.execute(["calibrate", "plain", "--workers", "1"]) == 0


@pytest.mark.medium
@pytest.mark.parametrize("quick", [[], ["--quick"]])
def test_a_selection_of_an_interrupted_analysis_is_refused(selected, monkeypatch, capsys, quick):
    ask = [["sensitivity", "plain", "--workers", "1", *quick], ["calibrate", "plain", "--workers", "1", *quick]]

    def stop(*given, **more):
        raise InputError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr("calib.analyses.sensitivity.write_record", stop)
        assert cli.execute(ask[0]) == 2
    capsys.readouterr()
    assert cli.execute(ask[1]) == 2
    said = capsys.readouterr().err
    assert "selection.csv" in said and f"'calib sensitivity plain{' --quick' * bool(quick)}'" in said
    results = Results.at(Path("results"), "plain", "quick" * bool(quick))
    (words,) = stale_answers(StudyFile.read(Path("plain")), results).sentences.values()
    assert words.endswith(f"calib sensitivity plain{' --quick' * bool(quick)}")
    assert [cli.execute(verb) for verb in ask] == [0, 0]
