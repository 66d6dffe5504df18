"""A verdict says how often intervals such as its own held the truth, where that was counted."""

from types import SimpleNamespace

import pandas as pd
import pytest

from calib.missing.coverage import MODES, Coverage, coverage_sentence


@pytest.mark.parametrize(
    ("kinds", "named", "told"),
    [
        (["frequency", "damping", "shape"], True, True),
        (["frequency"], True, True),
        (["frequency", "shape"], False, False),
        (["frequency", "shape", "frf"], True, False),  # FRFs were counted apart
        (["response"], True, False),
        ([], True, False),
    ],
)
def test_only_a_named_magnitude_of_a_modal_test_has_a_counted_coverage(kinds, named, told):
    adequacy = SimpleNamespace(kinds=pd.DataFrame({"kind": kinds}))
    sentence = coverage_sentence(SimpleNamespace(names_something=named, base_adequacy=adequacy))
    assert sentence == (MODES.sentence if told else "")


def test_the_share_is_that_of_the_counts():
    counted = Coverage(9, 12, "computed tests of a frame")
    assert counted.percent == 75 and "(75 %)" in counted.sentence and "9 of 12" in counted.sentence
