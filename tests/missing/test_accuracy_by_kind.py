"""Accuracies of frequencies, damping and shapes at which a verdict would change."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from calib.missing.accuracy_by_kind import GRIDS, accuracy_by_kind
from calib.missing.decision import decide

pytestmark = pytest.mark.usefixtures("fewer_samples")
STD = {"frequency": 0.001, "damping": 0.03, "shape": 0.005}
"""Stated, relative."""


@pytest.fixture
def wrong(toy):
    """A toy whose data of one kind, in some of its modes, are off by so many standard deviations."""
    plain = toy(effects=3, perturbations=6, parameters=3)

    @dataclass(frozen=True, eq=False)
    class Stated(type(plain)):
        @property
        def relative_std(self):
            return np.array([STD[row.kind] for row in self.rows])

    def make(kind, size, modes=("M0", "M2", "M5")):
        one = Stated(**{f.name: getattr(plain, f.name) for f in fields(plain)})
        one = one.drawn(np.random.default_rng(1))
        rng = np.random.default_rng(2)
        off = [size * rng.choice((-1, 1)) * (row.kind == kind and row.mode in modes) for row in one.rows]
        return replace(one, data=one.data + np.array(off))

    return make


@pytest.mark.medium
def test_the_kind_that_is_off_is_the_one_that_is_told(wrong):
    one = wrong("shape", 20.0)  # of 0.5 %
    found = accuracy_by_kind(decide(one), one, 1)
    assert found.told["frequency"] == found.told["damping"] == 0 and found.told["shape"] in (0.05, 0.1)
    assert (
        found.after < found.before and "shapes" in found.sentence and f"{100 * found.told['shape']:g} %" in found.then
    )
    table = found.table
    assert len(table) == (len(GRIDS["frequency"]) + 1) * (len(GRIDS["shape"]) + 1)
    assert table.loc[table["shape"] < 0.02, "missing"].all() and not table.loc[table["shape"] >= 0.1, "missing"].any()


@pytest.mark.medium
def test_two_kinds_that_are_off_need_both(wrong):
    one = wrong("shape", 20.0)
    one = replace(one, data=one.data + wrong("frequency", 12.0).data - wrong("frequency", 0.0).data)  # of 0.1 %
    found = accuracy_by_kind(decide(one), one, 1)
    assert found.told["frequency"] in (0.005, 0.01) and found.told["shape"] in (0.05, 0.1, 0.2)
    assert found.told["damping"] == 0
    alone = found.table[(found.table["frequency"] == 0) & (found.table["shape"] >= 0.1)]
    assert len(alone) and alone["missing"].all()


def test_no_accuracy_is_told_where_the_largest_is_not_enough(wrong):
    one = wrong("frequency", 150.0)  # 15 %
    found = accuracy_by_kind(decide(one), one, 1)
    assert found.told == {} and found.then == "" and "something would be missing" in found.sentence


def test_where_nothing_is_missing_or_no_shape_was_measured_nothing_is_told(wrong, toy):
    one = wrong("shape", 0.0)
    assert accuracy_by_kind(decide(one), one, 1) is None
    bare = toy(kinds=("frequency", "damping"), modes=12).drawn(np.random.default_rng(7), {"E1": 6.0})
    assert accuracy_by_kind(decide(bare), bare, 1) is None
