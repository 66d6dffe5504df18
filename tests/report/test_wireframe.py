"""The test's wireframe joins neighbouring sensors, and nothing else."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from calib.report.mesh import MeshTables
from calib.report.shapes import wireframe


def mesh(points, *elements):
    table = pd.DataFrame([(*e, *[np.nan] * (4 - len(e))) for e in elements], columns=list("abcd"))
    xyz = pd.DataFrame(np.asarray(points, dtype=float), columns=list("xyz"))
    return MeshTables(xyz.rename_axis("point").reset_index(), table.assign(group="g"))


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
    assert wireframe(mesh(points, *faces), corners).tolist() == [[0, 1], [0, 2], [1, 3], [2, 3]]


@pytest.fixture
def tube():
    """A closed tube along x, 24 m long and 2 m high and wide, of squares of 0.5 m."""
    n, steps = 48, [(0, 1), (1, 0), (0, -1), (-1, 0)]
    ring, here = [], np.array([-1.0, -1.0])
    for step in steps:
        for _ in range(4):
            ring.append(here)
            here = here + 0.5 * np.array(step)
    points = [(0.5 * i, y, z) for i in range(n + 1) for y, z in ring]
    m = len(ring)
    faces = [(i * m + j, i * m + (j + 1) % m, (i + 1) * m + (j + 1) % m, (i + 1) * m + j)
             for i in range(n) for j in range(m)]  # fmt: skip
    return mesh(points, *faces)


def test_rows_of_sensors_on_a_car_are_joined_along_its_walls(tube):
    """Two rows at the floor and one at the roof, which has fewer: no line crosses the inside or a wall askew."""
    low, high = [0.0, 3.0, 8.0, 12.0, 16.0, 21.0, 24.0], [0.0, 8.0, 12.0, 16.0, 24.0]
    rows = [("left", x, -1.0, 1.0) for x in low] + [("right", x, -1.0, -1.0) for x in low]
    rows += [("roof", x, 1.0, 1.0) for x in high]
    found = {tuple((rows[k][0], rows[k][1]) for k in pair) for pair in wireframe(tube, np.array([r[1:] for r in rows]))}
    along = {((side, a), (side, b)) for side in ("left", "right") for a, b in pairwise(low)}
    along |= {(("roof", a), ("roof", b)) for a, b in pairwise(high)}
    across = {(("left", x), ("right", x)) for x in low} | {(("left", x), ("roof", x)) for x in high}
    assert found == along | across


@pytest.mark.medium
@given(st.lists(st.integers(0, 49 * 16 - 1), min_size=2, max_size=12, unique=True))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_sensors_of_one_body_are_connected(tube, rows):
    sensors = tube.points[["x", "y", "z"]].to_numpy()[rows]
    found = wireframe(tube, sensors)
    graph = coo_array((np.ones(len(found)), found.T), shape=(len(rows), len(rows)))
    assert connected_components(graph, directed=False)[0] == 1


def test_without_lines_or_sensors_there_is_none():
    assert wireframe(mesh(LINE), np.zeros((2, 3))).shape == (0, 2)
    assert wireframe(mesh(LINE, *BAR), np.zeros((0, 3))).shape == (0, 2)
