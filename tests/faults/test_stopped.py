"""A search that is killed or interrupted at any moment, and started again, ends as if nothing had happened."""

import os
import random
import re
import shutil
import signal
import time
from pathlib import Path

import pytest

from calib.command import cli
from calib.execution import interrupt
from calib.report.figures import Figures

FOLDER = Path("results/mast")


def kill_again_and_again(start, kills, seed, whole, wait_for, left, seconds):
    """Kill at random moments, starting again each time; compare whenever a run got through."""
    draw, done, finished = random.Random(seed), 0, 0
    while done < kills:
        run = start()
        run.until(wait_for)
        if run.wait(draw.uniform(0.0, seconds)) is None:
            run.send(signal.SIGKILL)
            run.wait()
            done += run.code == -signal.SIGKILL
        if run.code == 0:
            finished += 1
            assert left(FOLDER) == whole
            shutil.rmtree(FOLDER)
        else:
            assert run.code == -signal.SIGKILL, run.err
        assert run.nobody_left()
    last = start()
    assert last.wait() == 0, last.err
    assert left(FOLDER) == whole
    return finished


def told_of_the_interruption(err: str) -> bool:
    """Whether one sentence is all that is said, besides how far a slow machine came."""
    *progress, last = err.splitlines()
    return last == "calib: interrupted; the same command again completes it" and all(
        re.fullmatch(r"[a-z ]+: \S.*", line) for line in progress
    )


def duration(start, wait_for):
    run = start()
    run.until(wait_for)
    began = time.monotonic()
    assert run.wait() == 0, run.err
    return time.monotonic() - began


@pytest.mark.slow
def test_killed_twice(mast, runner, left, whole):
    def start():
        return runner.fork("calibrate", "mast", "--workers", "1")

    kill_again_and_again(start, 2, 1, whole[0], lambda: True, left, whole[1])


@pytest.mark.whole  # tests/benchmarks/kills.py counts the same for every command
def test_killed_twenty_times(mast, runner, left, drafts):
    ledger = FOLDER / "ledger.sqlite"

    def start(*given):
        return runner.command("calibrate", "mast", "--workers", "1", *given)

    seconds = duration(lambda: start("--results", "whole"), Path("whole/mast/ledger.sqlite").exists)
    whole = left(Path("whole/mast"))
    assert whole.figures == {f"{name}.png" for name in Figures(Path("whole/mast"), "", False).plan}
    finished = kill_again_and_again(start, 20, 2, whole, ledger.exists, left, seconds)
    print(f"20 kills over {seconds:.1f} s of work, {finished} runs got through between them")
    for name in drafts(FOLDER):  # a kill within the moment of writing leaves a draft; a later run clears it away
        os.utime(FOLDER / name, (0, 0))
    assert start().wait() == 0
    assert drafts(FOLDER) == []


@pytest.mark.whole  # tests/benchmarks/kills.py counts the same for every command
def test_killed_twenty_times_with_worker_processes(mast, runner, left):
    def start(*given):
        return runner.fork("calibrate", "mast", "--workers", "2", *given)

    seconds = duration(lambda: start("--results", "whole"), Path("whole/mast/ledger.sqlite").exists)
    whole = left(Path("whole/mast"))
    finished = kill_again_and_again(start, 20, 4, whole, (FOLDER / "ledger.sqlite").exists, left, seconds)
    print(f"20 kills over {seconds:.1f} s of work, {finished} runs got through between them")


def interrupted(start, press):
    """A run that was interrupted while it calculated; one that got through before, on a busy machine, is repeated."""
    for _ in range(20):
        run = start()
        run.until(lambda run=run: (FOLDER / "ledger.sqlite-wal").exists() or run.poll() == 0, ended=0)
        press(run)
        if run.wait() != 0:
            assert run.code == 130, (run.code, run.err)
            return run
        shutil.rmtree(FOLDER)
    raise AssertionError("no run could be interrupted")


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_interrupted_by_the_keyboard_or_a_batch_system(mast, runner, left, drafts, workers, sign, whole):
    def press(run):
        """As a terminal or a batch system sends it."""
        time.sleep(0.05)  # into the work; any moment will do
        run.send(sign, everybody=True)

    run = interrupted(lambda: runner.fork("calibrate", "mast", "--workers", workers), press)
    assert told_of_the_interruption(run.err)
    assert run.nobody_left() and drafts(Path("results")) == [] and not Path("calib-error.log").exists()
    again = runner.fork("calibrate", "mast", "--workers", "1")
    assert again.wait() == 0
    assert left(FOLDER) == whole[0]


@pytest.mark.whole  # tests/benchmarks/kills.py counts the same for every command
def test_interrupted_at_any_moment(mast, runner, left, drafts):
    def start(*given):
        return runner.fork("run", "mast", "--workers", "1", *given, draw=True)

    seconds = duration(lambda: start("--results", "whole"), Path("whole/mast").exists)
    whole = left(Path("whole/mast"))
    draw, stopped = random.Random(3), 0
    while stopped < 20:
        run = start()
        run.until(FOLDER.exists)
        time.sleep(draw.uniform(0.0, seconds))
        run.send(signal.SIGINT)
        if run.wait() == 0:
            assert left(FOLDER) == whole
            shutil.rmtree(FOLDER)
            continue
        stopped += 1
        assert run.code == 130, (run.code, run.err)
        assert told_of_the_interruption(run.err)
        assert drafts(FOLDER) == [] and not Path("calib-error.log").exists()
    assert start().wait() == 0
    assert left(FOLDER) == whole


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, 3])
def test_interrupted_again_while_leaving(mast, runner, left, whole, times):
    draw = random.Random(5)

    def press_again_and_again(run):
        time.sleep(0.3)
        for _ in range(40):  # until it is over
            run.send(signal.SIGINT, everybody=True)
            time.sleep(draw.uniform(0.0, 0.02))

    for _ in range(times):
        run = interrupted(lambda: runner.fork("calibrate", "mast", "--workers", "2"), press_again_and_again)
        assert told_of_the_interruption(run.err) and run.nobody_left()
    again = runner.fork("calibrate", "mast", "--workers", "1")
    assert again.wait() == 0
    assert left(FOLDER) == whole[0]


@pytest.mark.slow
def test_two_runs_at_once_on_one_ledger(mast, runner, left, whole):
    runs = [runner.fork("calibrate", "mast", "--workers", "1") for _ in range(2)]
    assert [run.wait() for run in runs] == [0, 0], [run.err for run in runs]
    assert left(FOLDER) == whole[0]


@pytest.mark.slow
def test_a_thread_that_a_model_leaves_running_does_not_keep_the_command(mast, runner):
    """The matrices are made in the command's own process."""
    model = mast / "model.py"
    model.write_text("import threading\nthreading.Thread(target=threading.Event().wait).start()\n" + model.read_text())
    run = runner.command("compare", "mast")
    assert run.wait() == 0 and "Found:" in run.out
    assert interrupt.LEFT_RUNNING in run.err and run.nobody_left()


SLOWLY = """
import time
from pathlib import Path

def answer(values):
    time.sleep(0.02)
    with Path("answered").open("a") as stream:
        stream.write("one\\n")
    return {"y": values["a"] + values["b"], "z": values["a"]}
"""


@pytest.mark.slow
@pytest.mark.parametrize(("sign", "workers"), [(signal.SIGINT, 1), (signal.SIGKILL, 2)])
def test_a_stop_loses_only_what_is_under_way(plain, runner, rows, undrawn, monkeypatch, sign, workers):
    """The function of one worker runs in a process of its own, too, which is ended in the same way."""
    plain(SLOWLY)
    log, ledger = Path("answered"), Path("results/plain/ledger.sqlite")

    def answered() -> int:
        return len(log.read_text().split()) if log.exists() else 0

    run = runner.fork("sensitivity", "plain", "--workers", str(workers), "--quick")
    run.until(lambda: answered() >= 7)
    before = answered()  # outcomes so far have arrived when the next points are in progress
    run.until(lambda: answered() >= before + workers)
    run.send(sign, everybody=sign == signal.SIGINT)
    run.wait()
    assert run.code == (130 if sign == signal.SIGINT else -sign)
    assert len(rows(ledger)[0]) >= before - workers  # those may not have arrived yet
    assert run.nobody_left()
    kept, asked = len(rows(ledger)[0]), answered()
    again = runner.fork("sensitivity", "plain", "--workers", "1", "--quick")
    assert again.wait() == 0, again.err
    found = rows(ledger)[0]
    assert answered() - asked <= len(found) - kept + 2  # and two at most to see whether the model is the same
    model = Path("plain/model.py")
    model.write_text(model.read_text().replace("time.sleep", ""))
    monkeypatch.setattr("calib.api.staged.isolated", lambda study: study)
    assert cli.execute(["sensitivity", "plain", "--workers", "1", "--quick", "--results", "whole"]) == 0
    folders = Path("results/plain/quick"), Path("whole/plain/quick")
    tables = [{p.name: p.read_bytes() for p in folder.glob("*.csv")} for folder in folders]
    assert tables[0] == tables[1]
