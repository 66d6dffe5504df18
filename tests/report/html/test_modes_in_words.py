"""The page says at its head what moves most in the modes, which have names such as 1BT."""

from types import SimpleNamespace

import pandas as pd

from calib.report.html.comparison import modes_in_words, moving_most


def results(part=("frame", "frame", "axle_front", ""), **shapes):
    sensors = pd.DataFrame({"sensor": ["1x", "1y", "2x", "3y"], "part": part})
    return SimpleNamespace(sensors=sensors, table=shapes.get)


def shapes(**modes):
    rows = [
        (mode, sensor, sensor[-1], value)
        for mode, values in modes.items()
        for sensor, value in zip(("1x", "1y", "2x", "3y"), values, strict=True)
    ]
    return pd.DataFrame(rows, columns=["mode", "sensor", "direction", "measured_re"])


def test_each_mode_moves_most_where_its_shape_is_largest_and_those_of_one_kind_stand_together():
    table = shapes(A=(0.1, -1.0, 0.5, 9.0), B=(0.1, 0.2, -0.6, 9.0), C=(0.3, 0.7, 0.1, 9.0))
    own = results(shapes_before=table)
    assert moving_most(own) == {"A": "frame along y", "B": "axle front along x", "C": "frame along y"}
    assert modes_in_words(own) == "A, C: frame along y; B: axle front along x"


def test_the_calibrated_pairs_are_taken_where_there_are_any():
    before, after = shapes(A=(1.0, 0.0, 0.0, 0.0)), shapes(A=(0.0, 0.0, 1.0, 0.0))
    assert moving_most(results(shapes_before=before, shapes_after=after)) == {"A": "axle front along x"}


def test_nothing_is_said_without_parts_or_shapes_and_of_many_modes():
    table = shapes(A=(1.0, 0.0, 0.0, 0.0))
    assert moving_most(results(part=("",) * 4, shapes_before=table)) == {} == moving_most(results())
    many = shapes(**{f"mode_{k}": (1.0, 0.0, 0.0, 0.0) for k in range(60)})
    assert modes_in_words(results(shapes_before=many)) == ""


def test_a_part_with_many_sensors_does_not_outweigh_one_that_moves_more():
    sensors = pd.DataFrame({"sensor": ["1y", "2y", "3y", "4y"], "part": ["frame"] * 3 + ["box"]})
    rows = [("A", sensor, "y", value) for sensor, value in zip(sensors["sensor"], (0.8, 0.8, 0.8, 1.0), strict=True)]
    table = pd.DataFrame(rows, columns=["mode", "sensor", "direction", "measured_re"])
    own = SimpleNamespace(sensors=sensors, table={"shapes_after": table}.get)
    assert moving_most(own) == {"A": "box along y"}
