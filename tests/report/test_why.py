import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from calib.report.alike import alike_figure, alike_words, coinciding, draw_alike, most_alike
from calib.report.figures import Figures
from calib.report.scene import plot_coordinates
from calib.report.style import GREY, WITH
from calib.report.why import draw_bars, draw_shapes, explained_words, share, why_figure

REST = np.array([[[0.0, 0.0, -1.0], [4.0, 0.0, -1.0]], [[4.0, 0.0, -1.0], [4.0, 1.0, 1.0]]])


@pytest.fixture
def table():
    """Two effects, each with frequencies, one damping ratio, shapes of two modes and a prior."""
    labels = [("frequency", m, "", "") for m in ("B1", "B2", "T1")] + [("damping", "T1", "", "")]
    labels += [("shape", m, s, part) for m in ("B1", "T1") for s in ("1y", "2y", "3y") for part in ("re", "im")]
    labels += [("prior", "", "K", "")]
    rng, parts = np.random.default_rng(3), []
    residual = rng.normal(0.0, 4.0, len(labels))
    for effect, size in (("arb", 0.9), ("seats", 0.3)):
        own = pd.DataFrame(labels, columns=["kind", "mode", "sensor", "part"])
        own = own.assign(effects=effect, effect=effect, residual=residual)
        own["signature"] = size * residual + rng.normal(0.0, 0.3, len(own))
        parts.append(own.assign(left=own["residual"] - own["signature"]))
    return pd.concat(parts, ignore_index=True)


@pytest.fixture
def scalar():
    names = {"f1": "freq", "f2": "freq", "s1": "shape", "y": "response"}
    rows = [("arb", "arb", kind, "", name, "", 3.0, len(name), 1.0) for name, kind in names.items()]
    return pd.DataFrame(rows, columns="effects effect kind mode sensor part residual signature left".split())


@pytest.fixture
def places():
    rows = [
        ("arb", "spring 1", "stiffness", 0.0, 0.0, -1.0, 0.3),
        ("arb", "spring 2", "stiffness", 4.0, 0.0, -1.0, -0.8),
        ("arb", "scale of 1y", "fault", np.nan, np.nan, np.nan, 0.95),
        ("arb", "mass 1", "mass", 2.0, 0.0, -1.0, 0.6),
        ("seats", "spring 1", "stiffness", 0.0, 0.0, -1.0, 0.4),
    ]
    return pd.DataFrame(rows, columns="effect perturbation kind x y z correlation".split())


def of(table, effect, kind):
    return table[(table["effect"] == effect) & (table["kind"] == kind)]


def bars(ax, gid):
    return [bar for container in ax.containers for bar in container if bar.get_gid() == gid]


def line(ax, gid):
    (found,) = [line for line in ax.lines if line.get_gid() == gid]
    return found


def panels(figure, title):
    return [ax for ax in figure.axes if any(ax.get_title(loc=at).startswith(title) for at in ("left", "center"))]


def test_bars_and_dots_are_the_rows_of_the_table(table):
    rows = of(table, "arb", "frequency")
    ax = draw_bars(rows)
    for column in ("residual", "signature"):
        assert [bar.get_height() for bar in bars(ax, column)] == rows[column].tolist()
        assert [bar.get_x() + bar.get_width() / 2 for bar in bars(ax, column)] == pytest.approx([0, 1, 2])
    assert line(ax, "left").get_ydata().tolist() == rows["left"].tolist()
    assert [t.get_text() for t in ax.get_xticklabels()] == ["B1", "B2", "T1"]


def test_a_mode_without_a_value_keeps_its_place(table):
    ax = draw_bars(of(table, "arb", "damping"), names=["B1", "B2", "T1"])
    (bar,) = bars(ax, "residual")
    assert bar.get_x() + bar.get_width() / 2 == pytest.approx(2.0)
    assert [t.get_text() for t in ax.get_xticklabels()] == ["B1", "B2", "T1"]


def test_shapes_are_dots_of_signature_and_residual_on_equal_scales(table):
    rows = of(table, "arb", "shape")
    ax = draw_shapes(rows)
    for part in ("re", "im"):
        own = rows[rows["part"] == part]
        np.testing.assert_array_equal(np.column_stack(line(ax, part).get_data()), own[["signature", "residual"]])
    assert ax.get_xlim() == ax.get_ylim() and np.array_equal(*line(ax, "equal").get_data())
    largest = rows.loc[rows["signature"].abs().sort_values(ascending=False).index[:3]]
    expected = [f"{r.mode} {r.sensor}" + (" im" if r.part == "im" else "") for r in largest.itertuples()]
    assert sorted(t.get_text() for t in ax.texts) == sorted(expected)


def test_names_of_lines_have_four_digits_and_do_not_meet():
    """Neighbouring lines of one resonance have nearly the same signature."""
    rows = pd.DataFrame({
        "mode": ["15.2237288 Hz", "15.2541 Hz", "15.3 Hz"], "sensor": "1x/2x", "part": "re",
        "signature": [9.0, 9.1, 9.2], "residual": [8.0, 8.1, 8.1],
    })  # fmt: skip
    ax = draw_shapes(rows)
    assert {t.get_text() for t in ax.texts} == {"15.22 Hz 1x/2x", "15.25 Hz 1x/2x", "15.3 Hz 1x/2x"}
    heights = np.sort([t.xyann[1] for t in ax.texts])  # over that of the panel, 2.5 inches
    assert np.diff(heights).min() * 2.5 * 72 > 1.2 * ax.texts[0].get_fontsize()


@pytest.mark.medium
def test_of_one_of_several_tests_its_share_of_the_whole_decrease_is_told(table):
    """Not a share of its own sum of squares, which no fit minimises by itself."""
    own = table[table["effect"] == "arb"]
    together = str(own["effects"].iloc[0])
    numbers = {"effects": [together], "rows": [11.0], "before": [43.7], "after": [0.209], "share": [0.0453]}
    words = explained_words(own, pd.DataFrame(numbers))
    assert [part for part in ("11", "43.7", "0.209", "5 %") if part not in words] == []
    worse = explained_words(own, pd.DataFrame(numbers | {"before": [0.1], "share": [-0.02]}))
    assert "%" not in worse and "0.100" in worse and f"{100 * share(own):.0f} %" in explained_words(own)
    titles = [ax.get_title() for ax in why_figure(table, by_test=pd.DataFrame(numbers)).axes]
    assert any(titles) and not any("%" in title or "explained" in title for title in titles)


def test_the_share_is_of_the_sum_of_squares(table):
    assert share(table[table["effect"] == "arb"]) > 0.9 > share(table[table["effect"] == "seats"]) > 0.4
    assert share(pd.DataFrame({"residual": [3.0, 4.0], "left": [0.0, 3.0]})) == pytest.approx(16 / 25)
    assert share(pd.DataFrame({"residual": [1.0], "left": [2.0]})) == pytest.approx(-3.0)
    assert np.isnan(share(pd.DataFrame({"residual": [0.0], "left": [0.0]})))


def test_the_place_is_that_of_the_most_alike_perturbation_that_has_one(places):
    assert most_alike(places, "arb")["perturbation"] == "spring 2" and "spring 2" in alike_words(places, "arb")
    assert most_alike(places, "seats") is None and "spring" not in alike_words(places, "seats")
    assert alike_words(places.assign(x=np.nan), "arb") == ""


@pytest.mark.medium
def test_places_are_drawn_with_their_correlation(places):
    ax = draw_alike(places, REST, effect="arb")
    (dots,) = [c for c in ax.collections if c.get_gid() == "correlation"]
    np.testing.assert_array_equal(dots.get_array(), [-0.8, 0.6, 0.3])
    x, depth, height = (np.asarray(v) for v in dots._offsets3d)
    np.testing.assert_array_equal(np.column_stack([x, height, -depth]), [[4, 0, -1], [2, 0, -1], [0, 0, -1]])
    assert [t.get_text() for t in ax.texts if t.get_text()] == ["1"]
    assert not [t for t in draw_alike(places, REST, effect="seats").texts if t.get_text()]


def test_each_effect_has_its_panels(table):
    figure = why_figure(table)
    for title in ("frequency", "damping", "shape"):
        assert len(panels(figure, title)) == 2
    for ax, effect in zip(panels(figure, "frequency"), ("arb", "seats"), strict=True):
        assert [bar.get_height() for bar in bars(ax, "signature")] == of(table, effect, "frequency")[
            "signature"
        ].tolist()
    drawn = sum(len(bars(ax, "residual")) for ax in figure.axes)
    assert drawn == 2 * 4  # priors are no data


def test_each_effect_stands_on_the_structure_by_itself(places):
    acts = pd.DataFrame({"effect": ["arb"], "x": [1.0], "y": [0.5], "z": [0.25]})
    figure = alike_figure(places, REST, acts=acts)
    drawn = [c for ax in figure.axes for c in ax.collections if c.get_gid() == "correlation"]
    assert [len(c.get_array()) for c in drawn] == [3, 1]
    first, second = (t.get_text() for ax in figure.axes for t in ax.texts if ax.get_label() == "heading")
    assert "spring 2" in first and "+1.00, +0.50, +0.25" in first and "spring" not in second


def test_marks_that_lie_on_the_first_are_told(places):
    assert coinciding(places, "arb") == [] == coinciding(places, "seats")
    over = ("arb", "mass of plate 13", "mass", 4.0, 0.01, -1.0, 0.7)
    both = pd.concat([places, pd.DataFrame([over], columns=places.columns)], ignore_index=True)
    (told,) = coinciding(both, "arb")
    assert "mass of plate 13" in told and "0.70" in told
    (heading, _) = (
        t.get_text() for ax in alike_figure(both, REST).axes for t in ax.texts if ax.get_label() == "heading"
    )
    assert told in heading


def test_without_a_mesh_or_a_place_nothing_is_drawn_on_the_structure(table, places, tmp_path):
    table.to_csv(tmp_path / "why.csv", index=False)
    for some in (places, places.assign(x=np.nan)):
        some.to_csv(tmp_path / "why_places.csv", index=False)
        assert list(Figures(tmp_path, "", True).plan) == ["why_this_effect"]


def test_scalar_responses_are_bars_of_one_panel(scalar):
    figure = why_figure(scalar)
    (ax,) = [ax for ax in figure.axes if ax.containers]
    assert [bar.get_height() for bar in bars(ax, "residual")] == scalar["residual"].tolist()
    assert [t.get_text() for t in ax.get_xticklabels()] == scalar["sensor"].tolist()


def test_an_attempt_is_grey(table):
    rows = of(table, "arb", "frequency")
    for attempt, colour in ((False, WITH), (True, GREY)):
        assert {to_hex(bar.get_facecolor()) for bar in bars(draw_bars(rows, attempt=attempt), "signature")} == {
            colour.lower()
        }


@pytest.mark.medium
def test_the_figure_of_the_folder_needs_rows(table, places, tmp_path):
    places.to_csv(tmp_path / "why_places.csv", index=False)
    table.iloc[:0].to_csv(tmp_path / "why.csv", index=False)
    assert not Figures(tmp_path, "", True).plan
    table.to_csv(tmp_path / "why.csv", index=False)
    plan = Figures(tmp_path, "", True).plan
    assert list(plan) == ["why_this_effect"] and set(plan["why_this_effect"].tables) == {"why"}
    (file,) = Figures(tmp_path, "Car", True).save(["svg"])
    assert "B2, residual" in file.read_text("utf-8")


def test_the_star_is_where_the_effect_acts(places):
    acts = pd.DataFrame({"effect": ["arb", "seats"], "x": [1.0, 9.0], "y": [0.5, 9.0], "z": [0.25, 9.0]})
    star = line(draw_alike(places, REST, effect="arb", acts=acts), "acts")
    at = plot_coordinates(np.array([[1.0, 0.5, 0.25]]))[0]
    np.testing.assert_array_equal([axis[0] for axis in star.get_data_3d()], at)
    assert not [one for one in draw_alike(places, REST, effect="arb").lines if one.get_gid() == "acts"]


def test_further_parameters_of_an_effect_stand_in_its_heading(table):
    fitted = pd.DataFrame(
        [("arb", "arb", "size", "kg", 3.0), ("arb", "arb_freq", "natural frequency of it", "Hz", 14.258)],
        columns=["effect", "parameter", "description", "unit", "value"],
    )
    (heading,) = (
        t.get_text()
        for ax in why_figure(table[table["effect"] == "arb"], parameters=fitted).axes
        for t in ax.texts
        if ax.get_label() == "heading"
    )
    assert "arb_freq = 14.3 Hz as fitted; in the list: natural frequency of it" in heading.split("\n")


@pytest.mark.medium
def test_open_dots_of_imaginary_parts_are_in_the_legend(table):
    def legend(rows):
        figure = why_figure(rows)
        (found,) = figure.legends
        return dict(zip([t.get_text() for t in found.get_texts()], found.legend_handles, strict=True))

    complex_ = legend(table)
    assert complex_["imaginary"].get_markerfacecolor() == "white" != complex_["real"].get_markerfacecolor()
    assert "imaginary" not in legend(table[table["part"] != "im"])
