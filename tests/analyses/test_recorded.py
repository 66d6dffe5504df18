"""Least squares reads the ledger: no point is solved twice, neither within a run nor in the next one."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.analyses.calibrate import calibrate
from calib.analyses.fit_statistics import ObjectiveTerms, fit_problem
from calib.analyses.least_squares import fitted
from calib.analyses.provenance.recorded import RecordedFunction
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import Floors
from calib.errors.errors import EvaluationError
from calib.execution.evaluate import Evaluator
from calib.execution.outcome import point_key
from calib.problem.parameter import Parameter
from calib.problem.problem import Counts, PairProblem
from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.structure.function_model import FunctionModel
from calib.structure.modal_function import ModalFunctionModel
from calib.study.study import LoadedStudy
from tests.template import plain

RIG = Path(__file__).parents[2] / "studies/four_storey_rig"
LOGGED = """
from pathlib import Path

def answer(values):
    with Path("asked").open("a") as stream:
        stream.write("one\\n")
    return {"y": values["a"] ** 2, "z": values["a"] + values["b"], "w": values["b"] ** 3}
"""
ASKED = """
[held_out]
responses = ["w"]
[calibration]
method = "gauss-newton"
starts = 3
cases = [{ name = "A1", seed = 1 }, { name = "A2", seed = 2 }]
"""


@pytest.fixture
def solved(monkeypatch):
    """Number of solutions of every point."""
    counted, compare = Counter(), ModalProblem.compare

    def counting(self, values, modes=None):
        counted[point_key(self.space.complete(values))] += modes is None
        return compare(self, values, modes)

    monkeypatch.setattr(ModalProblem, "compare", counting)
    return counted


@pytest.fixture
def logged(here):
    """A study of scalar responses whose function logs a line per call."""
    return LoadedStudy.load(plain.write(Path("plain"), LOGGED, ASKED, y=(5.0, 0.1), z=(4.0, 0.1), w=(6.0, 0.1)))


@pytest.mark.medium
def test_modes_are_solved_once_and_not_again_in_the_next_run(tmp_path, solved):
    study = LoadedStudy.load(RIG)
    space = study.search_space
    starts = [space.complete(x) for x in sample(space, 3, 1).points]
    found = []
    for _ in range(2):
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            solved.clear()
            counts = Counts()
            found.append(
                (fitted(fit_problem(study, ledger, counts=counts), ObjectiveTerms.of(study), starts, 1), counts)
            )
            assert (
                sum(solved.values()) <= ledger.count(study.problem.fingerprint) + 1
            )  # and the modes of the predictions
            assert (counts.solved, counts.failed) == (sum(solved.values()), 0)
    (first, at_first), (second, again) = found
    assert at_first.solved > 10 and again.solved <= 1
    assert at_first.asked == again.asked == again.solved + again.reused
    assert second.values == first.values and second.misfit == first.misfit
    assert np.array_equal(second.fit.jacobian, first.fit.jacobian)
    assert second.predictions.equals(first.predictions)


@pytest.mark.medium
def test_least_squares_count_their_points(logged, tmp_path):
    counts = []
    for _ in range(2):
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            known = ledger.count(logged.problem.fingerprint)
            calibrate(logged, Results.at(tmp_path / "results", "plain"), ledger)
            new = ledger.count(logged.problem.fingerprint) - known
        summary = json.loads(Path("results/plain/summary.json").read_text())
        cases = summary["cases"].values()
        counts.append([[case[name] for name in ("evaluations", "solved", "reused", "failed")] for case in cases])
        for asked, by_model, reused, failed in counts[-1]:
            assert asked == by_model + reused and failed == 0
        # Least squares start from the nominal values, which were evaluated before.
        assert sum(case[1] for case in counts[-1]) == max(new - 1, 0)
    first, second = counts
    assert [case[0] for case in first] == [case[0] for case in second]
    assert sum(case[1] for case in first) > 20 and all(case[1] == 0 for case in second)


def test_a_failed_point_is_not_solved_again(tmp_path, solved):
    problem, counts = replace(LoadedStudy.load(RIG).problem, mode_count=5), Counts()  # of a model with four
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        said = []
        for _ in range(2):
            with pytest.raises(EvaluationError) as fault:
                PairProblem(ModalResidual(problem), problem.space, ledger, counts=counts).residual(problem.space.values)
            said.append(str(fault.value))
    assert said[0] == said[1] and sum(solved.values()) == 1
    assert (counts.asked, counts.failed) == (2, 2)


def test_residuals_with_other_floors_have_another_fingerprint():
    problem = LoadedStudy.load(RIG).problem
    one, other = ModalResidual(problem), ModalResidual(problem, Floors(freq=0.5))
    assert one.fingerprint == ModalResidual(problem).fingerprint != other.fingerprint


def test_a_function_is_the_same_whatever_the_ledger_has_of_it(tmp_path):
    """Else no stored point would be found again, and all that is stored would be read at every point."""

    def string(values):
        return {"natural_freq": np.array([1.0, 2.0]) * values["f"], "shapes": np.array([[0.7, 1.0]])}

    space = ParameterSpace((Parameter("f", 1.0, 0.5, 2.0, "Hz"),))
    modes = ModalFunctionModel("string", space, string, sensors=["1z"], n_modes=2)
    scalar = FunctionModel("string", space, modes.numbers)
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        kept = RecordedFunction(modes.numbers, "key", ledger, Evaluator(lambda: modes.numbers), frozenset({"f"}))
        behind = [model.with_function(kept) for model in (scalar, modes)]
        before = [model.fingerprint for model in behind]
        assert before[0] == scalar.fingerprint
        for f in (1.1, 1.2, 1.3):
            assert behind[1].modes({"f": f}, 1).natural_freq[0] == pytest.approx(f)
        assert ledger.count("key") == 3
        assert [model.fingerprint for model in behind] == before


@pytest.mark.medium
def test_a_function_is_called_once_per_point(logged, tmp_path):
    tables = []
    for _ in range(2):
        before = len(Path("asked").read_text().split()) if Path("asked").exists() else 0
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            known = ledger.count(logged.problem.fingerprint)
            answer = calibrate(logged, Results.at(tmp_path / "results", "plain"), ledger)
            new = ledger.count(logged.problem.fingerprint) - known
        tables.append(answer.parameters)
        # One more call for the reproducibility check.
        assert len(Path("asked").read_text().split()) - before == new + 1
        assert (new > 20) == (known == 0)
    assert tables[0].equals(tables[1])
