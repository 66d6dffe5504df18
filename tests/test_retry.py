"""Functions that are called again after failures of one kind: alone, in worker processes, and in a study."""

import subprocess

import pytest

import calib
from calib.command import cli
from calib.errors.errors import EvaluationError, InputError
from calib.execution.evaluate import Evaluator
from calib.results.fingerprint import digest_of
from calib.structure.function_model import DerivativesOnRequest

SPACE = calib.ParameterSpace([calib.Parameter("k", 2.0, 1.0, 3.0)])


class Failing:
    """Fails a number of times before it answers, and counts its calls."""

    def __init__(self, failures, fault):
        self.failures, self.fault, self.calls = failures, fault, 0

    def __call__(self, values):
        self.calls += 1
        if self.calls <= self.failures:
            raise self.fault
        return {"y": 2 * values["k"]}


def noted():
    fault = RuntimeError("solver failed")
    fault.add_note("LICENSE denied")
    return fault


@pytest.mark.parametrize(
    "fault",
    [
        RuntimeError("no LICENSE"), EvaluationError("no LICENSE"), noted(),
        subprocess.CalledProcessError(3, "ccx", output=b"LICENSE server"),
        subprocess.CalledProcessError(3, "ccx", stderr="LICENSE server"),
    ],
)  # fmt: skip
def test_a_failure_of_that_kind_is_repeated_whatever_says_so(fault):
    function = Failing(2, fault)
    assert calib.retrying(function, "LICENSE", times=2, wait=0.0)({"k": 1.5}) == {"y": 3.0}
    assert function.calls == 3


def test_other_failures_end_at_once_and_the_last_one_is_told():
    other, for_ever = Failing(1, ValueError("singular")), Failing(99, RuntimeError("no LICENSE"))
    with pytest.raises(ValueError, match="singular"):
        calib.retrying(other, "LICENSE", wait=0.0)({"k": 1.5})
    with pytest.raises(EvaluationError, match=r"no LICENSE.*3 times"):
        calib.retrying(for_ever, "LICENSE", times=3, wait=0.0)({"k": 1.5})
    assert (other.calls, for_ever.calls) == (1, 4)


def test_it_waits_between_calls(monkeypatch):
    waited = []
    monkeypatch.setattr("calib.execution.worker.time.sleep", waited.append)
    calib.retrying(Failing(2, RuntimeError("no LICENSE")), "LICENSE", wait=7.0)({"k": 1.5})
    assert waited == [7.0, 7.0]


def test_stored_results_stay_valid_with_a_retry():
    def function(values):
        return {"y": values["k"]}

    plain = calib.FunctionModel("f", SPACE, function)
    again = calib.FunctionModel("f", SPACE, calib.retrying(function, "LICENSE"))
    assert again.fingerprint == plain.fingerprint
    assert digest_of(calib.retrying(function, "A", wait=1.0)) == digest_of(function)


def test_derivatives_that_a_function_tells_are_kept():
    class Deriving(Failing):
        def derivatives_by(self, values, names):
            return {f"d(y)/d({name})": 2.0 for name in names}

    function = calib.retrying(Deriving(0, RuntimeError()), "LICENSE")
    assert isinstance(function, DerivativesOnRequest) and function.derivatives_by({}, ["k"]) == {"d(y)/d(k)": 2.0}
    assert not isinstance(calib.retrying(Failing(0, RuntimeError()), "LICENSE"), DerivativesOnRequest)


@pytest.mark.parametrize(
    ("changes", "place"), [({"pattern": "("}, "retry"), ({"times": 0}, "times"), ({"wait": -1.0}, "wait"),
                           ({"function": 3}, "retrying")],
)  # fmt: skip
def test_invalid_arguments_are_refused(changes, place):
    with pytest.raises(InputError) as fault:
        calib.retrying(**{"function": Failing(0, RuntimeError()), "pattern": "LICENSE"} | changes)
    assert place in str(fault.value.place)


def waiting_source():
    return calib.retrying(Failing(1, RuntimeError("no LICENSE")), "LICENSE", wait=1.5)


@pytest.mark.slow
def test_waiting_does_not_count_for_the_time_limit():
    with Evaluator(waiting_source, 1, time_limit=1.0, isolated=True) as evaluator:
        (outcome,) = evaluator.evaluate([{"k": 1.5}])
    assert outcome.status == "ok" and outcome.responses == {"y": 3.0} and outcome.seconds > 1.5


MODEL = """
from pathlib import Path
import calib

TAKEN = Path(__file__).parent / "taken"

def solve(values):
    left = int(TAKEN.read_text()) if TAKEN.exists() else 0
    if left:
        TAKEN.write_text(str(left - 1))
        raise RuntimeError("no LICENSE is free")
    return {"y": values["a"], "z": values["b"]}

def model():
    space = calib.ParameterSpace([calib.Parameter("a", 2.0, 1.0, 3.0), calib.Parameter("b", 2.0, 1.0, 3.0)])
    return calib.FunctionModel("f", space, solve)
"""
STUDY = """
title = "Licences"
model = "model.py:model"
selection = ["a", "b"]
{retry}
[measurement]
responses = "measured.csv"
[sensitivity]
samples = 8
"""


@pytest.fixture
def licences(tmp_path, monkeypatch):
    """A study whose solver finds no licence at first; returns what a sensitivity analysis says."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "licences"
    folder.mkdir()
    (folder / "model.py").write_text(MODEL)
    (folder / "measured.csv").write_text("response,value,std\ny,2.2,0.1\nz,1.9,0.1\n")

    def run(retry, taken, capsys):
        (folder / "study.toml").write_text(STUDY.format(retry=retry))
        (folder / "taken").write_text(str(taken))
        assert cli.execute(["sensitivity", "licences", "--workers", "1"]) == 0
        return capsys.readouterr()

    return run


@pytest.mark.usefixtures("functions_in_this_process", "undrawn")
def test_a_study_calls_its_function_again(licences, capsys):
    said = "".join(licences('retry = { pattern = "LICENSE", times = 6, wait = 0.0 }', 6, capsys))
    assert " 0 failed" in said


@pytest.mark.medium
@pytest.mark.usefixtures("functions_in_this_process", "undrawn")
def test_where_points_failed_the_command_is_named_and_a_retry_keeps_all_others(licences, capsys):
    said = "".join(licences("", 6, capsys))
    assert "of 8 points failed" in said and " 0 failed" not in said and "calib again licences" in " ".join(said.split())
    assert cli.execute(["again", "licences"]) == 0
    capsys.readouterr()
    assert " 0 failed" in "".join(licences('retry = { pattern = "LICENSE" }', 0, capsys))


def test_a_wrong_pattern_is_refused_with_its_line(tmp_path, capsys):
    (tmp_path / "study.toml").write_text(STUDY.format(retry='retry = { pattern = "(" }'))
    assert cli.execute(["sensitivity", str(tmp_path)]) == 2
    assert "retry" in capsys.readouterr().err
