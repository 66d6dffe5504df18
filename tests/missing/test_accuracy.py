"""Accuracy at which a verdict would change."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from calib.missing.accuracy import less_accurate, sentence
from calib.missing.explain import explain
from calib.problem import Rows


@pytest.mark.parametrize("verdict", ["nothing_detectable", "noise_underestimated"])
def test_no_accuracy_is_tried_where_nothing_is_missing(verdict):
    found = SimpleNamespace(verdict=verdict, noise_scale=2.0)
    table = less_accurate(found, Rows(()), np.zeros(0), 1)
    assert table.empty and sentence(table) == ""


def test_an_assumed_accuracy_counts_as_known_standard_deviation(toy):
    """Added to a standard deviation of a quarter of it: the few repeats then estimate a small part of the variance."""
    measured = toy().drawn(np.random.default_rng(1), {"E0": 6.0})
    found, rows = explain(measured), measured.rows

    def p_fit(dof):
        std_dof = {row.kind: dof for row in rows}
        return less_accurate(found, Rows(rows, {}, std_dof), np.full(len(rows), 2.5e-4), 1)["p_fit"][0]

    few, known = p_fit(4.0), p_fit(np.inf)
    assert known < few < 2 * known < 1e-4


def test_an_accuracy_that_the_scatter_of_the_data_contradicts_is_not_stated():
    table = pd.DataFrame({"accuracy": [0.01, 0.02, 0.05, 0.1], "misfit": [400.0, 200.0, 60.0, 20.0], "dof": 200.0})
    assert "only 2 %, something would be missing" in sentence(table.assign(missing=True))
    assert "only 10 %, nothing" in sentence(table.assign(missing=[True, True, True, False]))
