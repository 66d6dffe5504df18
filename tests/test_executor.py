"""Given executors: the same table as without one, failures as rows, and unsupported settings refused."""

import os
import pickle
import queue
import signal
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from calib.errors.errors import InputError
from calib.execution.evaluate import Evaluator
from calib.execution.executor import ExecutorEvaluator, Injected
from calib.execution.outcome import TOOK_TOO_LONG, WORKER_DIED
from calib.results.ledger import Ledger

# Other processes import the source by name, so it lives in a module of its own on the path.
MODULE = """
import os, time
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_info

from calib.errors.errors import EvaluationError, InputError


@dataclass(frozen=True)
class Source:
    log: str = ""
    kind: str = ""

    def __call__(self):
        if self.log:
            with open(self.log, "a") as stream:
                stream.write(f"{os.getpid()}\\n")
        if self.kind == "unbuildable":
            raise InputError("the study changed", place="study.toml")
        if self.kind == "bug":
            raise KeyError("nothing here")
        return answer


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
    time.sleep(0.02 * (x < 0.5))  # the first ones come last
    matrix = np.cos(np.arange(40000.0).reshape(200, 200) * x)
    threads = max((p["num_threads"] for p in threadpool_info()), default=1)
    return {"y": float(np.sum(matrix @ matrix)), "missing": float("nan"), "threads": threads}
"""


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sent")
    (folder / "sent_source.py").write_text(MODULE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        import sent_source

        yield sent_source.Source
    sys.modules.pop("sent_source")


def run(task):
    """What a worker of `Cluster` does with a task that arrived as bytes."""
    function, given = pickle.loads(task)
    return pickle.dumps(function(*given))


class Cluster(Executor):
    """Like a cluster's client: tasks travel as bytes to other processes, are taken last in first out, and come back so.

    Its futures are its own, not those of the pool behind it.
    """

    def __init__(self):
        self._pool = ProcessPoolExecutor(2, get_context("spawn"))
        self._waiting = queue.LifoQueue()

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        self._waiting.put((future, pickle.dumps((fn, args))))
        threading.Timer(0.05, self._next).start()
        return future

    def _next(self):
        future, task = self._waiting.get()
        if future.set_running_or_notify_cancel():
            future.set_result(pickle.loads(self._pool.submit(run, task).result()))

    def shutdown(self, wait=True, *, cancel_futures=False):
        self._pool.shutdown(wait)


class Tasks(Executor):
    """Holds all tasks; ``fault`` is raised by submit or by the future, ``stubborn`` futures raise when cancelled."""

    def __init__(self, submit=None, future=None, stubborn=False):
        self._submit, self._future, self._stubborn, self.futures = submit, future, stubborn, []

    def submit(self, fn, /, *args, **kwargs):
        number = len(self.futures)
        future = Stubborn() if self._stubborn else Future()
        self.futures.append(future)
        if self._submit is not None and number % 2:
            raise self._submit
        if self._future is not None and number % 2:
            future.set_exception(self._future)
        elif not (self._stubborn and number):
            future.set_result(fn(*args))
        return future


class Stubborn(Future):
    asked = 0

    def cancel(self):
        Stubborn.asked += 1
        raise RuntimeError("the scheduler cannot be reached")


EXECUTORS = {
    "threads": lambda: ThreadPoolExecutor(3),
    "spawned processes": lambda: ProcessPoolExecutor(2, get_context("spawn")),
    "forked processes": lambda: ProcessPoolExecutor(2, get_context("fork")),
    "cluster": Cluster,
    "at once": Tasks,
}


def points(*xs):
    return [{"x": float(x)} for x in xs]


def table(outcomes):
    return repr([(o.values, o.status, o.responses, o.error) for o in outcomes])


# -- the same table ----------------------------------------------------------------------------------------------------


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("kind", [pytest.param(k, marks=[pytest.mark.slow] * (k == "cluster")) for k in EXECUTORS])
def test_the_table_is_that_of_a_serial_evaluation(source, kind, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")  # of new processes
    batch, heard = points(*np.linspace(0.1, 0.9, 9), -1, -2, 0.3), []
    with Evaluator(source()) as serial:
        expected = table(serial.evaluate(batch))
    with threadpool_limits(2), EXECUTORS[kind]() as executor, ExecutorEvaluator(source(), executor) as evaluator:
        first = evaluator.evaluate(batch, heard.append)
        again = evaluator.evaluate(batch[::-1])[::-1]
        assert evaluator.evaluate([]) == []
    assert table(first) == table(again) == expected
    assert len(heard) == len(batch) and {id(o) for o in heard} == {id(o) for o in first}
    assert {o.responses["threads"] for o in first if o.status == "ok"} == {1.0}


def test_outcomes_are_told_as_they_arrive():
    heard, others = [], threading.Event()

    def waits(values):
        assert values["x"] < 0.6 or others.wait(300)
        return {"y": 0.0}

    def hear(outcome):
        heard.append(outcome)
        if len(heard) == 2:
            others.set()

    with ThreadPoolExecutor(2) as executor, ExecutorEvaluator(lambda: waits, executor) as evaluator:
        outcomes = evaluator.evaluate(points(0.6, 0.0, 0.1), hear)
    assert {o.status for o in outcomes} == {"ok"}
    assert [o.values["x"] for o in outcomes] == [0.6, 0.0, 0.1]
    assert [o.values["x"] for o in heard] == [0.0, 0.1, 0.6]


@pytest.mark.medium
def test_the_function_is_built_once_in_every_process_and_let_go(source, tmp_path):
    for executor, most in ((ThreadPoolExecutor(3), 1), (ProcessPoolExecutor(2, get_context("spawn")), 2)):
        log = tmp_path / f"{most}"
        with executor, ExecutorEvaluator(source(str(log)), executor) as evaluator:
            evaluator.evaluate(points(1, 2, 3, 4))
            evaluator.evaluate(points(1, 2, 3, 4))
            pids = log.read_text().split()
            assert len(set(pids)) == len(pids) <= most
    with ThreadPoolExecutor(1) as executor:
        evaluator = ExecutorEvaluator(source(str(log)), executor)
        evaluator.evaluate(points(1))
        evaluator.close()
        evaluator.evaluate(points(1))
        assert len(log.read_text().split()) == len(pids) + 2


def test_threads_leave_numerical_libraries_and_the_directory_as_they_were(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inner").mkdir()

    def restless(values):
        os.chdir(tmp_path / "inner")
        time.sleep(0.01 * values["x"])
        return {"threads": max(library["num_threads"] for library in threadpool_info())}

    with threadpool_limits(2), ThreadPoolExecutor(3) as executor:
        found = ExecutorEvaluator(lambda: restless, executor).evaluate(points(*range(12)))
        assert max(library["num_threads"] for library in threadpool_info()) == 2
    assert {o.responses["threads"] for o in found} == {1.0}
    assert os.getcwd() == str(tmp_path)


# -- failures are rows -------------------------------------------------------------------------------------------------


def test_a_process_that_dies_fails_its_points_and_loses_none(source):
    with ProcessPoolExecutor(1, get_context("spawn")) as executor, ExecutorEvaluator(source(), executor) as evaluator:
        heard = []
        outcomes = evaluator.evaluate(points(1, 2, -4, 3), heard.append)
        after = evaluator.evaluate(points(1, 2))
    assert [o.status for o in outcomes] == ["ok", "ok", "failed", "failed"] and len(heard) == 4
    assert {o.error for o in (*outcomes[2:], *after)} == {WORKER_DIED}
    assert all(o.transient for o in (*outcomes[2:], *after)) and [o.values["x"] for o in after] == [1, 2]


@pytest.mark.parametrize("where", ["submit", "future"])
def test_an_executor_that_fails_fails_the_point(source, where):
    executor = Tasks(**{where: ConnectionError("the scheduler is gone")})
    outcomes = ExecutorEvaluator(source(), executor).evaluate(points(1, 2, 3, 4))
    assert [o.status for o in outcomes] == ["ok", "failed", "ok", "failed"]
    assert outcomes[1].error.startswith(WORKER_DIED) and "the scheduler is gone" in outcomes[1].error
    assert outcomes[1].transient and outcomes[1].values == {"x": 2.0}


def test_points_that_somebody_cancels_have_failed(source):
    class Cancelled(Tasks):
        def submit(self, fn, /, *args, **kwargs):
            future = Future()
            future.cancel()
            return future

    outcomes = ExecutorEvaluator(source(), Cancelled()).evaluate(points(1, 2))
    assert [(o.status, o.transient) for o in outcomes] == [("failed", True)] * 2


def test_points_that_failed_with_the_executor_are_asked_again_by_one_that_survives(source, tmp_path):
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        broken = ledger.evaluate("f", points(1, 2), ExecutorEvaluator(source(), Tasks(submit=OSError("gone"))))
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger, ThreadPoolExecutor(1) as threads:
        held = ledger.evaluate("f", points(1, 2), ExecutorEvaluator(source(), threads))
        mended = ledger.evaluate("f", points(1, 2), ExecutorEvaluator(source(), Injected(threads, isolated=True)))
    assert [o.status for o in broken] == [o.status for o in held] == ["ok", "failed"]
    assert [o.status for o in mended] == ["ok", "ok"]


@pytest.mark.medium
def test_faults_of_the_setup_come_back(source):
    for kind, fault, text in (("unbuildable", InputError, "study changed"), ("bug", RuntimeError, "KeyError")):
        with ThreadPoolExecutor(2) as executor, pytest.raises(fault, match=text):
            ExecutorEvaluator(source(kind=kind), executor).evaluate(points(1, 2))
    with ProcessPoolExecutor(1, get_context("spawn")) as executor, pytest.raises(InputError) as caught:
        ExecutorEvaluator(source(), executor).evaluate(points(1, -3, 2))
    assert caught.value.place == "model"


def test_what_cannot_be_sent_is_told_and_threads_need_not_send():
    def answer(values):
        return {"y": values["x"]}

    with ProcessPoolExecutor(1, get_context("spawn")) as processes, pytest.raises(InputError, match="sent"):
        ExecutorEvaluator(lambda: answer, processes).evaluate(points(1))
    with ThreadPoolExecutor(1) as threads:
        assert ExecutorEvaluator(lambda: answer, threads).evaluate(points(1))[0].responses == {"y": 1.0}


# -- stopping ----------------------------------------------------------------------------------------------------------


def test_an_interrupt_cancels_what_waits(monkeypatch):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    started, go_on, heard = [], threading.Event(), []

    def waits(values):
        started.append(values["x"])
        if values["x"]:
            go_on.wait(20)
        return {"y": 0.0}

    def interrupt():
        while len(started) < 2 or not heard:  # all points are handed over by then
            time.sleep(0.01)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    try:
        with ThreadPoolExecutor(1) as executor:
            threading.Thread(target=interrupt).start()
            with pytest.raises(KeyboardInterrupt):
                ExecutorEvaluator(lambda: waits, executor).evaluate(points(0, 1, 2, 3), heard.append)
            go_on.set()
    finally:
        signal.signal(signal.SIGINT, before)
    assert started == [0.0, 1.0] and [o.values["x"] for o in heard] == [0.0]


def test_futures_that_cannot_be_cancelled_do_not_hide_why_it_stopped(source):
    executor, Stubborn.asked = Tasks(stubborn=True), 0

    def stop(outcome):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ExecutorEvaluator(source(), executor).evaluate(points(1, 2, 3), stop)
    assert Stubborn.asked == 3


# -- what is promised --------------------------------------------------------------------------------------------------


def test_a_setting_that_the_executor_cannot_keep_is_refused(source):
    with ThreadPoolExecutor(1) as executor:
        for given, settings in (
            (executor, {"time_limit": 5.0}),
            (executor, {"isolated": True}),
            (Injected(executor, time_limit=60.0), {"time_limit": 5.0}),
            (Injected(executor, time_limit=5.0), {"isolated": True}),
        ):
            with pytest.raises(InputError, match="Injected"):
                ExecutorEvaluator(source(), given, **settings)
        both = ExecutorEvaluator(source(), Injected(executor, 5.0, isolated=True), time_limit=5.0, isolated=True)
        assert both.isolated and not ExecutorEvaluator(source(), executor).isolated
        assert both.evaluate(points(1))[0].status == "ok"
        with pytest.raises(InputError):
            Injected(executor, time_limit=0.0)
    with pytest.raises(InputError, match="client"):
        ExecutorEvaluator(source(), dict)


def test_a_task_that_the_executor_has_ended_took_too_long(source):
    executor = Injected(Tasks(future=TimeoutError()), time_limit=2.0)
    outcomes = ExecutorEvaluator(source(), executor, time_limit=2.0).evaluate(points(1, 2))
    assert outcomes[1].error == f"{TOOK_TOO_LONG} 2 s" and outcomes[1].transient and outcomes[0].status == "ok"
