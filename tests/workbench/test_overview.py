"""The state of a study on its page: as the tables, the report and the commands tell it."""

import contextlib
import io
import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from calib.command import cli
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import page_summary
from calib.results.results import Results
from calib.workbench.missing import is_added
from calib.workbench.overview import _further, _next
from calib.workbench.studies import Studies


def test_a_study_tells_what_was_run_and_what_comes_next(page, key, here):
    found = page.get(f"study/{key}").json()
    states = {one["verb"]: one["state"] for one in found["analyses"]}
    assert states["compare"] == "done" and states["calibrate"] == "never"
    assert found["next"]["verb"] == "sensitivity"  # the first command that the comparison names
    record = json.loads((here / "results/mast/record.json").read_text())
    assert record["analyses"]["compare"]["answer"]["found"].replace(" -> ", " → ") == found["summary"]["found"]


def test_the_analyses_of_designs_tell_what_they_need_and_what_they_found(page, key, here):
    further = {one["verb"]: one for one in page.get(f"study/{key}").json()["further"]}
    assert {verb: one["after"] for verb, one in further.items()} == {
        "pareto": "calibrate", "refine": "sensitivity", "robustness": "calibrate",
    }  # fmt: skip
    assert {one["state"] for one in further.values()} == {"never"} and not further["pareto"]["figure"]
    home = here / "results/mast"
    (home / "pareto.csv").write_text("kind,design,first,second,objective,knee,lowest\nfront,1,0.1,0.2,0.3,True,True\n")
    (home / "pareto_objectives.csv").write_text("name,of,weight\nfrequencies,error,1\nMAC,1 - MAC,1\n")
    record = json.loads((home / "record.json").read_text())
    record["analyses"]["pareto"] = {**record["analyses"]["compare"], "answer": {"found": "A front."}}
    (home / "record.json").write_text(json.dumps(record))
    own = next(one for one in _further(StudyResults(home, "", True)) if one["verb"] == "pareto")
    assert (own["figure"], own["caption"], own["found"]) == ("pareto", "frequencies against MAC", "A front.")


def test_its_summary_is_that_of_the_report(page, key, here):
    found = page.get(f"study/{key}").json()["summary"]
    summary = page_summary(StudyResults(here / "results/mast", "", True))
    assert [tuple(fact) for fact in found["facts"]] == list(summary.facts) and found["sure"] == summary.sure


def test_what_a_change_makes_out_of_date_is_marked_at_once(page, key, here):
    file = here / "mast/study.toml"
    file.write_text(file.read_text().replace("threshold = 0.3", "threshold = 0.4"))
    found = page.get(f"study/{key}").json()
    stale = next(one for one in found["analyses"] if one["verb"] == "compare")
    assert stale["state"] == "stale" and "calib compare mast" in stale["stale"] and found["next"]["verb"] == "compare"
    assert page.get(f"study/{key}/figure/comparison").status_code == 404  # and is not shown


def test_a_study_that_cannot_be_read_says_why(page, key, here):
    (here / "mast/study.toml").write_text("title = 3\n")
    found = page.get(f"study/{key}")
    assert found.status_code == 409 and "title" in found.json()["fault"]
    (listed,) = page.get("studies").json()["studies"]
    assert "title" in listed["fault"]


def test_a_study_without_results_says_what_to_run(here, page_of):
    shutil.rmtree(here / "results")
    page = page_of(Path("mast"))
    (one,) = page.get("studies").json()["studies"]
    found = page.get(f"study/{one['key']}").json()
    assert found["summary"] is None and found["next"]["verb"] == "compare" and found["parts"] == []
    assert page.get(f"study/{one['key']}/missing").json()["explanation"] is None
    assert page.get(f"study/{one['key']}/search").json()["cases"] == []


def test_results_of_another_study_are_not_shown(here, page_of):
    owner = here / "results/mast/owner.json"
    owner.write_text(json.dumps({"study": "/elsewhere/mast/study.toml", "from_here": ""}))
    page = page_of(Path("mast"))
    (one,) = page.get("studies").json()["studies"]
    assert page.get(f"study/{one['key']}").json()["summary"] is None


def test_a_folder_lists_its_studies_and_their_versions(here, page_of):
    shutil.copytree(here / "mast", here / "more/deeper/other")
    version = here / "results/mast/mast_with_guy"
    version.mkdir()
    (version / "study.toml").write_text('title = "With a guy"\nbase = "../../../mast"\nwith_effects = ["guy"]\n')
    page = page_of(Path("."))
    found = {one["name"]: one for one in page.get("studies").json()["studies"]}
    assert list(found) == ["mast", "mast_with_guy", "other"]
    assert found["mast_with_guy"]["parent"] == found["mast"]["key"] and found["other"]["parent"] == ""
    assert found["mast"]["done"] == ["compare"] and found["other"]["done"] == []
    family = page.get(f"study/{found['mast']['key']}/versions").json()["versions"]
    assert [(one["name"], one["effects"]) for one in family] == [("mast", []), ("mast_with_guy", ["guy"])]


@pytest.mark.parametrize(("effects", "parent", "errors", "added"), [
    (["guy"], "mast", [{"rms": 1.1}], True), (["guy"], "mast", [], False), (["guy"], "other", [{"rms": 1.1}], False),
    (["strut"], "mast", [{"rms": 1.1}], False),
])  # fmt: skip
def test_what_was_added_does_not_come_next_again(here, monkeypatch, effects, parent, errors, added):
    own = {"key": "mast", "parent": "", "effects": [], "errors": []}
    version = {"key": "version", "parent": parent, "effects": effects, "errors": errors}
    monkeypatch.setattr("calib.workbench.missing.versions", lambda *given: [own, version])
    studies = Studies(Path("mast"), Path("results"))
    assert is_added(studies, SimpleNamespace(key="mast"), ["guy"], "") is added


def test_results_are_read_once_until_they_change(here):
    studies = Studies(Path("mast"), Path("results"))
    (study,) = studies.all().values()
    first = studies.results(study)
    assert studies.results(study) is first and first.record["analyses"]
    Results(here / "results/mast").write_json("record", {"analyses": {}})
    assert studies.results(study).record == {"analyses": {}}


@pytest.mark.slow
def test_of_several_tests_each_is_compared_and_the_first_is_shown(here, page_of, no_drawing):
    file = here / "mast/study.toml"
    text = file.read_text()
    start, end = text.index("[measurement]"), text.index("[parameters.K_base]")
    data = 'files = ["modes.csv"]\nshapes = ["shapes.csv"]\nsensors = "sensors.csv"\nstd_of = "mean"\n\n'
    file.write_text(f'{text[:start]}[[tests]]\nname = "one"\n{data}[[tests]]\nname = "two"\n{data}{text[end:]}')
    shutil.rmtree(here / "results")
    with no_drawing(), contextlib.redirect_stdout(io.StringIO()):
        assert cli.execute(["compare", "mast"]) == 0
    page = page_of(Path("mast"))
    (one,) = page.get("studies").json()["studies"]
    found = page.get(f"study/{one['key']}").json()
    assert found["tests"] == ["one", "two"] and one["done"] == ["compare"]
    compare = next(row for row in found["analyses"] if row["verb"] == "compare")
    assert compare["state"] == "done" and compare["found"].startswith("one: ") and " two: " in compare["found"]
    assert found["figure"] == {"name": "comparison", "test": "one", "words": "model against measurement"}
    for test in ("one", "two"):
        of_test = page.get(f"study/{one['key']}/correlation?test={test}").json()
        assert of_test["test"] == test and of_test["correlation"]["stages"][0]["pairs"]
    assert page.get(f"study/{one['key']}/correlation").json()["test"] == "one"


@pytest.mark.parametrize("part", ["quick", "..", "/", "../mast"])
def test_a_part_that_is_not_there_is_the_full_run(here, part):
    studies = Studies(Path("mast"), Path("results"))
    (study,) = studies.all().values()
    assert studies.results(study, part).folder.folder == Path("results/mast")


def test_numbers_that_are_not_finite_are_told_as_unknown():
    from calib.results.results import json_value

    assert json_value({"a": (math.nan, 1.0, [math.inf])}) == {"a": [None, 1.0, [None]]}


@pytest.mark.parametrize(
    ("explanation", "verb"),
    [({}, "sensitivity"), ({"verdict": "effect", "to_add": ["guy"]}, "add"), ({"verdict": "partial"}, "propose")],
)
def test_the_next_command_is_what_the_answer_holds_not_what_its_sentence_says(explanation, verb):
    def row(verb, command):
        return {
            "verb": verb,
            "state": "done" if command else "never",
            "then": "Not calib intervals.",
            "command": command,
        }

    rows = [row("compare", "sensitivity"), row("sensitivity", "")]
    rows += [row("explain", "nothing")] if explanation else []
    assert _next(SimpleNamespace(explanation=explanation), rows) == {"verb": verb, "words": "Not calib intervals."}


def test_the_record_holds_the_command_of_an_answer(here):
    record = json.loads((here / "results/mast/record.json").read_text())
    assert record["analyses"]["compare"]["answer"]["command"] == "sensitivity"
