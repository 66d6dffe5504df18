"""One case of a search: its evaluations, its result and its history."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import EvaluationError, InputError
from calib.execution.evaluate import Evaluator
from calib.execution.outcome import point_key
from calib.inference.agreement import agreement
from calib.inference.cases import Case, parameters_table, scaled_violation
from calib.inference.genetic import GeneticSettings
from calib.inference.objective import ResponseObjective
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.results.ledger import Ledger


@pytest.fixture
def ledger(tmp_path):
    with Ledger.open(tmp_path / "ledger.sqlite") as opened:
        yield opened


@pytest.mark.slow
def test_a_case_finds_the_target(ledger, search):
    seen = []
    longer = replace(search, settings=GeneticSettings(population=20, generations=30))
    result = longer.run(search.cases[0], ledger, search.evaluator(), progress=lambda *state: seen.append(state))
    assert result.misfit < 0.05 and result.misfit == search.objective(result.responses)
    assert result.responses == search.model(result.values) and result.values["g"] == 9.81
    assert search.space.feasible(np.array([[result.values[n] for n in search.space.free_names]])).all()
    assert result.asked == 600 == result.solved + result.reused + result.infeasible + result.failed
    assert min(result.solved, result.reused, result.infeasible, result.failed) > 0
    table = result.convergence
    assert table["generation"].tolist() == list(range(1, 31))
    assert (np.diff(table["best"]) <= 0).all() and table["best"].iloc[-1] == result.misfit
    assert (table["mean"] >= table["best"]).all() and table["feasible"].between(0, 20).all()
    ends = [state for state in seen if float(state[0]).is_integer()]
    assert ends == [(g, 30, b) for g, b in zip(table["generation"], table["best"], strict=True)]
    told = [generation for generation, _, _ in seen]
    assert told == sorted(told) and len(told) > 2 * len(ends)  # within a generation too


def test_the_history_holds_all_requests(ledger, search):
    evaluator = search.evaluator()
    result = search.run(search.cases[0], ledger, evaluator)
    history = ledger.history(search.run_id(search.cases[0]))
    counts = history["status"].value_counts()
    assert [counts[s] for s in ("solved", "reused", "infeasible", "failed")] == [
        result.solved, result.reused, result.infeasible, result.failed
    ]  # fmt: skip
    # Infeasible points are never evaluated, all others exactly once, each generation in one batch.
    free = np.array([[p[n] for n in search.space.free_names] for p in evaluator.points])
    assert search.space.feasible(free).all() and evaluator.batches <= search.settings.generations
    evaluated = [point_key(p) for p in evaluator.points]
    assert len(set(evaluated)) == len(evaluated) and set(evaluated) == set(history[history.status != "infeasible"].key)
    assert result.misfit == history["misfit"].min()
    assert (history["misfit"].isna() == history["status"].isin(["infeasible", "failed"])).all()
    failed = ledger.lookup("f", history[history.status == "failed"].key)
    assert {o.error for o in failed.values()} == {"no convergence"}


def test_started_again_it_reuses_the_ledger(ledger, search, assert_equal):
    evaluator = search.evaluator()
    first, second = search.run(search.cases[0], ledger, evaluator), search.run(search.cases[1], ledger, evaluator)
    count = len(evaluator.points)
    for case, before in zip(search.cases, (first, second), strict=True):
        again = search.run(case, ledger, evaluator)
        assert len(evaluator.points) == count
        assert_equal(again, before)


def test_another_case_with_the_same_seed_reuses_everything(ledger, search):
    search.run(search.cases[0], ledger, search.evaluator())
    twin = search.run(Case("twin", 1), ledger, search.evaluator())
    assert twin.solved == 0 and twin.reused > 0


@pytest.mark.medium
def test_workers_change_nothing(tmp_path, monkeypatch, search, assert_equal):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "case_model.py").write_text(
        "from calib.errors.errors import EvaluationError\n"
        "def model(values):\n"
        "    if 2.5 < values['k'] < 2.9:\n        raise EvaluationError('no convergence')\n"
        "    return {'a': values['k'] * values['place'] / 2, 'b': 2.0 * values['m'] + 0.0 * values['g']}\n"
        "def source():\n    return model\n"
    )
    from case_model import source

    found = []
    for workers in (1, 2):
        with Ledger.open(tmp_path / f"{workers}.sqlite") as ledger, Evaluator(source, workers) as evaluator:
            case = search.cases[0]
            found.append((search.run(case, ledger, evaluator), ledger.history(search.run_id(case))))
    assert_equal(found[0][0], found[1][0])
    pd.testing.assert_frame_equal(found[0][1], found[1][1], check_exact=True)


def test_a_run_is_named_after_all_that_determines_it(search):
    case = search.cases[0]
    names = {
        search.run_id(case),
        search.run_id(Case("C9", 1), initial=search.initial(case)),
        search.run_id(Case("C1", 9), initial=search.initial(case)),
        search.run_id(case, settings=GeneticSettings(population=8, generations=10)),
        search.run_id(case, objective=ResponseObjective({"a": 3.0})),
        search.run_id(case, fingerprint="g"),
        search.run_id(case, space=search.space.replace("g", value=9.5), initial=search.initial(case)),
        search.run_id(case, space=search.space.widen({"k": (1.0, 5.0)}), initial=search.initial(case)),
        search.run_id(case, space=ParameterSpace(search.space.parameters), initial=search.initial(case)),
        search.run_id(case, initial=search.initial(case)[::-1]),
    }
    assert len(names) == 10
    assert search.run_id(
        case, space=search.space.replace("g", description="gravity"), initial=search.initial(case)
    ) == search.run_id(case)


def test_nothing_can_be_evaluated(ledger, search):
    def broken(values):
        raise EvaluationError("singular stiffness")

    evaluator = search.evaluator(broken)
    with pytest.raises(EvaluationError, match=r"C1.*singular stiffness"):
        search.run(search.cases[0], ledger, evaluator)
    assert evaluator.batches == 1  # the whole initial population; the rest would only cost time
    with pytest.raises(EvaluationError, match="misfit is not finite"):
        search.run(search.cases[1], ledger, search.evaluator(lambda values: {"a": math.nan, "b": 1.0}))


def test_nothing_keeps_the_constraints(ledger, search):
    evaluator = search.evaluator()
    outside = np.tile([1.0, 0.0, 1.0], (8, 1))
    with pytest.raises(EvaluationError, match="broke a limit or constraint"):
        replace(search, settings=GeneticSettings(8, 2, sigma_start=1e-9)).run(
            search.cases[0], ledger, evaluator, initial=outside
        )
    assert not evaluator.points


def test_a_wrong_set_up_is_refused(ledger, search):
    with pytest.raises(InputError, match="no response 'c'"):
        replace(search, objective=ResponseObjective({"c": 1.0})).run(search.cases[0], ledger, search.evaluator())


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


@pytest.mark.slow
def test_a_solution_that_is_not_unique_is_detected(ledger, search):
    # Only the product of two parameters is seen.
    space = ParameterSpace((Parameter("p", 2.0, 1.0, 4.0), Parameter("q", 2.0, 1.0, 4.0)))
    settings, objective = GeneticSettings(population=12, generations=40), ResponseObjective({"product": 4.0})
    blind = replace(search, space=space, objective=objective, settings=settings)
    found = [
        blind.run(case, ledger, search.evaluator(lambda v: {"product": v["p"] * v["q"]}))
        for case in (Case(f"C{k}", k) for k in range(4))
    ]
    verdict = agreement(found, space, level=0.01)
    assert verdict.verdict == "several solutions" and set(verdict.differing) == {"p", "q"}
    assert not parameters_table(found, space)["stable"].any()


def test_paths_are_not_needed_for_a_search(search):
    with Ledger.open(Path(":memory:")) as ledger:
        assert search.run(search.cases[0], ledger, search.evaluator()).asked == 72
