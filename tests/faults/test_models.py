"""Models that fail: every fault is a row with a clear message, and the study goes on."""

import json
import sqlite3
import sys
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import pytest

from calib.command import cli
from calib.errors.errors import InputError
from calib.execution.evaluate import Evaluator
from calib.execution.outcome import TOOK_TOO_LONG, WORKER_DIED
from calib.execution.worker import Board
from calib.results.ledger import Ledger

# One integer parameter chooses what goes wrong.
KINDS = """
import json, os, signal, sys, time
import numpy as np
from calib.errors.errors import EvaluationError
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

SPACE = ParameterSpace((
    Parameter("what", 0.0, 0.0, {last}, integer=True), Parameter("a", 2.0, 1.0, 3.0), Parameter("b", 2.0, 1.0, 3.0)
))

def deeper(x):
    return deeper(x) + 1

def answer(values):
    what, a, b = values["what"], values["a"], values["b"]
    if what == 1:
        raise ValueError("no such load case")
    if what == 2:
        return {{"y": float(np.array([np.nan, 1.0]).sum()), "z": 1.0}}
    if what == 3:
        sys.exit("licence server not found")
    if what == 4:
        deeper(0)
    if what == 5:
        raise MemoryError
    if what == 6:
        print("solver banner", a)
        print("warning", file=sys.stderr)
    if what == 7:
        os.makedirs("run", exist_ok=True)
        os.chdir("run")
    if what == 8:
        values["a"] = values["b"] = 1e9
        values.clear()
    if what == 9:
        return {{"y": a}}
    if what == 10:
        raise EvaluationError("the solver did not converge")
    if what == 11:
        raise GeneratorExit("foreign panic")
    if what == 12:
        os._exit(0)
    if what == 13:
        os.kill(os.getpid(), signal.SIGKILL)
    if what == 14:
        time.sleep(1000)
    return {{"y": a + b / 2, "z": b / 2}}

def model():
    return FunctionModel("faults", SPACE, answer)
"""
SAID = {
    0: "",
    1: "ValueError: no such load case",
    2: "the response 'y' is nan",
    3: "SystemExit: licence server not found",
    4: "RecursionError: maximum recursion depth exceeded",
    5: "there was not enough memory",
    6: "",
    7: "",
    8: "",
    9: "the function gave no z (it gave y)",
    10: "the solver did not converge",
    11: "GeneratorExit: foreign panic",
    12: WORKER_DIED,
    13: WORKER_DIED,
    14: f"{TOOK_TOO_LONG} 2 s",
}

pytestmark = pytest.mark.usefixtures("functions_in_this_process")


@pytest.fixture
def faulty(here, monkeypatch):
    """A study of which every fault up to the given one occurs."""
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])

    def make(last: int) -> None:
        Path("faulty").mkdir()
        Path("faulty/model.py").write_text(KINDS.format(last=last))
        Path("faulty/measured.csv").write_text("response,value,std\ny,3.0,0.1\nz,1.0,0.1\n")
        Path("faulty/study.toml").write_text(
            'title = "Faulty"\nmodel = "model.py:model"\nselection = ["what", "a", "b"]\n'
            '[measurement]\nresponses = "measured.csv"\n'
            f"[sensitivity]\nsamples = {2 * (last + 1)}\n"
            "[calibration]\nmethod = 'genetic'\npopulation = 12\ngenerations = 4\ncases = [{ name = 'A1', seed = 1 }]\n"
        )

    return make


def evaluations() -> list[tuple[int, str, str]]:
    with sqlite3.connect("results/faulty/ledger.sqlite") as database:
        found = database.execute(
            "SELECT value, status, error FROM evaluations JOIN parameters USING (fingerprint, key, attempt)"
            " WHERE name = 'what'"
        ).fetchall()
    return [(int(value), status, error) for value, status, error in found]


def check_rows(last: int) -> None:
    rows = evaluations()
    assert {what for what, _, _ in rows} == set(range(last + 1))
    for what, status, error in rows:
        assert (status, error.startswith(SAID[what])) == ("failed" if SAID[what] else "ok", True), (what, error)


@pytest.mark.medium
def test_every_fault_in_this_process_is_a_row(faulty, here):
    faulty(11)
    assert cli.execute(["sensitivity", "faulty", "--workers", "1"]) == 0
    check_rows(11)
    assert len(evaluations()) == 25  # and the nominal values
    assert Path.cwd() == here and Path("results/faulty/sensitivity.csv").exists()
    assert cli.execute(["calibrate", "faulty", "--workers", "1"]) == 0
    summary = json.loads(Path("results/faulty/summary.json").read_text())
    assert summary["evaluations"] == 48 and summary["failed"] > 0
    assert not Path("calib-error.log").exists() and not list(Path().rglob("run/results"))


@pytest.mark.slow
def test_every_fault_in_worker_processes_is_a_row(faulty, late_only_where):
    faulty(14)
    late_only_where(lambda values: values["what"] == 14)
    study = Path("faulty/study.toml")
    study.write_text(study.read_text().replace("[calibration]", "[calibration]\ntime_limit = 2.0", 1))
    assert cli.execute(["sensitivity", "faulty", "--workers", "2"]) == 0
    check_rows(14)
    assert len(evaluations()) == 31
    assert cli.execute(["calibrate", "faulty", "--workers", "2"]) == 0
    check_rows(14)


@pytest.mark.medium
def test_a_model_that_fails_at_its_nominal_values(plain, capsys, one_sentence):
    plain("def answer(values):\n    import sys\n    sys.exit(0)")
    for verb in ("compare", "calibrate", "run"):
        capsys.readouterr()
        assert cli.execute([verb, "plain"]) == 2
        said = capsys.readouterr().err
        assert "at its nominal values: SystemExit: 0 (model.py, line " in said and one_sentence(said)


@pytest.mark.slow
def test_a_model_that_leaves_for_another_directory(plain, here, monkeypatch):
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    plain("import os\ndef answer(values):\n    os.chdir('/')\n    return {'y': values['a'], 'z': values['b']}")
    assert cli.execute(["run", "plain", "--workers", "1"]) == 0
    assert Path.cwd() == here and Path("results/plain/summary.json").exists()


# -- time limit --------------------------------------------------------------------------------------------------------

# Workers import the source by name; it needs little, so that they start quickly.
SLOW = """
import os, time

def answer(values):
    with open(values_log, "a") as stream:
        stream.write(f"{values['x']:g}\\n")
    if values["x"] < 0:
        time.sleep(1000)
    if values["x"] > 100:
        os._exit(1)
    time.sleep(0.02)
    return {"y": values["x"]}

values_log = os.environ["CALIB_TEST_LOG"]

def source():
    return answer
"""


@pytest.fixture
def slow(tmp_path, monkeypatch):
    (tmp_path / "slow_model.py").write_text(SLOW)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("CALIB_TEST_LOG", str(tmp_path / "log"))
    import slow_model

    yield slow_model.source
    sys.modules.pop("slow_model")


@pytest.fixture
def only_hanging_points_are_late(late_only_where):
    late_only_where(lambda values: values["x"] < 0)


def points(*xs):
    return [{"x": float(x)} for x in xs]


@pytest.mark.medium
@pytest.mark.usefixtures("only_hanging_points_are_late")
def test_a_point_that_hangs_is_abandoned(slow, tmp_path):
    with Evaluator(slow, 2, time_limit=0.5) as evaluator:
        outcomes = evaluator.evaluate(points(1, 2, -1, 3, -2, 4, 5, 6))
        again = evaluator.evaluate(points(7, 1))
    assert [o.error for o in outcomes] == [
        "",
        "",
        "it took longer than 0.5 s",
        "",
        "it took longer than 0.5 s",
        "",
        "",
        "",
    ]
    assert [o.responses.get("y") for o in outcomes] == [1, 2, None, 3, None, 4, 5, 6]
    assert [o.responses["y"] for o in again] == [7, 1]
    late = [o for o in outcomes if o.status == "failed"]
    assert all(o.transient and o.seconds >= 0.5 for o in late)
    asked = (tmp_path / "log").read_text().split()
    # Abandoning one point is enough; its neighbour may be restarted.
    assert sorted((asked.count("-1"), asked.count("-2"))) in ([1, 1], [1, 2])


@pytest.mark.slow
@pytest.mark.usefixtures("only_hanging_points_are_late")
def test_hanging_and_dying_in_one_batch(slow):
    with Evaluator(slow, 2, time_limit=0.5) as evaluator:
        outcomes = evaluator.evaluate(points(1, 101, -1, 2, 102, -2, 3))
    assert [o.error for o in outcomes] == [
        "", WORKER_DIED, "it took longer than 0.5 s", "", WORKER_DIED, "it took longer than 0.5 s", ""
    ]  # fmt: skip


def test_many_points_together_may_take_longer_than_one(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("calib.execution.worker.time", SimpleNamespace(monotonic=lambda: now[0]))
    board = Board(get_context("spawn"), 2)
    for number in range(40):
        board.note(1, number)
        now[0] += 0.2
        assert board.late(0.25) == {}
        board.clear(1)
    board.note(0, 40)
    board.note(1, 41)
    now[0] += 0.3
    assert board.late(0.25) == pytest.approx({40: 0.3, 41: 0.3})


@pytest.mark.medium
@pytest.mark.usefixtures("only_hanging_points_are_late")
def test_a_point_given_up_is_tried_again_by_the_next_run(slow, tmp_path):
    path = tmp_path / "ledger.sqlite"
    for limit in (0.3, 0.4):
        with Ledger.open(path) as ledger, Evaluator(slow, 2, time_limit=limit) as evaluator:
            for _ in range(2):
                outcomes = ledger.evaluate("f", points(1, -1), evaluator)
            assert outcomes[1].error == f"it took longer than {limit:g} s"
    asked = (tmp_path / "log").read_text().split()
    assert asked.count("-1") == 2 and set(asked) == {"-1", "1"}


def test_an_impossible_limit():
    for limit in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(InputError, match="time limit"):
            Evaluator(dict, 2, limit)
