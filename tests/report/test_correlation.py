import re

import numpy as np
import pandas as pd
import pytest

from calib.report.correlation import correlated_pairs, draw_correlation, others, strongest
from calib.report.figures import Figures


def square(names, values):
    table = pd.DataFrame(np.asarray(values, dtype=float), columns=names)
    table.insert(0, "parameter", names)
    return table


@pytest.fixture
def inputs():
    return square(["m_centre", "m_ends", "m_bar"], [[1.0, 0.05, -0.87], [0.05, 1.0, 0.27], [-0.87, 0.27, 1.0]])


@pytest.fixture
def many():
    """Twelve parameters, 66 pairs, of which 25 exceed 0.5."""
    values, rng = np.eye(12), np.random.default_rng(4)
    a, b = np.triu_indices(12, 1)
    sizes = np.concatenate([np.linspace(0.51, 0.99, 25), np.linspace(0.0, 0.49, 41)]) * rng.choice([-1, 1], 66)
    for i, j, value in zip(a, b, rng.permutation(sizes), strict=True):
        values[i, j] = values[j, i] = value
    return square([f"p{k}" for k in range(12)], values)


def test_each_pair_appears_once_the_strongest_first(many):
    found, matrix = correlated_pairs(many), many.set_index("parameter")
    assert len(found) == 66 == len({frozenset(p) for p in found[["parameter_a", "parameter_b"]].to_numpy()})
    assert [matrix.loc[a, b] for a, b, _ in found.itertuples(index=False)] == found["value"].tolist()
    assert found["value"].abs().is_monotonic_decreasing


def test_pairs_beyond_the_threshold_have_bars_and_the_others_are_counted(inputs):
    ax = draw_correlation(inputs, threshold=0.25, label="value")
    (bars,) = ax.containers
    assert [bar.get_width() for bar in bars] == [-0.87, 0.27]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["m_centre, m_bar", "m_ends, m_bar"]
    assert [t.get_text() for t in ax.texts] == ["−0.87", "+0.27"]
    left_out = inputs.loc[inputs["m_ends"] == 0.05, "parameter"].item(), "m_ends"
    assert left_out == ("m_centre", "m_ends") and re.findall(r"[\d.]+", others(inputs, 0.25)) == ["1", "0.25"]
    assert not draw_correlation(inputs, threshold=0.9, label="value").containers


def test_no_more_bars_than_can_be_read_and_the_limit_of_the_rest_is_theirs(many):
    shown = strongest(many, 0.5)
    (bars,) = draw_correlation(many, threshold=0.5, label="value", most_in_matrix=8).containers
    assert [bar.get_width() for bar in bars] == shown["value"].tolist() and len(shown) == 20
    count, limit = (float(n) for n in re.findall(r"[\d.]+", others(many, 0.5)))
    rest = correlated_pairs(many)["value"].abs()[20:]
    assert count == len(rest) == 46 and limit == round(rest.max(), 2) > 0.5


def test_unknown_values_are_counted_apart(inputs):
    inputs.loc[1, "m_bar"] = inputs.loc[2, "m_ends"] = np.nan
    assert strongest(inputs, 0.25)["value"].tolist() == [-0.87]
    assert [int(n) for n in re.findall(r"\b\d+(?= pair)", others(inputs, 0.25))] == [1, 1]


def test_the_matrix_of_a_few_parameters_holds_every_value_once(inputs):
    ax = draw_correlation(inputs, threshold=0.5, label="value", most_in_matrix=8)
    shown = np.ma.filled(ax.images[0].get_array().astype(float), np.nan)
    np.testing.assert_array_equal(shown, [[0.05, np.nan], [-0.87, 0.27]])
    assert [t.get_text() for t in ax.texts] == ["0.05", "−0.87", "0.27"]
    assert [t.get_text() for t in ax.get_xticklabels()] == ["m_centre", "m_ends"]
    assert [t.get_text() for t in ax.get_yticklabels()] == ["m_ends", "m_bar"]


def test_rows_and_columns_must_name_the_same_parameters(inputs):
    for most in (0, 8):
        with pytest.raises(ValueError, match="same parameters"):
            draw_correlation(inputs.iloc[::-1], threshold=0.5, label="value", most_in_matrix=most)


def test_the_figure_of_the_folder_needs_two_parameters(inputs, tmp_path):
    inputs.to_csv(tmp_path / "posterior_correlation.csv", index=False)
    assert list(Figures(tmp_path, "", True).plan) == ["posterior_correlation"]
    square(["m"], [[1.0]]).to_csv(tmp_path / "posterior_correlation.csv", index=False)
    assert not Figures(tmp_path, "", True).plan
    (tmp_path / "posterior_correlation.csv").write_text("parameter\n")
    assert not Figures(tmp_path, "", True).plan
