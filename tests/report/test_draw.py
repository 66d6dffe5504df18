import json
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from calib.errors.errors import InputError
from calib.report.figures import Figures, is_legible
from calib.report.style import COLUMN, NO_GLYPH, SYNTHETIC, WIDTH, add_heading, new_figure, save, style
from calib.report.tables import read_results

ALL = [
    "comparison",
    "mac_before",
    "mac_after",
    "orthogonality_after",
    "comac",
    "model",
    "model_modes_after",
    "mode_shapes_after",
    "modes",
    "sensitivity",
    "parameters",
    "searches",
    "convergence",
]
OF_THE_MODEL = ("mesh_points", "mesh_elements", "shapes_after", "deflection_after", "model_modes_after")
"""Tables of the figures in space."""


@pytest.fixture
def folder(
    tmp_path, before, after, mac, comac, shapes, mesh, deflection, model_modes, modes, sensitivity, parameters,
    convergence, cross, own,
):  # fmt: skip
    tables = {
        "comparison_before": before,
        "comparison_after": after,
        "mac_before": mac,
        "mac_after": mac,
        "cross_orthogonality_after": cross,
        "self_orthogonality_after": own,
        "comac_before": comac,
        "comac_after": comac,
        "shapes_after": shapes,
        "mesh_points": mesh.points,
        "mesh_elements": mesh.elements,
        "deflection_after": deflection,
        "model_modes_after": model_modes,
        "modes": modes,
        "sensitivity": sensitivity,
        "parameters": parameters,
        "convergence": convergence,
    }
    for name, table in tables.items():
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    (tmp_path / "summary.json").write_text(json.dumps({"best_case": "GB2"}))
    return tmp_path


@pytest.fixture
def saved(monkeypatch):
    """Figures by name, kept instead of written."""
    figures: dict[str, Figure] = {}

    def keep(figure, name, formats, key=""):
        figures[name] = figure
        return {"png": b"pixels"}

    monkeypatch.setattr("calib.report.figures.content", keep)
    return figures


@pytest.mark.slow
def test_every_figure_is_written_beside_its_table(folder, unrendered):
    written = Figures(folder, "Bogie", False).save()
    assert [p.stem for p in written] == ALL
    assert all(p.parent == folder and p.is_file() for p in written)
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]


def keep_only(folder, *names):
    for table in folder.glob("*.csv"):
        if table.stem not in names:
            table.unlink()


def all_words(figure):
    return [t.get_text() for t in figure.texts]


@pytest.mark.slow
def test_every_figure_of_a_synthetic_measurement_is_labelled(folder, saved):
    Figures(folder, "Bogie", True).save()
    assert list(saved) == ALL
    assert all(SYNTHETIC in all_words(figure) for figure in saved.values())
    saved.clear()
    keep_only(folder, "mac_before", "convergence")  # all have the same heading
    Figures(folder, "Bogie", False).save()
    assert list(saved) == ["mac_before", "convergence"]
    assert not any(SYNTHETIC in all_words(figure) for figure in saved.values())


@pytest.mark.slow
def test_the_heading_covers_no_data(folder, saved):
    Figures(
        folder, "A bogie with a title so long that it needs more than one line over a figure of this width", True
    ).save()
    assert list(saved) == ALL
    for figure in saved.values():
        figure.draw_without_rendering()
        lowest = min(t.get_window_extent().y0 for t in figure.texts if t.get_position()[1] > 0.5)
        for ax in figure.axes:
            assert ax.get_tightbbox().y1 <= lowest, figure.texts[0].get_text()


@pytest.mark.parametrize("synthetic", [False, True])
def test_the_heading_takes_no_room_from_the_data(synthetic):
    figure = new_figure(3.0)
    add_heading(figure, "Bogie", synthetic)
    layout = figure.get_layout_engine().get()
    assert layout["rect"][3] * figure.get_size_inches()[1] == pytest.approx(3.0)


@pytest.mark.medium
def test_figures_show_the_tables(folder, saved, before, convergence):
    keep_only(folder, "comparison_before", "comparison_after", "parameters", "convergence")
    Figures(folder, "Bogie", False).save()
    np.testing.assert_allclose(
        [bar.get_height() for bar in saved["comparison"].axes[0].containers[0]], 100 * before["freq_error"]
    )
    np.testing.assert_array_equal(saved["convergence"].axes[0].lines[0].get_ydata(), convergence["best"][:3])
    assert "GB2 (its fit is reported)" in [t.get_text() for t in saved["searches"].axes[0].get_legend().get_texts()]
    assert any("GB2" in t.get_text() for t in saved["parameters"].axes[0].get_legend().get_texts())


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
def test_missing_tables_have_no_figures(folder, saved):
    for name in ("comparison_after", "mac_before", "deflection_after", "sensitivity", "parameters"):
        (folder / f"{name}.csv").unlink()
    left = ["comparison", "mac_after", "orthogonality_after", "comac", "model", "modes", "convergence"]
    assert [p.stem for p in Figures(folder, "Bogie", False).save()] == left
    (folder / "mesh_points.csv").unlink()
    left.remove("model")
    assert [p.stem for p in Figures(folder, "Bogie", False).save() if p.stem != "modes"] == [
        p for p in left if p != "modes"
    ]


@pytest.mark.medium
def test_a_mesh_of_lines_without_sensors_has_no_figure_of_the_model(folder, saved):
    keep_only(folder, *OF_THE_MODEL)
    (folder / "shapes_after.csv").unlink()
    Figures(folder, "Bogie", False).save()
    assert "model_modes_after" in saved and not {"model", "mode_shapes_after"} & set(saved)


@pytest.mark.medium
def test_modes_of_every_stage_are_drawn_and_over_the_measurement_where_there_is_one(folder, saved):
    keep_only(folder, *OF_THE_MODEL)
    for name in ("deflection", "model_modes"):
        (folder / f"{name}_initial.csv").write_bytes((folder / f"{name}_after.csv").read_bytes())
    Figures(folder, "Bogie", False).save()
    assert [name for name in saved if "mode_shapes" in name or "model_modes" in name] == [
        "model_modes_initial", "model_modes_after", "mode_shapes_after",
    ]  # fmt: skip
    assert "before any calibration" in " ".join(all_words(saved["model_modes_initial"]))


def test_an_empty_folder_has_no_figures(tmp_path):
    assert Figures(tmp_path, "Bogie", False).save() == []


def test_a_missing_folder(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        Figures(tmp_path / "nowhere", "Bogie", False).save()


def damage(folder, name, old, new):
    path = folder / f"{name}.csv"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("name", "old", "new", "column", "line"),
    [
        ("comparison_before", "0.93", "o.93", "mac", "line 2"),
        ("comparison_after", "freq_error", "frequency_error", "freq_error", ""),
        ("comparison_after", "2BT", "1BT", "mode", "line 3"),
        ("mac_after", "0.11", "a lot", "1 (6.12 Hz)", "line 3"),
        ("cross_orthogonality_after", "model_mode", "partner", "model_mode", ""),
        ("self_orthogonality_after", "0.05", "small", "3BT", "line 3"),
        ("comac_before", "0.4", "inf", "comac", "line 3"),
        ("deflection_after", "1,0.0,", "1,,", "u", "line 3"),
        ("mesh_points", "1,2.0", "0,2.0", "point", "line 3"),
        ("sensitivity", "c_primary", "", "parameter", "line 3"),
        ("parameters", "0.375", "nan", "ratio", "line 3"),
        ("parameters", "True\n", "maybe\n", "identified", "line 2"),
        ("convergence", "GB1,1,", "GB1,one,", "generation", "line 3"),
    ],
)
def test_a_damaged_table_is_named_and_nothing_is_drawn(folder, name, old, new, column, line):
    damage(folder, name, old, new)
    with pytest.raises(InputError) as problem:
        Figures(folder, "Bogie", False).save()
    text = str(problem.value)
    assert f"{name}.csv" in text and repr(column) in text and line in text
    assert not list(folder.glob("*.png"))


@pytest.mark.parametrize("content", ["", "mode,mac\n", '"'])
def test_a_table_without_rows(folder, content):
    (folder / "mac_before.csv").write_text(content)
    with pytest.raises(InputError, match=r"mac_before\.csv"):
        Figures(folder, "Bogie", False).save()


@pytest.mark.parametrize("row", ["2y,0.8,0.7", "2y", '2y,"0.8'])
def test_a_row_with_too_few_or_too_many_cells(tmp_path, row):
    path = tmp_path / "comac_before.csv"
    path.write_text(f"sensor,comac\n1y,0.9\n{row}\n")
    with pytest.raises(InputError, match="line 3"):
        read_results(path, ["sensor"], ["comac"])


def test_names_that_look_like_numbers_or_gaps_stay_names(tmp_path):
    path = tmp_path / "mac_before.csv"
    path.write_text("mode,1\n01,0.5\nNA,0.25\n")
    table = read_results(path, ["mode"], others_are_numbers=True)
    assert list(table["mode"]) == ["01", "NA"] and list(table["1"]) == [0.5, 0.25]


@pytest.mark.parametrize("content", ['{"best_case": "GB7"}', "{"])
def test_a_damaged_summary(folder, content):
    (folder / "summary.json").write_text(content)
    with pytest.raises(InputError, match=r"summary\.json"):
        Figures(folder, "Bogie", False).save()


def test_without_a_summary_no_case_is_best(folder, saved):
    keep_only(folder, "parameters")
    (folder / "summary.json").write_text("{}")
    Figures(folder, "Bogie", False).save()
    assert "best" not in saved["parameters"].axes[0].get_legend().get_texts()[1].get_text()


@pytest.mark.medium
def test_an_interruption_while_saving_leaves_the_old_picture(folder, monkeypatch):
    keep_only(folder, "convergence")
    (picture,) = Figures(folder, "Bogie", False).save()
    old = picture.read_bytes()

    def stop(self, picture):
        with self.open("wb") as file:
            file.write(picture[:9])
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_bytes", stop)
    with pytest.raises(KeyboardInterrupt):
        Figures(folder, "Another title", False).save()
    assert picture.read_bytes() == old
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]


def test_the_users_own_settings_have_no_effect_and_are_kept(folder, saved):
    keep_only(folder, "convergence")
    with matplotlib.rc_context({"font.size": 30.0}):
        Figures(folder, "Bogie", False).save()
        assert matplotlib.rcParams["font.size"] == 30.0
    assert saved["convergence"].axes[0].xaxis.label.get_fontsize() == 9


@pytest.mark.slow
@pytest.mark.parametrize("figures", [("modes", "convergence"), pytest.param(ALL, marks=pytest.mark.slow)])
def test_any_name_can_be_drawn_without_a_warning(folder, recwarn, figures):
    names = ["a price of 5 $ and 6 $", "$x^{2$", "bridge \u6865\u6881 $\\alpha$"]
    table = pd.read_csv(folder / "modes.csv").assign(mode=names)
    table.to_csv(folder / "modes.csv", index=False)
    if figures != ALL:
        keep_only(folder, *figures)
    written = Figures(folder, names[0], False).save()
    assert set(figures) <= {p.stem for p in written} and not recwarn.list
    assert all(p.read_bytes().startswith(b"\x89PNG\r\n") and p.stat().st_size > 5000 for p in written)
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]
    keep_only(folder, "convergence")  # every figure has the same heading
    for name in names:
        assert [p.stem for p in Figures(folder, name, False).save()] == ["convergence"] and not recwarn.list


@pytest.mark.medium
def test_missing_characters_are_noted_in_the_picture_and_powers_stay_powers(tmp_path):
    with style():
        figure = new_figure(2.0)
        ax = figure.add_subplot()
        ax.set_title("\U000f1234")  # a private-use character, in no font
        ax.plot([1, 1000], [1, 1000])
        ax.set_yscale("log")
        figure.canvas.draw()
        save(figure, tmp_path / "a.png")
    assert NO_GLYPH in all_words(figure)
    assert any("mathdefault" in t.get_text() and t.get_parse_math() for t in ax.get_yticklabels())


@pytest.mark.slow
@pytest.mark.parametrize(
    "figures", [("mac_before", "model", "modes", "convergence"), pytest.param(ALL, marks=pytest.mark.slow)]
)
def test_in_a_column_a_figure_that_is_not_legible_there_stays_as_wide_as_a_page(folder, saved, figures):
    if figures != ALL:
        keep_only(folder, *figures, "mesh_points", "mesh_elements", "shapes_after")
    table = pd.read_csv(folder / "mac_before.csv")
    long = [f"{k} {'a name that leaves no room for the matrix ' * 3}" for k in range(len(table))]
    table.assign(mode=long).to_csv(folder / "mac_before.csv", index=False)
    drawings = Figures(folder, "Bogie", False)
    drawings.save(width="column")
    widths = {name: float(figure.get_size_inches()[0]) for name, figure in saved.items()}
    assert set(widths) == set(figures) and set(widths.values()) == {COLUMN, WIDTH}
    assert widths["convergence"] == widths["model"] == widths.get("mode_shapes_after", COLUMN) == COLUMN
    assert widths["mac_before"] == WIDTH
    assert all(is_legible(figure) for name, figure in saved.items() if widths[name] == COLUMN)
    assert set(drawings.too_wide) == {name for name, width in widths.items() if width == WIDTH}


def test_fits_without_a_search_have_no_convergence(folder):
    keep_only(folder, "convergence")
    table = pd.read_csv(folder / "convergence.csv")
    fitted = table["case"] == "GB1"
    table.assign(mean=table["mean"].mask(fitted)).to_csv(folder / "convergence.csv", index=False)
    ax = Figures(folder, "x", False).plan["convergence"].draw().axes[0]
    assert [line.get_label().split()[0] for line in ax.lines if line.get_linewidth() > 1.5] == ["GB2"]
    table.assign(mean=np.nan).to_csv(folder / "convergence.csv", index=False)
    assert "convergence" not in Figures(folder, "x", False).plan


def test_intervals_of_one_side_are_drawn_from_a_folder_as_its_table_has_them(folder, parameters):
    """Of a parameter that a constraint or a limit holds: not two standard deviations to either side."""
    best = parameters["case"] == "GB2"
    low = parameters["lower"] + 0.25 * (parameters["upper"] - parameters["lower"])
    high = parameters["lower"] + 0.5 * (parameters["upper"] - parameters["lower"])
    parameters.assign(low=low, high=high, std=1e3).to_csv(folder / "parameters.csv", index=False)
    with style():
        figure = Figures(folder, "", False).plan["parameters"].draw()
    (drawn,) = [marks for marks in figure.axes[0].collections if marks.get_gid() == "posterior"]
    assert len(drawn.get_segments()) == best.sum() > 1
    for segment in drawn.get_segments():
        assert segment[:, 0] == pytest.approx([0.25, 0.5])
