"""What is said on the terminal."""

import numpy as np
import pandas as pd

from calib import console
from calib.questions.sensitivity import Screening
from calib.results import Results


def test_a_parameter_of_which_no_response_is_known_is_told_as_such(tmp_path, capsys):
    table = pd.DataFrame(
        [("a", "x", np.nan), ("a", "y", np.nan), ("b", "x", 0.25), ("b", "y", 0.75)],
        columns=["parameter", "response", "mu_star"],
    )
    console.tell_screening(Screening("morris", table, 12, ""), Results(tmp_path))
    first, second = (line.split() for line in capsys.readouterr().out.splitlines() if line[:2] in ("a ", "b "))
    assert first == ["b", "0.75", "y"] and second == "a no response: too few are known, or none changes".split()
