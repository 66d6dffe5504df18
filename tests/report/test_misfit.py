import os

import numpy as np
import pandas as pd
import pytest

from calib.report.misfit import draw_pulls, draw_where_it_fails, where_it_fails_figure
from calib.report.style import GREY


@pytest.fixture
def kinds():
    """Not sorted; the explained model has no damping of mode 2."""
    rows = [
        ("base", "2BT", "shape", 88.0, 44.0, 1e-4),
        ("base", "1BT", "frequency", 9.0, 0.9, 0.0),
        ("base", "1BT", "shape", 44.0, 44.0, 1.0),
        ("base", "2BT", "frequency", 0.5, 0.0, np.nan),
        ("base", "2BT", "damping", 1.0, 1.0, 0.1),
        ("explained", "2BT", "shape", 22.0, 44.0, 0.01),
    ]
    return pd.DataFrame(rows, columns="stage mode kind chi2 dof p".split())


def cells(ax, names=None):
    """Texts and colours of the cells; row names are those of ``names`` where Axes share them."""
    rows, columns = (
        [t.get_text() for t in labels] for labels in ((names or ax).get_yticklabels(), ax.get_xticklabels())
    )
    words = {(rows[round(t.get_position()[1])], columns[round(t.get_position()[0])]): t.get_text() for t in ax.texts}
    values = ax.images[-1].get_array().filled(np.nan)
    colours = {(r, c): values[i, j] for i, r in enumerate(rows) for j, c in enumerate(columns)}
    return words, colours


def test_cells_hold_chi_square_per_degree_of_freedom_and_colours_the_p_value(kinds):
    ax = draw_where_it_fails(kinds)
    words, colours = cells(ax)
    assert [t.get_text() for t in ax.get_xticklabels()] == ["frequency", "damping", "shape"]
    assert words == {
        ("2BT", "frequency"): "–",
        ("2BT", "damping"): "1",
        ("2BT", "shape"): "2",
        ("1BT", "frequency"): "10",
        ("1BT", "damping"): "–",
        ("1BT", "shape"): "1",
    }
    assert colours["2BT", "shape"] == pytest.approx(4.0) and colours["2BT", "damping"] == pytest.approx(1.0)
    assert colours["1BT", "frequency"] == 16.0 and colours["1BT", "shape"] == 0.0
    assert np.isnan(colours["2BT", "frequency"]) and np.isnan(colours["1BT", "damping"])


def test_the_explained_model_stands_beside_the_base_model(kinds):
    figure = where_it_fails_figure(kinds)
    panels = [ax for ax in figure.axes if ax.images]
    assert [ax.get_title(loc="left") or ax.get_title() for ax in panels[:2]] == [
        "model as it is, calibrated",
        "with the missing effect, calibrated",
    ]
    words, colours = cells(panels[1], names=panels[0])
    assert words["2BT", "shape"] == "0.5" and colours["2BT", "shape"] == pytest.approx(2.0)
    assert len(where_it_fails_figure(kinds[kinds["stage"] == "base"]).axes) == 2  # one panel and the colour bar


@pytest.mark.medium
def test_an_attempt_is_labelled_and_hatched(kinds):
    def panels(table, **more):
        return [ax for ax in where_it_fails_figure(table, **more).axes if ax.images][:2]

    def hatched(ax):
        return [p for p in ax.patches if p.get_hatch() and p.get_gid() == "attempt"]

    base, named = panels(kinds, name="arb")
    assert named.get_title() == "with arb, calibrated" and not hatched(base) and not hatched(named)
    attempted = kinds.replace({"stage": {"explained": "attempt"}})
    base, attempt = panels(attempted, name="arb")
    assert attempt.get_title() == "with arb:\nbest attempt, not believed"
    assert len(hatched(attempt)) == 1 and not hatched(base)
    assert {t.get_color() for t in attempt.texts} == {"#000000"}  # on white, however dark the cell
    assert panels(attempted)[1].get_title() == "with the best attempt, not believed"


def test_less_than_half_a_degree_of_freedom_has_no_ratio(kinds):
    words, _ = cells(draw_where_it_fails(kinds.assign(dof=0.49)))
    assert set(words.values()) == {"–"}
    words, _ = cells(draw_where_it_fails(kinds.assign(dof=0.5)))
    assert words["1BT", "frequency"] == "18"


def test_responses_other_than_modes_are_not_called_modes(kinds):
    rows = [("base", "responses", kind, 2.0, 1.0, 0.5) for kind in ("shape", "heat", "damping", "freq")]
    ax = draw_where_it_fails(pd.DataFrame(rows, columns=kinds.columns))
    assert ax.get_ylabel() == "" and draw_where_it_fails(kinds).get_ylabel() == "mode"
    assert [t.get_text() for t in ax.get_xticklabels()] == ["frequency", "damping", "shape", "heat"]
    rows = [("base", mode, "frf", 2.0, 1.0, 0.5) for mode in ("responses", "run 2: responses", "1BT")]
    frfs = draw_where_it_fails(
        pd.DataFrame([*rows, ("base", "r: responses", "heat", 2.0, 1.0, 0.5)], columns=kinds.columns)
    )
    assert [t.get_text() for t in frfs.get_yticklabels()] == ["FRFs", "run 2: FRFs", "1BT", "r: responses"]


def test_cells_have_no_exponents(kinds):
    words, _ = cells(draw_where_it_fails(kinds.assign(chi2=1e-5, dof=1.0)))
    assert set(words.values()) == {"< 0.001", "–"}


def test_nothing_compared(kinds):
    where_it_fails_figure(kinds.iloc[:0]).savefig(os.devnull, format="png")
    assert [t.get_text() for t in draw_where_it_fails(kinds.iloc[:0]).texts] == ["no mode was compared"]


@pytest.fixture
def pulls():
    rows = [
        ("base", "K", "MN/m", 1.5, 1.2, 0.2, -3.5, 2.5, True),
        ("base", "rho", "-", 1.0, 1.05, 0.1, 0.5, 2.5, False),
        ("arb + seats", "K", "MN/m", 1.5, 1.49, 0.2, -0.1, 2.5, False),
        ("arb + seats", "rho", "-", 1.0, np.nan, 0.1, np.inf, 2.5, None),
    ]
    return pd.DataFrame(rows, columns="model parameter unit nominal value prior_sd standardised limit pulled".split())


def line(ax, gid):
    return [(x.get_xdata(), x.get_ydata()) for x in ax.lines if x.get_gid() == gid]


def test_dots_are_the_standardised_shifts_and_pulled_ones_have_a_ring(pulls):
    ax = draw_pulls(pulls)
    ((base, y),) = line(ax, "shift base")
    ((explained, below),) = line(ax, "shift arb + seats")
    np.testing.assert_array_equal(base, [-3.5, 0.5])
    np.testing.assert_array_equal(explained, [-0.1, np.inf])
    assert (np.round(y) == [0, 1]).all() and (below > y).all()
    ((ringed, at),) = line(ax, "pulled base")
    assert list(ringed) == [-3.5] and list(at) == [y[0]]
    assert len(line(ax, "pulled arb + seats")[0][0]) == 0
    assert sorted(x[0] for x, _ in line(ax, "limit")) == [-2.5, 2.5]
    low, high = ax.get_xlim()
    assert low == -high and 3.5 < high < 5.0


def test_of_many_parameters_those_pulled_most_are_drawn(pulls):
    shifts = np.linspace(-3.0, 2.0, 40)
    many = pd.concat([pulls.iloc[:1].assign(parameter=f"p{k}", standardised=z) for k, z in enumerate(shifts)])
    ax = draw_pulls(many)
    names = [t.get_text() for t in ax.get_yticklabels()]
    kept = sorted(range(40), key=lambda k: -abs(shifts[k]))[: len(names)]
    assert len(names) == 24 and names == [f"p{k}" for k in sorted(kept)]
    assert f"{40 - 24} parameters" in ax.get_xlabel() and "left out" not in draw_pulls(pulls).get_xlabel()


def test_values_stand_beside_the_dots_with_their_unit(pulls):
    words = [t.get_text() for t in draw_pulls(pulls).texts]
    assert words == ["1.5 → 1.2 → 1.49 MN/m", "1 → 1.05 → –", "nominal → base → with arb + seats"]
    long = pulls.replace({"K": "K_block"}).assign(nominal=12000.0)
    assert draw_pulls(long).texts[0].get_text() == "12000 → 1.2 → 1.49 MN/m"


def test_the_legend_has_an_entry_for_what_is_drawn(pulls):
    words = [t.get_text() for t in draw_pulls(pulls).get_legend().get_texts()]
    assert words == ["model as it is, calibrated", "with arb + seats, calibrated", "limit ± 2.50", "shifted too far"]
    calm = pulls[pulls["model"] != "base"].assign(limit=np.nan)
    assert [t.get_text() for t in draw_pulls(calm).get_legend().get_texts()] == ["with arb + seats, calibrated"]


def test_the_dots_of_an_attempt_are_hollow_and_grey(pulls):
    ax = draw_pulls(pulls, attempt=True)
    looks = {x.get_gid(): (x.get_color(), x.get_markerfacecolor()) for x in ax.lines}
    assert looks["shift arb + seats"] == (GREY, "white") and GREY not in looks["shift base"]
    words = [t.get_text() for t in ax.get_legend().get_texts()]
    assert words[:2] == ["model as it is, calibrated", "with arb + seats: best attempt, not believed"]


def test_no_parameter(pulls):
    assert [t.get_text() for t in draw_pulls(pulls.iloc[:0]).texts] == ["no parameter was calibrated"]
