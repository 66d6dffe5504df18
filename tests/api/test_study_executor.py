"""A study evaluated by an executor: tables are those of calib's own pool; unsupported settings are refused."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pandas as pd
import pytest

import calib
from calib.analyses.calibrate import calibrate
from calib.analyses.provenance import places
from calib.analyses.sensitivity import sensitivity
from calib.execution.executor import Injected
from calib.execution.tasks import unreported
from calib.execution.team import Team
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy

STUDIES = Path(__file__).resolve().parents[2] / "studies"

MODEL = """
from calib import FunctionModel, Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("k", 30.0, 1.0, 100.0, "kN/m"), Parameter("m", 7.0, 1.0, 50.0, "kg")))

def model():
    return FunctionModel("oscillator", SPACE, lambda v: {"w2": 1e3 * v["k"] / v["m"], "sag": 9.81 * v["m"] / v["k"]})
"""
STUDY = """
title = "Oscillator"
model = "model.py:model"
sensitivity = {{ samples = 30 }}
measurement = {{ responses = "measured.csv", synthetic = true }}
calibration = {{ population = 6, generations = 4{more} }}
"""
MEASURED = "response,value,std\nw2,4000.0,10.0\nsag,2.4525,0.01\n"  # of 40 kN/m and 10 kg


def oscillator(folder, more=""):
    folder.mkdir()
    (folder / "model.py").write_text(MODEL)
    (folder / "study.toml").write_text(STUDY.format(more=more))
    (folder / "measured.csv").write_text(MEASURED)
    return folder


class Threads(ThreadPoolExecutor):
    """Threads that know how many points they were given."""

    points = 0

    def submit(self, *args, **kwargs):
        self.points += 1
        return super().submit(*args, **kwargs)


def processes():
    return ProcessPoolExecutor(1, get_context("spawn"))


def tables(folder):
    """All tables of a folder."""
    return {path.name: pd.read_csv(path) for path in sorted(folder.glob("*.csv"))}


def require_same(one, other):
    assert one.keys() == other.keys() and one
    for name, table in one.items():
        pd.testing.assert_frame_equal(table, other[name], check_exact=True, obj=name)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Tables of the four-storey rig by its own pool."""
    return asked_of_rig(tmp_path_factory.mktemp("rig"), 1)


def asked_of_rig(root, workers):
    study, results = LoadedStudy.load(STUDIES / "four_storey_rig"), Results.at(root, "four_storey_rig")
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        sensitivity(study, results, ledger, workers, quick=True)
        calibrate(study, results, ledger, workers, "R1", quick=True, method="genetic")
    return tables(results.path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [lambda: Threads(3), processes],
    ids=["threads", "another process"],
)
def test_a_model_of_matrices_has_the_tables_of_the_own_pool(rig, make, tmp_path):
    with make() as executor:
        require_same(rig, asked_of_rig(tmp_path, Injected(executor)))
    if isinstance(executor, Threads):
        assert executor.points >= len(rig["sensitivity_samples.csv"])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A study of a function, run by its own pool."""
    root = tmp_path_factory.mktemp("oscillator")
    study = calib.Study.load(oscillator(root / "oscillator"), root / "results")
    study.run()
    return study


@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda: Threads(2), processes], ids=["threads", "another process"])
def test_a_whole_run_of_a_function_has_the_tables_of_the_own_pool(run, make, tmp_path):
    with make() as executor:
        found = calib.Study.load(run.path, tmp_path).run(executor=executor)
    if isinstance(executor, Threads):
        assert executor.points >= 30
    require_same(tables(run.folder.path), tables(found.folder.path))
    assert found.workers is None  # goes on with its own: those of the executor are shut down


@pytest.mark.slow
def test_a_time_limit_that_the_executor_does_not_keep_is_refused(undrawn, tmp_path):
    study = calib.Study.load(oscillator(tmp_path / "oscillator", ", time_limit = 60.0"), tmp_path / "results")
    with Threads(1) as threads:
        for ask in (study.run, study.calibrate, study.sensitivity):
            with pytest.raises(calib.InputError, match="60 s"):
                ask(executor=threads)
            with pytest.raises(calib.InputError, match="60 s"):
                ask(executor=Injected(threads, time_limit=30.0))
        assert not threads.points and not (tmp_path / "results").exists()
        study.sensitivity(executor=Injected(threads, time_limit=60.0))
        assert threads.points == 30


def test_workers_beside_an_executor_and_what_is_no_executor_are_refused(tmp_path):
    folder = oscillator(tmp_path / "oscillator")
    with Threads(1) as threads:
        with pytest.raises(calib.InputError, match="2 workers"):
            calib.Study.load(folder, tmp_path / "results", workers=2).run(executor=threads)
        with pytest.raises(calib.InputError, match="executor"):
            calib.Study.load(folder, tmp_path / "results").run(executor=3)
        assert not threads.points and not (tmp_path / "results").exists()


@pytest.fixture
def teams(monkeypatch):
    """Workers of each team with whether it waits, and the number of items of each call; no process is started."""
    seen = []

    class Seen(Team):
        def __init__(self, workers, patience=0.0):
            super().__init__(1)
            seen.append((workers, patience > 0, []))

        def __call__(self, function, shared, items, told=unreported):
            seen[-1][2].append(len(items))
            return super().__call__(function, shared, items, told)

    monkeypatch.setattr(places, "Team", Seen)
    monkeypatch.setattr("calib.report.figures.content", lambda figure, name, formats, *_: {"png": name.encode()})
    return seen


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("workers", [1, 2, None])
def test_those_who_compute_draw_too(tmp_path, teams, workers):
    study = calib.Study.load(oscillator(tmp_path / "oscillator"), tmp_path / "results", workers=workers)
    study.compare()
    study.report()
    expected = (places.available_cores(), True) if workers is None else (workers, False)
    assert [one[:2] for one in teams] == [expected, expected]
    pictures = len(list((tmp_path / "results/oscillator").glob("*.png")))
    assert pictures and all(pictures in one[2] for one in teams)


@pytest.mark.slow
def test_an_executor_gets_no_figures_and_nobody_else_is_asked(tmp_path, teams):
    study = calib.Study.load(oscillator(tmp_path / "oscillator"), tmp_path / "results")
    with ThreadPoolExecutor(1) as threads:
        study.calibrate(executor=threads)
    assert not teams and list((tmp_path / "results/oscillator").glob("*.png"))
