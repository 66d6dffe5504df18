"""The test's wireframe joins neighbouring sensors, and nothing else."""

import numpy as np
import pandas as pd

from calib.report.mesh import Mesh
from calib.report.wireframe import wireframe


def mesh(points, *elements):
    table = pd.DataFrame([(*e, *[np.nan] * (4 - len(e))) for e in elements], columns=list("abcd"))
    xyz = pd.DataFrame(np.asarray(points, dtype=float), columns=list("xyz"))
    return Mesh(xyz.rename_axis("point").reset_index(), table.assign(group="g"))


LINE = [(k, 0, 0) for k in range(7)]
BAR = [(k, k + 1) for k in range(6)]


def test_sensors_on_a_bar_are_joined_in_their_order():
    found = wireframe(mesh(LINE, *BAR), np.array([(6, 0.01, 0), (0, 0, 0), (2, 0, 0)], dtype=float))
    assert found.tolist() == [[0, 2], [1, 2]]


def test_parts_meet_where_their_points_coincide_and_else_stay_apart():
    points = [*LINE, (6, 0, 0), (6, 1, 0), (6, 2, 0)]
    sensors = np.array([(0, 0, 0), (6, 0, 0), (6, 2, 0)], dtype=float)
    assert wireframe(mesh(points, *BAR, (7, 8), (8, 9)), sensors).tolist() == [[0, 1], [1, 2]]
    points[7:] = [(6, 0.5, 0), (6, 1, 0), (6, 2, 0)]
    assert wireframe(mesh(points, *BAR, (7, 8), (8, 9)), sensors).tolist() == [[0, 1]]


def test_elements_over_one_another_are_as_long_as_one():
    branch = [(3, 0, 0), (3, 1.25, 0), (3, 2.5, 0)]
    sensors = np.array([(0, 0, 0), (6, 0, 0), (3, 2.5, 0)], dtype=float)
    twice = mesh([*LINE, *branch, *branch], *BAR, (7, 8), (8, 9), (10, 11), (11, 12))
    assert wireframe(twice, sensors).tolist() == [[0, 2], [1, 2]]  # the last one is the nearest to the middle


def test_sensors_at_the_corners_of_a_plate_are_joined_along_its_edges():
    n = 9
    points = [(i, j, 0) for j in range(n) for i in range(n)]
    faces = [
        (j * n + i, j * n + i + 1, (j + 1) * n + i + 1, (j + 1) * n + i) for j in range(n - 1) for i in range(n - 1)
    ]
    corners = np.array([(0, 0, 0), (n - 1, 0, 0), (0, n - 1, 0), (n - 1, n - 1, 0)], dtype=float)
    joined = {tuple(pair) for pair in wireframe(mesh(points, *faces), corners).tolist()}
    assert {(0, 1), (0, 2), (1, 3), (2, 3)} <= joined and len(joined) <= 5  # at most one diagonal


def test_without_lines_or_sensors_there_is_none():
    assert wireframe(mesh(LINE), np.zeros((2, 3))).shape == (0, 2)
    assert wireframe(mesh(LINE, *BAR), np.zeros((0, 3))).shape == (0, 2)
