"""The picture of an answer shows the place of the effect, that of the data alone, and the error without and with it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.report.answer import answer_figure, answered_place, most_telling_error
from calib.report.explanation_plan import read_place
from calib.report.scene import side_arrows, upright
from calib.report.style import style

PLACE = ["x", "y", "z"]
REST = np.array([[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], [[0.0, 0.0, 2.0], [4.0, 0.0, 2.0]]])


@pytest.fixture
def sensors():
    rows = [("1y", 0.0, 0.0, 0.0), ("2y", 4.0, 0.0, 0.0), ("3y", 4.0, 0.0, 2.0), ("4y", np.nan, np.nan, np.nan)]
    return pd.DataFrame(rows, columns=["sensor", *PLACE])


@pytest.fixture
def acts():
    rows = [("unit", 3.0, 0.0, 0.0), ("unit", 3.0, 0.0, 2.0), ("other", 1.0, 0.0, 0.0)]
    return pd.DataFrame(rows, columns=["effect", *PLACE])


@pytest.fixture
def pattern():
    """Sensor 2y has the largest single value, 3y the largest sum; 4y has no place and a frequency no sensor."""
    rows = [("unit", "", 90.0), ("unit", "2y", 4.0), ("unit", "3y", 3.0), ("unit", "3y", -3.0), ("unit", "4y", 50.0)]
    return pd.DataFrame(rows, columns=["effect", "sensor", "signature"])


@pytest.fixture
def local():
    rows = [
        ("added mass at sensor 2y", "2y", 4.0, 0.0, 0.0, -9.0, 4.0),
        ("mass of the beam", "", 2.0, 0.0, 0.0, 6.0, 4.0),
        ("added mass at sensor 1y", "1y", 0.0, 0.0, 0.0, np.nan, 4.0),
    ]
    return pd.DataFrame(rows, columns=["perturbation", "sensor", *PLACE, "score", "limit"])


@pytest.fixture
def errors():
    rows = [
        ("fit", "before", 2.0, 1.0), ("fit", "after", 1.0, 0.9), ("held_out_sensors", "before", 3.0, 1.1),
        ("held_out_sensors", "after", 1.2, 1.05), ("held_out_modes", "before", 9.0, 1.0),
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["group", "stage", "rms", "expected"])


def marks(figure, gid):
    """Places (n, 3) of the marks of a gid."""
    (line,) = [line for line in figure.axes[0].lines if line.get_gid() == gid]
    x, y, z = (np.asarray(v, dtype=float) for v in line.get_data_3d())
    return np.column_stack([x, z, -y])


def test_stars_stand_where_the_named_effect_acts_and_only_there(sensors, acts, pattern, local, errors):
    found = answered_place(sensors, acts, pattern, local)
    with style():
        figure = answer_figure(REST, found, ["unit"], {"unit": "64 kg"}, sensors, errors)
    np.testing.assert_allclose(marks(figure, "acts"), [[3, 0, 0], [3, 0, 2]])
    np.testing.assert_allclose(marks(figure, "alone"), [[4, 0, 0]])
    np.testing.assert_allclose(marks(figure, "shows"), [[4, 0, 2]])
    np.testing.assert_allclose(marks(figure, "sensors"), sensors[PLACE].dropna())
    assert {"3y", "2y"} <= {text.get_text() for text in figure.axes[0].texts}
    words = " ".join(text.get_text() for text in figure.legends[0].get_texts())
    assert "unit, 64 kg" in words and "sensor 2y fits best, 1 m from the star" in words and "sensor 3y" in words


def test_a_star_does_not_hide_the_diamond_and_the_legend_has_no_sensor_that_is_not_drawn(sensors, acts, pattern, local):
    def drawn(local, shown):
        found = answered_place(sensors, acts, pattern, local)
        with style():
            figure = answer_figure(REST, found, ["unit"], {}, shown)
        (line,) = [line for line in figure.axes[0].lines if line.get_gid() == "alone"]
        return line.get_markersize(), [text.get_text() for text in figure.legends[0].get_texts()]

    apart, words = drawn(local, sensors)
    assert apart < 19 and "sensors" in words
    at_star = local.assign(x=3.0)
    around, words = drawn(at_star, sensors.assign(x=np.nan))
    assert around > 19 and "sensors" not in words


def test_each_of_several_effects_has_a_line_with_its_own_size_within_the_figure(sensors, acts, pattern, local, errors):
    """Sizes come in the order of their evidence, which is another one."""
    what = ["mass of the crossbar", "soft mounts of the dampers", "uneven springs"]
    sizes = {name: f"{k} mm (95 %: {k} to {k})" for k, name in enumerate(reversed(what), 100)}
    found = answered_place(sensors, acts, pattern, local)
    with style():
        figure = answer_figure(REST, found, what, sizes, sensors, errors)
        figure.canvas.draw()
    star = figure.legends[0].get_texts()[0].get_text().splitlines()
    assert star[:3] == [f"{name}, {sizes[name]}," for name in what]
    assert found.marks("unit")["star"].splitlines()[1:] == [
        "at (+3.00, 0.00, 0.00) and (+3.00, 0.00, +2.00) m,", "as the list of causes assumes"
    ]  # fmt: skip
    many = replace(found, acts=np.vstack([found.acts, found.acts]))
    assert " m and 2 more places,\nas the list of causes assumes" in many.marks("unit")["star"]
    assert [text.get_text() for text in figure.axes[-1].get_xticklabels()] == ["without\nthem", "with\nthem"]
    bars = figure.axes[-1].get_tightbbox()
    legend = figure.legends[0].get_window_extent()
    assert legend.x1 < figure.bbox.x1 and not (legend.x1 > bars.x0 and legend.y1 > bars.y0)


def test_the_bars_are_the_error_in_data_that_no_fit_has_seen(sensors, acts, pattern, local, errors):
    with style():
        figure = answer_figure(REST, answered_place(sensors, acts, pattern, local), ["unit"], {}, sensors, errors)
    bars = {bar.get_gid(): bar.get_height() for bar in figure.axes[-1].patches}
    assert bars == {"before": 3.0, "after": 1.2}
    used = most_telling_error(errors[errors["group"] != "held_out_sensors"])
    assert used["rms"].tolist() == [2.0, 1.0]
    modes = pd.DataFrame([("held_out_modes", "after", 4.0, 1.0)], columns=errors.columns)
    unseen = pd.concat([errors[errors["group"] != "held_out_sensors"], modes])
    assert most_telling_error(unseen)["rms"].tolist() == [9.0, 4.0]
    assert most_telling_error(errors[errors["stage"] == "before"]) is None and most_telling_error(None) is None


def test_without_a_named_effect_the_picture_shows_the_place_that_is_told(sensors, acts, local):
    found = answered_place(sensors, acts, None, local.assign(told=[True, False, False]))
    assert not len(found.acts) and found.alone == "added mass at sensor 2y" and np.isnan(found.away)
    with style():
        figure = answer_figure(REST, found, [], {}, sensors)
    assert len(figure.axes) == 2  # the model and its axes
    assert {line.get_gid() for line in figure.axes[0].lines} >= {"alone", "sensors", "model"}


def test_without_a_named_effect_a_place_that_the_verdict_does_not_tell_is_not_marked(sensors, acts, local):
    assert answered_place(sensors, acts, None, local) is None  # a table without that column
    assert answered_place(sensors, acts, None, local.assign(told=False)) is None
    assert answered_place(sensors, acts, None, None) is None


def test_a_score_within_its_limit_points_nowhere(sensors, acts, pattern, local):
    assert not answered_place(sensors, acts, pattern, local.assign(limit=9.5)).alone


def test_something_like_an_effect_is_marked_where_it_acts(sensors, acts, pattern, local):
    found = answered_place(sensors, acts, pattern, local.assign(told=False), attempt=True)
    assert len(found.acts) == 2 and not found.alone and found.sensor == "3y"


@pytest.mark.parametrize(("told", "points"), [(True, True), (False, False)])
def test_an_attempt_points_at_its_effect_only_where_that_is_told(tmp_path, sensors, acts, pattern, local, told, points):
    effects = pd.DataFrame({"name": ["unit"], "told": [told]})
    why = pattern.assign(effects="unit", kind="shape", mode=list("ABCDE"), part="")
    tables = {"sensors": sensors, "effect_places": acts, "why": why, "effects": effects}
    for name, table in (tables | {"perturbations": local.assign(told=False)}).items():
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    found = read_place(tmp_path, attempt=True)
    assert (found is not None and len(found.acts) == 2) == points
    assert read_place(tmp_path, attempt=False).alone == "added mass at sensor 2y"


def test_of_a_change_of_a_whole_part_no_distance_is_told(sensors, acts, pattern, local):
    part = local.assign(score=[3.0, 6.0, np.nan])
    found = answered_place(sensors, acts, pattern, part)
    assert found.alone == "mass of the beam" and np.isnan(found.away)
    assert not any("away" in words for words in found.marks("unit").values())


@pytest.mark.parametrize(
    ("axes", "ends"),
    [
        ("x to the front, y up, z to the left", {"front": [4, 0, 1], "left": [2, 0, 2]}),
        ("x to the front, y to the left, z up", {"front": [4, 0, 0], "left": [2, 0, 2]}),  # left rises in the view
        ("x along the arm, y up", {}),
    ],
)
def test_the_sides_that_the_axes_name_are_marked(sensors, acts, pattern, local, axes, ends):
    with style(), upright(axes):
        arrows = side_arrows(REST.reshape(-1, 3))
        figure = answer_figure(REST, answered_place(sensors, acts, pattern, local), ["unit"], {}, sensors, None)
    assert {text.get_text() for text in figure.axes[0].texts} & {"front", "left"} == set(arrows) == set(ends)
    for side, (start, end) in arrows.items():
        way = np.abs(end - start)
        assert np.count_nonzero(way) == 1 and (end - start)[way > 0] > 0
        np.testing.assert_allclose(start[way == 0], np.array(ends[side])[way == 0])
        assert (start - np.array(ends[side]))[way > 0] > 0
