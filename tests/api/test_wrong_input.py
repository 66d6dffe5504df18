"""Wrong arguments are refused in one sentence, not by a traceback from inside."""

import numpy as np
import pandas as pd
import pytest

import calib

NAN = float("nan")
SPACE = calib.ParameterSpace((calib.Parameter("k", 30.0, 1.0, 100.0), calib.Parameter("m", 7.0, 1.0, 50.0)))
MODEL = calib.FunctionModel("oscillator", SPACE, lambda v: {"w2": v["k"] / v["m"], "m": v["m"]})


def responses(given=None, **options):
    return calib.ResponseTest({"w2": (4.0, 0.01), "m": (10.0, 0.1)} if given is None else given, **options)


def modes(**changes):
    one = np.array([1.0])
    given = dict(
        names=("A",), natural_freq=one, damped_freq=one, freq_std=0.01 * one, damping_ratio=NAN * one,
        damping_std=NAN * one, sensors=(calib.Sensor(1, "x"),), shapes=np.ones((1, 1)), shape_std=np.full((1, 1), 0.01),
    )  # fmt: skip
    return calib.MeasuredModes(**{**given, **changes})


def structure(**changes):
    given = dict(
        stiffness={"k": np.eye(1)}, mass=np.eye(1), dofs=[(1, "x")], parameters=[calib.Parameter("k", 40.0, 1.0, 100.0)]
    )
    return calib.StructuralModel.from_matrices(**{**given, **changes})


def modal(**options):
    return calib.ModalTest(modes(), **options)


PROBLEM = calib.Problem(MODEL, responses())

WRONG = {
    "value is text": lambda: calib.Parameter("k", "3", 1.0, 5.0),
    "value is None": lambda: calib.Parameter("k", None, 1.0, 5.0),
    "no such distribution": lambda: calib.Parameter("k", 3.0, 1.0, 5.0, distribution="normal"),
    "space of names": lambda: calib.ParameterSpace(("k",)),
    "coefficient is text": lambda: calib.LinearConstraint("c", (("k", "1"),), 0.0, 1.0),
    "limit is text": lambda: calib.LinearConstraint("c", (("k", 1.0),), "0", 1.0),
    "model without a space": lambda: calib.FunctionModel("a", SPACE.parameters, dict),
    "model without a function": lambda: calib.FunctionModel("a", SPACE, 3),
    "responses without names": lambda: responses(np.ones(3)),
    "response of three numbers": lambda: responses({"w2": (4.0, 0.1, 0.2)}),
    "response is text": lambda: responses({"w2": "4"}),
    "deviation of 0": lambda: responses({"w2": (4.0, 0.0)}),
    "deviation is text": lambda: responses({"w2": (4.0, "1 %")}),
    "response without a name": lambda: responses({1: 4.0}),
    "accuracy is a list": lambda: responses(accuracy=[1]),
    "accuracy is no share": lambda: responses(accuracy="lots"),
    "held-out name instead of a list": lambda: responses(held_out="m"),
    "held out is None": lambda: responses(held_out=None),
    "condition without values": lambda: responses(condition=["k"]),
    "condition is text": lambda: responses(condition={"k": "a"}),
    "test without a name": lambda: responses(name=""),
    "no model": lambda: calib.Problem(None, responses()),
    "no tests": lambda: calib.Problem(MODEL, None),
    "data instead of a test": lambda: calib.Problem(MODEL, {"w2": 4.0}),
    "model and test exchanged": lambda: calib.Problem(responses(), MODEL),
    "a model is joined": lambda: calib.Problem.join(PROBLEM, MODEL),
    "start outside the limits": lambda: calib.Problem(
        calib.FunctionModel("a", SPACE.replace("k", value=300.0), MODEL.function), responses()
    ),
    "one name kept": lambda: PROBLEM.keep("k"),
    "one name fitted": lambda: PROBLEM.calibrate("k", starts=1),
    "values fitted": lambda: PROBLEM.calibrate({"k": 3.0}, starts=1),
    "no start": lambda: PROBLEM.calibrate(starts=0),
    "negative seed": lambda: PROBLEM.calibrate(starts=2, seed=-1),
    "values without names": lambda: PROBLEM.compare(np.ones(2)),
    "value of a point is text": lambda: PROBLEM.compare({"k": "3x"}),
    "nothing at which statistics are asked for": lambda: PROBLEM.statistics_at(None),
    "effect by name": lambda: PROBLEM.explain(["wear"]),
    "no effects added": lambda: PROBLEM.with_effects(None),
    "files instead of modes": lambda: calib.ModalTest("a.uff"),
    "held-out mode instead of a list": lambda: modal(held_out="A"),
    "clusters without modes": lambda: modal(clusters=["x"]),
    "mode count is text": lambda: modal(mode_count="3"),
    "one end of a window": lambda: modal(freq_window=3),
    "threshold is None": lambda: modal(threshold=None),
    "choice of pairs is text": lambda: modal(override={"A": "1"}),
    "frequencies are text": lambda: modes(natural_freq=["1"]),
    "negative deviation": lambda: modes(freq_std=np.array([-0.1])),
    "sensors by name": lambda: modes(sensors=("1x",)),
    "place in a plane": lambda: calib.Sensor(1, "x", (0.0, 1.0)),
    "no such direction": lambda: calib.Problem(
        structure(), calib.ModalTest(modes(sensors=(calib.Sensor(1, "q"),)), mode_count=1)
    ),
    "matrix is None": lambda: structure(mass=None),
    "matrix is a file": lambda: structure(stiffness={"k": "K.npy"}),
    "matrix with ragged rows": lambda: structure(stiffness={"k": [[1, 2], [1]]}),
    "scaled by a number": lambda: structure(stiffness={"k": np.eye(1), "a": (np.eye(1), 3.0)}),
    "matrix with three entries": lambda: structure(stiffness={"k": (np.eye(1), "k", 2)}),
    "rows without directions": lambda: structure(dofs=[1]),
    "rows are a number": lambda: structure(dofs=3),
    "coordinate is text": lambda: structure(
        dofs=pd.DataFrame({"node": [1], "direction": "x", "x": ["a"], "y": [0.0], "z": [0.0]})
    ),
    "line of three nodes": lambda: structure(lines=[(1, 1, 1)]),
    "parameters by name": lambda: structure(parameters=["k"]),
    "no files": lambda: calib.read_modes(None),
    "no such file": lambda: calib.read_responses("nowhere.csv"),
    "no such study": lambda: calib.Study.load("nowhere"),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_wrong_input_is_refused(wrong):
    with pytest.raises(calib.InputError):
        wrong()


def test_lists_iterators_and_series_serve_as_well():
    tests = (responses({"w2": [4.0, 0.01]}, name=name) for name in "ab")
    problem = calib.Problem(MODEL, tests)
    assert len(problem.pairs) == 2 and len(problem.fit_problem.rows) == 2
    found = problem.compare(pd.Series({"k": 40.0, "m": 10.0})).table
    assert found["model"].tolist() == [4.0, 4.0]


def test_a_structure_takes_a_whole_space():
    assert structure(parameters=SPACE.without({"m": 7.0})).space.names == ("k",)


def test_an_answer_without_names_is_a_failure_in_words():
    problem = calib.Problem(calib.FunctionModel("a", SPACE, lambda v: None), responses())
    with pytest.raises(calib.EvaluationError, match="NoneType"):
        problem.compare()


@pytest.mark.parametrize(("name", "place"), [({}, "the test"), ({"name": "loaded"}, "test loaded")])
def test_an_error_names_the_test(name, place):
    with pytest.raises(calib.InputError) as found:
        modal(held_out=["B"], **name)
    assert str(found.value).startswith(f"{place}: held-out mode or sensor 'B' was not measured")


def test_no_more_modes_are_wanted_than_a_free_structure_has():
    """Of five masses on a line that nothing holds, one motion is rigid."""
    links = 2 * np.eye(5) - np.eye(5, k=1) - np.eye(5, k=-1)
    links[0, 0] = links[-1, -1] = 1.0
    model = calib.StructuralModel.from_matrices(
        {"k": links}, np.eye(5), dofs=[(n, "x") for n in range(1, 6)],
        parameters=[calib.Parameter("k", 100.0, 50.0, 200.0, "N/m")],
    )  # fmt: skip
    modes = model.modes({"k": 110.0}, 4)

    def problem(count):
        freq = np.arange(1.0, 6.0)
        freq[: modes.n_modes] = modes.natural_freq
        return calib.Problem(model, calib.ModalTest(calib.modes(freq[:count], names=[f"m{n}" for n in range(count)])))

    for count in (3, 4):
        assert problem(count).compare().table["freq_error"].tolist() == pytest.approx([(10 / 11) ** 0.5 - 1] * count)
    with pytest.raises(calib.InputError, match="4 vibration modes, but 5"):
        problem(5).compare()
