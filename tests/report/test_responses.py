"""Scalar responses before and after calibration stand in one chart, with their values and errors."""

import numpy as np
import pandas as pd
import pytest

from calib.report.figures import is_legible
from calib.report.responses import draw_responses
from calib.report.style import style


def table(names, error, std=0.02):
    measured = np.arange(1.0, len(names) + 1)
    model = measured * (1 + np.asarray(error))
    in_std = (model - measured) / (std * measured)
    return pd.DataFrame(
        {"response": names, "measured": measured, "model": model, "error": error, "error_in_std": in_std}
    )


def test_both_stages_have_bars_values_and_percent_in_one_chart():
    before, after = table(["load", "lift"], [0.1, -0.25]), table(["load", "lift"], [0.004, 0.0])
    ax = draw_responses(before, after)
    heights = [[bar.get_height() for bar in bars] for bars in ax.containers]
    np.testing.assert_allclose(heights, [[5.0, -12.5], [0.2, 0.0]], atol=1e-12)
    words = [text.get_text().split("\n") for text in ax.texts]
    assert words == [["1.100", "+10.0 %"], ["1.500", "−25.0 %"], ["1.004", "+0.4 %"], ["2", "0.0 %"]]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["load\nmeasured 1", "lift\nmeasured 2"]


def test_values_stand_in_the_unit_of_their_response():
    before = table(["load", "lift"], [0.1, -0.25]).assign(unit=["N", np.nan])
    ax = draw_responses(before)
    assert [text.get_text().split("\n")[0] for text in ax.texts] == ["1.100 N", "1.500"]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["load\nmeasured 1 N", "lift\nmeasured 2"]


@pytest.mark.parametrize("count", [10, 40])
def test_many_responses_keep_their_names_and_of_very_many_no_value_is_written(count):
    names = [f"r{k}" for k in range(count)]
    ax = draw_responses(table(names, np.full(count, 0.01)), added=table(names[:-1], np.full(count - 1, 0.0)))
    ax.figure.draw_without_rendering()
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert len(labels) == count and all(a.startswith(b) for a, b in zip(labels, names, strict=True))
    written = [text.get_text() for text in ax.texts if text.get_text()]
    assert len(written) == (2 * count - 1 if 2 * count - 1 <= 30 else 0)


@pytest.mark.medium
def test_values_and_names_of_many_responses_stand_clear_of_axes_legend_and_each_other():
    names = [f"response_{k}" for k in range(11)]
    error = np.array([-0.09, 0.48, *np.full(9, 0.002)])
    with style():
        ax = draw_responses(table(names, error), table(names, error / 30))
        ax.figure.draw_without_rendering()
        assert is_legible(ax.figure)
    whole = ax.get_window_extent()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert len(boxes) == 22 and all(whole.x0 < box.x0 and box.x1 < whole.x1 for box in boxes)
    widths = [bar.get_width() for bar in ax.containers[0]]
    np.testing.assert_allclose(widths, error / 0.02, rtol=1e-9)
