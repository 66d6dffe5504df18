"""Figures and sections of FRFs hold what the tables hold."""

import numpy as np
import pandas as pd
import pytest

from calib.report.frf import OVERLAID, draw_frac, draw_frf_lines, overlay_figure
from calib.report.tables import comparison_kind

FREQ = np.array([1.0, 2.0, 3.0, 4.0, 8.0, 9.0])
"""A gap between 4 and 8 Hz, where a band is left out."""
NAMES = [(f"{r}z", f"{q}z") for q in (1, 2) for r in (1, 2, 3, 4)]


def overlays(stage):
    rng = np.random.default_rng(len(stage))
    measured = np.random.default_rng(0)
    rows = []
    for response, reference in NAMES:
        test = measured.standard_normal((2, len(FREQ)))
        model = rng.standard_normal((2, len(FREQ)))
        rows.append(pd.DataFrame({
            "response": response, "reference": reference, "freq": FREQ, "measured_re": test[0], "measured_im": test[1],
            "model_re": model[0], "model_im": model[1], "std": 0.1,
        }))  # fmt: skip
    return pd.concat(rows, ignore_index=True)


def functions(frac):
    names = pd.DataFrame(NAMES, columns=["response", "reference"])
    return names.assign(unit="m/N", lines=6, frac=frac, amplitude=1.0, error=0.1, in_std=1.0)


BEFORE = functions([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
AFTER = functions([0.9, 0.99, 0.7, 0.95, 0.8, 0.6, 0.999, 0.85])
WORST = ["2z/2z", "3z/1z", "1z/2z", "4z/2z", "1z/1z", "4z/1z", "2z/1z", "3z/2z"]
"""By FRAC after calibration."""
STAGES = {"before": BEFORE, "after": AFTER}


def joined(line):
    """Data of a curve and its pieces; an empty point parts two of them."""
    x, y = (np.asarray(values, float) for values in line.get_data())
    known = np.isfinite(x)
    assert np.isnan(y[~known]).all()
    return x[known], y[known], [len(piece) for piece in np.split(x, np.flatnonzero(~known)) if np.isfinite(piece).any()]


def of(table, name):
    response, reference = name.split("/")
    own = table[(table["response"] == response) & (table["reference"] == reference)]
    return {kind: (own[f"{kind}_re"] + 1j * own[f"{kind}_im"]).to_numpy() for kind in ("measured", "model")}


@pytest.mark.medium
def test_overlays_show_the_functions_that_agree_least_as_the_tables_have_them():
    tables = {stage: overlays(stage) for stage in STAGES}
    figure = overlay_figure(tables, STAGES)
    amplitudes, phases = figure.axes[::2], figure.axes[1::2]
    assert [ax.texts[0].get_text() for ax in amplitudes] == WORST[:OVERLAID]
    assert amplitudes[0].get_ylabel() == "|H|, m/N" and phases[-1].get_xlabel() == "frequency (Hz)"
    for name, amplitude, phase in zip(WORST, amplitudes, phases, strict=False):
        expected = [of(tables["before"], name)["measured"], *(of(tables[stage], name)["model"] for stage in STAGES)]
        assert len(amplitude.lines) == len(phase.lines) == 3
        for values, upper, lower in zip(expected, amplitude.lines, phase.lines, strict=True):
            freq, drawn, pieces = joined(upper)
            np.testing.assert_array_equal(freq, FREQ)
            np.testing.assert_allclose(drawn, np.abs(values))
            np.testing.assert_allclose(joined(lower)[1], np.degrees(np.angle(values)))
            assert sum(pieces) - len(pieces) + 1 == len(FREQ) and len(pieces) == 2
    assert amplitudes[0].get_yscale() == "log"
    words = [text.get_text() for text in amplitudes[0].get_legend().get_texts()]
    assert len(words) == 3 and words[0] == "measured"


def test_few_functions_stand_alone_and_short_ones_are_one_curve():
    name, short = functions(0.5).head(1), overlays("before").head(2)
    figure = overlay_figure({"before": short}, {"before": name})
    assert len(figure.axes) == 2
    freq, _, pieces = joined(figure.axes[0].lines[0])
    assert freq.tolist() == [1.0, 2.0] and pieces == [2]


def test_frac_is_drawn_for_every_function_in_the_order_of_the_latest_stage():
    ax = draw_frac(STAGES)
    assert [t.get_text() for t in ax.get_yticklabels()] == WORST
    assert ax.get_ylim()[0] > ax.get_ylim()[1]  # the first stands on top
    for line, table in zip(ax.lines, STAGES.values(), strict=True):
        own = dict(zip(table["response"] + "/" + table["reference"], table["frac"], strict=True))
        np.testing.assert_allclose(line.get_xdata(), [own[name] for name in WORST])
        assert list(line.get_ydata()) == list(range(len(WORST)))


def test_errors_along_the_frequency_axis_are_parted_where_lines_are_left_out():
    lines = {
        stage: pd.DataFrame({"freq": FREQ, "assurance": 1.0, "amplitude": 1.0, "in_std": level * np.arange(1.0, 7.0)})
        for stage, level in (("before", 20.0), ("after", 0.5))
    }
    ax = draw_frf_lines(lines)
    *curves, one = ax.lines
    assert np.unique(one.get_ydata()).tolist() == [1.0]
    for line, table in zip(curves, lines.values(), strict=True):
        freq, drawn, pieces = joined(line)
        np.testing.assert_array_equal(freq, FREQ)
        np.testing.assert_array_equal(drawn, table["in_std"])
        assert len(pieces) == 2
    assert ax.get_ylim()[0] == 0.0 and ax.get_ylim()[1] > 120.0


@pytest.mark.parametrize(
    ("heads", "kind"),
    [
        ("response,reference,unit,lines", "frf"),
        ("response,reference,held_out", "frf"),
        ("response,measured,model", "responses"),
        ("mode,natural_freq", "modes"),
    ],
)
def test_a_table_tells_its_kind(tmp_path, heads, kind):
    path = tmp_path / "comparison_before.csv"
    path.write_text(heads + "\n")
    assert comparison_kind(path) == kind and comparison_kind(tmp_path / "nothing.csv") == "modes"
