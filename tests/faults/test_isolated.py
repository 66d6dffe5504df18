"""Models that end their process or never return, with default workers: failed rows, and the command goes on."""

import sqlite3
from pathlib import Path

import pytest

from calib import cli
from calib.outcome import TOOK_TOO_LONG, WORKER_DIED

MODEL = """
import ctypes, os, time
from calib.function import FunctionModel
from calib.space import Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("a", 2.0, 1.0, 3.0), Parameter("b", 2.0, 1.0, 3.0)))

def answer(values):
    if values["a"] > 2.75:
        {fault}
    return {{"y": values["a"] + values["b"], "z": values["a"]}}

def model():
    return FunctionModel("faults", SPACE, answer)
"""
STUDY = """
title = "Faults"
model = "model.py:model"
selection = ["a", "b"]
[measurement]
responses = "measured.csv"
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
def faults(here, undrawn):
    def make(fault: str) -> None:
        Path("faults").mkdir()
        Path("faults/model.py").write_text(MODEL.format(fault=fault))
        Path("faults/study.toml").write_text(STUDY)
        Path("faults/measured.csv").write_text("response,value,std\ny,3.0,0.1\nz,1.0,0.1\n")

    return make


def rows():
    with sqlite3.connect("results/faults/ledger.sqlite") as database:
        return database.execute(
            "SELECT value, status, error FROM evaluations JOIN parameters USING (fingerprint, key, attempt)"
            " WHERE name = 'a'"
        ).fetchall()


@pytest.mark.parametrize(
    ("fault", "told", "more"),
    [("os._exit(3)", WORKER_DIED, []), ("time.sleep(1000)", f"{TOOK_TOO_LONG} 1 s", ["--workers", "1"])],
)
def test_a_point_that_ends_its_process_is_a_row_whatever_the_workers(faults, fault, told, more, runner):
    faults(fault)
    run = runner.fork("sensitivity", "faults", *more)  # were it to end this process, the run would tell
    assert run.wait() == 0, run.err
    found = rows()
    assert len(found) == 9 and any(a > 2.75 for a, _, _ in found)
    for a, status, error in found:
        assert (status, error) == (("failed", told) if a > 2.75 else ("ok", "")), a
    assert run.nobody_left()


def test_least_squares_survives_such_a_point_too(faults, runner):
    faults("os._exit(3)")
    for method in ("gauss-newton", "genetic"):
        run = runner.fork("calibrate", "faults", "--method", method)
        assert run.wait() == 0, run.err
    assert any(status == "failed" for _, status, _ in rows())


def test_adopted_values_that_end_the_process_are_told(faults, capsys):
    faults("ctypes.string_at(0)")
    study = Path("faults/study.toml")
    study.write_text(study.read_text() + "[parameters.a]\nvalue = 2.9\n")
    assert cli.execute(["compare", "faults"]) == 2
    assert WORKER_DIED in capsys.readouterr().err
