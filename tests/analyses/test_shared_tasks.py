"""Explanations whose tasks other processes share: the same tables to the last byte, for any number of workers."""

import contextlib
import json
import pickle
from pathlib import Path

import pytest

from calib.analyses.explain import explain
from calib.command import cli
from calib.execution.shared_store import SharedStore, read
from calib.execution.tasks import shared_by, unreported
from calib.results.results import Results
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]


class Elsewhere:
    """Does tasks as other processes do, in reverse order, with what a team sends to these."""

    processes = 2

    def __init__(self, store):
        self.store, self.done = store, set()

    def __call__(self, function, shared, items, told=unreported):
        there, content, requested = read(self.store.written((function, shared, items)))
        found = [there(content, item) for item in reversed(requested)][::-1]
        self.done.add(function.__name__)
        return [pickle.loads(pickle.dumps(one)) for one in found]


@pytest.fixture
def store():
    store = SharedStore()
    yield store
    store.close()


def tables(folder):
    """Bytes of all tables, and the summary without what the clock tells."""
    own = {file.name: file.read_bytes() for file in sorted(folder.glob("*.csv"))}
    summary = json.loads((folder / "explanation.json").read_text("utf-8"))
    return own, {key: value for key, value in summary.items() if key != "seconds"}


@pytest.mark.slow
def test_an_explanation_is_the_same_whoever_shares_its_tasks(guyed, store, tmp_path):
    known, results, _, _ = guyed
    study, share = LoadedStudy.load(known.file), Elsewhere(store)  # anew: of a module that was loaded again since
    with shared_by(share):
        explain(study, Results.at(tmp_path, study.name))
    assert {"_linearisation", "_of_dense_modes", "_solved"} <= share.done
    assert tables(tmp_path / study.name) == tables(results.path)


@pytest.mark.slow
def test_fits_of_a_decision_are_the_same_whoever_makes_them(store, tmp_path):
    """Single effects, faults and effects beside others; what is told of evaluations and the budget too."""
    study, share = LoadedStudy.load(ROOT / "studies/hidden_three"), Elsewhere(store)
    with shared_by(share):
        explain(study, Results.at(tmp_path / "shared", study.name))
    explain(study, Results.at(tmp_path / "alone", study.name))
    assert {"_computed", "_solved"} <= share.done
    assert tables(tmp_path / "shared" / study.name) == tables(tmp_path / "alone" / study.name)


@pytest.mark.slow
@pytest.mark.whole
def test_tables_are_the_same_for_any_number_of_workers(tmp_path):
    for workers in (1, 2):
        root = tmp_path / str(workers)
        command = [
            "explain",
            str(ROOT / "studies/hidden_bogie"),
            "--results",
            str(root),
            "--cache",
            str(root / "cache"),
        ]
        with contextlib.redirect_stdout(None):
            assert cli.execute([*command, "--workers", str(workers)]) == 0
    one, two = (tables(tmp_path / str(workers) / "hidden_bogie") for workers in (1, 2))
    assert one == two
