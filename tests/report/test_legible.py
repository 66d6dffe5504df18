import pytest

from calib.report.figures import is_legible, wrap_labels
from calib.report.style import COLUMN, WIDTH, new_figure, plain_ticks, style


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
