"""Values of the page are judged: what cannot be is called so, and what has no uncertainty shows none."""

import numpy as np
import pandas as pd

from calib.report.html.calibrated import moved
from calib.report.html.comparison import expansion_remarks
from calib.report.html.explanation import faults_in_words


def test_accelerometers_heavier_than_any_are_called_impossible():
    rows = [
        ("mass", 8.4, ""),
        ("mass", 0.05, "accelerometers of 0.05 kg each"),
        ("gain", 8.4, "a gain"),
        ("mass", np.nan, ""),
    ]
    words = faults_in_words(pd.DataFrame(rows, columns=["kind", "magnitude", "told"]))
    assert words[0].startswith("impossible") and words[1:] == ["accelerometers of 0.05 kg each", "a gain", ""]


def test_a_frequency_that_no_parameter_moves_has_no_interval():
    table = pd.DataFrame({"natural_freq": [50.0, 50.0], "std": [3.7e-26, 0.006], "lower": [50.0, 49.9]})
    for column in ("std", "lower"):
        assert moved(table, column).isna().tolist() == [True, False]
    assert moved(table, "std")[1] == 0.006


def test_a_large_error_of_the_reduction_is_explained_and_a_reason_kept():
    table = pd.DataFrame({"reason": ["", np.nan, "no sensor moves"], "tam_error": [0.016, 0.45, 0.9]})
    first, second, third = expansion_remarks(table)
    assert first == "" and "sensors do not tell" in second and third == "no sensor moves"
