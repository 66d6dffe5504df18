"""At which accuracy a verdict would change."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.missing.accuracy import less_accurate, sentence


@pytest.mark.parametrize("verdict", ["nothing_detectable", "noise_underestimated"])
def test_where_nothing_is_missing_no_accuracy_is_asked(verdict):
    found = SimpleNamespace(verdict=verdict, noise_scale=2.0)
    table = less_accurate(found, (), np.zeros(0), {}, {}, 1)
    assert table.empty and sentence(table) == ""
