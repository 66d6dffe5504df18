import os

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection

from calib.report.style import new_figure
from calib.report.verification import (
    best_candidates,
    draw_error_versions,
    draw_errors,
    draw_next_measurement,
    next_measurement_figure,
)

nan = np.nan


@pytest.fixture
def errors():
    rows = [
        ("held_out_sensors", "after", 1.0, 0.9, 0.4),
        ("held_out_sensors", "before", 2.0, 1.1, 1e-9),
        ("fit", "before", 4.0, 0.95, 0.0),
        ("fit", "after", 0.9, nan, nan),
        ("held_out_modes", "before", nan, nan, nan),
    ]
    return pd.DataFrame(rows, columns="group stage rms expected p".split())


def dots(ax, stage):
    (line,) = [line for line in ax.lines if line.get_gid() == stage]
    return line


def labels(axis):
    return [t.get_text() for t in axis]


def test_dots_are_the_errors_of_the_groups_in_the_table(errors):
    ax = draw_errors(errors)
    assert labels(ax.get_xticklabels()) == ["used in the fit", "validation sensors"]
    np.testing.assert_array_equal(dots(ax, "before").get_ydata(), [4.0, 2.0])
    np.testing.assert_array_equal(dots(ax, "after").get_ydata(), [0.9, 1.0])
    assert labels(ax.texts) == ["4.00\np < 0.001", "2.00\np < 0.001", "0.90", "1.00\np = 0.4"]
    assert ax.get_yscale() == "linear" and ax.get_ylim()[0] == 0.0


def test_the_noise_floor_is_marked_at_every_dot(errors):
    ax = draw_errors(errors)
    marks = {c.get_gid(): c.get_segments() for c in ax.collections if isinstance(c, LineCollection)}
    np.testing.assert_allclose([s[0][1] for s in marks["expected before"]], [0.95, 1.1])
    (after,) = marks["expected after"]
    at = dots(ax, "after").get_xdata()[1]
    assert after[0][1] == 0.9 and after[0][0] < at < after[1][0]


def test_errors_that_differ_much_have_a_logarithmic_axis(errors):
    ax = draw_errors(errors.assign(rms=10.0 * errors["rms"]))
    assert ax.get_yscale() == "log"
    assert ax.get_ylim()[0] < 0.9 and ax.get_ylim()[1] > 40.0


def test_an_attempt_is_no_explanation(errors):
    attempted = errors.replace({"stage": {"after": "attempt"}})
    after, attempt = draw_errors(errors, name="arb"), draw_errors(attempted, name="arb")
    assert labels(after.get_legend().get_texts())[1] == "with arb, calibrated"
    assert labels(attempt.get_legend().get_texts())[1] == "with arb: best attempt, not believed"
    assert labels(draw_errors(attempted).get_legend().get_texts())[1] == "with the best attempt, not believed"
    assert labels(draw_errors(errors).get_legend().get_texts())[1] == "with the missing effect, calibrated"
    shown, plain = dots(attempt, "attempt"), dots(after, "after")
    np.testing.assert_array_equal(shown.get_ydata(), [0.9, 1.0])
    assert shown.get_marker() != plain.get_marker() and shown.get_color() != plain.get_color()


def test_no_errors(errors):
    for table in (errors.iloc[:0], errors.assign(rms=nan)):
        ax = draw_errors(table)
        ax.figure.savefig(os.devnull, format="png")
        assert labels(ax.texts) == ["no error is known"]


@pytest.fixture
def versions():
    rows = [
        (2, "arb + seats", "fit", 1.0, 0.9),
        (0, "", "fit", 4.0, 0.95),
        (0, "", "held_out_modes", 8.0, 1.0),
        (1, nan, "fit", 2.0, nan),
        (2, "arb + seats", "held_out_modes", 1.2, 1.1),
    ]
    return pd.DataFrame(rows, columns="version effects group rms expected".split())


def test_lines_are_the_errors_in_the_order_of_the_versions(versions):
    ax = draw_error_versions(versions)
    lines = {line.get_gid(): line for line in ax.lines}
    np.testing.assert_array_equal(lines["fit"].get_ydata(), [4.0, 2.0, 1.0])
    np.testing.assert_array_equal(lines["held_out_modes"].get_ydata(), [8.0, nan, 1.2])
    assert labels(ax.get_xticklabels()) == ["0\nbase model", "1\nbase model", "2\narb + seats"]
    x, y = lines["expected fit"].get_data()
    np.testing.assert_allclose(x, [-0.2, 0.2, nan, 0.8, 1.2, nan, 1.8, 2.2])
    np.testing.assert_allclose(y, [0.95, 0.95, nan, nan, nan, nan, 0.9, 0.9])


def test_one_version_or_none(versions):
    draw_error_versions(versions[versions["version"] == 0]).figure.savefig(os.devnull, format="png")
    assert labels(draw_error_versions(versions.iloc[:0]).texts) == ["no version of the model is known"]


@pytest.fixture
def candidates():
    rows = [(f"sensor {k}", "sensor", "arb", 1.0 + 0.1 * k, nan) for k in range(12)]
    rows += [("twice", "repeats", "arb", np.inf, nan), ("weigh", "bench", "arb", nan, nan)]
    table = pd.DataFrame(rows, columns="measurement kind effect gain ln_bayes".split())
    more = {
        "gain_low": table["gain"] - 0.2,
        "gain_high": table["gain"] + 0.3,
        "ln_bayes_low": nan,
        "ln_bayes_high": nan,
    }
    return table.assign(**more)


def test_the_ten_best_candidates_are_drawn_from_no_gain(candidates):
    ax = draw_next_measurement(candidates)
    assert labels(ax.get_yticklabels()) == ["twice (for arb)", *(f"sensor {k} (for arb)" for k in range(11, 2, -1))]
    (container,) = ax.containers
    np.testing.assert_allclose([b.get_x() for b in container], 1.0)
    np.testing.assert_allclose([b.get_width() for b in container][1:], np.arange(1.1, 0.2, -0.1))
    assert labels(ax.texts)[:2] == ["× ∞", "× 2.10"]
    (ranges,) = [c for c in ax.collections if c.get_gid() == "range"]
    ends = [segment[:, 0] for segment in ranges.get_segments()]
    np.testing.assert_allclose(ends, [(1 + 0.1 * k - 0.2, 1 + 0.1 * k + 0.3) for k in range(11, 2, -1)])
    assert labels(ax.get_legend().get_texts()) == ["more repeats", "further sensor"]
    assert len(next_measurement_figure(candidates).axes) == 1


@pytest.mark.medium
def test_with_two_leading_effects_the_expected_bayes_factors_rank(candidates):
    ln_bayes = np.arange(14.0)[::-1]
    ends = {"ln_bayes_low": ln_bayes - 3, "ln_bayes_high": ln_bayes + 3}
    two = candidates.assign(ln_bayes=ln_bayes, **ends, effect=["arb", "seats"] * 7)
    assert list(best_candidates(two)["measurement"])[:3] == ["sensor 0", "sensor 1", "sensor 2"]
    figure = next_measurement_figure(two)
    _, left, right = figure.axes
    np.testing.assert_allclose([b.get_width() for b in right.containers[0]], np.arange(13.0, 3.0, -1.0))
    np.testing.assert_allclose([b.get_width() for b in left.containers[0]], np.arange(0.0, 1.0, 0.1), atol=1e-12)
    assert labels(left.get_yticklabels())[1] == "sensor 1 (for seats)"
    assert [line.get_xdata()[0] for line in right.lines if line.get_gid() == "threshold"] == [3.0]
    figure.savefig(os.devnull, format="png")


def test_a_candidate_is_drawn_once_for_the_effect_whose_score_it_raises_most(candidates):
    other = candidates.assign(effect="seats", gain=candidates["gain"] + [0.5, -0.5] * 7)
    both = pd.concat([candidates, other], ignore_index=True)
    names = labels(draw_next_measurement(both).get_yticklabels())
    assert names[:4] == ["twice (for arb)", "sensor 10 (for seats)", "sensor 8 (for seats)", "sensor 11 (for arb)"]
    assert len(set(names)) == 10
    assert labels(draw_next_measurement(candidates.assign(effect="")).get_yticklabels())[:2] == ["twice", "sensor 11"]


def test_candidates_are_drawn_for_what_the_recommendation_is_about(candidates):
    other = candidates.assign(effect="seats", gain=candidates["gain"] / 2)
    both = pd.concat([candidates.assign(told=False), other.assign(told=True)], ignore_index=True)
    assert set(best_candidates(both)["effect"]) == {"seats"}
    assert set(best_candidates(both.assign(told=False))["effect"]) == {"arb"}


def test_no_candidate(candidates):
    next_measurement_figure(candidates.iloc[:0]).savefig(os.devnull, format="png")
    assert labels(draw_next_measurement(candidates.iloc[:0]).texts) == ["no further measurement was considered"]


def test_a_given_axes_is_drawn_on_and_returned(errors, versions, candidates):
    for plot, table in ((draw_errors, errors), (draw_error_versions, versions), (draw_next_measurement, candidates)):
        ax = new_figure(3.0).add_subplot()
        assert plot(table, ax) is ax
