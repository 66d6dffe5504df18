"""Intervals of parameters after an explanation that names nothing, in tables and words."""

from dataclasses import replace

import pandas as pd

from calib.analyses.explain import explain, keep
from calib.results import Results
from calib.study import Study

TRUE = {"E": 206.0, "m_top": 46.0, "K_base": 1.8}


def test_the_true_values_lie_inside_where_the_effect_is_not_in_the_library(mast, edited, tmp_path):
    folder = mast.write_study(tmp_path / "mast", {"guy": 12000.0})
    text = (folder / "effects.py").read_text()
    (folder / "effects.py").write_text(
        text.replace('        _one("guy", "Guy rope along x", 4.5, (0,), "stiffness", "N/m", 5e3, 1e5),\n', "")
    )
    results = Results.at(tmp_path / "r", "mast")
    answer = explain(Study.load(folder), results)
    assert answer.verdict == "none_explains"
    table = pd.read_csv(results.path / "unexplained.csv").set_index("parameter")
    assert set(table.index) == set(TRUE) and (table["low_unexplained"] < table["high_unexplained"]).all()
    inside = [table["low_unexplained"][n] <= v <= table["high_unexplained"][n] for n, v in TRUE.items()]
    alone = [table["low"][n] <= v <= table["high"][n] for n, v in TRUE.items()]
    assert all(inside) and not all(alone)
    keep(Study.load(folder), results, replace(answer, tables={}))
    assert not (results.path / "unexplained.csv").exists()  # nothing of an earlier verdict is left
    (words,) = [s for s in answer.sentences if s.startswith("The unexplained misfit")]
    assert "times as wide as those of the fit alone" in words


def test_a_named_effect_leaves_no_second_interval(guyed):
    _, results, answer, _ = guyed
    assert answer.verdict == "effect" and not (results.path / "unexplained.csv").exists()
    assert not any(s.startswith("The unexplained misfit") for s in answer.sentences)
