import math
import multiprocessing
import os
import signal
import sqlite3
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.errors import EvaluationError, InputError
from calib.evaluate import Evaluator
from calib.ledger import Ledger, key_of
from calib.outcome import WORKER_DIED, Outcome, attempt
from calib.sensitivity.sampling import sample
from calib.space import LinearConstraint, Parameter, ParameterSpace
from calib.updating.cases import (
    Case,
    CaseResult,
    agreement,
    convergence_table,
    parameters_table,
    run_case,
    run_id,
    scaled_violation,
)
from calib.updating.genetic import GeneticSettings
from calib.updating.objective import ResponseObjective

FORK = multiprocessing.get_context("fork")
CASES = (Case("C1", 1), Case("C2", 2))
SETTINGS = GeneticSettings(population=8, generations=9)
OBJECTIVE = ResponseObjective({"a": 3.0, "b": 1.0})
SPACE = ParameterSpace(
    (
        Parameter("k", 2.0, 1.0, 4.0, "kN/m"),
        Parameter("m", 0.5, 0.0, 1.0, "t"),
        Parameter("place", 2, 1, 3, integer=True),
        Parameter("g", 9.81, 9.0, 10.0, distribution="fixed"),
    ),
    (LinearConstraint("sum", (("k", 1.0), ("m", 2.0), ("g", 1.0)), 11.5, 14.0),),
)


def model(values):
    if 2.5 < values["k"] < 2.9:
        raise EvaluationError("no convergence")
    return {"a": values["k"] * values["place"] / 2, "b": 2.0 * values["m"] + 0.0 * values["g"]}


class Serial:
    workers = 1

    def __init__(self, function=model, pause=0.0):
        self.function, self.pause, self.points, self.batches = function, pause, [], 0

    def evaluate(self, points):
        self.points += [dict(p) for p in points]
        self.batches += 1
        time.sleep(self.pause)
        return [attempt(self.function, p) for p in points]


def initial(case, space=SPACE, settings=SETTINGS):
    return sample(space, settings.population, case.seed).points


def run(case, ledger, evaluator, space=SPACE, settings=SETTINGS, objective=OBJECTIVE, **more):
    start = more.pop("initial", initial(case, space, settings))
    return run_case(case, space, objective, settings, evaluator, ledger, "f", start, **more)


def run_of(case, **changes):
    given = {"space": SPACE, "objective": OBJECTIVE, "settings": SETTINGS, "fingerprint": "f"} | changes
    return run_id(case, initial=given.pop("initial", initial(case)), **given)


@pytest.fixture
def ledger(tmp_path):
    with Ledger.open(tmp_path / "ledger.sqlite") as opened:
        yield opened


# -- one case ----------------------------------------------------------------------------------------------------------


def test_a_case_finds_the_target(ledger):
    seen = []
    settings = GeneticSettings(population=20, generations=60)
    result = run(CASES[0], ledger, Serial(), settings=settings, progress=lambda *told: seen.append(told))
    assert result.misfit < 0.01 and result.misfit == OBJECTIVE(result.responses)
    assert result.responses == model(result.values) and result.values["g"] == 9.81
    assert SPACE.feasible(np.array([[result.values[n] for n in SPACE.free_names]])).all()
    assert result.asked == 1200 == result.solved + result.reused + result.infeasible + result.failed
    assert min(result.solved, result.reused, result.infeasible, result.failed) > 0
    table = result.convergence
    assert table["generation"].tolist() == list(range(1, 61))
    assert (np.diff(table["best"]) <= 0).all() and table["best"].iloc[-1] == result.misfit
    assert (table["mean"] >= table["best"]).all() and table["feasible"].between(0, 20).all()
    assert seen == [(g, 60, b) for g, b in zip(table["generation"], table["best"], strict=True)]


def test_the_history_is_what_was_asked(ledger):
    evaluator = Serial()
    result = run(CASES[0], ledger, evaluator)
    history = ledger.history(run_of(CASES[0]))
    counts = history["status"].value_counts()
    assert [counts[s] for s in ("solved", "reused", "infeasible", "failed")] == [
        result.solved, result.reused, result.infeasible, result.failed
    ]  # fmt: skip
    # Infeasible points are never evaluated, all others exactly once, each generation in one batch.
    free = np.array([[p[n] for n in SPACE.free_names] for p in evaluator.points])
    assert SPACE.feasible(free).all() and evaluator.batches <= SETTINGS.generations
    evaluated = [key_of(p) for p in evaluator.points]
    assert len(set(evaluated)) == len(evaluated) and set(evaluated) == set(history[history.status != "infeasible"].key)
    assert result.misfit == history["misfit"].min()
    assert (history["misfit"].isna() == history["status"].isin(["infeasible", "failed"])).all()
    failed = ledger.lookup("f", history[history.status == "failed"].key)
    assert {o.error for o in failed.values()} == {"no convergence"}


def test_started_again_it_answers_from_the_ledger(ledger):
    evaluator = Serial()
    first, second = run(CASES[0], ledger, evaluator), run(CASES[1], ledger, evaluator)
    count = len(evaluator.points)
    for case, before in zip(CASES, (first, second), strict=True):
        again = run(case, ledger, evaluator)
        assert len(evaluator.points) == count
        assert_equal(again, before)


def assert_equal(one, other):
    pd.testing.assert_frame_equal(one.convergence, other.convergence, check_exact=True)
    names = ("name", "values", "misfit", "responses", "asked", "solved", "reused", "infeasible", "failed")
    assert [getattr(one, n) for n in names] == [getattr(other, n) for n in names]


def test_another_case_with_the_same_seed_reuses_everything(ledger):
    run(CASES[0], ledger, Serial())
    twin = run(Case("twin", 1), ledger, Serial())
    assert twin.solved == 0 and twin.reused > 0


def test_workers_change_nothing(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "case_model.py").write_text(
        "from calib.errors import EvaluationError\n"
        "def model(values):\n"
        "    if 2.5 < values['k'] < 2.9:\n        raise EvaluationError('no convergence')\n"
        "    return {'a': values['k'] * values['place'] / 2, 'b': 2.0 * values['m'] + 0.0 * values['g']}\n"
        "def source():\n    return model\n"
    )
    from case_model import source

    found = []
    for workers in (1, 2):
        with Ledger.open(tmp_path / f"{workers}.sqlite") as ledger, Evaluator(source, workers) as evaluator:
            found.append((run(CASES[0], ledger, evaluator), ledger.history(run_of(CASES[0]))))
    assert_equal(found[0][0], found[1][0])
    pd.testing.assert_frame_equal(found[0][1], found[1][1], check_exact=True)


def test_a_run_is_named_after_all_that_determines_it():
    case = CASES[0]
    names = {
        run_of(case),
        run_of(Case("C9", 1), initial=initial(case)),
        run_of(Case("C1", 9), initial=initial(case)),
        run_of(case, settings=GeneticSettings(population=8, generations=10)),
        run_of(case, objective=ResponseObjective({"a": 3.0})),
        run_of(case, fingerprint="g"),
        run_of(case, space=SPACE.replace("g", value=9.5), initial=initial(case)),
        run_of(case, space=SPACE.widen({"k": (1.0, 5.0)}), initial=initial(case)),
        run_of(case, space=ParameterSpace(SPACE.parameters), initial=initial(case)),
        run_of(case, initial=initial(case)[::-1]),
    }
    assert len(names) == 10
    assert run_of(case, space=SPACE.replace("g", description="gravity"), initial=initial(case)) == run_of(case)


def test_nothing_can_be_evaluated(ledger):
    def broken(values):
        raise EvaluationError("singular stiffness")

    evaluator = Serial(broken)
    with pytest.raises(EvaluationError, match=r"C1.*singular stiffness"):
        run(CASES[0], ledger, evaluator)
    assert evaluator.batches == 1  # the whole initial population; the rest would only cost time
    with pytest.raises(EvaluationError, match="misfit is not finite"):
        run(CASES[1], ledger, Serial(lambda values: {"a": math.nan, "b": 1.0}))


def test_nothing_keeps_the_constraints(ledger):
    evaluator = Serial()
    outside = np.tile([1.0, 0.0, 1.0], (8, 1))
    with pytest.raises(EvaluationError, match="broke a limit or constraint"):
        run(CASES[0], ledger, evaluator, settings=GeneticSettings(8, 2, sigma_start=1e-9), initial=outside)
    assert not evaluator.points


def test_a_wrong_set_up_is_told(ledger):
    with pytest.raises(InputError, match="no response 'c'"):
        run(CASES[0], ledger, Serial(), objective=ResponseObjective({"c": 1.0}))


def test_violations_of_different_units_compare():
    space = ParameterSpace(
        (
            Parameter("a", 0.5, 0.0, 1.0),
            Parameter("b", 500.0, 0.0, 1000.0),
            Parameter("c", 7.0, 0.0, 9.0, "-", "fixed"),
        ),
        (
            LinearConstraint("small", (("a", 1.0),), 0.0, 0.5),
            LinearConstraint("large", (("b", 1.0), ("c", 1.0)), 7, 507),
        ),
    )
    points = np.array([[0.5, 500.0], [0.7, 500.0], [0.5, 700.0], [0.7, 700.0], [0.5 + 1e-12, 0.0]])
    np.testing.assert_allclose(scaled_violation(space, points), [0, 0.2, 0.2, 0.4, 0], atol=1e-12)
    assert scaled_violation(space, points)[4] == 0.0 and scaled_violation(space, np.array([[0.5 + 1e-8, 0.0]]))[0] > 0
    assert scaled_violation(ParameterSpace(space.parameters), points).tolist() == [0.0] * 5


# -- interruptions -----------------------------------------------------------------------------------------------------


def everything(path):
    """Evaluations and history as tables, without what depends on the clock."""
    with sqlite3.connect(path) as database:
        return [
            database.execute(f"SELECT {columns} FROM {table} ORDER BY {order}").fetchall()
            for table, columns, order in (
                ("evaluation", "fingerprint, key, attempt, parameters, responses, status, error", "id"),
                ("history", "run, generation, individual, fingerprint, key, status, misfit", "id"),
            )
        ]


def search_all(path, evaluator, kill=lambda ledger: None):
    with Ledger.open(path) as ledger:
        kill(ledger)
        return [run(case, ledger, evaluator) for case in CASES]


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def _killed_at(path, place, number):
    """Search until the given place is passed for the given time, and be killed there."""
    calls = 0

    def count():
        nonlocal calls
        calls += 1
        if calls == number:
            die()

    def prepare(ledger):
        append, record = ledger.append, ledger.record
        if place == "statement":  # anywhere, in the middle of transactions too
            ledger._database.set_trace_callback(lambda statement: count())
        elif place == "before append":
            ledger.append = lambda *given: (count(), append(*given))
        elif place == "between append and record":
            ledger.append = lambda *given: (append(*given), count())
        elif place == "after record":
            ledger.record = lambda *given: (record(*given), count())

    search_all(path, Serial(), prepare)


def killed(path, place, number):
    process = FORK.Process(target=_killed_at, args=(path, place, number))
    process.start()
    process.join()
    return process.exitcode == -signal.SIGKILL


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    path = tmp_path_factory.mktemp("uninterrupted") / "ledger.sqlite"
    results = search_all(path, Serial())
    tables = everything(path)
    kinds = {row[5] for row in tables[1]}
    assert kinds == {"solved", "reused", "infeasible", "failed"}  # or the comparison would prove little
    return results, tables


@pytest.mark.parametrize(
    ("place", "numbers"),
    [
        ("before append", (1, 5)),
        ("between append and record", (1, 4, 12)),
        ("after record", (1, 9, 10, 17)),
        ("statement", (1, 2, 3, 9, 10, 40, 77, 150, 151, 152, 300, 333, 500)),
    ],
)
def test_killed_at_any_moment_it_ends_the_same(tmp_path, uninterrupted, place, numbers):
    for number in numbers:
        path = tmp_path / f"{number}.sqlite"
        assert killed(path, place, number)
        results = search_all(path, Serial())
        assert everything(path) == uninterrupted[1]
        for one, other in zip(results, uninterrupted[0], strict=True):
            assert_equal(one, other)


def test_killed_again_and_again(tmp_path, uninterrupted):
    path, times = tmp_path / "ledger.sqlite", 0
    # Replaying takes statements too, so every start gets a little further than the last.
    while killed(path, "statement", 30 + 25 * times):
        times += 1
    assert times > 5 and everything(path) == uninterrupted[1]


def _slowly(path):
    search_all(path, Serial(pause=0.01))


def test_killed_from_outside(tmp_path, uninterrupted):
    path, times = tmp_path / "ledger.sqlite", 0
    while True:
        process = FORK.Process(target=_slowly, args=(path,))
        process.start()
        process.join(0.05 + 0.03 * times)
        if process.exitcode is not None:
            break
        process.kill()
        process.join()
        times += 1
    assert times > 0 and process.exitcode == 0 and everything(path) == uninterrupted[1]


def test_stopped_by_the_keyboard(tmp_path, uninterrupted):
    path = tmp_path / "ledger.sqlite"
    evaluator = Serial()

    def pressed(generation, generations, best):
        if generation == 4:
            raise KeyboardInterrupt

    with Ledger.open(path) as ledger, pytest.raises(KeyboardInterrupt):
        run(CASES[0], ledger, evaluator, progress=pressed)
    search_all(path, evaluator)
    assert everything(path) == uninterrupted[1]
    assert len(evaluator.points) == len(uninterrupted[1][0])


def test_a_failure_of_the_machine_is_mended_by_the_next_run(tmp_path, uninterrupted):
    class Unlucky(Serial):
        workers = 2

        def evaluate(self, points):
            given = super().evaluate(points)
            return [Outcome(o.values, "failed", {}, WORKER_DIED) if k == 3 else o for k, o in enumerate(given)]

    path = tmp_path / "ledger.sqlite"
    unlucky = search_all(path, Unlucky())
    assert unlucky[0].failed > uninterrupted[0][0].failed
    healthy = Serial()
    healthy.workers = 2
    mended = search_all(path, healthy)
    assert mended[0].misfit == uninterrupted[0][0].misfit
    assert mended[0].failed == uninterrupted[0][0].failed
    history = [[r[:5] + r[6:] for r in sorted(rows)] for rows in (everything(path)[1], uninterrupted[1][1])]
    assert history[0] == history[1]


# -- tables ------------------------------------------------------------------------------------------------------------


def result(name, misfit=0.1, **values):
    table = pd.DataFrame({"generation": [1, 2], "best": [1.0, misfit], "mean": [2.0, 1.0], "feasible": [3, 4]})
    return CaseResult(
        name, {"k": 2.0, "m": 0.5, "place": 2.0, "g": 9.81} | values, misfit, {}, table, 2, 2, 0, 0, 0, 1.0
    )


def test_the_parameters_table():
    table = parameters_table(
        [result("A", k=1.0, m=0.5), result("B", k=1.3, m=0.995), result("C", k=1.31, m=0.5)], SPACE
    )
    assert table.columns.tolist() == [
        "case", "parameter", "value", "unit", "lower", "upper", "ratio", "on_bound", "spread", "stable"
    ]  # fmt: skip
    assert table["case"].tolist() == ["A"] * 3 + ["B"] * 3 + ["C"] * 3
    assert table["parameter"].tolist() == ["k", "m", "place"] * 3
    k = table[table.parameter == "k"]
    np.testing.assert_allclose(k["ratio"], [0.0, 0.1, 0.31 / 3], atol=1e-12)
    assert k["on_bound"].tolist() == [True, False, False] and k["unit"].tolist() == ["kN/m"] * 3
    np.testing.assert_allclose(k["spread"], 0.31 / 3)
    assert k["stable"].tolist() == [False] * 3
    m = table[table.parameter == "m"]
    assert m["on_bound"].tolist() == [False, True, False] and m["stable"].tolist() == [False] * 3
    assert table[table.parameter == "place"]["stable"].tolist() == [True] * 3


def test_the_threshold_of_stability():
    for value, stable in ((1.29, True), (1.31, False)):
        table = parameters_table([result("A", k=1.0), result("B", k=value)], SPACE)
        assert table["stable"].iloc[0] is stable or table["stable"].iloc[0] == stable


def test_one_case_says_nothing_about_stability(tmp_path):
    table = parameters_table([result("A")], SPACE)
    assert table["spread"].isna().all() and table["stable"].isna().all()
    table.to_csv(tmp_path / "parameters.csv", index=False)
    assert ",," in (tmp_path / "parameters.csv").read_text() or (tmp_path / "parameters.csv").read_text().endswith(
        ",\n"
    )


def test_the_convergence_table():
    table = convergence_table([result("A"), result("B", 0.2)])
    assert table.columns.tolist() == ["case", "generation", "best", "mean", "feasible"]
    assert table["case"].tolist() == ["A", "A", "B", "B"] and table["best"].tolist() == [1.0, 0.1, 1.0, 0.2]
    assert convergence_table([]).columns.tolist() == table.columns.tolist()


# -- agreement ---------------------------------------------------------------------------------------------------------


def test_cases_that_agree():
    found = agreement([result("A", 0.101), result("B", 0.100, k=2.2), result("C", 0.102)], SPACE)
    assert found.verdict == "one solution" and found.solutions == (("B", "A", "C"),)
    assert found.differing == () and found.worse == () and "6.7 %" in found.sentence


def test_several_solutions():
    cases = [result("A", 0.100), result("B", 0.103, k=3.5, m=0.7), result("C", 0.101, k=2.1), result("D", 0.5, m=0.0)]
    found = agreement(cases, SPACE)
    assert found.verdict == "several solutions" and found.solutions == (("A", "C"), ("B",))
    assert found.differing == ("k", "m") and found.worse == ("D",)
    for words in ("not unique", "2 sets", "A, C", "k by 50 %", "m by 20 %", "D (misfit 0.5)"):
        assert words in found.sentence


def test_scatter_decides_what_fits_equally_well():
    cases = [result("A", 0.10), result("B", 0.19, k=3.5)]
    assert agreement(cases, SPACE).verdict == "not settled"
    assert agreement(cases, SPACE, level=0.18).verdict == "not settled"
    assert agreement(cases, SPACE, level=0.20).verdict == "several solutions"
    assert agreement([result("A", 0.10), result("B", 0.19)], SPACE, level=0.20).verdict == "one solution"


def test_one_case_and_unsettled_cases():
    assert agreement([result("A")], SPACE).verdict == "one case"
    found = agreement([result("A", 0.1), result("B", 0.3), result("C", 0.2)], SPACE)
    assert found.verdict == "not settled" and found.worse == ("C", "B") and "more generations" in found.sentence


def test_a_problem_that_is_not_unique_is_found_out(ledger):
    # Only the product of two parameters is seen.
    space = ParameterSpace((Parameter("p", 2.0, 1.0, 4.0), Parameter("q", 2.0, 1.0, 4.0)))
    settings, objective = GeneticSettings(population=12, generations=40), ResponseObjective({"product": 4.0})
    found = [
        run(case, ledger, Serial(lambda v: {"product": v["p"] * v["q"]}), space, settings, objective)
        for case in (Case(f"C{k}", k) for k in range(4))
    ]
    verdict = agreement(found, space, level=0.01)
    assert verdict.verdict == "several solutions" and set(verdict.differing) == {"p", "q"}
    assert not parameters_table(found, space)["stable"].any()


def test_paths_are_not_needed_for_a_search():
    with Ledger.open(Path(":memory:")) as ledger:
        assert run(CASES[0], ledger, Serial()).asked == 72
