"""Terminal output of the command."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from calib.analyses.sensitivity import Screening
from calib.console.printing import printing
from calib.results import Results


def test_a_parameter_of_which_no_response_is_known_is_told_as_such(tmp_path, capsys):
    table = pd.DataFrame(
        [("a", "x", np.nan), ("a", "y", np.nan), ("b", "x", 0.25), ("b", "y", 0.75)],
        columns=["parameter", "response", "mu_star"],
    )
    with printing("sensitivity") as listener:
        listener.screened(Screening("morris", table, 12, ""), Results(tmp_path))
    first, second = (line.split() for line in capsys.readouterr().out.splitlines() if line[:2] in ("a ", "b "))
    assert first == ["b", "0.75", "y"] and second == "a no response: too few are known, or none changes".split()


@pytest.mark.parametrize(
    ("verdict", "names", "untold", "added"),
    [
        ("effect", ["guy"], ["guy"], "it: guy"),
        ("two_effects", ["guy", "lamp"], ["guy", "lamp"], "them: guy lamp"),
        ("two_effects", ["guy", "lamp"], ["guy", "lamp", "ice"], ""),
        ("indistinguishable", ["guy"], ["guy", "lamp"], ""),
    ],
)
def test_only_an_effect_without_a_competing_model_is_added(capsys, verdict, names, untold, added):
    chosen = SimpleNamespace(names=names)
    found = SimpleNamespace(verdict=verdict, chosen=chosen, untold=untold)
    with printing("explain") as listener:
        listener.may_add(SimpleNamespace(file=Path("mast/study.toml")), found)
    them, _, which = added.partition(": ")
    told = f"Add {them} with: calib extend mast {which} --into FOLDER\n" if added else ""
    assert "".join(x for x in capsys.readouterr().out.splitlines(True) if x.strip()) == told
