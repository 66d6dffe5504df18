import numpy as np
import pandas as pd
import pytest

from calib.report.comparison import comparison_figure, draw_comac, draw_frequency_error, draw_mac, draw_mac_matrix
from calib.report.style import BLACK, GREY, new_figure


def heights(container):
    return [bar.get_height() for bar in container]


def words(ax):
    return [t.get_text() for t in ax.texts]


def legend(ax):
    return [t.get_text() for t in ax.get_legend().get_texts()]


def test_bars_are_the_errors_in_percent(before, after):
    ax = draw_frequency_error(before, after)
    first, second = ax.containers
    np.testing.assert_allclose(heights(first), 100 * before["freq_error"])
    np.testing.assert_allclose(heights(second), 100 * after["freq_error"])
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1BT\n6.95 Hz", "2BT\n10.83 Hz", "3BT\n13.20 Hz"]
    assert legend(ax) == [
        "before calibration: mean |error| 10.00 %, 2 of 3 paired",
        "after calibration: mean |error| 1.00 %",
    ]


def test_an_unpaired_mode_is_marked_where_its_bar_would_stand(before, after):
    ax = draw_frequency_error(before, after)
    marks = [t for t in ax.texts if t.get_text() == "not paired"]
    assert len(marks) == 1
    bar = ax.containers[0][2]
    assert marks[0].xy[0] == pytest.approx(bar.get_x() + bar.get_width() / 2)


def test_bars_are_written_with_their_value(before):
    assert {"−12.0", "+8.0", "not paired"} <= set(words(draw_frequency_error(before)))


def test_before_alone(before):
    ax = draw_frequency_error(before)
    assert len(ax.containers) == 1 and len(legend(ax)) == 1


def test_modes_are_matched_by_name_and_not_by_row(before, after):
    ax = draw_frequency_error(before, after.iloc[::-1])
    np.testing.assert_allclose(heights(ax.containers[1]), 100 * after["freq_error"])


def test_with_added_effects_three_models_are_told_apart(before, after):
    better = after.assign(freq_error=after["freq_error"] / 2, mac=0.99)
    tables, names = (before, after, better), ["nominal values", "calibrated without arb", "calibrated with arb"]
    errors, macs = (draw(before, after, added=better, effects="arb") for draw in (draw_frequency_error, draw_mac))
    for bars, marks, table in zip(errors.containers, macs.lines, tables, strict=True):
        np.testing.assert_allclose(heights(bars), 100 * table["freq_error"])
        np.testing.assert_allclose(marks.get_ydata(), 1 - table["mac"])
    assert all([words.split(":")[0] for words in legend(ax)] == names for ax in (errors, macs))
    assert len({tuple(bars[0].get_facecolor()) for bars in errors.containers}) == 3
    assert len({(marks.get_color(), marks.get_marker()) for marks in macs.lines}) == 3


def test_mac_is_drawn_by_what_it_lacks(before, after):
    """On a scale that shows 0.99 beside 0.999; what is nearer to 1 is drawn as 0.999, and the noise last."""
    ax = draw_mac(before, after.assign(mac=[0.99995, 0.96, 0.88]), noise_mac=0.9999)
    assert ax.get_yscale() == "log"
    first, second, noise = (line.get_ydata() for line in ax.lines)
    np.testing.assert_allclose(first, 1 - before["mac"])
    np.testing.assert_allclose(second, [0.001, 0.04, 0.12])
    np.testing.assert_allclose(noise, 0.001)
    assert {"not paired", "1.000", "0.960"} <= set(words(ax))
    assert [label.split(":")[0] for label in legend(ax)][:2] == ["before calibration", "after calibration"]
    ax = draw_mac(before, after)
    assert legend(ax) == ["before calibration: mean MAC 0.740, 2 of 3 paired", "after calibration: mean MAC 0.943"]


def test_there_is_no_mac_panel_without_measured_shapes(before, after):
    assert len(comparison_figure(before, after).axes) == 2
    silent = [table.assign(mac=np.nan) for table in (before, after)]
    assert len(comparison_figure(*silent).axes) == 1
    assert len(comparison_figure(silent[0]).axes) == 1


def test_all_modes_unpaired(before):
    ax = draw_frequency_error(before.assign(freq_error=np.nan))
    assert words(ax).count("not paired") == 3
    assert legend(ax) == ["before calibration: mean |error| unknown, 0 of 3 paired"]


def test_matrix_cells_hold_the_values(mac):
    ax = draw_mac_matrix(mac)
    cells = {(round(t.get_position()[1]), round(t.get_position()[0])): t.get_text() for t in ax.texts}
    assert cells == {(0, 0): "0.93", (0, 1): "0.02", (0, 2): "0.30", (1, 0): "0.11", (1, 1): "0.55"}
    np.testing.assert_allclose(ax.images[0].get_array().filled(np.nan), mac.drop(columns="mode").to_numpy())
    assert [t.get_text() for t in ax.get_xticklabels()] == list(mac.columns[1:])
    assert [t.get_text() for t in ax.get_yticklabels()] == list(mac["mode"])


def dots(ax):
    return {line.get_label().split(" ")[0]: line.get_ydata() for line in ax.lines}


def test_comac_is_sorted_by_the_newest_table(comac):
    later = comac.assign(comac=[0.95, 0.97, 0.99, 0.96])
    ax = draw_comac(comac, later)
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1y", "3y", "2y", "2z"]
    np.testing.assert_allclose(dots(ax)["before"], [0.9, 0.7, 0.4, 0.99])
    np.testing.assert_allclose(dots(ax)["after"], [0.95, 0.96, 0.97, 0.99])
    assert ax.get_ylim()[0] < 0.4


def test_a_sensor_that_hardly_moves_is_grey_and_says_so(comac):
    ax = draw_comac(comac.assign(motion=[0.5, 0.04, 0.9, 0.1]))
    names = {label.get_text(): label.get_color() for label in ax.get_xticklabels()}
    assert names == {"2y (4 %)": GREY, "3y": BLACK, "1y": BLACK, "2z": BLACK}
    assert "hardly moves" in ax.get_xlabel() and "hardly moves" not in draw_comac(comac).get_xlabel()


def test_comac_before_alone(comac):
    ax = draw_comac(comac)
    assert [t.get_text() for t in ax.get_xticklabels()] == ["2y", "3y", "1y", "2z"]
    np.testing.assert_allclose(dots(ax)["before"], [0.4, 0.7, 0.9, 0.99])


def test_of_many_sensors_the_worst_are_shown_and_the_axis_label_states_it():
    table = pd.DataFrame({"sensor": [f"{i}y" for i in range(60)], "comac": np.linspace(1.0, 0.2, 60)})
    ax = draw_comac(table)
    assert len(dots(ax)["before"]) == 40 and dots(ax)["before"][0] == pytest.approx(0.2)
    assert "40 worst of 60" in ax.get_xlabel()


def test_a_given_axes_is_drawn_on_and_returned(before, mac, comac):
    for draw, table in (
        (draw_frequency_error, before),
        (draw_mac, before),
        (draw_mac_matrix, mac),
        (draw_comac, comac),
    ):
        ax = new_figure(3.0).add_subplot()
        assert draw(table, ax=ax) is ax


def test_of_hundreds_of_model_modes_a_matrix_draws_those_like_a_measured_one():
    mac = np.full((2, 200), 0.01)
    mac[0, 7], mac[1, 190] = 0.9, 0.8
    ax = draw_mac_matrix(pd.DataFrame(mac, columns=[str(k) for k in range(200)]).assign(mode=["A", "B"]))
    ticks = [label.get_text() for label in ax.get_xticklabels()]
    drawn = np.asarray(ax.images[0].get_array())
    assert {"7", "190"} <= set(ticks) and len(ticks) < 50 and ticks == sorted(ticks, key=int)
    assert drawn[0, ticks.index("7")] == 0.9 and drawn[1, ticks.index("190")] == 0.8 and "of 200" in ax.get_xlabel()
