"""The case that a calibration reports: one for all tests."""

from types import SimpleNamespace

import pytest

from calib.analyses.calibrate import best_of
from calib.analyses.fit_statistics import EQUAL


def case(misfit, criterion, fitted=True):
    statistics = SimpleNamespace(fit="a fit" if fitted else None, criterion=criterion)
    return SimpleNamespace(result=SimpleNamespace(misfit=misfit), statistics=statistics)


@pytest.mark.parametrize(
    ("misfits", "best"), [(((2.0, 1.0),), 1), (((1.0, 1.2), (3.0, 0.1)), 1), (((1.0, 1.2), (0.1, 3.0)), 0)]
)
def test_of_equal_cases_the_lowest_misfit_over_all_tests_is_reported(misfits, best):
    sums = (5.0, 5.0 + EQUAL / 2)
    assert best_of([[case(*pair) for pair in zip(own, sums, strict=True)] for own in misfits]) == best


def test_a_lower_sum_of_squares_outweighs_any_misfit():
    assert best_of([[case(1.0, 5.0 + 2 * EQUAL), case(9.0, 5.0)]]) == 1
    assert best_of([[case(1.0, 1.0, fitted=False), case(9.0, 5.0)]]) == 1


def test_searches_alone_are_compared_by_their_misfit():
    assert best_of([[case(3.0, 1.0, fitted=False), case(2.0, 9.0, fitted=False)]]) == 1
