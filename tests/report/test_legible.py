import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

from calib.report.calibration import draw_searches
from calib.report.comparison import draw_comac, draw_mac_matrix
from calib.report.figures import fit_cells, is_legible, wrap_labels
from calib.report.frequencies import draw_frequencies
from calib.report.sensitivity import draw_sensitivity
from calib.report.style import COLUMN, WIDTH, fill, legend_above, new_figure, plain_ticks, style


def panel(width, draw):
    with style(width):
        figure = new_figure(2.5)
        ax = figure.add_subplot()
        draw(ax)
        return figure


@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize(("width", "legible"), [(WIDTH, True), (COLUMN, False)])
@pytest.mark.parametrize(
    "draw",
    [
        lambda ax: ax.set_xticks(range(9), [f"member {k}" for k in range(9)]),
        lambda ax: [ax.text(k / 12, 0.5, "0.123") for k in range(12)],
        lambda ax: ax.set_xlabel("a label that is too long for one of the two columns of a journal's page"),
        lambda ax: ax.text(1.02, 0.5, "words beside the panel" * 3, transform=ax.transAxes),
    ],
    ids=["ticks", "values", "label", "beside"],
)
def test_what_a_page_has_room_for_and_a_column_has_not(width, legible, draw):
    assert is_legible(panel(width, draw)) is legible


def test_ticks_beyond_the_limits_are_not_drawn_and_need_no_room():
    def draw(ax):
        ax.set_xlim(0, 10)
        ax.set_xticks([0, 5, 10, 40])

    assert is_legible(panel(COLUMN, draw))


def test_a_value_over_the_name_of_its_row_is_not_legible():
    def draw(at):
        def of(ax):
            ax.set(xlim=(0, 1), ylim=(0, 1))
            ax.set_yticks([0.5], ["a name"])
            ax.text(at, 0.5, "0.85", ha="right", va="center")

        return is_legible(panel(WIDTH, of))

    assert draw(0.2) and not draw(-0.02)


def test_a_logarithmic_axis_of_few_decades_has_plain_numbers():
    def draw(ax):
        ax.set_yscale("log")
        ax.set_ylim(0.004, 0.03)
        plain_ticks(ax.yaxis)

    figure = panel(WIDTH, draw)
    figure.draw_without_rendering()
    axis = figure.axes[0].yaxis
    labels = [t.get_text() for t in (*axis.get_majorticklabels(), *axis.get_minorticklabels()) if t.get_text()]
    assert {"0.01", "0.02"} < set(labels) and all(0.0 < float(label) < 1.0 for label in labels)


def test_a_long_label_is_broken():
    figure = panel(COLUMN, lambda ax: ax.set_xlabel("a label that is too long for one of the two columns\nof a page"))
    wrap_labels(figure)
    assert is_legible(figure) and figure.axes[0].get_xlabel().replace("\n", " ").endswith("columns of a page")


@pytest.mark.parametrize(
    ("words", "letters", "lines"),
    [
        ("before calibration: mean |error| 10.43 %", 36, ["before calibration: mean |error|", "10.43 %"]),
        ("after calibration: mean |error| 0.28 %", 36, ["after calibration: mean |error|", "0.28 %"]),
        ("amplitude over the largest of the mode (–)", 40, ["amplitude over the largest of the", "mode (–)"]),
        ("error of the frequency, model − measured (%)", 31, ["error of the frequency,", "model − measured (%)"]),
        ("stiffness of the bush (ρ = −0.90)", 28, ["stiffness of the bush", "(ρ = −0.90)"]),
        (
            "at (+2.00, −0.20, 0.00) and (+2.00, +0.20, 0.00) m",
            44,
            ["at (+2.00, −0.20, 0.00) and", "(+2.00, +0.20, 0.00) m"],
        ),
        ("front roof unit on soft mounts, 0.875 rad/kNm", 40, ["front roof unit on soft mounts,", "0.875 rad/kNm"]),
        ("0.1 = 0.2 = 0.3", 5, ["0.1 =", "0.2 =", "0.3"]),
    ],
)
def test_no_line_ends_within_a_number_and_what_belongs_to_it(words, letters, lines):
    assert fill(words, letters).split("\n") == lines


def test_a_label_higher_than_its_figure_is_not_legible():
    label = "residual, measured − model (standard deviations)"
    assert not is_legible(panel(WIDTH, lambda ax: ax.set_ylabel(label)))
    assert is_legible(panel(WIDTH, lambda ax: ax.set_ylabel(label.replace(" (", "\n("))))


def test_a_width_ends_with_its_context():
    with style(COLUMN):
        assert new_figure(1.0).get_size_inches()[0] == COLUMN
    with style():
        assert new_figure(1.0).get_size_inches()[0] == WIDTH


def test_characters_that_no_font_has_do_not_make_a_figure_illegible():
    assert is_legible(panel(COLUMN, lambda ax: ax.set_xlabel("\U0001f701 \u1a01")))


def test_panels_without_any_room_are_not_legible():
    def draw(ax):
        ax.set_yticks(
            [0.0, 1.0], ["a name much longer than a column of a page is wide, whatever is left out of it"] * 2
        )

    assert not is_legible(panel(COLUMN, draw))


def test_small_text_is_legible_on_a_page_only():
    def draw(ax):
        ax.text(0.5, 0.5, "0.85", fontsize=6.5)

    assert is_legible(panel(WIDTH, draw)) and not is_legible(panel(COLUMN, draw))


def test_a_value_over_the_legend_is_not_legible():
    def draw(at):
        def of(ax):
            ax.plot([0, 1], label="calibrated")
            legend_above(ax)
            ax.text(0.08, at, "measured", transform=ax.transAxes)

        return is_legible(panel(WIDTH, of))

    assert draw(0.5) and not draw(1.03)


def in_a_column(draw):
    with style(COLUMN):
        ax = draw()
        wrap_labels(ax.figure)
        fit_cells(ax.figure)
        return ax


def matrix(columns):
    values = np.round(np.random.default_rng(1).random((4, columns)), 2)
    table = pd.DataFrame(values, columns=[f"{k} ({k}.00 Hz)" for k in range(columns)])
    return table.assign(mode=["1B", "2B", "3B", "4B"])


@pytest.mark.medium
@pytest.mark.parametrize(("columns", "letters"), [(8, 4), (16, 3), (24, 0)])
def test_cells_of_a_column_hold_as_much_of_their_number_as_they_have_room_for(columns, letters):
    table = matrix(columns)
    ax = in_a_column(lambda: draw_mac_matrix(table))
    assert is_legible(ax.figure) and ax.figure.get_size_inches()[0] == COLUMN
    values = table.drop(columns="mode").to_numpy().ravel()
    expected = [f"{v:.2f}"[4 - letters :] if letters else "" for v in values]
    assert [text.get_text() for text in ax.texts] == expected
    assert all(text.get_fontsize() >= 7 for text in ax.figure.findobj(Text) if text.get_text())


def test_what_a_constraint_lends_stays_in_brackets_where_there_is_no_room_for_numbers():
    names = [f"natural_freq_{k}" for k in range(20)]
    whole = pd.DataFrame(np.full((2, 20), 0.6), columns=names).assign(parameter=["stiffness_of_the_rail", "mass"])
    own = whole.copy()
    own.loc[1, names] = 0.1
    ax = in_a_column(lambda: draw_sensitivity(whole, partial=own))
    cells = [text.get_text() for text in ax.texts if text.get_transform() is ax.transData]
    assert cells == [""] * 20 + ["()"] * 20


@pytest.mark.medium
def test_a_column_has_the_searches_with_their_stability_below_the_names(parameters):
    ax = in_a_column(lambda: draw_searches(parameters))
    assert is_legible(ax.figure)
    names = list(dict.fromkeys(parameters["parameter"]))
    unstable = set(parameters.loc[parameters["stable"] == False, "parameter"])  # noqa: E712
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert unstable and {name for name, label in zip(names, labels, strict=True) if "not stable" in label} == unstable


@pytest.mark.medium
def test_a_column_has_the_worst_sensors_and_measured_frequencies_alone(modes):
    names = [f"{k}y" for k in range(30)]
    ax = in_a_column(lambda: draw_comac(pd.DataFrame({"sensor": names, "comac": np.linspace(0.2, 1.0, 30)})))
    assert is_legible(ax.figure) and [t.get_text() for t in ax.get_xticklabels()] == names[:18]
    assert "the 18 worst of 30" in ax.get_xlabel().replace("\n", " ")
    ax = in_a_column(lambda: draw_frequencies(modes))
    assert is_legible(ax.figure) and {t.get_gid() for t in ax.texts} - {None} == {"freq_measured"}
