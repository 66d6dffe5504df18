"""The viewer's data are those of the tables, and its view holds them."""

import base64
import json

import numpy as np
import pandas as pd
import pytest

from calib.report.html.space import framed, packed_numbers, scene
from calib.report.html.study_results import StudyResults
from calib.report.scene import plot_coordinates, upright, view_directions
from calib.report.where import sensor_rms

PLACE, MOTION = ["x", "y", "z"], ["u", "v", "w"]
PERTURBATIONS = ["perturbations of stiffness", "perturbations of mass"]


def unpacked(pack):
    """Points (n, 3) as the page reads them."""
    counts = np.frombuffer(base64.b64decode(pack["numbers"]), dtype="<i2")
    return (counts * pack["step"]).reshape(-1, 3)


def layer(results, name):
    return next(layer for layer in scene(results)["layers"] if layer["name"] == name)


# -- mode shapes -------------------------------------------------------------------------------------------------------


def test_points_and_lines_reproduce_every_deflected_line(everything, results):
    data = scene(results)
    assert [s["name"] for s in data["stages"]] == ["before calibration", "after calibration"]
    points = pd.read_csv(everything / "mesh_points.csv").set_index("point")
    elements = pd.read_csv(everything / "mesh_elements.csv")
    assert elements["c"].isna().all() and data["faces"] == []  # a mast has no shells
    ends = elements[["a", "b"]].to_numpy(dtype=int)
    lines = np.array(data["lines"]).reshape(-1, 2)
    np.testing.assert_allclose(unpacked(data["points"])[lines], points[PLACE].to_numpy()[ends], atol=1e-3)
    for stage, name in zip(data["stages"], ("before", "after"), strict=True):
        table = pd.read_csv(everything / f"deflection_{name}.csv")
        assert stage["modes"]
        for mode in stage["modes"]:
            own = table[table["mode"] == mode["name"]].set_index("point")[MOTION].reindex(points.index).to_numpy()
            moved = unpacked(mode["motion"])[lines]
            np.testing.assert_allclose(moved, own[ends], atol=np.abs(own).max() / 60000)


def test_measured_motions_are_those_at_the_sensors(everything, results):
    data, shapes = scene(results), pd.read_csv(everything / "shapes_after.csv")
    sites = unpacked(data["sites"]["points"])
    for mode in data["stages"][-1]["modes"]:
        own = shapes[shapes["mode"] == mode["name"]]
        measured = unpacked(mode["measured"])
        assert len(mode["at"]) == len(measured)
        found = {}
        for site, motion in zip(mode["at"], measured, strict=True):
            for sensor in data["sites"]["words"][site].split(", "):
                found[sensor] = sites[site], motion
        for row in own.to_dict("records"):
            place, motion = found[row["sensor"]]
            np.testing.assert_allclose(place, [row[axis] for axis in PLACE], atol=1e-3)
            assert motion[PLACE.index(row["direction"])] == pytest.approx(row["measured_re"], abs=1e-4)


def test_faces_keep_their_corners_and_an_unpaired_mode_has_no_motion(folder):
    pd.DataFrame(
        [(0, 0, 0, 0), (1, 1, 0, 0), (2, 1, 1, 0), (3, 0, 1, 0), (4, 5, 5, 5)], columns=["point", *PLACE]
    ).to_csv(folder / "mesh_points.csv", index=False)
    pd.DataFrame([("wall", 0, 1, 2, 3)], columns=["group", *"abcd"]).to_csv(folder / "mesh_elements.csv", index=False)
    moves = pd.DataFrame([("B1x", k, 0.1 * k, 0, 0) for k in range(5)], columns=["mode", "point", *MOTION])
    for stage in ("before", "after"):
        moves.to_csv(folder / f"deflection_{stage}.csv", index=False)
    data = scene(StudyResults(folder, "", False))
    assert len(unpacked(data["points"])) == 4  # the last one belongs to no element
    assert data["faces"] == [0, 1, 2, 3] and len(data["lines"]) == 8 and data["lone"] == []  # and the borders
    first, *others = data["stages"][0]["modes"]
    assert first["name"] == "B1x"
    np.testing.assert_allclose(unpacked(first["motion"])[:, 0], [0.0, 0.1, 0.2, 0.3], atol=1e-5)
    assert others and all(mode["motion"] is None for mode in others)


def test_a_mesh_without_elements_is_shown_as_points(folder):
    pd.DataFrame(columns=["group", *"abcd"]).to_csv(folder / "mesh_elements.csv", index=False)
    data = scene(StudyResults(folder, "", False))
    assert data["lone"] == list(range(len(pd.read_csv(folder / "mesh_points.csv")))) and data["lines"] == []


# -- layers of dots ----------------------------------------------------------------------------------------------------


def test_every_sensor_stands_at_its_place_along_its_direction(everything, results):
    sensors, shown = pd.read_csv(everything / "sensors.csv"), layer(results, "sensors")
    dots, feet = unpacked(shown["points"]), unpacked(shown["feet"])
    rows = {name.split(",")[0]: k for k, name in enumerate(shown["names"])}
    assert rows.keys() == {*sensors["sensor"]}
    held = {name: colour for name, colour in zip(shown["names"], shown["colours"], strict=True) if "validation" in name}
    assert {name.split(",")[0] for name in held} == {*sensors.loc[sensors["held_out"], "sensor"]}
    assert len({*held.values()}) == 1 and len({*shown["colours"]}) == 2
    for row in sensors.to_dict("records"):
        k = rows[row["sensor"]]
        np.testing.assert_allclose(feet[k], [row[axis] for axis in PLACE], atol=1e-3)
        assert int(np.argmax(dots[k] - feet[k])) == PLACE.index(row["direction"])


def test_misfits_have_the_size_and_the_place_of_their_rms(everything, results):
    table, shown = pd.read_csv(everything / "sensor_misfit.csv"), layer(results, "misfit")
    found = sensor_rms(table[table["stage"] == "base"]).set_index("sensor")
    dots, feet = unpacked(shown["points"]), unpacked(shown["feet"])
    names = [name.split(":")[0] for name in shown["names"]]
    assert names == list(found.index)  # worst first
    np.testing.assert_allclose(feet, found[PLACE], atol=1e-3)
    rms = found["rms"].to_numpy()
    lengths = np.linalg.norm(dots - feet, axis=1)
    np.testing.assert_allclose(lengths / lengths[0], rms / rms[0], atol=2e-3)
    span = np.array(shown["sizes"]) - 6.0
    np.testing.assert_allclose(span / span[0], rms / rms[0], atol=0.02)


@pytest.mark.medium
def test_scores_beyond_the_limit_have_the_colour_of_their_key_in_a_layer_for_each_kind(everything, results):
    table = pd.read_csv(everything / "perturbations.csv")
    (limit,), largest = set(table["limit"]), table["score"].abs().max()
    by_kind = table.dropna(subset=[*PLACE, "score"]).groupby("kind")
    assert len(by_kind) > 1 and {*PERTURBATIONS} == {f"perturbations of {kind}" for kind, _ in by_kind}
    found = []
    for kind, placed in by_kind:
        shown = layer(results, f"perturbations of {kind}")
        names = [name.split(": z ")[0] for name in shown["names"]]
        rows = placed.set_index("perturbation").loc[names]
        assert len(names) == len(placed)
        found += (beyond := (rows["score"].abs() > limit).tolist())
        first, second = (entry["colour"] for entry in shown["key"])
        assert shown["colours"] == [first if b else second for b in beyond]
        np.testing.assert_allclose(unpacked(shown["points"]), rows[PLACE], atol=1e-3)
        np.testing.assert_allclose(shown["sizes"], 6.0 + 12.0 * rows["score"].abs() / largest, atol=0.051)
    assert 0 < sum(found) < len(found)


def test_effects_are_shown_where_they_act_the_credible_ones_marked(folder):
    shown = next(layer for layer in scene(StudyResults(folder, "", False))["layers"] if layer["name"] == "effects")
    acts = pd.read_csv(folder / "effect_places.csv")
    credible = set(pd.read_csv(folder / "effects.csv").query("credible")["name"])
    assert sorted(name.split(":")[0] for name in shown["names"]) == sorted(acts["effect"])
    marked = {name.split(":")[0] for name, size in zip(shown["names"], shown["sizes"], strict=True) if size == 18.0}
    assert marked == credible & set(acts["effect"]) != set()


@pytest.mark.parametrize(
    ("gone", "left"),
    [
        (["shapes_before", "shapes_after"], ["sensors", "misfit", "effects", *PERTURBATIONS]),
        (["sensors"], ["misfit", "effects", *PERTURBATIONS]),
        (["sensor_misfit", "perturbations"], ["sensors", "effects"]),
        (["effect_places"], ["sensors", "misfit", *PERTURBATIONS]),
    ],
)
def test_only_what_has_data_is_offered(folder, gone, left):
    for name in gone:
        (folder / f"{name}.csv").unlink()
    data = scene(StudyResults(folder, "", False))
    assert [layer["name"] for layer in data["layers"]] == left
    assert bool(data["stages"]) == ("shapes_before" not in gone)


def test_without_a_mesh_dots_are_shown_alone(folder):
    (folder / "mesh_points.csv").unlink()
    data = scene(StudyResults(folder, "", False))
    assert data["stages"] == [] and len(unpacked(data["points"])) == 0
    assert len(data["layers"][0]["names"]) == len(pd.read_csv(folder / "sensors.csv"))


def test_without_any_data_there_is_no_viewer(folder):
    for name in ("shapes_before", "shapes_after", "sensors", "sensor_misfit", "effect_places", "perturbations"):
        (folder / f"{name}.csv").unlink()
    assert scene(StudyResults(folder, "", False)) is None


# -- the view ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", ["", "x to the front, y to the left, z up"])
@pytest.mark.parametrize("size", [(4.0, 2.0, 0.5), (0.0, 0.0, 6.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_the_view_holds_all_points_and_is_that_of_the_figures(size, axes):
    points = np.array([[0.0, 0.0, 0.0], size]) + np.array([3.0, -1.0, 2.0])
    with upright(axes):
        view = framed(points)
        eye, centre = np.array(view["eye"]), np.array(view["centre"])
        np.testing.assert_allclose(view_directions() @ plot_coordinates(eye), 0.0, atol=1e-12)
        seen = plot_coordinates(points - centre) @ view_directions().T
    assert view["up"] == ([0.0, 0.0, 1.0] if axes else [0.0, 1.0, 0.0])
    assert eye @ view["up"] > 0 and np.linalg.norm(eye) == pytest.approx(1.0)  # from above
    assert np.all(np.abs(seen) <= np.array(view["size"]) / 2 + 1e-12)
    assert np.all(np.linalg.norm(points - centre, axis=1) <= view["radius"] + 1e-12)
    assert min(view["size"]) > 0 and view["radius"] > 0


@pytest.mark.parametrize(("axes", "other"), [("", 2), ("z up", 1)])
def test_turned_about_the_vertical_everything_stays_in_the_width_of_the_view(axes, other):
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (30, 3)) * [9.0, 1.0, 2.0] + [5.0, 0.0, -3.0]
    with upright(axes):
        view = framed(points)
    for angle in np.linspace(0.0, np.pi, 7):
        around = np.eye(3)[0] * np.cos(angle) + np.eye(3)[other] * np.sin(angle)
        across = (points - view["centre"]) @ around
        assert np.abs(across).max() <= view["size"][0] / 2 + 1e-12


def test_packed_numbers_lose_less_than_a_step():
    values = np.random.default_rng(3).normal(size=(50, 3)) * [1e-4, 1.0, 30.0]
    pack = packed_numbers(values)
    assert np.abs(unpacked(pack) - values).max() <= 0.5 * pack["step"] <= np.abs(values).max() / 65000
    assert unpacked(packed_numbers(np.zeros((2, 3)))).tolist() == [[0.0] * 3] * 2
    assert len(unpacked(packed_numbers(np.zeros((0, 3))))) == 0


def test_all_data_can_be_written_as_json(results):
    data = scene(results)
    assert json.loads(json.dumps(data, allow_nan=False)) == data
