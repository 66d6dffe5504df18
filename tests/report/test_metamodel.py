"""Figures of metamodels show the numbers of their tables."""

import numpy as np
import pandas as pd
import pytest

from calib.report.metamodel import TOTAL, draw_prognosis, draw_residuals, surface_figure


@pytest.fixture
def tables():
    total = pd.DataFrame({"response": ["f1", "f2"], "cop": [0.9, np.nan]})
    inputs = pd.DataFrame(
        {
            "response": ["f1", "f1", "f2", "f2"],
            "parameter": ["k", "m", "k", "m"],
            "cop": [0.7, 0.004, np.nan, np.nan],
        }
    )
    return total, inputs


def test_the_matrix_has_every_input_and_the_total_in_the_last_row(tables):
    ax = draw_prognosis(*tables)
    shown = np.ma.filled(ax.images[-1].get_array().astype(float), np.nan)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["k", "m", TOTAL]
    np.testing.assert_allclose(shown, [[0.7, np.nan], [np.nan, np.nan], [0.9, np.nan]])
    assert {"0.70", "0.90"} == {text.get_text() for text in ax.texts if text.get_text()[:1] == "0"}


def test_predicted_values_stand_against_computed_ones():
    rng = np.random.default_rng(1)
    true = rng.normal(size=50)
    table = pd.DataFrame({"true": true, "predicted": true + 0.1 * rng.normal(size=50)})
    assert draw_residuals(table, "mac", unit="-").get_xlabel() == "mac, model"
    ax = draw_residuals(table, "f1", unit="Hz")
    assert ax.get_xlabel().endswith("(Hz)") and ax.get_ylabel().endswith("(Hz)")
    (points,) = [c for c in ax.collections if c.get_gid() == "designs"]
    np.testing.assert_allclose(points.get_offsets(), table)
    cop = 1 - ((table["true"] - table["predicted"]) ** 2).sum() / ((true - true.mean()) ** 2).sum()
    assert f"CoP {cop:.3f}" in ax.get_title(loc="left") and "50 designs" in ax.get_title(loc="left")
    (line,) = ax.lines
    assert np.array_equal(line.get_xdata(), line.get_ydata())


def test_a_surface_is_that_of_its_grid():
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(1, 2, 5), np.linspace(10, 30, 4)))
    grid = pd.DataFrame({"k": x, "m": y, "f1": x * y}).sample(frac=1.0, random_state=1)
    designs = pd.DataFrame({"k": [1.2, 1.8], "m": [11.0, 29.0]})
    figure = surface_figure(grid, designs, "k", "m", "f1", {"k": "k, N/m", "f1": "f1, Hz"})
    flat, space = [ax for ax in figure.axes if ax.get_label() != "<colorbar>"]
    assert flat.get_xlabel() == space.get_xlabel() == "k, N/m" and flat.get_ylabel() == "m"
    (points,) = [c for c in flat.collections if c.get_gid() == "designs"]
    np.testing.assert_allclose(points.get_offsets(), designs)
    low, high = space.get_zlim()
    assert low < 10.0 and high > 60.0 and flat.get_xlim() == (1.0, 2.0)
    (contours,) = [c for c in flat.collections if c.get_gid() != "designs"]
    assert contours.get_array().min() <= 10.0 + 60.0 / 14 and contours.get_array().max() >= 60.0 - 60.0 / 14
