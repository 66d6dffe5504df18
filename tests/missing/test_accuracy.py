"""Accuracy at which a verdict would change."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2, f

from calib.missing.accuracy import accuracy_sentence, less_accurate
from calib.missing.decision import decide
from calib.problem.labels import RowLabels


@pytest.mark.parametrize("verdict", ["nothing_detectable", "noise_underestimated"])
def test_no_accuracy_is_tried_where_nothing_is_missing(verdict):
    found = SimpleNamespace(verdict=verdict, noise_scale=2.0)
    table = less_accurate(found, RowLabels(()), np.zeros(0), 1)
    assert table.empty and accuracy_sentence(table, 0.01) == ""


def test_an_assumed_accuracy_counts_as_known_standard_deviation(toy):
    """Added to a standard deviation of a quarter of it: the few repeats then estimate a small part of the variance."""
    measured = toy().drawn(np.random.default_rng(1), {"E0": 6.0})
    found, rows = decide(measured), measured.rows

    def p_fit(dof):
        std_dof = {row.kind: dof for row in rows}
        return less_accurate(found, RowLabels(rows, {}, std_dof), np.full(len(rows), 2.5e-4), 1)["p_fit"][0]

    few, known = p_fit(4.0), p_fit(np.inf)
    assert known < few < 2 * known < 1e-4


def test_an_accuracy_that_the_scatter_of_the_data_contradicts_is_not_stated():
    table = pd.DataFrame({"accuracy": [0.01, 0.02, 0.05, 0.1], "p_smaller": [0.9, 0.02, 0.009, 0.0], "missing": True})
    assert "only 2 %, something would be missing" in accuracy_sentence(table, 0.01)
    assert "only 5 %, something would be missing" in accuracy_sentence(table, 0.005)
    assert "only 10 %, nothing" in accuracy_sentence(table.assign(missing=[True, True, True, False]), 0.01)


def test_the_probability_of_a_smaller_sum_of_squares_is_a_lower_tail(toy):
    """Of chi-square where standard deviations are known, else of F, with the dof of one kind to those of all."""
    measured = toy().drawn(np.random.default_rng(1), {"E0": 6.0})
    found, rows = decide(measured), measured.rows
    own = 1e-3  # standard deviation of every row, as large as the smallest accuracy: half the variance is estimated

    def table(dof):
        std_dof = {row.kind: dof for row in rows}
        return less_accurate(found, RowLabels(rows, {}, std_dof), np.full(len(rows), own), 1)

    known, few = table(np.inf), table(8.0)
    np.testing.assert_allclose(known["p_smaller"], chi2.cdf(known["misfit"], known["dof"]), atol=1e-9)
    assert known["p_smaller"].is_monotonic_decreasing and known["p_smaller"].between(0.1, 0.9).any()
    dof, ratio = known["dof"], known["misfit"] / known["dof"]
    behind = 8.0 / (own**2 / (own**2 + known["accuracy"] ** 2)) ** 2
    ends = np.sort([f.cdf(ratio, dof, k * behind) for k in (1, len({row.kind for row in rows}))], axis=0)
    assert (few["p_smaller"] >= ends[0] - 1e-12).all() and (few["p_smaller"] <= ends[1] + 1e-12).all()
    assert not np.allclose(few["p_smaller"], known["p_smaller"], rtol=0, atol=1e-4)
