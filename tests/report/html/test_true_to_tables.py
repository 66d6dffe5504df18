"""The numbers, sentences and figures of the page are those of the tables beside it."""

import html
import json
import re

import numpy as np
import pandas as pd
import pytest

from calib.report.html.study_results import StudyResults
from calib.report.html.write import page, sections
from calib.report.numbers import fixed, percent, with_unit
from calib.report.verification import GROUPS
from tests.report.html.page_blocks import Picture, Table, Words, page_blocks, section_blocks


@pytest.mark.medium
def test_measured_modes_are_those_of_the_table(everything, read, reader):
    table = pd.read_csv(everything / "measured.csv")
    rows = read.tables["Measured modes"][1:]
    assert [r[0] for r in rows] == list(table["mode"])
    np.testing.assert_allclose([reader.number(r[1]) for r in rows], table["natural_freq"], atol=0.000501)
    np.testing.assert_allclose([reader.number(r[2]) for r in rows], table["freq_std"], atol=0.000501)
    assert [r[-1] for r in rows] == ["validation" if held else "fitted" for held in table["held_out"]]


@pytest.mark.parametrize("stage", ["before", "after"])
def test_compared_modes_are_those_of_the_table(everything, read, stage, reader):
    table = pd.read_csv(everything / f"comparison_{stage}.csv")
    caption = "Mode by mode before calibration" if stage == "before" else "The model calibrated without guy (case A1)"
    head, *rows = read.tables[caption]
    assert [r[0] for r in rows] == list(table["mode"])
    for column, name, factor, tolerance in (
        ("model mode", "model_mode", 1, 0),
        ("measured, Hz", "natural_freq_measured", 1, 6e-4),
        ("model, Hz", "natural_freq_model", 1, 6e-4),
        ("error, %", "freq_error", 100, 6e-3),
        ("MAC", "mac", 1, 6e-4),
        ("margin", "margin", 1, 6e-4),
    ):
        cells = [reader.number(r[head.index(column)]) for r in rows]
        np.testing.assert_allclose(cells, factor * table[name], atol=tolerance, err_msg=column)


def points(words):
    """Points of a cell such as ``(+1.00, +0.50, −2.00), (+1.00, +0.50, +2.00)``; every number but 0.00 has its sign."""
    numbers = re.findall(r"[+−]\d+\.\d\d|\b0\.00", words)
    assert not {"+0.00", "−0.00"} & set(numbers)
    return np.array([float(n.replace("−", "-")) for n in numbers]).reshape(-1, 3)


def test_the_place_of_every_local_perturbation_stands_beside_it(everything, read):
    known = pd.read_csv(everything / "perturbations.csv").set_index("perturbation")
    (table,) = [rows for caption, rows in read.tables.items() if caption.startswith("Local stiffness or mass changes")]
    assert len(table) > 3
    for row in table[1:]:
        np.testing.assert_allclose(points(row[4]), [known.loc[row[0], ["x", "y", "z"]].astype(float)], atol=0.00501)


def test_effects_errors_and_candidate_fits_are_those_of_the_tables(everything, read, reader):
    effects = pd.read_csv(everything / "effects.csv").set_index("name")
    head, *rows = read.tables["Every listed effect, ranked"]
    assert {r[1] for r in rows} == set(effects.index)
    for row in rows:
        assert reader.number(row[head.index("z")]) == pytest.approx(effects["z"][row[1]], abs=0.0501)
        assert reader.number(row[head.index("evidence")]) == pytest.approx(effects["ln_bayes"][row[1]], abs=0.0501)
    about = {r[0]: tuple(r[1:]) for r in read.tables["Description of the effects"][1:]}
    acts = pd.read_csv(everything / "effect_places.csv").set_index("effect")
    for name, row in effects.iterrows():
        lacks, look_for, at = about.pop(row["title"])
        assert (lacks, look_for) == (row["lacks"], row["look_for"])
        np.testing.assert_allclose(points(at), acts.loc[[name]], atol=0.00501)
    assert not about
    errors = pd.read_csv(everything / "added_errors.csv")
    rows = read.tables["Errors before and after adding guy, both models calibrated"][1:]
    for k, stage in enumerate(("before", "after")):
        own = errors[errors["stage"] == stage]
        np.testing.assert_allclose([reader.number(r[2 + k]) for r in rows], own["rms"], atol=0.00501)
        np.testing.assert_allclose([reader.number(r[4 + k]) for r in rows], own["expected"], atol=0.00501)
    fits = pd.read_csv(everything / "candidate_fits.csv")
    assert [r[0] for r in read.tables["Candidate fits"][1:]] == list(fits["effects"].fillna("none"))


def test_the_added_effect_is_reported_by_parameter_and_by_mode(everything, text, read, reader):
    found = pd.read_csv(everything / "added_parameters.csv").set_index("parameter")
    head, *rows = read.tables["Parameters, calibrated without and with guy"]
    assert [r[0] for r in rows] == list(found.index) and "guy" in found.index
    assert head[4] == "without" and head[7] == "with guy"
    for row in rows:
        assert found["added"][row[0]] == (row[0] == "guy")
        assert found["added"][row[0]] or "–" not in (row[3], row[4])
        assert reader.number(row[7]) == pytest.approx(found["after"][row[0]], rel=6e-4)
        assert (row[9] == "yes") == found["after_identified"][row[0]]
    compared = pd.read_csv(everything / "comparison_added.csv").set_index("mode")
    head, *rows = read.tables["Mode by mode, calibrated with guy"]
    for row in rows:
        assert reader.number(row[head.index("MAC")]) == pytest.approx(compared["mac"][row[0]], abs=0.00051)
        assert reader.number(row[head.index("error, %")]) == pytest.approx(
            100 * compared["freq_error"][row[0]], abs=0.00501
        )
    assert [r[0] for r in rows] == list(compared.index)
    moved = found[(found["after"] - found["before"]).abs() > 2 * found["before_std"]].index
    (words,) = [w for w in read.text.split("standard deviations: ") if w.startswith(f"{moved[0]} ")]
    words = words[: words.index("). ")]
    assert [w.split()[0] for w in words.split("; ")] == list(moved) and "guy" not in words
    modes = pd.read_csv(everything / "added_modes.csv")
    ((head, *rows),) = (t for name, t in read.tables.items() if name.startswith("Every measured mode, validation"))
    assert [r[1] for r in rows] == ["validation" if held else "fitted" for held in modes["held_out"]]
    for stage, words in (("initial", "nominal"), ("before", "without guy"), ("after", "with guy")):
        cells = [reader.number(r[head.index(f"error {words}, %")]) for r in rows]
        np.testing.assert_allclose(cells, 100 * modes[f"error_{stage}"], atol=0.00501)
    top = " ".join(reader(text[: text.index("<section")]).text.split())
    conclusion = json.loads((everything / "added.json").read_text("utf-8"))["conclusion"]
    assert conclusion.startswith("With the effect the model fits better and predicts ")
    assert conclusion.replace(" -> ", " → ") in top
    assert (
        "0.03 % (a perfect model: 0.16 %)" in top
    )  # the standard deviation of each frequency is 0.2 %: 0.2 sqrt(2/pi)
    rms = pd.read_csv(everything / "added_errors.csv").set_index(["group", "stage"])["rms"]
    errors = [f"{rms['held_out_modes', stage]:.2f}" for stage in ("before", "after")]
    assert f"error in validation modes {errors[0]} → {errors[1]} σ" in top


def test_the_sentences_are_those_in_the_record(everything, read):
    told = [s.replace("->", "→") for s in json.loads((everything / "explanation.json").read_text())["sentences"]]
    record = json.loads((everything / "record.json").read_text())
    sure = record["analyses"]["explain"]["answer"]["sure"]
    assert sure in told and all(" ".join(s.split()) in read.text for s in told)
    assert read.text.count(" ".join(sure.split())) == 1  # at the top, and not again beside the verdict
    for analysis in ("compare", "sensitivity", "calibrate", "extend"):
        sentences = record["analyses"][analysis]["sentences"]
        assert sentences and all(" ".join(s.replace("->", "→").split()) in read.text for s in sentences)


@pytest.mark.medium
def test_figures_show_the_tables(everything, blocks, painted):
    pictures, figures = blocks(everything, Picture), StudyResults(everything, "", True).figures
    assert set(pictures) <= set(figures.plan) and len(pictures) > 12
    for name, picture in pictures.items():
        assert picture.tables and all((everything / f"{table}.csv").is_file() for table in picture.tables), name
    words = hovers(figures.svg("comparison"))
    told = {"before": "nominal values", "after": "calibrated without guy", "added": "calibrated with guy"}
    for stage, model in told.items():
        for row in pd.read_csv(everything / f"comparison_{stage}.csv").to_dict("records"):
            assert f"{row['mode']}, {model}: {percent(row['freq_error'], 2, sign=True)} %" in words
            assert f"{row['mode']}, {model}: MAC {fixed(row['mac'], 3)}" in words
    mac, cells = pd.read_csv(everything / "mac_before.csv").set_index("mode"), hovers(figures.svg("mac_before"))
    assert set(cells) >= {f"{m}, model mode {c}: {fixed(mac.loc[m, c], 3)}" for m in mac.index for c in mac}
    drawn = hovers(figures.svg("added_errors"))
    for row in pd.read_csv(everything / "added_errors.csv").to_dict("records"):
        label = GROUPS.get(row["group"], row["group"])
        assert any(w.startswith(label) and f": {fixed(row['rms'], 2)} σ" in w for w in drawn), label
    drawn = hovers(figures.svg("ranked_effects"))
    for row in pd.read_csv(everything / "effects.csv").to_dict("records"):
        assert any(w.startswith(f"{row['name']}: evidence {fixed(row['ln_bayes'], 1)}") for w in drawn)


def hovers(svg):
    """Words under the mouse."""
    return [html.unescape(words) for words in re.findall(r"<title>(.*?)</title>", svg)]


@pytest.mark.medium
def test_effects_that_are_not_visible_are_grey(folder, blocks):
    effects = pd.read_csv(folder / "effects.csv")
    effects["visible"] = effects["name"] != "lamp"
    effects.to_csv(folder / "effects.csv", index=False)
    table = blocks(folder, Table)["Every listed effect, ranked"]
    (k,) = table.grey
    assert table.rows[k][1] == "lamp" and "not visible at a plausible magnitude of" in table.rows[k][-1]


@pytest.mark.medium
def test_a_group_of_data_that_one_stage_lacks_has_a_dash(folder, blocks):
    errors = pd.read_csv(folder / "added_errors.csv")
    lost = (errors["group"] == "held_out_sensors") & (errors["stage"] == "after")
    errors[~lost].to_csv(folder / "added_errors.csv", index=False)
    rows = {
        row[0]: row for row in blocks(folder, Table)["Errors before and after adding guy, both models calibrated"].rows
    }
    (own,) = (row for label, row in rows.items() if "validation sensors" in label)
    assert lost.sum() == 1 and own[3] == "–" and own[2] != "–"


def test_one_matrix_of_the_sensitivity_is_open_and_the_others_tell_where_they_differ(everything, text, reader, blocks):
    pictures = blocks(everything, Picture)
    assert not pictures["partial"].folded
    first = pd.read_csv(everything / "partial.csv").set_index("parameter").abs()
    for name in ("sensitivity", "variance_share"):
        table = pd.read_csv(everything / f"{name}.csv").set_index("parameter").abs()
        apart = (table - first).abs().stack()
        parameter, response = apart.idxmax()
        told = f"{fixed(table.loc[parameter, response], 2)} instead of {fixed(first.loc[parameter, response], 2)}"
        assert f"{parameter} on " in pictures[name].folded and pictures[name].folded.endswith(told)
        inside = text[text.rindex("<details>", 0, text.index(f'<figure id="{name}"')) :]
        assert inside.index(f'<figure id="{name}"') < inside.index("</details>")


@pytest.mark.slow
def test_a_mode_of_an_added_effect_is_told_in_the_section_of_that_model(folder):
    def told():
        return [
            (section.name, block.text)
            for section in sections(StudyResults(folder, "", True))
            for block in section_blocks(section)
            if isinstance(block, Words) and "of its own" in block.text
        ]

    found = json.loads((folder / "added.json").read_text())
    assert found["own_modes"] == [] and found["own"] == "" and told() == []  # a guy rope has no mass
    own = "guy brings a mode of its own at 3 Hz."
    (folder / "added.json").write_text(json.dumps({**found, "own": own}))
    assert told() == [("added", own)]


@pytest.mark.medium
def test_the_axes_stand_with_the_places_of_the_effects_as_the_model_names_them(folder, blocks):
    file = folder / "record.json"
    record = json.loads(file.read_text("utf-8"))
    assert record["axes"] == ""  # the mast's model names none
    for axes, words in (("x to the bow, z to port", "x to the bow, z to port"), ("", "x along, y up, z across")):
        file.write_text(json.dumps(record | {"axes": axes}))
        every = page_blocks(StudyResults(folder, "", True))
        (k,) = [k for k, b in enumerate(every) if isinstance(b, Table) and b.caption == "Description of the effects"]
        assert every[k - 1] == Words(f"Axes: {words}.") and "acts at (x, y, z), m" in every[k].heads


def test_what_narrows_the_named_effect_has_a_table_of_its_own(everything, blocks):
    table = blocks(everything, Table)["Candidate measurements for guy, best first"]
    candidates = pd.read_csv(everything / "next_measurement.csv")
    own = candidates[candidates["effect"] == "guy"].sort_values("gain", ascending=False, kind="stable")
    assert [row[0] for row in table.rows] == own["measurement"].tolist()[: len(table.rows)] and len(table.rows) == 5
    assert [row[3].split()[1] for row in table.rows] == [fixed(gain, 2) for gain in own["gain"].head(5)]
    guy = pd.read_csv(everything / "effects.csv").set_index("name").loc["guy"]
    width = guy["magnitude_high"] - guy["magnitude_low"]
    for row, gain in zip(table.rows, own["gain"].head(5), strict=True):
        now, then = (with_unit(size, guy["unit"], 2) for size in (width, width / gain))
        assert row[-1] == f"{now} wide, then about {then}"
    assert not table.folded


def test_held_out_sensors_are_a_candidate_to_be_used(everything):
    candidates, sensors = (pd.read_csv(everything / f"{name}.csv") for name in ("next_measurement", "sensors"))
    held = sensors.loc[sensors["held_out"], "sensor"]
    own = candidates[candidates["kind"] == "sensor"]["measurement"].unique()
    assert [name for name in own if "validation" in name] == [f"sensors {', '.join(held)}, validation data so far"]


@pytest.mark.medium
def test_the_limits_of_the_search_are_told_beside_those_of_the_sensitivity(folder, reader):
    space = pd.read_csv(folder / "parameter_space.csv")
    space.loc[0, ["lower", "upper", "search_lower", "search_upper"]] = 11.0, 12.0, 1.0, 22.0
    space.loc[1, ["search_lower", "search_upper"]] = np.nan
    space.loc[1, "distribution"] = "fixed"
    space.to_csv(folder / "parameter_space.csv", index=False)
    head, *rows = reader(page(StudyResults(folder, "mast", True))).tables["Parameters of the model"]
    sensitivity, search = (head.index(name) for name in ("limits of the sensitivity", "search limits"))
    assert (rows[0][sensitivity], rows[0][search]) == ("11 to 12", "1 to 22")
    assert rows[1][sensitivity] == rows[1][search] == "held"
    space.drop(columns=["search_lower", "search_upper"]).to_csv(folder / "parameter_space.csv", index=False)
    assert "limits" in reader(page(StudyResults(folder, "mast", True))).tables["Parameters of the model"][0]


def test_every_comparison_has_its_own_limit_beside_it(everything, read, reader):
    known = pd.read_csv(everything / "where_it_fails_added.csv")
    (rows,) = [t for caption, t in read.tables.items() if caption.startswith("Every comparison in standard deviations")]
    at = rows[0].index("its limit, σ")
    found = [reader.number(row[at]) for row in rows[1:] if row[at] != "–"]
    np.testing.assert_allclose(found, known["limit"].dropna(), atol=0.00501)
    assert known["limit"].nunique() > 1
