import numpy as np
import pandas as pd
import pytest

from calib.report.calibration import draw_convergence, draw_searches, ends_figure


def words(ax):
    return [t.get_text() for t in ax.texts if t.get_gid() != "bar value"]


def bar_values(ax):
    return {round(float(t.xy[1]), 6): t.get_text() for t in ax.texts if t.get_gid() == "bar value"}


def legend(ax):
    return [t.get_text() for t in ax.get_legend().get_texts()]


def test_bar_lengths_are_the_ratios_in_percent(parameters):
    ax = draw_searches(parameters)
    for bars, case in zip(ax.containers, ["GB1", "GB2"], strict=True):
        rows = parameters[parameters["case"] == case]
        np.testing.assert_allclose([bar.get_width() for bar in bars], 100 * rows["ratio"])
        assert bars.get_label() == case
    assert [t.get_text() for t in ax.get_yticklabels()] == ["K_primary (MN/m)", "position"]


def test_every_bar_has_its_value_beside_it(parameters):
    ax = draw_searches(parameters)
    middle = [round(bar.get_y() + bar.get_height() / 2, 6) for bars in ax.containers for bar in bars]
    assert bar_values(ax) == dict(zip(middle, ["1.5", "−0.25", "1.6", "1"], strict=True))
    searched = draw_searches(parameters.assign(search_value=[1.25, np.nan, 1.75, 0.5]))
    assert list(bar_values(searched).values()) == ["1.25", "−0.25", "1.75", "0.5"]


@pytest.mark.parametrize(("units", "dark"), [(["MN/m", "-"], 1), (["-", "-"], 0)])
def test_a_dark_line_separates_neighbours_of_different_units(parameters, units, dark):
    ax = draw_searches(parameters.assign(unit=units * 2))
    between = [line for line in ax.lines if list(line.get_ydata()) == [0.5, 0.5]]
    assert len(between) == 1 and sum(line.get_linewidth() > 0.8 for line in between) == dark


def test_bars_of_a_case_stand_in_the_row_of_their_parameter(parameters):
    ax = draw_searches(parameters)
    assert len(ax.containers) == 2
    for bars in ax.containers:
        assert [round(bar.get_y() + bar.get_height() / 2) for bar in bars] == [0, 1]


def test_cases_may_lack_parameters(parameters):
    ax = draw_searches(parameters.drop(index=2))
    np.testing.assert_allclose([bar.get_width() for bar in ax.containers[1]], [np.nan, 100.0])


def test_a_value_at_a_limit_has_a_marker_beside_its_bar(parameters):
    ax = draw_searches(parameters)
    marks = {line.get_gid(): line for line in ax.lines if (line.get_gid() or "").startswith("on_limit")}
    assert len(marks["on_limit GB1 >"].get_xdata()) == len(marks["on_limit GB2 <"].get_xdata()) == 0
    bar = ax.containers[1][1]
    assert marks["on_limit GB2 >"].get_ydata() == pytest.approx([bar.get_y() + bar.get_height() / 2])
    assert marks["on_limit GB2 >"].get_xdata()[0] > 100.0
    assert "ends at a search limit" in legend(ax)


def test_a_search_that_ended_at_a_limit_is_marked_wherever_least_squares_went(parameters):
    """The bar ends where the search did: at the lower limit it has no length, and only the mark is seen."""
    table = parameters.assign(lower=0.0, upper=10.0, on_limit=[False, True, False, False], stable=True)
    table["search_value"] = [0.0, 5.0, 10.0, np.nan]
    table["search_on_limit"] = pd.Series([True, False, True, None], dtype=object)
    marks = {
        line.get_gid(): line.get_xdata().tolist()
        for line in draw_searches(table).lines
        if (line.get_gid() or "").startswith("on_limit")
    }
    assert marks == {
        "on_limit GB1 <": [1.6], "on_limit GB1 >": [], "on_limit GB2 <": [], "on_limit GB2 >": [101.6],
    }  # fmt: skip


def test_an_unstable_parameter_is_hatched_and_labelled(parameters):
    ax = draw_searches(parameters)
    assert [[bool(bar.get_hatch()) for bar in bars] for bars in ax.containers] == [[False, True], [False, True]]
    assert words(ax) == ["not stable, spread 62 %"]


def test_stable_parameters_within_their_limits_have_no_markers(parameters):
    ax = draw_searches(parameters.assign(stable=True, on_limit=False))
    assert words(ax) == [] and legend(ax) == ["GB1", "GB2"]


def test_unknown_stability_is_no_verdict(parameters):
    ax = draw_searches(parameters.assign(stable=None, spread=np.nan))
    assert words(ax) == [] and not any(bar.get_hatch() for bars in ax.containers for bar in bars)


def test_the_reported_case_is_marked(parameters):
    assert legend(draw_searches(parameters.assign(stable=True), best_case="GB1"))[:2] == [
        "GB1 (its fit is reported)",
        "GB2",
    ]


def test_lines_are_the_misfits(convergence):
    ax = draw_convergence(convergence)
    best = {line.get_label().split(" ")[0]: line for line in ax.lines if line.get_label().startswith("GB")}
    np.testing.assert_array_equal(best["GB1"].get_xdata(), [0, 1, 2])
    np.testing.assert_array_equal(best["GB1"].get_ydata(), [1.0, 0.5, 0.25])
    # rows in any order are drawn by generation; a generation without a feasible point is a gap
    np.testing.assert_array_equal(best["GB2"].get_xdata(), [0, 1, 2])
    np.testing.assert_array_equal(best["GB2"].get_ydata(), [np.nan, 0.6, 0.3])
    assert legend(ax) == ["GB1 (ends at 0.250)", "GB2 (ends at 0.300)", "mean of the generation"]
    means = [line.get_ydata() for line in ax.lines if line.get_linestyle() == "--" and len(line.get_xdata())]
    np.testing.assert_array_equal(means, [[2.0, 1.0, 0.5], [np.nan, 1.2, 0.6]])


def test_logarithmic_only_when_all_is_positive(convergence):
    assert draw_convergence(convergence).get_yscale() == "log"
    assert draw_convergence(convergence.assign(best=0.0)).get_yscale() == "linear"


def test_one_case_and_one_generation(convergence):
    ax = draw_convergence(convergence.iloc[:1])
    assert ax.lines[0].get_marker() == "o" and list(ax.lines[0].get_ydata()) == [1.0]


def test_a_case_without_a_feasible_point(convergence):
    ax = draw_convergence(convergence.assign(best=np.nan, mean=np.nan))
    assert legend(ax) == ["GB1 (no feasible point)", "GB2 (no feasible point)"]


def test_bars_show_where_the_searches_ended():
    rows = [
        {
            "case": case, "parameter": "k", "value": 6.0, "unit": "-", "lower": 0.0, "upper": 10.0, "ratio": 0.6,
            "on_limit": False, "spread": 0.2, "stable": False, "std": 0.5, "search_value": found,
        }
        for case, found in (("A", 2.0), ("B", 4.0))
    ]  # fmt: skip
    ax = draw_searches(pd.DataFrame(rows), best_case="B")
    assert [p.get_width() for c in ax.containers for p in c.patches] == [20.0, 40.0]


def test_ends_of_searches_are_open_and_fits_filled():
    table = pd.DataFrame(
        [
            ("GB1", "search", "1BT", 0.02, 0.98), ("GB1", "search", "2BT", -0.01, 0.9999),
            ("GB1", "least squares", "1BT", 0.01, 0.99), ("GB1", "least squares", "2BT", np.nan, np.nan),
            ("GB2", "search", "1BT", 0.03, 0.95), ("GB2", "search", "2BT", 0.01, 0.97),
        ],
        columns=["case", "point", "what", "error", "mac"],
    )  # fmt: skip
    errors, mac = ends_figure(table).axes
    marks = {line.get_gid(): line for line in [*errors.lines, *mac.lines] if line.get_gid()}
    np.testing.assert_allclose(marks["error GB1 search"].get_ydata(), [2.0, -1.0])
    np.testing.assert_allclose(marks["error GB1 least squares"].get_ydata(), [1.0, np.nan])
    np.testing.assert_allclose(marks["mac GB1 search"].get_ydata(), [0.02, 1e-3])
    fills = [marks[f"mac GB1 {point}"].get_markerfacecolor() == "none" for point in ("search", "least squares")]
    assert fills == [True, False]
    assert marks["error GB1 search"].get_xdata()[1] < 1 < marks["error GB2 search"].get_xdata()[1]
    assert legend(errors)[:2] == ["GB1: mean |error| 1.50 % → 50.50 %", "GB2: mean |error| 2.00 %"]
    assert len(ends_figure(table.assign(mac=np.nan)).axes) == 1
