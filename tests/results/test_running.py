"""What a command tells of its progress to other processes."""

import contextlib
import io
import json
import math
import os
import signal
import subprocess
import sys
import time

import pytest

from calib.api.progress import noted
from calib.command import cli
from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.results.running import RunningNote, notes_in
from calib.results.written import LOG


@pytest.fixture
def home(tmp_path):
    (tmp_path / LOG).touch()
    return tmp_path


def told(note, words="calibrate: GB1", **more):
    note.tell(words, **{"stage": "GB1", "done": 1.0, "total": 4.0, "best": math.nan, "left": "2 min", **more})


def test_a_running_command_is_seen_and_vanishes_when_it_ends(home):
    with RunningNote(home, "calibrate", {"quick": True}) as note:
        assert notes_in(home) == []  # before the first stage nobody knows of it
        told(note)
        told(note, "calibrate: GB2", best=0.25, done=2.0)
        (seen,) = notes_in(home)
        assert (seen["verb"], seen["options"], seen["words"]) == ("calibrate", {"quick": True}, "calibrate: GB2")
        assert (seen["best"], seen["done"], seen["left"], seen["running"]) == (0.25, 2.0, "2 min", True)
    assert notes_in(home) == []


@pytest.mark.parametrize("fault", [InputError("no such file", place="a.csv"), KeyboardInterrupt(), OSError("gone")])
def test_it_vanishes_with_a_command_that_fails(home, fault):
    with pytest.raises(type(fault)), RunningNote(home, "explain", {}) as note:
        told(note)
        assert len(notes_in(home)) == 1
        raise fault
    assert notes_in(home) == []


def test_that_of_a_killed_command_vanishes_with_the_next(home):
    (home / ".running-1.json").write_text('{"pid": 1, "verb": "explain", "began": 1.0, "told": 2.0}')
    assert [one["running"] for one in notes_in(home)] == [False]
    with RunningNote(home, "calibrate", {}) as note:
        told(note)
        assert [one["verb"] for one in notes_in(home)] == ["calibrate"]


def test_nothing_is_left_where_no_results_were(tmp_path):
    with pytest.raises(InputError), RunningNote(tmp_path, "explain", {}) as note:
        told(note)
        raise InputError("refused")
    assert list(tmp_path.iterdir()) == []
    with RunningNote(tmp_path / "none", "compare", {}) as note:
        told(note)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("owner", ['{"study": "/elsewhere/mast/study.toml", "from_here": ""}', "{"])
def test_nothing_is_written_where_the_results_are_of_another_study(home, owner):
    (home / "owner.json").write_text(owner)
    with pytest.raises(InputError), RunningNote(home, "compare", {}, home / "mast/study.toml") as note:
        told(note)
        raise InputError("refused")
    assert {path.name for path in home.iterdir()} == {LOG, "owner.json"}


def test_a_damaged_note_is_left_out(home):
    (home / ".running-7.json").write_text("{")
    (home / ".running-8.json").write_text("[1]")
    (home / ".running-9.json").write_text(json.dumps({"pid": "9", "verb": "run", "began": 1.0, "told": 1.0}))
    (home / ".running-5.json").write_text(json.dumps({"pid": 5, "verb": "run", "began": None, "told": 1.0}))
    assert notes_in(home) == []


def test_every_stage_is_noted_and_counts_now_and_then(home):
    with RunningNote(home, "calibrate", {}) as note:
        seen = []
        note.tell = lambda words, *rest: seen.append(words)
        tell = noted(lambda *given: None, "calibrate", note)
        tell("sampling", 1, 100)
        for count in range(2, 50):
            tell("", count, 100)
        tell("least squares")
    assert seen[0] == "calibrate: sampling 1/100" and seen[-1] == "calibrate: least squares" and len(seen) < 20


@pytest.mark.medium
def test_a_command_tells_its_stages(tmp_path, monkeypatch, no_drawing):
    monkeypatch.chdir(tmp_path)
    write_example(tmp_path / "mast")
    seen = []
    own = RunningNote.tell
    monkeypatch.setattr(
        RunningNote, "tell", lambda note, *given: (own(note, *given), seen.extend(notes_in(note._home)))
    )
    with no_drawing(), contextlib.redirect_stdout(io.StringIO()):
        assert cli.execute(["compare", "mast"]) == 0
        assert cli.execute(["compare", "mast"]) == 0  # now there is a folder from the beginning on
    assert seen[0]["verb"] == "compare" and seen[0]["words"] == "compare: solving the model" and seen[0]["running"]
    assert notes_in(tmp_path / "results/mast") == []


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_killed_command_does_not_count_as_running(home):
    """The lock ends with the process, however that ends."""
    code = (
        "import sys, time; from pathlib import Path; from calib.results.running import RunningNote\n"
        "with RunningNote(Path(sys.argv[1]), 'run', {}) as note:\n"
        "    note.tell('run', 'run', 0.0, 0.0, float('nan'), ''); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(home)])
    while not notes_in(home):
        time.sleep(0.02)
    assert notes_in(home)[0]["running"]
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not notes_in(home)[0]["running"]
