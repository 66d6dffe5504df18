"""Standard deviations that are taken, and what is told of them."""

import numpy as np
import pytest

from calib.correlation.scatter import assumptions, scatter_of
from calib.measurement.read import read_measurement

MODES = "mode,freq,freq_kind,repeat\n" + "".join(
    f"{mode},{value + step},natural,{k}\n"
    for k, step in ((1, 0.0), (2, 0.2), (3, 0.1))
    for mode, value in (("a", 10), ("b", 20), ("c", 30))
    if mode != "c" or k == 1
)


def test_the_assumed_deviation_of_a_mode_is_the_one_that_is_taken(tmp_path):
    """One mode is in one of three repeats: it takes the scatter of a single repeat, not that of a mean."""
    file = tmp_path / "modes.csv"
    file.write_text(MODES)
    measured = read_measurement([file])
    assert np.isnan(measured.freq_std).tolist() == [False, False, True]
    taken = scatter_of(measured).freq
    assert taken[2] > 1.5 * np.sqrt(np.mean(taken[:2] ** 2))
    (told,) = [a for a in assumptions(measured) if "frequenc" in a.item]
    assert float(told.value) == pytest.approx(100 * taken[2], rel=0.05)
