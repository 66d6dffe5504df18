"""The figure and the section of held-out predictions show the numbers of their tables."""

import numpy as np
import pandas as pd
import pytest

from calib.report.figures import Figures, is_legible
from calib.report.html.study_results import StudyResults
from calib.report.html.write import sections
from calib.report.predictions import draw_predictions
from tests.report.html.page_blocks import Table, section_blocks

CAPTION = "Validation data by the base model, alone and with the unexplained misfit"


def blocks_of_errors(folder):
    """Blocks of the section of prediction errors."""
    found = {section.name: section for section in sections(StudyResults(folder, "Bogie", True))}
    return section_blocks(found["errors"]) if "errors" in found else []


def table_of(blocks):
    (table,) = [block for block in blocks if isinstance(block, Table) and block.caption == CAPTION]
    return table


def made(freq=False):
    rows = [
        ("held_out_sensors", "1BT", "101y", "shape", "re", 0.5, 0.4, 0.3, 0.5, False, 0.2, 0.7, True),
        ("held_out_sensors", "1BT", "101y", "shape", "im", 0.1, 0.1, 0.0, 0.2, True, -0.1, 0.34, True),
        ("held_out_modes", "4BT", "", "frequency", "", 12.0, 10.0, 9.0, 10.5, False, 9.5, 11.5, False),
    ]
    columns = (
        "group mode sensor kind part value predicted low high inside "
        "low_unexplained high_unexplained inside_unexplained"
    ).split()
    table = pd.DataFrame(rows, columns=columns)
    if freq:
        table.insert(5, "freq", [10.0, 11.0, 12.0])
    return table


ERRORS = pd.DataFrame(
    [("held_out_sensors", 2, 3.5, 1.1, 1e-6, 1.3, 0.4), ("held_out_modes", 1, 2.5, 1.05, 1e-5, 1.7, 0.3)],
    columns="group rows rms expected p expected_unexplained p_unexplained".split(),
)


def dots(ax, gid):
    (line,) = [line for line in ax.lines if line.get_gid() == gid]
    return line.get_xydata().tolist()


def bars(ax):
    (found,) = [c for c in ax.collections if c.get_gid() == "unexplained"]
    return [s[:, 1].tolist() for s in found.get_segments()], [url for url in found.get_urls()]


@pytest.mark.parametrize("freq", [False, True])
def test_dots_and_bars_are_distances_from_the_prediction_in_half_intervals_of_the_fit_alone(freq):
    ax = draw_predictions(made(freq))
    np.testing.assert_allclose(dots(ax, "inside"), [[0, 1.0], [1, 0.0]], atol=1e-12)
    np.testing.assert_allclose(dots(ax, "outside"), [[2, 4.0]])
    ends, words = bars(ax)
    np.testing.assert_allclose(
        ends, [[-2.0, 3.0], [-2.0, 2.4], [-0.5, 3.0]]
    )  # the lower half interval of the last is 1
    assert len(words) == 3 and ("12%20Hz" in words[2] or "12 Hz" in words[2]) == freq
    assert [t.get_text() for t in ax.get_xticklabels()] == ["validation sensors", "validation modes"]
    assert ax.get_yscale() == "linear" and is_legible(ax.figure)


def test_of_many_values_evenly_spaced_ones_are_drawn():
    many = pd.concat([made()] * 200, ignore_index=True).sort_values("group", kind="stable")
    ax = draw_predictions(many)
    assert len(bars(ax)[0]) == 134 + 67 and "one value in 3" in ax.get_xlabel()


def test_values_far_off_have_a_logarithmic_axis():
    assert draw_predictions(made().assign(value=[40.0, 0.1, 12.0])).get_yscale() == "symlog"


@pytest.fixture
def unbounded(tmp_path):
    """Folder of results in which the interval of the first value, with the misfit, has no upper end."""
    table = made()
    table.loc[0, "high_unexplained"] = np.inf
    table.to_csv(tmp_path / "unexplained_predictions.csv", index=False)
    ERRORS.to_csv(tmp_path / "unexplained_errors.csv", index=False)
    return tmp_path, table


@pytest.mark.medium
def test_a_value_without_a_finite_interval_is_counted_and_not_drawn(unbounded):
    folder, table = unbounded
    ax = draw_predictions(table)
    np.testing.assert_allclose(dots(ax, "inside"), [[0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(dots(ax, "outside"), [[1, 4.0]])
    assert len(bars(ax)[0]) == 2
    plan = Figures(folder, "Bogie", True).plan
    np.testing.assert_allclose(dots(plan["held_out_predictions"].draw().axes[0], "outside"), [[1, 4.0]])
    assert table_of(blocks_of_errors(folder)).rows[0][:3] == ("validation sensors", "1 of 2", "2 of 2")


def test_without_any_finite_interval_the_figure_says_so():
    ax = draw_predictions(made().assign(low=-np.inf))
    assert "no prediction has a finite interval" in [text.get_text() for text in ax.texts]


@pytest.mark.medium
def test_the_page_counts_and_tells_what_the_tables_hold(tmp_path):
    made().to_csv(tmp_path / "unexplained_predictions.csv", index=False)
    ERRORS.to_csv(tmp_path / "unexplained_errors.csv", index=False)
    assert "held_out_predictions" in Figures(tmp_path, "Bogie", True).plan
    blocks = blocks_of_errors(tmp_path)
    table, names = table_of(blocks), [getattr(block, "name", "") for block in blocks]
    words = blocks[names.index("held_out_predictions") - 1]
    assert table.rows[0][:5] == ("validation sensors", "1 of 2", "2 of 2", "3.50", "1.10")
    assert table.rows[1][:5] == ("validation modes", "0 of 1", "0 of 1", "2.50", "1.05")
    assert table.rows[0][5] == "1.30" and "noise of the measurement" in words.text


def test_without_the_tables_the_page_has_no_section(tmp_path):
    assert blocks_of_errors(tmp_path) == []
