"""Three-dimensional figures: their data are those of the tables."""

import numpy as np
import pandas as pd
import pytest

from calib.report.html.space import directions, new_space, scene, scene_layout
from calib.report.html.study_results import StudyResults
from calib.report.scene import plot_coordinates, view_directions

PLACE, MOTION = ["x", "y", "z"], ["u", "v", "w"]


def test_points_and_lines_reproduce_every_deflected_line(everything, results):
    stages = scene(results)["stages"]
    assert [s["name"] for s in stages] == ["before calibration", "after calibration"]
    points = pd.read_csv(everything / "mesh_points.csv").set_index("point")
    elements = pd.read_csv(everything / "mesh_elements.csv")
    assert elements["c"].isna().all()  # a mast has no shells
    ends = elements[["a", "b"]].to_numpy(dtype=int)
    for stage, name in zip(stages, ("before", "after"), strict=True):
        table = pd.read_csv(everything / f"deflection_{name}.csv")
        lines = np.array(stage["lines"])
        rest = plot_coordinates(points[PLACE].to_numpy()[ends])
        np.testing.assert_allclose(np.array(stage["points"])[lines], rest, atol=6e-6)
        assert stage["modes"]
        for mode in stage["modes"]:
            own = table[table["mode"] == mode["name"]].set_index("point")[MOTION].reindex(points.index)
            np.testing.assert_allclose(
                np.array(mode["motion"])[lines], plot_coordinates(own.to_numpy()[ends]), atol=6e-6
            )


def test_measured_motions_are_those_at_the_sensors(everything, results):
    shapes = pd.read_csv(everything / "shapes_after.csv")
    for mode in scene(results)["stages"][-1]["modes"]:
        own = shapes[shapes["mode"] == mode["name"]]
        found = {tuple(p): m for p, m in zip(mode["places"], mode["measured"], strict=True)}
        for row in own.to_dict("records"):
            place = tuple(np.round(plot_coordinates(np.array([row["x"], row["y"], row["z"]])), 5))
            axis = {"x": (0, 1.0), "z": (1, -1.0)}[row["direction"]]
            assert axis[1] * found[place][axis[0]] == pytest.approx(row["measured_re"], abs=1e-5)


def test_shells_are_two_triangles_each_and_an_unpaired_mode_is_at_rest(folder):
    pd.DataFrame(
        [(0, 0, 0, 0), (1, 1, 0, 0), (2, 1, 1, 0), (3, 0, 1, 0), (4, 5, 5, 5)], columns=["point", *PLACE]
    ).to_csv(folder / "mesh_points.csv", index=False)
    pd.DataFrame([("wall", 0, 1, 2, 3)], columns=["group", *"abcd"]).to_csv(folder / "mesh_elements.csv", index=False)
    moves = pd.DataFrame([("B1x", k, 0.1 * k, 0, 0) for k in range(5)], columns=["mode", "point", *MOTION])
    for stage in ("before", "after"):
        moves.to_csv(folder / f"deflection_{stage}.csv", index=False)
    stage = scene(StudyResults(folder, "", False))["stages"][0]
    assert len(stage["points"]) == 4  # the last one belongs to no element
    triangles = np.array(stage["triangles"]).T
    assert sorted(map(sorted, triangles.tolist())) == [[0, 1, 2], [0, 2, 3]]
    assert len(stage["lines"]) == 4  # the borders
    first, *others = stage["modes"]
    assert first["name"] == "B1x" and first["paired"]
    np.testing.assert_allclose(np.array(first["motion"])[:, 0], [0.0, 0.1, 0.2, 0.3])
    assert others and not any(m["paired"] for m in others) and not np.any(others[0]["motion"])


def test_without_measured_shapes_there_is_no_viewer(folder):
    for stage in ("before", "after"):
        (folder / f"shapes_{stage}.csv").unlink()
    assert scene(StudyResults(folder, "", False)) is None


@pytest.mark.parametrize("size", [(4.0, 2.0, 0.5), (0.0, 0.0, 6.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_the_view_keeps_equal_scales_and_holds_all_points(size):
    points = np.array([[0.0, 0.0, 0.0], size]) + np.array([3.0, -1.0, 2.0])
    look = scene_layout(points)
    spans = [look[f"{axis}axis"]["range"] for axis in "xyz"]
    ratio = [look["aspectratio"][axis] for axis in "xyz"]
    scales = np.array(ratio) / np.ptp(spans, axis=1)
    assert np.all(np.isfinite(scales)) and np.ptp(scales) < 1e-9 * scales[0]
    assert all(a <= p + 1e-9 and p <= b + 1e-9 for (a, b), p in zip(spans * 2, points.ravel(), strict=True))
    eye = np.array([look["camera"]["eye"][axis] for axis in "xyz"])
    np.testing.assert_allclose(view_directions() @ eye, 0.0, atol=1e-12)
    assert eye[2] > 0  # from above


def test_directions_stand_along_the_axes():
    corner, *tips = directions(np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]]))
    np.testing.assert_allclose(np.array(tips) - corner, 0.5 * np.eye(3))
    assert new_space(None, np.zeros((1, 3))).data  # a single point has directions too
