import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.errors.errors import EvaluationError, InputError
from calib.execution.evaluate import Evaluator
from calib.execution.outcome import OUT_OF_MEMORY, WORKER_DIED, attempt

# Workers import the factory by name, so it lives in a module of its own on the path.
MODULE = """
import logging, os, signal, subprocess, sys, threading, time, warnings
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_info

from calib.errors.errors import EvaluationError, InputError


@dataclass(frozen=True)
class Source:
    log: str = ""
    kind: str = "sum"

    def __call__(self):
        if self.log:
            with open(self.log, "a") as stream:
                stream.write(f"{os.getpid()}\\n")
        if self.kind == "unbuildable":
            raise InputError("the study changed", place="study.toml")
        if self.kind == "bug":
            raise KeyError("nothing here")
        if self.kind == "dies at start":
            os._exit(1)
        return globals()["answer"]


def answer(values):
    x = values["x"]
    if x == -1:
        raise EvaluationError("no convergence")
    if x == -2:
        np.linalg.inv(np.zeros((2, 2)))
    if x == -3:
        raise InputError("unknown parameter", place="model")
    if x == -4:
        os._exit(3)
    if x == -5:
        return {"y": float("inf")}
    if x == -6:
        time.sleep(30)
    if x in (-8, -9):
        os.kill(os.getpid(), signal.SIGTERM)
    if x == -9:
        raise EvaluationError("the solver has ended")
    if x == -10:
        return {"code": subprocess.run(["sh", "-c", "kill -TERM $$"]).returncode}
    if x == -11:
        warnings.warn("of a library"), logging.getLogger("library").warning("of a library")
    if x == -7:
        threading.Thread(target=threading.Event().wait).start()
    threads = max((p["num_threads"] for p in threadpool_info()), default=1)
    matrix = np.cos(np.arange(90000.0).reshape(300, 300) * x)
    return {
        "y": float(np.sum(matrix @ matrix)),
        "missing": float("nan"),
        "threads": threads,
        "environment": float(os.environ.get("OPENBLAS_NUM_THREADS", -1)),
        "pid": os.getpid() if x == 7 else 0,
    }
"""


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("factory")
    (folder / "evaluation_factory.py").write_text(MODULE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        import evaluation_factory

        yield evaluation_factory.Source
    sys.modules.pop("evaluation_factory")


def points(*xs):
    return [{"x": float(x)} for x in xs]


def alive(pid):
    # A process that ended but was not yet waited for still answers signals.
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def gone(pids):
    until = time.monotonic() + 20
    while any(alive(p) for p in pids) and time.monotonic() < until:
        time.sleep(0.02)
    return not any(alive(p) for p in pids)


# -- one point ---------------------------------------------------------------------------------------------------------


class Silent(Exception):
    """An exception that fails to say why it was raised."""

    def __str__(self):
        raise ValueError("no text")


def fails(fault):
    def function(values):
        raise fault

    return attempt(function, {"x": 1.0})


RAISED = fails.__code__.co_firstlineno + 2


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (EvaluationError("no\n  convergence"), "no convergence"),
        (np.linalg.LinAlgError("singular"), "LinAlgError: singular"),
        (ZeroDivisionError("zero"), "ZeroDivisionError: zero"),
        (KeyError("k"), "KeyError: 'k'"),
        (SystemExit(4), "SystemExit: 4"),
        (SystemExit(), "SystemExit"),
        (Silent(), "Silent: its text cannot be made"),
        (MemoryError(), OUT_OF_MEMORY),
    ],
)
def test_a_failure_is_a_row(fault, text):
    outcome = fails(fault)
    where = "" if isinstance(fault, EvaluationError | MemoryError) else f" (test_evaluate.py, line {RAISED})"
    assert (outcome.status, outcome.error, outcome.responses, outcome.values) == (
        "failed",
        text + where,
        {},
        {"x": 1.0},
    )
    assert outcome.transient == (text == OUT_OF_MEMORY)


def test_faults_of_the_setup_and_the_keyboard_are_no_rows():
    for fault in (InputError("unknown parameter"), KeyboardInterrupt()):
        with pytest.raises(type(fault)):
            fails(fault)


@pytest.mark.parametrize("answer", [None, {"y": "much"}, {"y": 1j}, {"y": math.inf}, {"y": -math.inf}])
def test_an_answer_that_is_no_number_is_a_failure(answer):
    outcome = attempt(lambda values: answer, {"x": 1.0})
    assert outcome.status == "failed" and outcome.error and outcome.responses == {}


def test_not_available_is_an_answer():
    outcome = attempt(lambda values: {"y": np.float64(2.0), "z": math.nan}, {"x": np.float64(1.0)})
    assert outcome.status == "ok" and outcome.responses["y"] == 2.0 and math.isnan(outcome.responses["z"])
    assert type(outcome.values["x"]) is float and type(outcome.responses["y"]) is float


def test_the_function_cannot_change_the_point():
    outcome = attempt(lambda values: {"y": values.pop("x")}, {"x": 1.0})
    assert outcome.values == {"x": 1.0}


def test_no_workers():
    with pytest.raises(InputError, match="0 workers"):
        Evaluator(dict, 0)


# -- batches -----------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_workers_change_nothing(source, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    batch = points(*np.linspace(0.1, 0.9, 13), -1, -2, -5, 0.3)
    with Evaluator(source(), 1) as one, Evaluator(source(), 2) as two:
        serial, parallel = one.evaluate(batch), two.evaluate(batch)
        again = two.evaluate(batch[::-1])[::-1]
        assert two.evaluate([]) == []
    assert repr([(o.values, o.status, o.responses, o.error) for o in serial]) == repr(
        [(o.values, o.status, o.responses, o.error) for o in parallel]
    )
    assert [o.responses.get("y") for o in again] == [o.responses.get("y") for o in parallel]
    assert [o.values for o in parallel] == batch
    assert [o.status for o in serial[13:]] == ["failed", "failed", "failed", "ok"]


@pytest.mark.parametrize(
    ("workers", "xs"),
    [(1, (0.1, -1, -5, 0.3)), pytest.param(2, (0.1, -6, -4, 0.2, -1, 0.3), marks=pytest.mark.slow)],
)
def test_every_outcome_is_told_once(source, workers, xs):
    told = []
    with Evaluator(source(), workers, time_limit=2.0) as evaluator:
        outcomes = evaluator.evaluate(points(*xs), told.append)
    assert sorted(told, key=lambda o: o.values["x"]) == sorted(outcomes, key=lambda o: o.values["x"])
    assert [o.values["x"] for o in outcomes] == list(xs)


def test_an_outcome_is_told_before_the_next_one_is_asked():
    asked, told = [], []

    def function(values):
        assert len(told) == len(asked)
        asked.append(values["x"])
        return {"y": 0.0}

    with Evaluator(lambda: function) as evaluator:
        assert {o.status for o in evaluator.evaluate(points(1, 2, 3), told.append)} == {"ok"}


@pytest.mark.medium
def test_workers_inherit_one_thread_and_the_environment_is_restored(source, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    monkeypatch.delenv("BLIS_NUM_THREADS", raising=False)
    with Evaluator(source(), 2) as evaluator:
        outcomes = evaluator.evaluate(points(1, 2, 3))
    assert {(o.responses["environment"], o.responses["threads"]) for o in outcomes} == {(1.0, 1.0)}
    assert os.environ["OPENBLAS_NUM_THREADS"] == "2" and "BLIS_NUM_THREADS" not in os.environ
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_this_process_uses_one_thread_while_it_evaluates(source):
    with threadpool_limits(2), Evaluator(source(), 1) as evaluator:
        outcomes = evaluator.evaluate(points(1))
        assert max(library["num_threads"] for library in threadpool_info()) == 2
    assert outcomes[0].responses["threads"] == 1


def test_the_function_is_built_once_and_only_when_needed(source, tmp_path):
    log = tmp_path / "built"
    with Evaluator(source(str(log)), 1) as evaluator:
        assert not log.exists()
        evaluator.evaluate(points(1))
        evaluator.evaluate(points(2))
    assert log.read_text().split() == [str(os.getpid())]


@pytest.mark.slow
def test_a_point_that_kills_its_worker_is_a_failed_row(source, tmp_path):
    log = tmp_path / "built"
    with Evaluator(source(str(log)), 2) as evaluator:
        outcomes = evaluator.evaluate(points(1, 2, -4, 3, 4, 5))
        pids = [int(p) for p in log.read_text().split()]
        after = evaluator.evaluate(points(1))
        pids += [int(p) for p in log.read_text().split()]
    assert [o.status for o in outcomes] == ["ok", "ok", "failed", "ok", "ok", "ok"]
    assert outcomes[2].error == WORKER_DIED and outcomes[2].transient
    assert after[0].responses["y"] == outcomes[0].responses["y"]
    assert gone(pids)


@pytest.mark.medium
@pytest.mark.skipif(os.name == "nt", reason="the system has no such signals")
def test_a_worker_leaves_requests_to_end_to_its_parent_and_the_programs_of_a_model_do_not(source):
    with Evaluator(source(), isolated=True) as evaluator:
        program, fine, ended = evaluator.evaluate(points(-10, -8, -9))
    assert program.responses == {"code": -signal.SIGTERM}
    assert fine.status == "ok"
    assert ended.error == WORKER_DIED and ended.transient  # of the request, not of the point


def test_warnings_of_libraries_do_not_reach_the_terminal(source, capfd):
    with Evaluator(source(), isolated=True) as evaluator:
        assert evaluator.evaluate(points(-11))[0].status == "ok"
    assert capfd.readouterr() == ("", "")


@pytest.mark.medium
def test_a_thread_that_the_model_leaves_running_keeps_no_process(source, tmp_path):
    log = tmp_path / "built"
    evaluator = Evaluator(source(str(log)), isolated=True)
    assert evaluator.evaluate(points(-7))[0].status == "ok"
    closing = threading.Thread(target=evaluator.close, daemon=True)  # were it to wait for ever, the test would not
    closing.start()
    closing.join(60.0)
    assert not closing.is_alive() and gone([int(p) for p in log.read_text().split()])


@pytest.mark.slow
def test_faults_of_the_setup_in_a_worker_come_back(source, tmp_path):
    log = tmp_path / "built"
    for kind, fault, text in (("unbuildable", InputError, "study changed"), ("bug", RuntimeError, "KeyError")):
        with pytest.raises(fault, match=text), Evaluator(source(str(log), kind), 2) as evaluator:
            evaluator.evaluate(points(1, 2))
    with pytest.raises(InputError, match="unknown parameter") as caught, Evaluator(source(str(log)), 2) as evaluator:
        evaluator.evaluate(points(1, -3, -6))
    assert caught.value.place == "model"
    assert gone([int(p) for p in log.read_text().split()])


@pytest.mark.medium
def test_workers_that_cannot_start(source):
    with (
        Evaluator(source(kind="dies at start"), 2) as evaluator,
        pytest.raises(InputError, match="end while they start"),
    ):
        evaluator.evaluate(points(1))


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGKILL])
def test_nothing_stays_behind_when_the_parent_is_stopped(source, tmp_path, sign):
    log, script = tmp_path / "built", tmp_path / "run.py"
    script.write_text(
        "from calib.execution.evaluate import Evaluator\nfrom evaluation_factory import Source\n"
        "if __name__ == '__main__':\n"
        f"    with Evaluator(Source({str(log)!r}), 2) as evaluator:\n"
        "        evaluator.evaluate([{'x': -6.0}] * 4)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path)}
    # A group of its own, as a terminal's foreground job: the keyboard's interrupt reaches parent and workers alike.
    # A test run in the background of a shell inherits an ignored interrupt; a foreground job does not.
    parent = subprocess.Popen(
        [sys.executable, str(script)],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    until = time.monotonic() + 30
    while (not log.exists() or len(log.read_text().split()) < 2) and time.monotonic() < until:
        time.sleep(0.02)
    if sign == signal.SIGINT:
        os.killpg(parent.pid, sign)
    else:
        parent.send_signal(sign)
    _, errors = parent.communicate(timeout=20)
    assert parent.returncode == -sign
    assert gone([int(p) for p in log.read_text().split()])
    if sign == signal.SIGINT:
        assert errors.count("Traceback") == 1  # the parent's own; workers say nothing


LATE = """
import os, sys, time
if os.environ["PARENT"] == str(os.getpid()):  # the real module
    place = sys.path.pop(0)
    del sys.modules["threadpoolctl"]
    import threadpoolctl
    sys.path.insert(0, place)
else:
    with open(os.environ["SAID"], "w") as said:
        said.write("importing")
        said.flush()
        time.sleep(1e5)
"""
LONGEST = 300.0
STARTS = {
    "workers": "from calib.execution.evaluate import Evaluator; Evaluator(dict, 2).evaluate([{'x': 1.0}])",
    "team": "from calib.execution.team import Team; t = Team(2); t(operator.add, 0, range(100)); time.sleep(1e5)",
    "apart": "from calib.execution.worker import apart; apart(abs, -1)",
}


@pytest.mark.medium
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
@pytest.mark.parametrize("start", STARTS)
def test_a_process_that_is_still_importing_when_its_parent_is_killed_ends_too(tmp_path, start):
    (tmp_path / "threadpoolctl.py").write_text(LATE)
    os.mkfifo(tmp_path / "said")
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1]), "SAID": str(tmp_path / "said")}
    script = (
        f"import operator, os, sys, time; os.environ['PARENT'] = str(os.getpid()); sys.path[0] = {str(tmp_path)!r};"
    )
    parent = subprocess.Popen([sys.executable, "-c", script + STARTS[start]], env=environment)
    said = os.open(tmp_path / "said", os.O_RDONLY)
    assert os.read(said, 9) == b"importing"
    parent.kill()
    parent.wait()
    words = b"importing"
    while words and select.select([said], [], [], LONGEST)[0]:
        words = os.read(said, 99)
    os.close(said)
    assert not words  # every process that could write has ended
