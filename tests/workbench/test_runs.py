"""Commands that the page starts, stops and tells, and those that were started elsewhere."""

import json
import os
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
import typer

from calib.command import cli, example
from calib.errors.errors import InputError
from calib.report.html.study_results import StudyResults
from calib.results.running import RunningNote
from calib.study.loading import module_of
from calib.workbench import runs
from calib.workbench.missing import uncalibrated
from calib.workbench.runs import KINDS, Commands, adding, new_study
from calib.workbench.studies import Studies

from .conftest import PORT, TOKEN

MAST = module_of(Path(__file__).resolve().parents[1] / "template/mast_effects.py")

WAITS = "import time; print('begun', flush=True); time.sleep(60)"
REFUSES = "import sys; print('GB1'); print('Error: study.toml, line 3: no such key.', file=sys.stderr); sys.exit(2)"


@pytest.fixture
def study(here):
    (found,) = Studies(Path("mast"), Path("results")).all().values()
    return found


@pytest.fixture
def commands(monkeypatch):
    """Commands that run a piece of Python instead of calib."""

    def of(code):
        monkeypatch.setattr(runs, "_CALIB", (sys.executable, "-c", code))
        return Commands()

    yield of
    for process in started:
        process.kill()
    started.clear()


started = []


@pytest.fixture(autouse=True)
def noted_processes(monkeypatch):
    popen = runs.subprocess.Popen

    def kept(*given, **more):
        process = popen(*given, **more)
        started.append(process)
        return process

    monkeypatch.setattr(runs.subprocess, "Popen", kept)


def until(holds):
    """Wait for another process."""
    for _ in range(3000):
        if holds():
            return
        time.sleep(0.01)
    pytest.fail("it did not come to that")


def ended(commands, study):
    until(lambda: all(one["state"] != "running" for one in commands.listing(study)))
    return commands.listing(study)[-1]


def test_a_command_has_the_arguments_of_its_options(study, commands):
    own = commands("import sys; print(sys.argv[1:])")
    own.start(study, "calibrate", {"quick": True, "case": "C1", "workers": 2})
    found = ended(own, study)
    assert found["state"] == "done"
    assert found["command"] == "calib calibrate mast --results results --quick --case C1 --workers 2"


def test_commands_have_the_options_that_the_page_gives_and_write_where_it_looks():
    known = typer.main.get_command(cli.app).commands
    for verb, options in runs.OPTIONS.items():
        assert set(options) <= {name.lstrip("-") for one in known[verb].params for name in one.opts}, verb
        assert "quick" in options or verb in ("report", "again"), (
            verb
        )  # those of a quick run stand in a folder of their own


def test_one_that_fails_says_what_it_said(study, commands):
    own = commands(REFUSES)
    own.start(study, "calibrate", {})
    found = ended(own, study)
    assert (found["state"], found["sentence"]) == ("failed", "study.toml, line 3: no such key.")
    assert "GB1" in found["tail"]


def test_only_one_runs_at_a_time_and_it_can_be_stopped(study, commands):
    own = commands(WAITS)
    own.start(study, "run", {})
    with pytest.raises(InputError, match="stop it"):
        own.start(study, "compare", {})
    (running,) = own.listing(study)
    assert running["state"] == "running" and running["words"] == "run: reading the study"
    assert own.stop(study, running["pid"]) and not own.stop(study, 1)
    assert ended(own, study)["state"] == "stopped"


def test_what_follows_begins_when_the_first_has_succeeded(study, commands, here):
    own = commands("import pathlib, sys; pathlib.Path(sys.argv[1]).touch()")
    own.start_all(study, [("extend", ("first",)), ("calibrate", ("second",))], {})
    until((here / "second").exists)
    assert [one["verb"] for one in own.listing(study)] == ["extend", "calibrate"]
    own = commands(REFUSES)
    own.start_all(study, [("extend", ("first",)), ("calibrate", ("third",))], {})
    assert ended(own, study)["verb"] == "extend" and len(own.listing(study)) == 1


def test_a_command_of_a_terminal_is_listed_and_stopped_by_the_page(study, here, commands):
    own = commands(WAITS)
    with RunningNote(study.home, "explain", {}) as note:
        note.tell("explain: testing 3/7", "testing", 3.0, 7.0, float("nan"), "2 min")
        (seen,) = own.listing(study)
        assert (seen["verb"], seen["state"], seen["again"], seen["left"]) == ("explain", "running", {}, "2 min")
        with pytest.raises(InputError, match="a command runs"):
            own.start(study, "compare", {})
    assert own.listing(study) == []


def test_the_note_of_an_own_command_tells_how_far_it_is(study, commands):
    code = (
        "import pathlib, time; from calib.results.running import RunningNote\n"
        "with RunningNote(pathlib.Path('results/mast'), 'run', {}) as note:\n"
        "    note.tell('run: sampling 3/9', 'sampling', 3.0, 9.0, 0.5, '5 s'); time.sleep(60)"
    )
    own = commands(code)
    own.start(study, "run", {})
    until(lambda: own.listing(study)[0]["words"] == "run: sampling 3/9")
    (seen,) = own.listing(study)
    assert (seen["verb"], seen["done"], seen["total"]) == ("run", 3.0, 9.0)


def test_a_command_on_an_extended_study_tells_how_far_it_is_too(study, commands):
    code = (
        "import pathlib, time; from calib.results.running import RunningNote\n"
        "home = pathlib.Path('results/mast_with_guy'); home.mkdir()\n"
        "with RunningNote(home, 'calibrate', {}) as note:\n"
        "    note.tell('calibrate: A1, generation 3/9', 'search', 3.0, 9.0, 0.5, '5 s'); time.sleep(60)"
    )
    own = commands(code)
    own.start_all(study, [("calibrate", ("calibrate", "results/mast/mast_with_guy"))], {"effects": ["guy"]})
    until(lambda: own.listing(study)[0]["words"] == "calibrate: A1, generation 3/9")
    assert [one["left"] for one in own.listing(study)] == ["5 s"]


def test_an_extended_study_has_a_place_of_its_own(study, here):
    (_, first), (_, second) = adding(study, ["guy", "a b"], quick=True, calibrated=True)
    place = here / "results/mast/mast_with_guy_a_b"
    assert first == ("extend", "mast", "guy", "a b", "--into", str(place.relative_to(here)), "--results", "results")
    assert second[-1] == "--quick" and Path(second[1]) == place.relative_to(here)
    place.mkdir()
    assert Path(adding(study, ["guy", "a b"], quick=True, calibrated=True)[1][1][1]).name == "mast_with_guy_a_b_2"


@pytest.mark.medium
def test_an_extended_study_whose_calibration_was_stopped_is_calibrated_on(tmp_path, monkeypatch, no_drawing):
    MAST.write_study(tmp_path / "mast", {"guy": 12000.0})
    monkeypatch.chdir(tmp_path)
    studies = Studies(Path("mast"), Path("results"))
    (study,) = studies.all().values()
    assert uncalibrated(studies, study, ["guy"], quick=True) is None
    with no_drawing():
        assert cli.execute(["extend", "mast", "guy", "--into", "results/mast/mast_with_guy"]) == 0
    written = uncalibrated(studies, study, ["guy"], quick=True)
    assert written.name == "mast_with_guy" and uncalibrated(studies, study, ["ice"], quick=True) is None
    (command,) = adding(study, ["guy"], True, True, written)
    assert command == ("calibrate", ("calibrate", "results/mast/mast_with_guy", "--results", "results", "--quick"))


def test_before_an_effect_is_added_the_study_is_calibrated_once(page, key, monkeypatch):
    given = []
    monkeypatch.setattr(Commands, "start_all", lambda self, study, commands, options: given.append(commands))
    known = {"name": ["guy"], "title": ["Guy"]}
    monkeypatch.setattr(StudyResults, "table", lambda self, name: pd.DataFrame(known) if name == "effects" else None)
    asked = f"study/{key}/add?part=quick&test=", {"effects": ["guy"], "quick": True}
    assert page.post(asked[0], json=asked[1]).status_code == 200
    monkeypatch.setattr(StudyResults, "analyses", {"calibrate": {"when": "now"}})
    assert page.post(asked[0], json=asked[1]).status_code == 200
    first, second = ([(verb, "--quick" in arguments) for verb, arguments in commands] for commands in given)
    assert first == [("calibrate", True), ("extend", False), ("calibrate", True)] and second == first[1:]


def test_the_page_starts_and_stops_a_command(page, key, here, monkeypatch):
    monkeypatch.setattr(runs, "_CALIB", (sys.executable, "-c", WAITS))
    (run,) = page.post(f"study/{key}/run", json={"verb": "compare"}).json()["runs"]
    assert run["state"] == "running"
    refused = page.post(f"study/{key}/run", json={"verb": "compare"})
    assert refused.status_code == 409 and "a command runs on this study" in refused.json()["fault"]
    assert page.post(f"study/{key}/stop", json={"pid": run["pid"]}).status_code == 200
    with page.websocket_connect(f"ws://127.0.0.1:{PORT}/{TOKEN}/live") as live:
        seen = None
        while seen != "stopped":
            seen = json.loads(live.receive_text())["studies"][key]["runs"][0]["state"]


def test_a_failure_is_told_until_later_results_are_written(study, commands, here):
    own = commands(REFUSES)
    own.start(study, "calibrate", {"quick": True})
    assert ended(own, study)["again"] == {"quick": True}
    note = here / "results/mast/.running-1.json"
    told = {"pid": 1, "verb": "extend", "options": {}, "began": time.time(), "told": time.time()}
    note.write_text(json.dumps(told))
    killed = own.listing(study)[-1]
    assert (killed["verb"], killed["state"], killed["again"]) == ("extend", "failed", None)
    later = time.time_ns() + 10**9
    os.utime(here / "results/mast/record.json", ns=(later, later))
    assert own.listing(study) == []


def test_a_further_command_on_another_study_is_not_given_again(study, commands):
    own = commands(REFUSES)
    own.start_all(study, [("calibrate", ("other",))], {"effects": ["guy"], "quick": True})
    assert ended(own, study)["again"] is None  # it would calibrate the study that the page shows


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../new", "a/b", "a\\b", "-x", "--table", ".new", "new.", "a\n", 3, None]
)
def test_a_new_study_has_a_plain_name(here, name):
    with pytest.raises(InputError, match="is no name of a folder"):
        new_study(Studies(Path("."), Path("results")), name, "")


def test_a_new_study_lies_in_the_folder_of_the_page(here, tmp_path):
    (tmp_path / "outside").mkdir()
    Path("link").symlink_to(tmp_path / "outside")
    for name in ("link", "results"):
        with pytest.raises(InputError, match="is not free"):
            new_study(Studies(Path("."), Path("results")), name, "table")
    for studies, kind in ((Studies(Path("mast"), Path("results")), ""), (Studies(Path("."), Path("results")), "x")):
        with pytest.raises(InputError, match="writes no such study"):
            new_study(studies, "new", kind)
    assert not Path("new").exists() and not any((tmp_path / "outside").iterdir())


def test_the_page_offers_every_kind_of_example():
    assert set(KINDS) == {"", *example.KINDS}


@pytest.mark.slow  # the command writes it
def test_a_new_study_is_written_by_the_command_and_what_it_refuses_is_told(here, page_of):
    page = page_of(Path("."))
    found = page.post("new", json={"name": "my tower", "kind": "table"}).json()
    assert Path("my tower/runs.csv").is_file()
    assert found["key"] in [one["key"] for one in page.get("studies").json()["studies"]]
    again = page.post("new", json={"name": "mast", "kind": ""})
    assert again.status_code == 409 and "mast" in again.json()["fault"]
