"""Points that derivatives and starts ask for together: shared by workers, with the same results as alone."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import calib
from calib.errors.errors import EvaluationError
from calib.execution.ahead import ask, evaluated_together, is_collecting, points_shared
from calib.problem.differences import central_jacobian


class Kept:
    """A function that keeps its results, and tells the batches that it is asked for."""

    def __init__(self, fails=lambda x: False):
        self.found, self.batches, self.calls, self.fails = {}, [], [], fails

    def __call__(self, x):
        ask(self, {"x": x}, lambda: x in self.found)
        if x not in self.found:
            self.calls.append(x)
            self.found[x] = x**2
        if self.fails(x):
            raise EvaluationError("no")
        return self.found[x]

    def ahead(self, points):
        self.batches.append([point["x"] for point in points])
        self.found |= {x: x**2 for x in self.batches[-1]}


def test_what_computations_ask_for_is_one_batch():
    function = Kept()
    with points_shared():
        assert evaluated_together([lambda x=x: function(x) for x in (1.0, 2.0, 3.0)])
        assert not is_collecting()
    assert function.batches == [[1.0, 2.0, 3.0]] and not function.calls
    assert [function(x) for x in (1.0, 2.0, 3.0)] == [1.0, 4.0, 9.0] and not function.calls


def test_one_that_asks_twice_takes_two_batches_and_known_points_none():
    function = Kept(fails=lambda x: x == 2.0)
    with points_shared():
        evaluated_together([lambda x=x: function(x) + function(x + 10) for x in (1.0, 2.0)])
        evaluated_together([lambda: function(1.0)])
    assert function.batches == [[1.0, 2.0], [11.0]]


def test_within_another_set_the_points_are_left_to_that_one():
    function = Kept()

    def inner(at):
        evaluated_together([lambda x=x: function(at + x) for x in (0.1, 0.2)])
        return function(at)

    with points_shared():
        evaluated_together([lambda: inner(1.0), lambda: inner(2.0)])
    assert function.batches[0] == [1.1, 1.2, 2.1, 2.2]


def test_without_sharing_or_a_function_that_keeps_results_nothing_is_run_ahead():
    function, run = Kept(), []
    assert not evaluated_together([lambda: function(1.0)]) and not function.batches
    with points_shared():
        assert not evaluated_together([lambda k=k: run.append(k) for k in range(3)])
    assert run == [0]


def test_derivatives_ask_for_both_ends_of_all_differences_at_once():
    function = Kept()
    space = calib.ParameterSpace([calib.Parameter("x", 2.0, 1.0, 2.0), calib.Parameter("y", 5.0, 0.0, 10.0)])

    def residual(values):
        return np.array([function(values["x"]) + function(10 * values["y"])])

    alone = central_jacobian(residual, space, {}, ["x", "y"], 1e-3)
    function.found.clear()
    with points_shared():
        shared = central_jacobian(residual, space, {}, ["x", "y"], 1e-3)
    assert shared == pytest.approx(alone, rel=0, abs=0) and len(function.batches[0]) == 3  # x is on its limit


SPACE = calib.ParameterSpace([calib.Parameter(name, 2.0, 1.0, 3.0) for name in ("a", "b")])


def responses(values):
    time.sleep(0.021)  # long enough to be shared
    a, b = values["a"], values["b"]
    return {"r1": a + b**2, "r2": a * b, "r3": np.sin(a) + b, "r4": a - b}


def modes(values):
    time.sleep(0.021)
    number, place = np.arange(1, 4), np.array([[0.2], [0.5], [0.7], [0.9]])
    freq = number * np.sqrt(values["a"]) + 0.1 * values["b"] * number**2
    return {"natural_freq": freq, "shapes": np.sin(np.pi * number * place)}


def of_numbers():
    test = calib.ResponseTest({"r1": (6.2, 0.1), "r2": (4.3, 0.1), "r3": (2.8, 0.1), "r4": (0.3, 0.1)})
    return responses, lambda function: calib.Problem(calib.FunctionModel("f", SPACE, function), test)


def of_modes():
    sensors = ["1z", "2z", "3z", "4z"]
    true = modes({"a": 2.2, "b": 1.9})
    measured = calib.modes(
        true["natural_freq"], shapes=true["shapes"], sensors=[calib.Sensor(int(s[0]), "z") for s in sensors],
        freq_std=0.01 * true["natural_freq"],
    )  # fmt: skip
    return modes, lambda function: calib.Problem(
        calib.ModalFunctionModel("m", SPACE, function, sensors, 3), calib.ModalTest(measured)
    )


def counts(fit):
    return [(c.result.asked, c.result.solved, c.result.reused, c.result.failed) for c in fit.calibration.cases]


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("kind", [of_numbers, of_modes])
def test_starts_and_derivatives_are_shared_and_change_no_digit(kind):
    function, problem = kind()
    calls, running, most = [], [], []
    lock = threading.Lock()

    def counted(values):
        with lock:
            calls.append(tuple(values.values()))
            running.append(1)
            most.append(len(running))
        try:
            return function(values)
        finally:
            with lock:
                running.pop()

    alone = problem(counted).calibrate(starts=3, progress=False)
    asked, serial = sorted(calls), max(most)
    calls.clear(), most.clear()
    with ThreadPoolExecutor(4) as executor:
        shared = problem(counted).calibrate(starts=3, executor=executor, progress=False)
    assert serial == 1 and max(most) == 4
    assert shared.values == alone.values
    assert sorted(calls) == asked
    assert shared.parameters.equals(alone.parameters)
    assert counts(shared) == counts(alone)
