"""The legend of overlaid FRFs stands between the heading and the curves, whatever the number of stages."""

import numpy as np
import pandas as pd
import pytest

from calib.report.frf import overlay_figure
from calib.report.style import COLUMN, WIDTH, add_heading, style

STAGES = ("before", "after", "added")


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("width", [WIDTH, COLUMN])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_legend_covers_neither_heading_nor_curves(count, width):
    freq = np.linspace(1.0, 20.0, 5)
    line = pd.DataFrame({"freq": freq, "measured_re": 1.0, "measured_im": 0.1, "model_re": 2.0, "model_im": 0.1})
    names = pd.DataFrame({"response": ["1x", "2x"], "reference": "1x", "frac": 0.5, "unit": "m/N"})
    overlay = pd.concat([line.assign(response=r, reference="1x") for r in names["response"]], ignore_index=True)
    with style(width):
        figure = overlay_figure(
            dict.fromkeys(STAGES[:count], overlay), dict.fromkeys(STAGES[:count], names), effects="prop"
        )
        add_heading(figure, "Chain", True)
        figure.draw_without_rendering()
    axes = figure.axes[0]
    legend = axes.get_legend().get_window_extent()
    assert len(axes.get_legend().get_texts()) == count + 1
    assert figure.texts and not any(legend.overlaps(text.get_window_extent()) for text in figure.texts)
    assert legend.y0 >= axes.get_window_extent().y1 - 1  # pixels, of rounding
