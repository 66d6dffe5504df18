import numpy as np
import pandas as pd
import pytest

from calib.report.sensitivity import draw_sensitivity


def cells(ax):
    return {
        (round(t.get_position()[1]), round(t.get_position()[0])): t.get_text()
        for t in ax.texts
        if t.get_transform() == ax.transData
    }


def test_cells_are_grouped_and_small_ones_blank(sensitivity):
    ax = draw_sensitivity(sensitivity)
    # columns: natural frequency of 1BT and 2BT, then MAC of 1BT; 0.25 itself is not shown
    assert cells(ax) == {(0, 0): "0.90", (0, 1): "−0.30", (1, 2): "−0.70", (2, 1): "0.50"}
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1BT", "2BT", "1BT"]
    assert [t.get_text() for t in ax.get_yticklabels()] == list(sensitivity["parameter"])
    assert {"natural frequency", "MAC"} <= {t.get_text() for t in ax.texts}


def test_colours_follow_the_shown_values_alone(sensitivity):
    image = draw_sensitivity(sensitivity).images[-1]
    shown = np.ma.filled(image.get_array().astype(float), np.nan)
    np.testing.assert_array_equal(shown, [[0.9, -0.3, np.nan], [np.nan, np.nan, -0.7], [np.nan, 0.5, np.nan]])
    assert (image.norm.vmin, image.norm.vmax) == (-1.0, 1.0)


def test_threshold_is_an_argument(sensitivity):
    assert set(cells(draw_sensitivity(sensitivity, threshold=0.6)).values()) == {"0.90", "−0.70"}
    assert len(cells(draw_sensitivity(sensitivity, threshold=0.0))) == 7  # without zero and NaN


def test_a_response_of_unknown_kind_keeps_its_name(sensitivity):
    ax = draw_sensitivity(sensitivity.rename(columns={"mac_1BT": "camber"}))
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1BT", "2BT", "camber"]
    assert "other" in {t.get_text() for t in ax.texts}
    alone = draw_sensitivity(sensitivity[["parameter", "mac_1BT"]].rename(columns={"mac_1BT": "camber"}))
    assert set(cells(alone)) and "other" not in {t.get_text() for t in alone.texts}


def test_a_response_without_a_value_is_explained_in_the_axis_label(sensitivity):
    assert "grey: no value" in draw_sensitivity(sensitivity).get_xlabel()
    assert "grey" not in draw_sensitivity(sensitivity.fillna(0.0)).get_xlabel()


def test_the_range_of_a_parameter_stands_beside_its_name(sensitivity):
    first = str(sensitivity["parameter"].iloc[0])
    space = pd.DataFrame({"parameter": [first], "unit": ["kN/m"], "lower": [242.0], "upper": [270.8]})
    labels = [t.get_text() for t in draw_sensitivity(sensitivity, space=space).get_yticklabels()]
    assert labels[0].startswith(first) and "242" in labels[0] and labels[0].endswith("271 kN/m")
    assert labels[1:] == sensitivity["parameter"].astype(str).tolist()[1:]


@pytest.mark.parametrize("part", [0.02, -0.3])
def test_a_value_that_other_parameters_lend_stands_in_brackets(sensitivity, part):
    assert "lent" not in draw_sensitivity(sensitivity, partial=sensitivity).get_xlabel()
    responses = [name for name in sensitivity.columns if name != "parameter"]
    row, response = next((k, r) for k in sensitivity.index for r in responses if abs(sensitivity[r][k]) > 0.25)
    own = sensitivity.copy()
    own.loc[row, response] = part * np.sign(own.loc[row, response])
    ax = draw_sensitivity(sensitivity, partial=own)
    (words,) = (t.get_text() for t in ax.texts if t.get_text().startswith("("))
    full = words.strip("()").replace(".", "0.")
    assert full in cells(draw_sensitivity(sensitivity)).values() and "lent" in ax.get_xlabel()
