import numpy as np
import pytest

from calib.report.frequencies import draw_frequencies, stages_of_added


@pytest.mark.parametrize("stages", [("before", "after"), ("initial", "before", "after")])
def test_marks_are_the_errors_in_percent(modes, stages):
    if "initial" in stages:
        modes = modes.assign(error_initial=[-0.3, 0.2, 0.1], freq_initial=[5.0, 13.0, 14.5], mac_initial=0.8)
    ax = draw_frequencies(modes)
    assert [line.get_gid() for line in ax.lines if line.get_gid() in ("initial", "before", "after")] == [*stages]
    for stage in stages:
        (line,) = [line for line in ax.lines if line.get_gid() == stage]
        np.testing.assert_allclose(line.get_xdata(), 100 * modes[f"error_{stage}"])
        np.testing.assert_array_equal(line.get_ydata(), [0, 1, 2])


def test_frequencies_and_mac_are_written_in_their_rows(modes):
    ax = draw_frequencies(modes)
    for column in ("freq_measured", "freq_before", "freq_after", "mac_before", "mac_after"):
        found = {t.xy[1]: t.get_text() for t in ax.texts if t.get_gid() == column}
        assert found == {k: "–" if np.isnan(v) else f"{v:.3f}" for k, v in enumerate(modes[column])}


def test_without_shapes_there_are_no_columns_of_mac(modes):
    ax = draw_frequencies(modes.assign(mac_before=np.nan, mac_after=np.nan))
    assert not [t for t in ax.texts if "MAC" in t.get_text()]


@pytest.mark.parametrize("kind", ["natural", "damped"])
def test_axis_and_heading_name_the_kind_of_frequency(modes, kind):
    ax = draw_frequencies(modes.assign(freq_kind=kind))
    assert kind in ax.get_xlabel() and [t for t in ax.texts if t.get_text() == f"{kind} frequency (Hz)"]


def test_held_out_modes_are_labelled_and_enter_no_mean(modes):
    ax = draw_frequencies(modes)
    assert [t.get_text() for t in ax.get_yticklabels()] == ["1BT", "2BT (validation)", "3BT"]
    words = [t.get_text() for t in ax.get_legend().get_texts()]
    assert words == ["before calibration", "after calibration"]


def test_stages_of_added_effects_are_told_apart(modes):
    modes = modes.assign(error_initial=[-0.3, 0.2, 0.1], freq_initial=[5.0, 13.0, 14.5], mac_initial=0.8)
    ax = draw_frequencies(modes, looks=stages_of_added("arb"))
    words = [t.get_text() for t in ax.get_legend().get_texts()]
    assert words == ["nominal values", "calibrated without arb", "calibrated with arb"]
    heads = [t.get_text() for t in ax.texts if t.xy[1] == -0.5]
    assert heads[:4] == ["measured", "nominal", "without", "with"]
