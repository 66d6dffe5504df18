"""Paths and pictures told in fewer bytes draw the same."""

import base64
import io
import itertools
import re

import numpy as np
import pytest
from matplotlib import hatch
from PIL import Image

from calib.report.style import new_figure, style
from calib.report.svg import PNG, boxed, shorter, smaller, svg_text

LINES = "fill: none; stroke: #000000"


def points(path):
    return np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path), dtype=float)


@pytest.mark.medium
def test_dots_of_a_hatch_are_arcs_of_their_centres_and_radius():
    with style():
        figure = new_figure(2.0)
        figure.add_subplot().bar([0], [1], hatch="..")
        text = svg_text(figure, "one")
    (tile,) = re.findall(r"<pattern.*?</pattern>", text, re.DOTALL)
    dots = np.array(
        re.findall(r"M([-\d.]+) ([-\d.]+)a([\d.]+) \3 0 1 0 ([\d.]+) 0a\3 \3 0 1 0 -\4 0z", tile), dtype=float
    )
    own = hatch.get_path("..", 6)
    starts = np.flatnonzero(own.codes == own.MOVETO)
    circles = [72 * own.vertices[a:b] for a, b in zip(starts, [*starts[1:], None], strict=True)]
    assert len(dots) == len(circles) > 100
    for (x, y, radius, across), circle in zip(dots, circles, strict=True):
        low, high = circle[:-1].min(axis=0), circle[:-1].max(axis=0)
        middle = (low + high) / 2
        np.testing.assert_allclose([x + across / 2, y], [middle[0], 72 - middle[1]], atol=0.011)
        assert radius == pytest.approx((high - low)[0] / 2, abs=0.006) and across == pytest.approx(
            2 * radius, abs=0.011
        )
    assert len(text) < 40_000


def test_eight_curves_that_are_no_circle_stay():
    ellipse = "M2 0" + "".join(
        f"C0 0 0 0 {2 * np.cos(t):.6f} {np.sin(t):.6f}" for t in np.arange(1, 9) * np.pi / 4
    ) + "z"  # fmt: skip
    assert shorter(ellipse, "fill: #ff0000") == ellipse


def test_chained_lines_lose_only_what_lies_on_a_straight_line():
    """Every point given lies on what is left, which holds all corners and both ends, in their order."""
    rng = np.random.default_rng(3)
    corners = np.round(rng.uniform(0, 400, (12, 2)), 2)
    corners[5] = corners[3]  # back on itself
    ways = itertools.pairwise(corners)
    dense = np.concatenate([a + np.linspace(0, 1, 20)[:-1, None] * (b - a) for a, b in ways] + [corners[-1:]])
    segments = "".join(f"M{a:.6f} {b:.6f}L{c:.6f} {d:.6f}" for (a, b), (c, d) in itertools.pairwise(dense))
    left = shorter(segments, LINES)
    assert left.count("M") == 1
    np.testing.assert_allclose(points(left), corners, atol=1e-9)
    assert points(shorter(f"{segments}M1 2L3 4", LINES)).tolist() == [*points(left).tolist(), [1, 2], [3, 4]]


def test_a_curve_keeps_its_course():
    angle = np.linspace(0, 2 * np.pi, 2000)
    circle = 100 + 60 * np.column_stack([np.cos(angle), np.sin(angle)])
    left = points(shorter("M" + "L".join(f"{x:.6f} {y:.6f}" for x, y in circle), LINES))
    assert 20 < len(left) < 1000
    middle = (left[1:] + left[:-1]) / 2
    assert np.abs(np.hypot(*(middle - 100).T) - 60).max() < 0.02  # a chord is farthest from its arc in the middle


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("M1.50 2.00L4.00 2.00L4.00 -3.25L1.50 -3.25L1.50 2.00z", "M1.50 2.00H4.00V-3.25H1.50z"),
        ("M-1 2L-1 7L5 7L5 2z", "M-1 2V7H5V2z"),
        ("M0 0L1 0L1 1L0 2L0 0z", "M0 0L1 0L1 1L0 2L0 0z"),
        ("M0 0L1 0L1 1L0 1", "M0 0L1 0L1 1L0 1"),
        ("M0 0L2 0L2 1L0 1zM5 5L6 5L6 6L5 6L5 5z", "M0 0H2V1H0zM5 5H6V6H5z"),
    ],
)
def test_boxes_are_told_by_their_sides(path, told):
    assert boxed(path) == told


@pytest.mark.parametrize("look", ["fill: #ff0000", "fill: none; stroke-dasharray: 3,2"])
def test_filled_and_dashed_lines_stay(look):
    segments = "M0 0L1 0M1 0L2 0"
    assert shorter(segments, look) == segments


@pytest.mark.parametrize("colours", [2, 256, 5000])
def test_a_picture_keeps_every_pixel(colours):
    rng = np.random.default_rng(colours)
    pixels = rng.integers(0, 256, (colours, 4), dtype=np.uint8)[rng.integers(0, colours, (90, 120))]
    file = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(file, "PNG")
    given = PNG + base64.b64encode(file.getvalue()).decode()
    made = smaller(given)
    shown = Image.open(io.BytesIO(base64.b64decode(made.removeprefix(PNG)))).convert("RGBA")
    np.testing.assert_array_equal(np.asarray(shown), pixels)
    assert (len(made) < 0.6 * len(given)) == (colours <= 256)
