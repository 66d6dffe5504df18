"""When random starts of least squares agree."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.inference.integers import fit_mixed
from calib.inference.rules import RULES
from calib.inference.starts import Optima, UntilAgreed
from calib.problem.space import Parameter, ParameterSpace


def ends(*misfits, unconverged=0, failed=0):
    out = [SimpleNamespace(misfit=m, converged=True) for m in misfits]
    out += [SimpleNamespace(misfit=0.0, converged=False)] * unconverged
    return [*out, *([None] * failed)]


@pytest.mark.parametrize(
    ("tried", "found", "lowest", "unseen"),
    [
        (ends(), 0, 0, 1.0),
        (ends(1.0), 1, 1, 1.0),
        (ends(1.0, 1.0, 1.0, 1.0), 1, 4, 1 / 6),
        (ends(1.0, 9.0, 1.0, 9.0, 1.0), 2, 3, 6 / 20),
        (
            ends(1.0, 1.0 + 0.6 * RULES.equal, 1.0 + 1.2 * RULES.equal),
            1,
            3,
            1 / 3,
        ),  # neighbours are one optimum
        (ends(1.0, 1.0, unconverged=2, failed=1), 4, 2, 1.0),
    ],
)
def test_optima_are_counted_and_the_share_that_is_unseen_follows(tried, found, lowest, unseen):
    optima = Optima.of(tried)
    assert (optima.starts, optima.found, optima.lowest) == (len(tried), found, lowest)
    assert optima.unseen == pytest.approx(unseen)


@pytest.mark.parametrize(("other", "needed"), [((), 5), ((9.0,), 9), ((9.0, 20.0), 12)])
def test_more_optima_need_more_starts(other, needed):
    """w (w + 1) / (n (n - 1)) falls to a tenth at 5, 9 and 12 starts for one, two and three optima."""
    until, tried = UntilAgreed(), ends(*other)
    while not until(tried):
        tried = [*tried, *ends(1.0)]
    assert until.optima.starts == needed


def test_an_optimum_that_one_start_reached_is_no_agreement():
    assert not Optima.of(ends(1.0, *[9.0] * 30)).agree
    assert Optima.of(ends(1.0, 1.0, *[9.0] * 30)).agree


def test_random_starts_above_a_known_one_do_not_agree():
    until = UntilAgreed(given=1)
    assert until(ends(1.0 - 0.5 * RULES.equal, *[1.0] * 5))
    assert not until(ends(1.0 - 2 * RULES.equal, *[1.0] * 5)) and until.optima.agree


class Wave:
    """Sum of squares with a valley near each integer, the lowest at the given one."""

    def __init__(self, lowest):
        self.lowest, self.solved = lowest, 0

    def residual(self, values):
        self.solved += 1
        x = values["x"]
        return np.array([10.0 * np.sin(np.pi * x), 5.0 * (x - self.lowest)])

    def jacobian(self, values, names):
        return np.array([[10.0 * np.pi * np.cos(np.pi * values["x"])], [5.0]])


def test_starts_go_on_until_they_agree_and_known_ones_do_not_count():
    space = ParameterSpace((Parameter("x", 0.0, -0.4, 1.4, "-"),))
    starts = [{"x": x} for x in (1.0, 0.05, 0.95, 0.1, 0.9, 1.05, 0.0, 1.1, -0.1, 0.85, 1.2, 0.15, -0.2)]
    until = UntilAgreed(given=1)
    found = fit_mixed(Wave(1.0), space, starts, enough=until)
    assert found.best.values["x"] == pytest.approx(1.0, abs=0.05)
    assert until.optima == Optima(starts=9, found=2, lowest=5)
    assert len(found.by_start) == 10
    assert len(fit_mixed(Wave(1.0), space, starts).by_start) == len(starts)
