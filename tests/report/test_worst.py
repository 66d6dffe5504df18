import numpy as np
import pandas as pd

from calib.report.worst import draw_worst


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


def test_what_has_grown_beyond_the_noise_is_shown_however_small_it_was():
    """The worst first, then below a line the largest of what the last stage has made worse."""
    many = {f"M{k:02d}": 30.0 - k for k in range(20)}
    before = table(**many, A=0.9, B=0.8, C=0.1, D=0.7)
    after = table(**dict.fromkeys(many, 0.5), A=1.7, B=2.5, C=0.9, D=0.6)
    ax = draw_worst(before, after)
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names[:2] == ["frequency M00", "frequency M01"] and names[-2:] == ["frequency B", "frequency A"]
    (line,) = [line for line in ax.lines if line.get_gid() == "grown"]
    assert names[int(line.get_ydata()[0] + 0.5)] == "frequency B"
    drawn = draw_worst(table(A=2.0, B=3.0), table(A=1.5, B=1.0), added=table(A=1.8, B=0.5)).collections[0]
    colours = {tuple(colour) for colour in drawn.get_colors()}
    assert len(colours) == 2  # A has grown from the second stage to the third, though not from the first
    assert not any(line.get_gid() == "grown" for line in draw_worst(table(A=2.0), table(A=3.0)).lines)
