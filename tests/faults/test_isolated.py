"""Models that end their process or never return, with default workers: failed rows, and the command goes on."""

import sqlite3
from pathlib import Path

import pytest

from calib.command import cli
from calib.execution.outcome import TOOK_TOO_LONG, WORKER_DIED

FUNCTION = """
import ctypes, os, time

def answer(values):
    if values["a"] > 2.75:
        FAULT
    return {"y": values["a"] + values["b"], "z": values["a"]}
"""
ASKED = """
[sensitivity]
samples = 8
[calibration]
starts = 2
time_limit = 1.0
population = 6
generations = 3
cases = [{ name = "A1", seed = 1 }]
"""


@pytest.fixture
def faults(plain, undrawn):
    """Makes the plain study with a function that does that where ``a`` is large."""
    return lambda fault: plain(FUNCTION.replace("FAULT", fault), ASKED)


def rows():
    with sqlite3.connect("results/plain/ledger.sqlite") as database:
        return database.execute(
            "SELECT value, status, error FROM evaluations JOIN parameters USING (fingerprint, key, attempt)"
            " WHERE name = 'a'"
        ).fetchall()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "told", "more"),
    [("os._exit(3)", WORKER_DIED, []), ("time.sleep(1000)", f"{TOOK_TOO_LONG} 1 s", ["--workers", "1"])],
)
def test_a_point_that_ends_its_process_is_a_row_whatever_the_workers(
    faults, fault, told, more, runner, late_only_where
):
    faults(fault)
    late_only_where(lambda values: values["a"] > 2.75)
    run = runner.fork("sensitivity", "plain", *more)  # were it to end this process, the run would tell
    assert run.wait() == 0, run.err
    found = rows()
    assert len(found) == 9 and any(a > 2.75 for a, _, _ in found)
    for a, status, error in found:
        assert (status, error) == (("failed", told) if a > 2.75 else ("ok", "")), a
    assert run.nobody_left()


@pytest.mark.slow
def test_least_squares_survives_such_a_point_too(faults, runner):
    faults("os._exit(3)")
    for method in ("gauss-newton", "genetic"):
        run = runner.fork("calibrate", "plain", "--method", method)
        assert run.wait() == 0, run.err
    assert any(status == "failed" for _, status, _ in rows())


@pytest.mark.slow
def test_adopted_values_that_end_the_process_are_told(faults, capsys):
    faults("ctypes.string_at(0)")
    study = Path("plain/study.toml")
    study.write_text(study.read_text() + "[parameters.a]\nvalue = 2.9\n")
    assert cli.execute(["compare", "plain"]) == 2
    assert WORKER_DIED in capsys.readouterr().err
