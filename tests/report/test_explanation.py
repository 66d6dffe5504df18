import os

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from calib.errors.errors import InputError
from calib.report.explanation import (
    MOST,
    draw_confounding,
    draw_ranked_effects,
    draw_visibility,
    ranked,
    ranked_effects_figure,
)
from calib.report.figures import Figures
from calib.report.style import BLUE, GREY, ORANGE, REST, SYNTHETIC, new_figure

nan = np.nan
FIGURES = [
    "answer",
    "where_it_fails_sigma",
    "sensor_misfit",
    "perturbation_map",
    "pulls",
    "ranked_effects",
    "confounding",
    "errors_before_after",
    "errors_over_versions",
    "next_measurement",
]


@pytest.fixture
def effects():
    rows = [
        ("shear", "shear flexibility", 0.6, 0.4, 2.9, 1.0, False, -1.8, nan, nan, nan, False, False, ""),
        ("seats", "seats", 9.0, 0.8, 0.02, 0.2, True, 30.0, 29.0, 28.5, 0.2, True, False, "body mass has to move"),
        ("arb", "anti-roll bar", 10.0, 0.5, 0.1, 2.0, True, 40.0, 41.0, 39.0, 0.8, True, True, ""),
        ("track", "track compliance", nan, 0.0, np.inf, 1.0, False, nan, nan, nan, nan, False, False, ""),
        ("rod", "rod", -1.2, 0.9, 0.5, 1.0, True, -0.5, nan, nan, nan, False, False, ""),
    ]
    names = "name title z unabsorbed magnitude_min plausible visible ln_bayes ln_bayes_third ln_bayes_triple"
    names += " model_probability refitted credible implausible"
    return pd.DataFrame(rows, columns=names.split()).assign(unit="N/m", magnitude=0.3)


ORDER = ["anti-roll bar", "seats", "rod", "shear flexibility", "track compliance"]


def dots(ax):
    return [c for c in ax.collections if c.get_gid() is not None]


def value(dot):
    ((x, _),) = np.ma.filled(dot.get_offsets(), nan)
    return x


def words(ax):
    return [t.get_text() for t in ax.texts]


def labels(axis):
    return [t.get_text() for t in axis]


def test_effects_are_ranked_by_their_evidence(effects):
    assert list(ranked(effects)["title"]) == ORDER
    ax = draw_ranked_effects(effects)
    assert labels(ax.get_yticklabels()) == ORDER
    np.testing.assert_array_equal([value(dot) for dot in dots(ax)], [40.0, 30.0, -0.5, -1.8, nan])
    assert ax.get_ylim()[0] > ax.get_ylim()[1]
    assert words(ax) == ["40", "30 implausible", "−0.5", "−1.8", "no value"]
    assert "0" in words(draw_ranked_effects(effects.assign(ln_bayes=effects["ln_bayes"].replace(-0.5, -9e-4))))


def test_colours_and_legend_show_the_status_of_every_effect(effects):
    ax = draw_ranked_effects(effects)
    faces = [to_hex(dot.get_facecolor()[0]).upper() for dot in dots(ax)]
    assert faces[0] == ORANGE and faces[1] == BLUE and faces[3] == faces[4] == REST
    assert len(set(faces)) == 4
    marks = [len(dot.get_paths()[0]) for dot in dots(ax)]
    assert [mark != marks[0] for mark in marks] == [False, True, False, False, False]
    assert [dot.get_gid() for dot in dots(ax)][:3] == ["candidates left", "refitted", "not refitted: linear estimate"]
    assert labels(ax.get_legend().get_texts()) == [
        "candidates left",
        "refitted",
        "not refitted: linear estimate",
        "not visible with these data",
        "fitted with implausible values",
        "threshold ln 5 + 3 = 4.6",
        "prior width ÷ 3 to × 3",
    ]


def test_the_threshold_grows_with_the_number_of_effects(effects):
    for table in (effects, effects.iloc[:1]):
        (line,) = [x for x in draw_ranked_effects(table).lines if x.get_gid() == "threshold"]
        assert line.get_xdata()[0] == pytest.approx(np.log(len(table)) + 3.0)


def test_of_hundreds_of_effects_those_with_most_evidence_are_drawn(effects):
    many = pd.concat([effects.assign(name=[f"{n}_{k}" for n in effects["name"]]) for k in range(30)], ignore_index=True)
    many["ln_bayes"] = np.arange(len(many), dtype=float)
    names = list(many["name"][::-1][:MOST])
    ax = draw_ranked_effects(many)
    assert len(dots(ax)) == MOST and len(many) > 2 * MOST
    table = pd.DataFrame(np.eye(len(many)), columns=many["name"]).assign(effect=many["name"])
    ax = draw_confounding(table, effects=many)
    shown = labels(ax.get_xticklabels())
    assert 16 < len(shown) < MOST and shown == names[: len(shown)] and not ax.texts, "no room for numbers in its cells"


def test_thin_lines_span_the_prior_widths(effects):
    spans = [list(x.get_xdata()) for x in draw_ranked_effects(effects).lines if x.get_gid() == "prior"]
    assert spans == [[39.0, 41.0], [28.5, 30.0]]


@pytest.mark.medium
def test_values_do_not_cover_the_line_of_the_threshold(effects):
    """They stand right of it, wherever their dot lies."""
    ax = draw_ranked_effects(effects.assign(ln_bayes=[-1.8, 3.9, 40.0, 0.0, -0.5]))
    ax.figure.savefig(os.devnull, format="png")
    (line,) = [x for x in ax.lines if x.get_gid() == "threshold"]
    across = ax.transData.transform((line.get_xdata()[0], 0.0))[0]
    assert all(t.get_window_extent().x0 > across for t in ax.texts)


def test_labels_of_effects_that_are_not_visible_are_grey(effects):
    figure = ranked_effects_figure(effects.assign(implausible=""))
    _, left, right = figure.axes
    grey = [t.get_color() == GREY for t in left.get_yticklabels()]
    assert grey == [t.get_color() == GREY for t in left.texts] == [False, False, False, True, True]
    beside = sorted((t for t in right.texts if t.xy[1] >= 0), key=lambda t: t.xy[1])
    assert [t.get_color() == GREY for t in beside[::2]] == grey
    assert right.get_xlabel() == "smallest visible magnitude /\nplausible magnitude (–)"


@pytest.mark.parametrize(("factor", "scale"), [(1.0, "linear"), (100.0, "function")])
def test_overwhelming_evidence_is_drawn_on_an_axis_of_roots(effects, factor, scale):
    wide = effects.assign(ln_bayes=factor * effects["ln_bayes"])
    ax = draw_ranked_effects(wide)
    assert ax.get_xscale() == scale
    assert ax.get_xlim()[0] < factor * -1.8 and ax.get_xlim()[1] > factor * 40.0


def test_visibility_is_the_smallest_over_the_plausible_magnitude(effects):
    ax = draw_visibility(effects)
    lines = {x.get_gid(): x for x in ax.lines}
    np.testing.assert_allclose(lines["visible"].get_xdata(), [0.05, 0.1, 0.5])
    np.testing.assert_allclose(lines["visible"].get_ydata(), [0, 1, 2])
    np.testing.assert_allclose(lines["not visible"].get_xdata(), [2.9])
    assert list(lines["never"].get_ydata()) == [4]
    assert ax.get_xscale() == "log" and lines["plausible"].get_xdata()[0] == 1.0
    beside = [t.get_text() for t in sorted(ax.texts, key=lambda t: t.xy[1])]
    assert beside == ["z", "probability", "10.0", "80 %", "9.0", "20 %", "−1.2", "–", "0.6", "–", "–", "–"]


@pytest.mark.medium
def test_both_panels_have_the_same_rows(effects):
    figure = ranked_effects_figure(effects)
    _, left, right = figure.axes
    assert left.get_ylim() == right.get_ylim()
    figure.savefig(os.devnull, format="png")
    assert left.get_position().y0 == pytest.approx(right.get_position().y0)
    assert not [t for t in right.get_yticklabels() if t.get_visible()]


@pytest.mark.slow
def test_no_labels_of_the_ranking_overlap():
    table = pd.DataFrame({"name": [f"e{k}" for k in range(14)], "title": "an effect with a rather long title"})
    table["ln_bayes"] = np.geomspace(4000.0, 0.1, 14)
    table = table.assign(
        z=-10.5, unabsorbed=0.5, magnitude_min=np.inf, plausible=1.0, ln_bayes_third=-5.0, ln_bayes_triple=nan
    )
    table = table.assign(model_probability=1.0, visible=True, refitted=True, credible=True, implausible="because")
    figure = ranked_effects_figure(table)
    figure.savefig(os.devnull, format="png")
    over, left, right = figure.axes
    boxes = [t.get_window_extent() for ax in (left, right) for t in [*ax.texts, *ax.get_xticklabels()] if t.get_text()]
    boxes += [t.get_window_extent() for t in left.get_yticklabels()]
    boxes.append(over.get_legend().get_window_extent())
    for k, box in enumerate(boxes):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in boxes[:k])


@pytest.fixture
def correlations():
    cells = [[1.0, 0.95, -0.2], [0.95, 1.0, nan], [-0.2, nan, 1.0]]
    table = pd.DataFrame(cells, columns=["arb", "seats", "rod"])
    table.insert(0, "effect", ["arb", "seats", "rod"])
    return table


def test_confounding_cells_hold_the_correlations(correlations, effects):
    ax = draw_confounding(correlations[["effect", "rod", "seats", "arb"]], effects=effects)
    values = correlations.drop(columns="effect").to_numpy()
    np.testing.assert_array_equal(ax.images[-1].get_array().filled(nan), values)
    cells = {(round(t.get_position()[1]), round(t.get_position()[0])): t.get_text() for t in ax.texts}
    assert cells[0, 1] == "0.95" and cells[0, 2] == "−0.20" and (1, 2) not in cells
    assert labels(ax.get_yticklabels()) == [
        "anti-roll bar (arb,\nγ\xa00.50)",
        "seats (γ\xa00.80)",
        "rod (γ\xa00.90)",
    ]
    assert labels(ax.get_xticklabels()) == ["arb", "seats", "rod"]


def test_collinear_pairs_are_outlined(correlations):
    ax = draw_confounding(correlations)
    centres = [(p.get_x() + p.get_width() / 2, p.get_y() + p.get_height() / 2) for p in ax.patches]
    np.testing.assert_allclose(sorted(centres), [(0, 1), (1, 0)])
    assert "outlined" in ax.get_xlabel() and labels(ax.get_yticklabels()) == ["arb", "seats", "rod"]
    assert len(draw_confounding(correlations.replace(0.95, -0.95)).patches) == 2
    below = draw_confounding(correlations.replace(0.95, 0.85))
    assert not below.patches and "outlined" not in below.get_xlabel()


@pytest.mark.slow
def test_one_effect_or_none(correlations, effects):
    ranked_effects_figure(effects.iloc[:1]).savefig(os.devnull, format="png")
    ranked_effects_figure(effects.iloc[:0]).savefig(os.devnull, format="png")
    draw_confounding(correlations.iloc[:1, :2]).figure.savefig(os.devnull, format="png")
    for empty in (draw_ranked_effects(effects.iloc[:0]), draw_visibility(effects.iloc[:0])):
        assert words(empty) == ["no effect was tested"]
    assert words(draw_confounding(correlations.iloc[:0, :1])) == ["no effect was tested"]


def test_a_given_axes_is_drawn_on_and_returned(correlations, effects):
    for plot, table in ((draw_ranked_effects, effects), (draw_visibility, effects), (draw_confounding, correlations)):
        ax = new_figure(3.0).add_subplot()
        assert plot(table, ax) is ax


TABLES = {
    "misfit_kinds": "stage,mode,kind,chi2,dof,p\nbase,1BT,shape,88,44,1e-4\n",
    "mesh_points": "point,x,y,z\n1,0,0,0\n2,4,1,2\n",
    "mesh_elements": "group,a,b,c,d\nframe,1,2,,\n",
    "sensor_misfit": "stage,mode,sensor,node,direction,x,y,z,re,im\nbase,1BT,1y,1,y,0,0,0,1.5,nan\n",
    "perturbations": "perturbation,kind,x,y,z,sensor,score,unabsorbed,limit,told\n"
    "spring 1,stiffness,0,0,0,,-8,0.5,2.6,True\n",
    "pulls": "model,parameter,unit,nominal,value,prior_sd,standardised,limit,pulled\nbase,K,,1,1.2,0.1,2.8,2.5,True\n",
    "confounding": "effect,arb\narb,1.0\n",
    "errors": "group,stage,rms,expected,p\nfit,before,4.4,1.0,0.0\nfit,after,0.9,1.0,\n",
    "versions": "version,study,effects,group,rms,expected\n0,bogie,,fit,4.4,1.0\n1,bogie_2,arb,fit,0.9,1.0\n",
    "next_measurement": "measurement,kind,effect,gain,gain_low,gain_high,ln_bayes,ln_bayes_low,ln_bayes_high,words\n"
    "twice,repeats,arb,inf,inf,inf,,,,more\n",
}


@pytest.fixture
def folder(tmp_path, effects):
    for name, text in TABLES.items():
        (tmp_path / f"{name}.csv").write_text(text)
    effects.to_csv(tmp_path / "effects.csv", index=False)
    return tmp_path


@pytest.fixture
def saved(monkeypatch):
    figures = {}
    monkeypatch.setattr("calib.report.figures.content", lambda figure, name, *_: figures.update({name: figure}) or {})
    return figures


@pytest.mark.medium
def test_every_table_of_a_folder_has_its_figure(folder, unrendered):
    written = Figures(folder, "Bogie", True).save()
    assert [p.stem for p in written] == FIGURES
    assert all(p.parent == folder and p.read_bytes().startswith(b"\x89PNG") for p in written)


@pytest.mark.slow
def test_a_column_has_room_for_every_figure_of_an_explanation(folder, saved, effects):
    figures = Figures(folder, "Bogie", True)
    figures.save(width="column")
    assert figures.too_wide == () and set(saved) == set(FIGURES)
    told = {text.get_text() for ax in saved["ranked_effects"].axes for text in ax.texts}
    assert set(effects["title"]) < told and "z\xa010.0, 80 %" in told
    assert {text.get_text() for text in saved["pulls"].axes[0].texts} == {"K", "1 → 1.2"}


@pytest.mark.medium
def test_headings_state_that_local_perturbations_are_no_causes_and_what_is_synthetic(folder, saved):
    Figures(folder, "Bogie", True).save()
    for figure in saved.values():
        assert SYNTHETIC in [t.get_text() for t in figure.texts]
    heading = [t.get_text().replace("\n", " ") for t in saved["perturbation_map"].texts]
    assert "Bogie: scores of local stiffness or mass changes: places to inspect, not causes" in heading


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(("stage", "later"), [("explained", "after"), ("attempt", "attempt")])
def test_an_attempt_is_never_drawn_as_the_missing_effect(folder, saved, stage, later):
    with (folder / "misfit_kinds.csv").open("a") as file:
        file.write(f"{stage},1BT,shape,44,44,0.5\n")
    with (folder / "pulls.csv").open("a") as file:
        file.write("arb,K,,1,1.1,0.1,1.4,2.5,False\n")
    (folder / "errors.csv").write_text(TABLES["errors"].replace("after", later))
    Figures(folder, "Bogie", False).save()
    texts = {}
    for name in ("where_it_fails_sigma", "pulls", "errors_before_after"):
        axes = saved[name].axes
        found = [a.get_title(loc="left") for a in axes] + [t for a in axes for t in words(a)]
        found += [t for a in axes if a.get_legend() for t in labels(a.get_legend().get_texts())]
        texts[name] = [t.replace("\n", " ") for t in found]
    attempt = "with arb: best attempt, not believed"
    for name, found in texts.items():
        assert (attempt in found) == (stage == "attempt"), name
        assert not any("missing effect" in t for t in found)
    assert ("with arb, calibrated" in texts["errors_before_after"]) == (stage == "explained")
    assert ("with arb, calibrated" in texts["where_it_fails_sigma"]) == (stage == "explained")


@pytest.mark.medium
def test_an_empty_cell_written_as_nan_is_empty(folder, saved, effects):
    effects.assign(implausible=nan).to_csv(folder / "effects.csv", index=False, na_rep="nan")
    Figures(folder, "Bogie", False).save()
    assert not [text for ax in saved["ranked_effects"].axes for text in words(ax) if "implausible" in text]


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    ("gone", "figures"),
    [
        ("mesh_elements", {"answer", "sensor_misfit", "perturbation_map"}),
        ("versions", {"errors_over_versions"}),
        ("effects", {"ranked_effects"}),
        ("confounding", {"confounding"}),
    ],
)
def test_without_its_table_there_is_no_figure(folder, saved, gone, figures):
    (folder / f"{gone}.csv").unlink()
    Figures(folder, "Bogie", False).save()
    assert set(FIGURES) - set(saved) == figures


def test_tables_without_rows_have_no_figure(folder):
    for path in folder.glob("*.csv"):
        if path.stem != "mesh_points":  # a model has points
            path.write_text(path.read_text().split("\n")[0] + "\n")
    assert Figures(folder, "Bogie", False).save() == []


@pytest.mark.parametrize(
    ("name", "old", "new", "column"),
    [
        ("effects", "anti-roll bar,10.0", "anti-roll bar,ten", "z"),
        ("perturbations", "-8", "-inf", "score"),
        ("pulls", "True", "perhaps", "pulled"),
        ("confounding", "arb,1.0", "seats,1.0", "effect"),
        ("mesh_points", "2,4,1,2", "2,4,,2", "y"),
    ],
)
def test_a_damaged_table_is_named(folder, name, old, new, column):
    path = folder / f"{name}.csv"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=rf"{name}\.csv") as problem:
        Figures(folder, "Bogie", False).save()
    assert column in str(problem.value)
    assert not list(folder.glob("*.png"))


def test_effects_named_together_are_told_to_share_their_evidence(effects):
    together = effects.assign(credible=effects["name"].isin(["seats", "arb"]))
    together.loc[together["credible"], "ln_bayes"] = 30.0
    apart = together.assign(ln_bayes=together["ln_bayes"] + np.arange(len(together)))
    words = [ranked_effects_figure(table).get_supxlabel() for table in (together, apart)]
    assert ["together" in text for text in words] == [True, False]
