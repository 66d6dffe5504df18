"""Clusters: the table of one process, whatever dies; settings kept or refused; nothing stays behind."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

import calib
from calib.errors.errors import InputError
from calib.execution import cluster_tasks, cluster_worker
from calib.execution.cluster import Cluster
from calib.execution.evaluate import Evaluator
from calib.execution.executor import Injected
from calib.execution.outcome import TOOK_TOO_LONG, WORKER_DIED
from calib.execution.tasks import in_this_process
from calib.study.study_text import read_settings

INSTALLED = pytest.mark.skipif(
    not any((Path(folder) / "distributed").is_dir() for folder in sys.path if folder),
    reason="the extra 'cluster' is not installed",
)

MODULE = """
import os, signal, time

import numpy as np
from threadpoolctl import threadpool_info

from calib.errors.errors import EvaluationError


class Source:
    def __init__(self, log):
        self.log = log
        self.matrix = np.cos(np.arange(40000.0).reshape(200, 200))

    def __setstate__(self, state):
        self.__dict__ = state
        with open(f"{self.log}/read", "a") as stream:
            stream.write(f"{os.getpid()}\\n")

    def __call__(self):
        return self.answer

    def answer(self, values):
        x = values["x"]
        if x == -1:
            raise EvaluationError("no convergence")
        if x == -2:
            os._exit(3)
        if x == -3:
            with open(f"{self.log}/process", "w") as stream:
                stream.write(str(os.getpid()))
            time.sleep(600)
        if x == -4 and not os.path.exists(f"{self.log}/died"):  # its process dies on the first machine only
            open(f"{self.log}/died", "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        if x > 100:
            time.sleep(0.3)
        threads = max((p["num_threads"] for p in threadpool_info()), default=1)
        return {"y": float(np.sum((self.matrix * x) @ self.matrix)), "missing": float("nan"), "threads": threads}
"""


@pytest.fixture
def source(tmp_path, monkeypatch):
    (tmp_path / "cluster_source.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    import cluster_source

    yield cluster_source.Source(str(tmp_path))
    sys.modules.pop("cluster_source")


def points(*xs):
    return [{"x": float(x)} for x in xs]


def table(outcomes):
    return repr([(o.values, o.status, o.responses, o.error) for o in outcomes])


def silent(sentence):
    """Nobody is told."""


def wait_for(what, seconds=120):
    until = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < until
        time.sleep(0.05)


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


# -- names and settings ------------------------------------------------------------------------------------------------


def test_names_of_clusters():
    for name in ("dask", "dask://node1:8786", "dask://[::1]:8786"):
        assert Injected.of(name).executor.name == name
    for name in ("ray", "dask:node1:8786", "dask://node1", "dask://node1:8786/x", ""):
        with pytest.raises(InputError, match="HOST:PORT"):
            Injected.of(name)
    with pytest.raises(InputError, match="3 workers"):
        Injected.of("dask://node1:8786", 3)
    Injected.of("dask://node1:8786").require(60.0, isolated=True)  # it keeps both


@pytest.mark.parametrize(("entry", "good"), [("dask://a:1", True), ("processes", True), ("ray", False)])
def test_the_executor_of_a_study(entry, good, tmp_path):
    file = tmp_path / "study.toml"
    text = 'title = "t"\nmodel = "m.py:m"\nmeasurement = {{ responses = "r.csv" }}\n[compute]\nexecutor = "{}"\n'
    file.write_text(text.format(entry))
    if good:
        assert read_settings(file).compute.executor == entry
    else:
        with pytest.raises(InputError, match=r"line 5.*HOST:PORT"):
            read_settings(file)


def test_workers_of_another_version_are_refused_in_one_sentence():
    own = cluster_worker.library_versions()
    cluster_worker.require_same(own, "tcp://a:1")
    assert {"calib", "Python", "numpy"} <= set(own)
    with pytest.raises(InputError, match=re.escape(f"tcp://a:1 has calib {own['calib']}, and this")):
        cluster_worker.require_same(own | {"calib": "0.0.1"}, "tcp://a:1")


def test_a_missing_package_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"calib\[cluster\]"):
        Cluster("dask").client()


# -- a cluster of two --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two():
    """A cluster of two workers on this machine."""
    made = Injected.of("dask", 2, silent)
    yield made
    made.close()


@INSTALLED
@pytest.mark.slow
def test_the_table_is_that_of_a_serial_evaluation(source, two, tmp_path):
    given, heard = points(*range(1, 30), -1, -4, -2), []
    with two.evaluator(source, 30.0) as evaluator:
        found = evaluator.evaluate(given, heard.append)
        again = evaluator.evaluate(given[:20])
        assert evaluator.evaluate([]) == []
    (tmp_path / "died").touch()
    with Evaluator(source) as serial:
        expected = serial.evaluate(given[:-1])
    assert table(found[:-1]) == table(expected) and table(again) == table(expected[:20])
    assert found[-1].error == f"{WORKER_DIED} twice" and len(heard) == len(given)
    assert {o.responses["threads"] for o in found if o.status == "ok"} == {1.0}
    children = (tmp_path / "read").read_text().split()
    assert len(children) == len(set(children)) <= 2 + 3  # two, and one after each death


@INSTALLED
@pytest.mark.slow
def test_a_point_beyond_the_time_limit_is_ended(source, two, tmp_path):
    with two.evaluator(source, 1.0) as evaluator:
        late, good = evaluator.evaluate(points(-3, 1))
    assert late.error == f"{TOOK_TOO_LONG} 1 s" and late.transient and good.status == "ok"
    assert not is_alive(int((tmp_path / "process").read_text()))


@INSTALLED
@pytest.mark.slow
def test_workers_that_are_killed_change_no_table(source, two):
    given, client = points(*range(101, 131)), two.executor.client()
    with two.evaluator(source) as evaluator:
        heard = []

        def kill(outcome):
            heard.append(outcome)
            if len(heard) in (3, 12):
                pid = next(iter(client.run(os.getpid).values()))
                os.kill(pid, signal.SIGKILL)

        found = evaluator.evaluate(given, kill)
    with Evaluator(source) as serial:
        assert table(found) == table(serial.evaluate(given))


@INSTALLED
@pytest.mark.slow
def test_an_interrupt_ends_running_points_and_the_next_ones_are_evaluated(source, two, tmp_path):
    def stop(outcome):
        wait_for((tmp_path / "process").exists)
        raise KeyboardInterrupt

    with two.evaluator(source) as evaluator:
        with pytest.raises(KeyboardInterrupt):
            evaluator.evaluate(points(-3, 1, *range(101, 140)), stop)
        pid = int((tmp_path / "process").read_text())
        wait_for(lambda: not is_alive(pid))
        assert evaluator.evaluate(points(1))[0].status == "ok"


@INSTALLED
@pytest.mark.slow
def test_a_scheduler_that_goes_away_is_told_and_nothing_is_lost(source):
    made, heard = Injected.of("dask", 1, silent), []
    scheduler = made.executor.client().run_on_scheduler(os.getpid)

    def end(outcome):
        heard.append(outcome)
        if len(heard) == 2:
            os.kill(scheduler, signal.SIGKILL)

    with pytest.raises(InputError, match="went away"):
        made.evaluator(source).evaluate(points(*range(101, 120)), end)
    assert len(heard) >= 2 and {o.status for o in heard} == {"ok"}
    made.close()


@INSTALLED
@pytest.mark.slow
def test_below_a_nanny_of_dasks_own_points_are_evaluated_and_a_limit_is_refused(source):
    """Its workers are daemons, which may start no process."""
    from distributed import Client as DaskClient
    from distributed import LocalCluster

    with LocalCluster(1, threads_per_worker=2, dashboard_address=None) as made, DaskClient(made) as client:
        for given in (client, client.get_executor()):
            found = Injected.of(given, tell=silent).evaluator(source, None, 60.0).evaluate(points(1, 2, -1))
            assert [o.status for o in found] == ["ok", "ok", "failed"]
        assert {o.responses["threads"] for o in found[:2]} == {1.0}
        with pytest.raises(InputError, match="DAEMON"):
            Injected.of(client).evaluator(source, 60.0).evaluate(points(1))


class At(int):
    stays_here = True


@INSTALLED
@pytest.mark.slow
def test_long_tasks_are_done_by_workers_and_those_that_fail_there_here(two, monkeypatch):
    monkeypatch.setattr(cluster_tasks, "LONG", 0.0)
    here, told = os.getpid(), []

    def task(shared, item):
        if item == 3 and os.getpid() != here:
            os._exit(3)
        if item == 5:
            raise InputError("five", place="item")
        return shared + item, os.getpid()

    heard = []
    share = Injected(Cluster(two.executor.name, client=two.executor.client(), tell=heard.append)).tasks(in_this_process)
    found = share(task, 10, range(3), told.append)
    assert [value for value, _ in found] == [10, 11, 12] and told == sorted(told) and max(told) == 3
    assert found[0][1] == here and here not in {pid for _, pid in found[1:]}
    assert share(task, 10, [3, 3]) == [(13, here)] * 2  # its workers die
    with pytest.raises(InputError, match="five"):
        share(task, 10, [0, 5, 6])
    assert len(heard) == 1 and WORKER_DIED in heard[0]
    assert {pid for _, pid in share(task, At(), [0, 1])} == {here}  # it needs files of this machine
    monkeypatch.setattr(cluster_tasks, "LONG", 1e9)
    assert {pid for _, pid in share(task, 10, [0, 1])} == {here}


# -- studies and problems ----------------------------------------------------------------------------------------------

MODEL = """
from calib import FunctionModel, Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("k", 30.0, 1.0, 100.0, "kN/m"), Parameter("m", 7.0, 1.0, 50.0, "kg")))

def model():
    return FunctionModel("oscillator", SPACE, lambda v: {"w2": 1e3 * v["k"] / v["m"], "sag": 9.81 * v["m"] / v["k"]})
"""
STUDY = """
title = "Oscillator"
model = "model.py:model"
sensitivity = { samples = 30 }
measurement = { responses = "measured.csv", synthetic = true }
calibration = { population = 6, generations = 4, time_limit = 60.0 }
"""
MEASURED = "response,value,std\nw2,4000.0,10.0\nsag,2.4525,0.01\n"  # of 40 kN/m and 10 kg


@pytest.fixture
def oscillator(tmp_path):
    folder = tmp_path / "oscillator"
    folder.mkdir()
    for name, text in (("model.py", MODEL), ("study.toml", STUDY), ("measured.csv", MEASURED)):
        (folder / name).write_text(text)
    return folder


def address_of(made):
    return f"dask://{made.executor.client().scheduler.address.partition('//')[2]}"


def tables(folder):
    return {path.name: pd.read_csv(path) for path in sorted(folder.glob("*.csv"))}


@INSTALLED
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a point takes")
def test_a_study_and_its_command_have_the_tables_of_own_processes(oscillator, two, undrawn, tmp_path):
    address = address_of(two)
    own = calib.Study.load(oscillator, tmp_path / "own", workers=1)
    own.sensitivity()
    own.calibrate()
    by_cluster = calib.Study.load(oscillator, tmp_path / "cluster", executor=address)
    by_cluster.sensitivity()
    by_cluster.calibrate()
    command = [sys.executable, "-m", "calib", "sensitivity", str(oscillator), "--results", str(tmp_path / "command")]
    done = subprocess.run([*command, "--executor", address], capture_output=True, text=True, check=True)
    assert "does not pay" in done.stderr
    expected = tables(tmp_path / "own/oscillator")
    for name, table_ in tables(tmp_path / "cluster/oscillator").items():
        pd.testing.assert_frame_equal(table_, expected[name], check_exact=True, obj=name)
    samples = "sensitivity_samples.csv"
    pd.testing.assert_frame_equal(tables(tmp_path / "command/oscillator")[samples], expected[samples], check_exact=True)


@INSTALLED
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a point takes")
def test_a_function_of_a_notebook_is_fitted_by_a_cluster(two, tmp_path):
    space = calib.ParameterSpace((calib.Parameter("k", 30.0, 1.0, 100.0, "kN/m"),))
    log = tmp_path / "log"

    def answer(values):
        time.sleep(0.03)
        with log.open("a") as stream:
            stream.write(f"{os.getpid()}\n")
        return {"w2": 1e3 * values["k"] / 10.0}

    problem = calib.Problem(calib.FunctionModel("oscillator", space, answer), calib.ResponseTest({"w2": (4e3, 10.0)}))
    found = problem.calibrate(executor=address_of(two), progress=False)
    assert found.values["k"] == pytest.approx(40.0, rel=1e-4)
    assert {*log.read_text().split()} - {str(os.getpid())}
