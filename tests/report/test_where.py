import os

import numpy as np
import pandas as pd
import pytest

from calib.report.numbers import place
from calib.report.where import (
    best_perturbations,
    draw_mode_misfit,
    draw_perturbations,
    draw_sensor_misfit,
    perturbation_map_figure,
    score_limit,
    sensor_misfit_figure,
    sensor_rms,
)

DIAGONAL = np.sqrt(4.0**2 + 1.0**2 + 2.0**2)


@pytest.fixture
def structure():
    """Two lines."""
    return np.array([[[0.0, 0.0, -1.0], [4.0, 0.0, -1.0]], [[4.0, 0.0, -1.0], [4.0, 1.0, 1.0]]])


@pytest.fixture
def misfit():
    """Sensors 1y and 1z are at one place, 9y has none; mode C is the worst and A the best of the base model."""
    rows = []
    for mode, size in (("A", 1.0), ("B", 2.0), ("C", 4.0), ("D", 3.0)):
        rows += [
            ("base", mode, "1y", 1, "y", 0.0, 0.0, -1.0, 3.0 * size, 4.0 * size),
            ("base", mode, "1z", 1, "z", 0.0, 0.0, -1.0, size, 0.0),
            ("base", mode, "2y", 2, "y", 4.0, 0.0, -1.0, -size, np.nan),
            ("base", mode, "9y", 9, "y", np.nan, np.nan, np.nan, 99.0, 99.0),
            ("explained", mode, "1y", 1, "y", 0.0, 0.0, -1.0, 0.5, 0.5),
        ]
    return pd.DataFrame(rows, columns="stage mode sensor node direction x y z re im".split())


@pytest.fixture
def perturbations():
    rows = [
        ("spring 1", "stiffness", 0.0, 0.0, -1.0, "", -8.0, 0.5),
        ("spring 2", "stiffness", 4.0, 0.0, -1.0, "", 2.0, 0.25),
        ("spring 3", "stiffness", 4.0, 1.0, 1.0, "", np.nan, 0.0),
        ("damper 1", "damping", 4.0, 1.0, 1.0, "", 4.0, 0.75),
        ("mass 1", "mass", 2.0, 0.0, -1.0, "1y", 0.1, 1.0),
        ("mass 9", "mass", np.nan, np.nan, np.nan, "9y", 7.0, 1.0),
    ]
    return pd.DataFrame(rows, columns="perturbation kind x y z sensor score unabsorbed".split()).assign(limit=2.9)


def drawn(ax, gid):
    """Points (n, 3) of a line, gaps left out, back in the coordinates of the data."""
    (line,) = [line for line in ax.lines if line.get_gid() == gid]
    x, y, z = (np.asarray(v, dtype=float) for v in line.get_data_3d())
    points = np.column_stack([x, z, -y])
    return points[~np.isnan(points).any(axis=1)]


def dots(ax, gid):
    """Places (n, 3) and values of the circles, and the circles."""
    (circles,) = [c for c in ax.collections if c.get_gid() == gid]
    x, y, z = (np.asarray(v, dtype=float) for v in circles._offsets3d)
    return np.column_stack([x, z, -y]), np.asarray(circles.get_array()), circles


def test_rms_weighs_real_and_imaginary_parts_equally_and_noise_gives_one(misfit):
    table = sensor_rms(misfit[misfit["stage"] == "base"]).set_index("sensor")["rms"]
    mean_square = np.mean([1.0, 4.0, 16.0, 9.0])
    assert table["1y"] == pytest.approx(np.sqrt(mean_square * (9 + 16) / 2))
    assert table["2y"] == pytest.approx(np.sqrt(mean_square))
    rng = np.random.default_rng(3)
    noise = pd.DataFrame({"sensor": "a", "direction": "y", "x": 0.0, "y": 0.0, "z": 0.0, "mode": range(4000)})
    noise[["re", "im"]] = rng.normal(size=(4000, 2))
    assert sensor_rms(noise)["rms"][0] == pytest.approx(1.0, abs=0.03)


def test_sticks_lie_along_the_sensors_and_the_worst_is_a_tenth_of_the_structure(misfit, structure):
    ax = draw_sensor_misfit(misfit, structure)
    place, rms, circles = dots(ax, "rms")
    root = np.sqrt(7.5)
    np.testing.assert_allclose(rms, [root * np.sqrt(12.5), root, root * np.sqrt(0.5)])
    length = 0.1 * DIAGONAL * rms / rms[0]
    expected = [[0, length[0], -1], [4, length[1], -1], [0, 0, -1 + length[2]]]
    np.testing.assert_allclose(place, expected, atol=1e-12)
    np.testing.assert_allclose(drawn(ax, "structure"), [[0, 0, -1], [4, 0, -1], [4, 0, -1], [4, 1, 1]])
    assert (np.diff(circles.get_sizes()) < 0).all()
    assert circles.norm.vmin == 0.0 and circles.norm.vmax == pytest.approx(rms[0])
    assert [t.get_text() for t in ax.texts] == ["all modes, sensors: 3", "1", "2", "3"]


def test_small_misfits_do_not_look_large(misfit, structure):
    _, rms, circles = dots(draw_sensor_misfit(misfit, structure, stage="explained"), "rms")
    np.testing.assert_allclose(rms, [0.5])
    assert circles.norm.vmax == 3.0


def test_arrows_are_the_residuals_of_the_mode(misfit, structure):
    rows = misfit[(misfit["stage"] == "base") & (misfit["mode"] == "B")]
    ax = draw_mode_misfit(rows, structure, scale=0.01)
    np.testing.assert_allclose(drawn(ax, "re"), [[0, 0, -1], [0, 0.06, -0.98], [4, 0, -1], [4, -0.02, -1]], atol=1e-12)
    np.testing.assert_allclose(drawn(ax, "im"), [[0, 0, -1], [0, 0.08, -1]], atol=1e-12)
    np.testing.assert_allclose(drawn(ax, "re tip"), drawn(ax, "re")[1::2])


@pytest.mark.medium
def test_the_three_worst_modes_have_panels_on_one_scale(misfit, structure):
    figure = sensor_misfit_figure(misfit, structure)
    panels = [ax for ax in figure.axes if ax.get_subplotspec() is not None][1:]
    placed = misfit[(misfit["stage"] == "base") & misfit["x"].notna()]
    titles = [ax.texts[0].get_text() for ax in panels]
    for title, mode in zip(titles, "CDB", strict=True):
        parts = placed.loc[placed["mode"] == mode, ["re", "im"]].to_numpy().ravel()
        assert title == f"{mode}   rms {np.sqrt(np.nanmean(parts**2)):.1f} σ"
    lengths = [np.linalg.norm(drawn(ax, "im")[1] - drawn(ax, "im")[0]) for ax in panels]
    np.testing.assert_allclose(lengths, 0.1 * DIAGONAL * np.array([4.0, 3.0, 2.0]) / 4.0)
    words = [t.get_text() for t in figure.texts]
    assert any(text.startswith("worst sensors:\n1  1y") and "9y" not in text for text in words)


def test_without_sensors_the_structure_alone_is_drawn(misfit, structure):
    figure = sensor_misfit_figure(misfit.iloc[:0], structure)
    figure.savefig(os.devnull, format="png")
    assert len(drawn(figure.axes[0], "structure")) == 4


def test_perturbations_are_drawn_at_their_places_with_a_symmetric_scale(perturbations, structure):
    ax = draw_perturbations(perturbations, structure)
    place, score, circles = dots(ax, "score")
    np.testing.assert_array_equal(score, [-8.0, 2.0])
    np.testing.assert_allclose(place, [[0, 0, -1], [4, 0, -1]])
    assert (circles.norm.vmin, circles.norm.vmax) == (-8.0, 8.0)
    assert circles.get_sizes()[0] > circles.get_sizes()[1]
    np.testing.assert_allclose(drawn(ax, "absorbed"), [[4, 1, 1]])


def test_the_colour_scale_reaches_five_at_least(perturbations):
    assert score_limit(perturbations) == 8.0
    assert score_limit(perturbations.assign(score=0.1 * perturbations["score"])) == 5.0
    assert score_limit(perturbations.iloc[:0]) == score_limit(perturbations.assign(score=np.nan)) == 5.0


@pytest.mark.medium
def test_the_best_three_are_numbered_at_their_places_and_named(perturbations, structure):
    assert list(best_perturbations(perturbations)["perturbation"]) == ["spring 1", "damper 1", "spring 2"]
    figure = perturbation_map_figure(perturbations, structure)
    panels = {ax.texts[0].get_text().split(",")[0]: [t.get_text() for t in ax.texts[1:]] for ax in figure.axes[:3]}
    assert panels == {"stiffness": ["1", "3"], "damping": ["2"], "mass": []}
    (words,) = [t.get_text() for t in figure.texts if "largest scores" in t.get_text()]
    at = place(perturbations.loc[perturbations["perturbation"] == "spring 1", ["x", "y", "z"]].to_numpy()[0])
    assert (
        f"1  spring 1\n     stiffness, z = −8.0, γ = 0.50\n     x, y, z = {at} m" in words and "explained by" in words
    )
    first = next(t for t in figure.axes[0].texts if t.get_text() == "1")
    figure.savefig(os.devnull, format="png")
    at = figure.axes[0].transData.transform(first.xy)
    circle = figure.axes[0].collections[0]
    np.testing.assert_allclose(at, figure.axes[0].transData.transform(circle.get_offsets()[0]), atol=0.5)


@pytest.mark.medium
@pytest.mark.parametrize("table", ["misfit", "perturbations"])
def test_all_texts_lie_inside_the_picture_and_do_not_overlap(table, structure, request):
    given = request.getfixturevalue(table)
    figure = (sensor_misfit_figure if table == "misfit" else perturbation_map_figure)(given, structure)
    figure.savefig(os.devnull, format="png")
    boxes = [t.get_window_extent() for t in figure.texts]
    boxes += [legend.get_window_extent() for legend in figure.legends]
    boxes += [ax.get_tightbbox() for ax in figure.axes if ax.get_label() == "colours"]
    whole = figure.bbox
    for k, box in enumerate(boxes):
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= whole.x1 and box.y1 <= whole.y1
        assert not any(box.overlaps(other) for other in boxes[:k])


@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("kinds", [["stiffness"], ["stiffness", "mass"], []])
def test_there_is_a_panel_per_kind(perturbations, structure, kinds):
    figure = perturbation_map_figure(perturbations[perturbations["kind"].isin(kinds)], structure)
    figure.savefig(os.devnull, format="png")
    assert sum(ax.get_subplotspec() is not None for ax in figure.axes) == max(1, len(kinds))
