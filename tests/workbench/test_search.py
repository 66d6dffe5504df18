"""The page's reader of a ledger sees what searches have recorded, as they go, and disturbs nobody."""

import contextlib
import io
import math
import shutil
import sqlite3

import numpy as np
import pandas as pd
import pytest

from calib.command import cli
from calib.command.example import write_example
from calib.execution.outcome import Individual, Outcome, point_key
from calib.results.ledger import Ledger
from calib.workbench import search
from calib.workbench.search import LedgerReader, latest_of_cases

RUN, OTHER = "GB1:1:0123456789abcdef", "GB2:2:fedcba9876543210"


def individuals(*misfits, of="x"):
    return [Individual(point_key({of: value}), "ok", value) for value in misfits]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


@pytest.fixture
def ledger(path):
    with Ledger.open(path) as opened:
        yield opened


def test_curves_grow_generation_by_generation(ledger, path):
    reader = LedgerReader(path)
    assert reader.read() == []
    ledger.record(RUN, "f", 1, [*individuals(3.0, 5.0), Individual(point_key({"x": 9.0}), "failed", math.nan)])
    (run,) = reader.read()
    assert (run.case, run.generations, run.individuals, run.failed) == ("GB1", [[1, 3.0, 4.0]], 3, 1)
    ledger.record(RUN, "f", 2, individuals(4.0, 6.0))
    ledger.record(OTHER, "f", 1, individuals(1.5, of="y"))
    first, second = reader.read()
    assert first.generations == [[1, 3.0, 4.0], [2, 3.0, 5.0]]  # best so far, mean of the generation
    assert second.generations == [[1, 1.5, 1.5]] and second.best[0] == 1.5
    assert first.generations_since(0) == first.generations and first.generations_since(3) == [[2, 3.0, 5.0]]


@pytest.mark.parametrize("query", [search._GENERATIONS, search._LASTS])
def test_what_is_known_of_a_history_is_not_gone_through_again(ledger, path, query):
    for generation in range(1, 20):
        ledger.record(RUN, "f", generation, individuals(*map(float, range(generation, 50 + generation))))
    with contextlib.closing(sqlite3.connect(path)) as database:
        plan = [str(row[3]) for row in database.execute(f"EXPLAIN QUERY PLAN {query}", (900,))]
    assert plan[0].startswith("SEARCH history USING INTEGER PRIMARY KEY")


def test_infeasible_individuals_have_no_misfit(ledger, path):
    ledger.record(RUN, "f", 1, [Individual(point_key({"x": 1.0}), "infeasible", math.nan)])
    ledger.record(RUN, "f", 2, individuals(2.0))
    (run,) = LedgerReader(path).read()
    assert run.generations == [[1, None, None], [2, 2.0, 2.0]] and run.infeasible == 1


def test_generations_that_were_replaced_are_read_anew(ledger, path):
    reader = LedgerReader(path)
    for generation, misfits in enumerate(((3.0,), (1.0,), (0.5,)), 1):
        ledger.record(RUN, "f", generation, individuals(*misfits))
    reader.read()
    ledger.record(RUN, "f", 2, individuals(2.0))  # it turned out otherwise: the later ones are gone
    (run,) = reader.read()
    assert run.generations == [[1, 3.0, 3.0], [2, 2.0, 2.0]] and (run.best[0], run.individuals) == (2.0, 2)


def test_the_best_point_is_that_of_the_lowest_misfit(ledger, path):
    for x in (4.0, 2.0, 3.0):
        ledger.append("f", [Outcome({"x": x}, "ok", {"y": 10 * x}, "", 0.1)])
    ledger.record(RUN, "f", 1, individuals(4.0, 2.0, 3.0))
    reader = LedgerReader(path)
    (run,) = reader.read()
    assert reader.point(run) == ({"x": 2.0}, {"y": 20.0}) and reader.evaluations == 3


def test_of_a_case_the_latest_search_is_shown(ledger, path):
    ledger.record(RUN, "f", 1, individuals(3.0))
    ledger.record("GB1:1:later", "g", 1, individuals(7.0))
    assert [run.name for run in latest_of_cases(LedgerReader(path).read())] == ["GB1:1:later"]


def test_a_writer_is_neither_waited_for_nor_held_up(ledger, path):
    ledger.record(RUN, "f", 1, individuals(3.0))
    reader = LedgerReader(path)
    writing = sqlite3.connect(path, isolation_level=None)
    writing.execute("BEGIN IMMEDIATE")
    writing.execute("UPDATE history SET misfit = 0.0")
    assert reader.read()[0].generations == [[1, 3.0, 3.0]]  # what was stored before
    writing.execute("COMMIT")
    writing.close()
    ledger.record(RUN, "f", 2, individuals(2.0))
    assert reader.read()[0].generations[-1] == [2, 2.0, 2.0]


def test_what_is_no_ledger_or_is_gone_keeps_what_was_known(tmp_path, path):
    assert LedgerReader(tmp_path / "none.sqlite").read() == []
    path.write_text("no database")
    assert LedgerReader(path).read() == []
    path.unlink()
    with Ledger.open(path) as ledger:
        ledger.record(RUN, "f", 1, individuals(3.0))
    reader = LedgerReader(path)
    assert len(reader.read()) == 1
    path.unlink()
    assert len(reader.read()) == 1


def test_a_closed_ledger_is_read_without_a_file_beside_it(tmp_path, path):
    with Ledger.open(path) as ledger:
        ledger.record(RUN, "f", 1, individuals(3.0))
    before = sorted(file.name for file in tmp_path.iterdir())
    assert len(LedgerReader(path).read()) == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == before == ["ledger.sqlite"]


def test_another_ledger_in_its_place_is_read_from_its_beginning(tmp_path, path):
    with Ledger.open(path) as ledger:
        ledger.record(RUN, "f", 1, individuals(3.0))
    with Ledger.open(tmp_path / "other.sqlite") as ledger:
        ledger.record(OTHER, "f", 1, individuals(5.0))
    reader = LedgerReader(path)
    reader.read()
    shutil.move(tmp_path / "other.sqlite", path)
    assert [run.name for run in reader.read()] == [OTHER]


@pytest.mark.slow
def test_the_curves_are_those_of_the_table(tmp_path, monkeypatch, no_drawing):
    """To the last bit: the page computes nothing that the search has not."""
    monkeypatch.chdir(tmp_path)
    write_example(tmp_path / "mast")
    with no_drawing(), contextlib.redirect_stdout(io.StringIO()):
        assert cli.execute(["calibrate", "mast", "--method", "genetic", "--quick", "--workers", "1"]) == 0
    table = pd.read_csv(next(tmp_path.glob("results/mast/*/convergence.csv")))
    runs = {run.case: run for run in LedgerReader(tmp_path / "results/mast/ledger.sqlite").read()}
    assert set(runs) == set(table["case"])
    for case, own in table.groupby("case"):
        drawn = np.array(runs[case].generations, dtype=float)
        np.testing.assert_allclose(drawn, own[["generation", "best", "mean"]].to_numpy(float), rtol=1e-9)
