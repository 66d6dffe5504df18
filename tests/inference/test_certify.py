"""A search on an approximate model whose best individuals are evaluated again by an exact one."""

import numpy as np

from calib.execution.evaluate import Evaluator
from calib.execution.outcome import Outcome
from calib.inference.cases import Case, run_case
from calib.inference.genetic import GeneticSettings
from calib.inference.objective import ResponseObjective
from calib.problem.sampling import sample
from calib.problem.space import Parameter, ParameterSpace
from calib.results.ledger import Ledger

SPACE = ParameterSpace((Parameter("x", 0.5, 0.0, 2.0), Parameter("y", 0.5, 0.0, 2.0)))
OBJECTIVE = ResponseObjective({"a": 1.0, "b": 1.0})
SETTINGS = GeneticSettings(population=12, generations=25)


def approximate(values):
    # Wrong near x = 1: it promises a perfect fit where the exact model does not fit at all.
    return {"a": values["x"], "b": 1.0 if abs(values["x"] - 1) < 0.2 else values["y"]}


def exact(values):
    return {"a": values["x"], "b": values["y"]}


def certify(outcome):
    return Outcome(outcome.values, "ok", exact(outcome.values))


def search(folder, **more):
    with Ledger.open(folder / "l.sqlite") as ledger:
        evaluator = Evaluator(lambda: approximate)
        initial = sample(SPACE, 12, 3).points
        return run_case(Case("C", 3), SPACE, OBJECTIVE, SETTINGS, evaluator, ledger, "f", initial, **more)


def test_the_approximation_alone_is_fooled(tmp_path):
    result = search(tmp_path)
    assert OBJECTIVE(exact(result.values)) > 10 * result.misfit


def test_a_certified_best_holds_what_it_promises(tmp_path):
    result = search(tmp_path, certify=certify)
    assert result.misfit == OBJECTIVE(exact(result.values))
    assert result.responses == exact(result.values)
    assert result.misfit < 0.2
    assert np.all(np.diff(result.convergence["best"]) <= 0)


def test_only_would_be_bests_are_certified_and_each_once(tmp_path):
    certified = []

    def count(outcome):
        certified.append(tuple(outcome.values.values()))
        return certify(outcome)

    result = search(tmp_path, certify=count)
    assert len(certified) == len(set(certified)) < 0.6 * result.asked


def test_a_failure_at_full_order_is_a_failure(tmp_path):
    def refuse(outcome):
        if abs(outcome.values["x"] - 1) < 0.3:
            return Outcome(outcome.values, "failed", {}, "no convergence")
        return certify(outcome)

    result = search(tmp_path, certify=refuse)
    assert abs(result.values["x"] - 1) >= 0.3 and result.failed > 0
