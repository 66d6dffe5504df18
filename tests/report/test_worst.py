import numpy as np
import pandas as pd

from calib.report.comparison import draw_worst


def table(**sizes):
    return pd.DataFrame({"kind": "frequency", "what": list(sizes), "in_std": list(sizes.values())})


def found(ax):
    """Name and size of every dot, by the label of its stage."""
    names = [label.get_text() for label in ax.get_yticklabels()]
    return {
        dots.get_label(): {names[round(y)]: x for x, y in dots.get_offsets().tolist()}
        for dots in ax.collections
        if not dots.get_label().startswith("_")
    }


def test_every_stage_has_its_dots_and_the_first_orders_them():
    stages = {"before": table(A=2.0, B=30.0), "after": table(A=1.0, B=5.0), "added": table(A=1.5, B=0.3)}
    ax = draw_worst(stages["before"], stages["after"], added=stages["added"], effects="arb")
    assert [label.get_text() for label in ax.get_yticklabels()] == ["frequency B", "frequency A"]
    words = ("nominal values", "calibrated without arb", "calibrated with arb")
    for told, stage in zip(words, stages.values(), strict=True):
        assert found(ax)[told] == {f"frequency {r.what}": r.in_std for r in stage.itertuples()}


def test_what_only_a_later_stage_compares_is_shown_too():
    """A mode that is paired after the calibration alone may be the worst there."""
    ax = draw_worst(table(A=2.0, B=np.nan), table(A=1.0, B=9.0, C=4.0))
    assert [label.get_text() for label in ax.get_yticklabels()] == ["frequency B", "frequency C", "frequency A"]


def test_a_comparison_that_a_stage_lacks_is_still_joined_and_drawn():
    ax = draw_worst(table(A=2.0, B=30.0, C=np.nan), table(B=5.0))
    assert found(ax) == {
        "before calibration": {"frequency B": 30.0, "frequency A": 2.0},
        "after calibration": {"frequency B": 5.0},
    }


def test_the_dashed_line_is_in_the_legend():
    ax = draw_worst(table(A=2.0, B=30.0))
    (line,) = [line for line in ax.lines if line.get_gid() == "noise"]
    assert line.get_xdata()[0] == 1.0
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["before calibration", line.get_label()]
