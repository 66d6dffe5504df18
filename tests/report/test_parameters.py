import numpy as np
import pandas as pd
import pytest

from calib.report.parameters import draw_parameters


@pytest.fixture
def table(parameters):
    return parameters.assign(std=[0.05, np.nan, 0.05, 0.5], identified=[True, False, True, False])


@pytest.fixture
def prior():
    return pd.DataFrame({"parameter": ["position", "K_primary"], "value": [0.0, 1.4], "prior_sd": [0.25, 0.4]})


def lines(ax):
    return {line.get_gid(): line for line in ax.lines if line.get_gid()}


def words(ax):
    return [t.get_text() for t in ax.texts]


def segments(ax, gid):
    (found,) = [c for c in ax.collections if c.get_gid() == gid]
    return [segment[:, 0].tolist() for segment in found.get_segments()]


def test_the_reported_value_stands_between_the_limits_with_its_interval(table):
    ax = draw_parameters(table, best_case="GB1")
    found = lines(ax)
    sure = found["identified True"]
    assert sure.get_xdata().tolist() == [0.5] and sure.get_ydata().tolist() == [0]
    assert found["identified False"].get_xdata().tolist() == [0.375]
    assert found["identified False"].get_markerfacecolor() == "white"
    (interval,) = segments(ax, "posterior")  # position has no standard deviation
    np.testing.assert_allclose(interval, [0.5 - 1.96 * 0.05, 0.5 + 1.96 * 0.05])
    assert words(ax) == ["1.500 ± 0.050 MN/m", "−0.250"]


def test_an_interval_ends_at_the_limits_and_a_value_there_is_marked(table):
    ax = draw_parameters(table, best_case="GB2")
    np.testing.assert_allclose(segments(ax, "posterior")[1], [1.0 - 1.96 * 0.25, 1.0])
    mark = lines(ax)["on_limit"]
    assert mark.get_ydata().tolist() == [1] and mark.get_xdata()[0] > 1.0


def test_the_other_cases_are_crosses_in_the_rows_of_their_parameters(table):
    cross = lines(draw_parameters(table, best_case="GB2"))["other cases"]
    assert cross.get_xdata().tolist() == [0.5, 0.375] and cross.get_ydata().tolist() == [0, 1]
    alone = lines(draw_parameters(table[table["case"] == "GB1"]))
    assert len(alone["other cases"].get_xdata()) == 0


def test_the_prior_is_a_band_about_the_nominal_value_within_the_limits(table, prior):
    ax = draw_parameters(table, None, "GB1", prior)
    (bands,) = ax.containers
    found = [(bar.get_y() + bar.get_height() / 2, bar.get_x(), bar.get_x() + bar.get_width()) for bar in bands]
    # K_primary 1.4 of 1 to 2 with 0.4, position 0 of -1 to 1 with 0.25
    np.testing.assert_allclose(found, [[0, 0.0, 1.0], [1, 0.25, 0.75]])
    np.testing.assert_allclose(lines(ax)["nominal"].get_xdata(), [0.4, 0.5])
    none = draw_parameters(table, None, "GB1", prior.iloc[:0])
    assert not any(bar.get_width() for container in none.containers for bar in container)


def test_an_unknown_case_is_the_first_and_unknown_verdicts_are_filled(table):
    found = lines(draw_parameters(table.drop(columns="identified"), best_case="XX"))
    assert found["identified None"].get_xdata().tolist() == [0.5, 0.375]


def test_the_legend_names_what_is_seen(table):
    def legend(table):
        handles = draw_parameters(table, best_case="GB1").get_legend().legend_handles
        return {handle.get_label(): handle.get_markerfacecolor() for handle in handles if handle.get_marker() == "o"}

    assert list(legend(table)) == ["GB1: value and 95 % interval", "not identified"]
    (only,) = legend(table.assign(identified=False)).items()
    assert only == ("GB1: value and 95 % interval, not identified", "white")
    same = table.assign(ratio=[0.5, 0.375, 0.5, 0.375])
    for found, crosses in ((table, True), (same, False)):
        shown = draw_parameters(found, best_case="GB1").get_legend().get_texts()
        assert ("other cases" in [text.get_text() for text in shown]) is crosses
