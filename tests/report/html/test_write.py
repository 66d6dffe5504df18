"""The whole page: its sections, that it is self-contained, escaping, and writing."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.report.html import write
from calib.report.html.study_results import StudyResults
from calib.report.html.write import LONGEST, page, sections, write_report
from tests.report.html.page_blocks import Picture, Table, Viewer, section_blocks

TITLE = "A mast that may lack something"
OPEN = ["place", "order", "afterwards", "doubts"]
WHOLE = [
    *OPEN, "measured", "compared", "fails", "sensitivity", "calibrated", "pulled", "effects", "verdict", "suspect",
    "added", "next", "errors", "candidate_fits", "assumptions", "versions",
]  # fmt: skip


# -- sections ----------------------------------------------------------------------------------------------------------


def test_every_analysis_has_its_section_in_order(read):
    assert [a["id"] for a in read.named("section")] == WHOLE
    assert [a["href"] for a in read.named("a") if "download" not in a] == [f"#{name}" for name in WHOLE]
    assert len(read.named("h1")) == 1 and len(read.named("h2")) == len(WHOLE)


def test_the_verdict_and_what_is_synthetic_come_before_any_section(everything, text, reader):
    top = reader(text[: text.index("<section")]).text
    assert json.loads((everything / "explanation.json").read_text())["sentences"][0] in top
    assert "Synthetic measurement" in top


def test_the_answer_stands_open_and_all_else_is_folded(read, text):
    folded = [a["id"] for a in read.named("section") if a.get("class") == "folded"]
    assert folded == [name for name in WHOLE if name not in OPEN]
    for name in WHOLE:
        body = text[text.index(f'<section id="{name}"') :]
        assert body[body.index(">") + 1 :].lstrip().startswith("<details>") == (name in folded), name


@pytest.mark.slow
def test_a_measured_structure_is_not_called_synthetic(everything, reader):
    assert "ynthetic" not in reader(page(StudyResults(everything, TITLE, False))).text


@pytest.mark.medium
@pytest.mark.parametrize(
    ("gone", "section", "command"),
    [
        (
            [
                "selection",
                "sensitivity",
                "partial",
                "variance_share",
                "input_correlation",
                "prognosis",
                "prognosis_inputs",
                "sensitivity_samples",
            ],
            "sensitivity",
            "calib sensitivity",
        ),
        (["parameters"], "calibrated", "calib calibrate"),
        (["explanation"], "verdict", "calib explain"),
        (["comparison_before"], "compared", "calib compare"),
    ],
)
def test_an_analysis_that_was_not_run_is_omitted_and_its_command_named(folder, gone, section, command):
    for name in gone:
        for suffix in ("csv", "json"):
            (folder / f"{name}.{suffix}").unlink(missing_ok=True)
    *shown, last = sections(StudyResults(folder, TITLE, True))
    also = ("place", "order", "doubts") if section == "verdict" else ()
    assert [s.name for s in shown] == [n for n in WHOLE if n not in (section, *also)] and last.name == "not_run"
    assert any(f"{command} mast" in words.text for words in section_blocks(last))


@pytest.mark.medium
def test_every_section_depends_on_its_own_tables_alone(folder):
    for name in ("pulls", "effects", "next_measurement", "candidate_fits"):
        (folder / f"{name}.csv").unlink()
    shown = [s.name for s in sections(StudyResults(folder, TITLE, True))]
    assert shown == [n for n in WHOLE if n not in ("pulled", "effects", "next", "candidate_fits")]


@pytest.mark.slow
def test_a_study_without_a_library_is_not_advised_to_explain(folder):
    (folder / "explanation.json").unlink()
    record = json.loads((folder / "record.json").read_text())
    (folder / "record.json").write_text(json.dumps({**record, "effects_known": 0}))
    left = [n for n in WHOLE if n not in ("verdict", "place", "order", "doubts")]
    assert [s.name for s in sections(StudyResults(folder, TITLE, True))] == left


@pytest.mark.medium
def test_results_without_a_record_are_shown_as_far_as_possible(folder):
    for name in ("record.json", "measured.csv", "sensors.csv"):
        (folder / name).unlink()
    shown = [s.name for s in sections(StudyResults(folder, TITLE, False))]
    assert shown == [n for n in WHOLE if n not in ("measured", "versions")]


@pytest.mark.medium
def test_a_model_is_shown_whether_or_not_shapes_were_measured(folder, blocks):
    sensors = pd.read_csv(folder / "sensors.csv")
    used = (~sensors["held_out"]).sum()
    assert f"the {used} sensors" in blocks(folder, Picture)["model"].alt and used < len(sensors)
    for name in ("sensors", "shapes_before", "shapes_after"):
        (folder / f"{name}.csv").unlink()
    assert "model_places" in blocks(folder, Picture)


@pytest.mark.slow
def test_scalar_responses_have_neither_modes_nor_shapes(scalar, reader):
    found = reader(page(StudyResults(scalar, "Five masses", True)))
    names = [a["id"] for a in found.named("section")]
    assert {"measured", "compared", "fails", "effects", "verdict", "errors"} <= set(names)
    assert not found.named("select") and "EMAC" not in found.text
    table = pd.read_csv(scalar / "comparison_before.csv")
    rows = found.tables["Every response, before calibration"][1:]
    assert [r[0] for r in rows] == list(table["response"])
    np.testing.assert_allclose([reader.number(r[3]) for r in rows], 100 * table["error"], atol=0.00501)


def test_versions_seeds_and_times_of_every_analysis_are_shown(everything, read):
    record = json.loads((everything / "record.json").read_text())
    rows = read.tables["Analyses run"][1:]
    assert [r[0] for r in rows] == [f"calib {analysis}" for analysis in record["analyses"]]
    assert f"numpy {np.__version__}" in read.text
    assert any("A1 1" in r[3] for r in rows)


@pytest.mark.slow
def test_adopted_values_are_shown(folder):
    record = json.loads((folder / "record.json").read_text())
    (folder / "record.json").write_text(json.dumps({**record, "adopted": {"E": 205.25}, "adopted_from": "../older"}))
    shown = next(s for s in sections(StudyResults(folder, TITLE, True)) if s.name == "versions")
    told = [getattr(block, "text", "") for block in section_blocks(shown)]
    assert "Adopted from the study ../older and held fixed: E 205.25." in told


@pytest.mark.slow
def test_until_something_is_added_the_errors_are_those_of_the_explanation(folder, reader, blocks):
    for file in folder.glob("added*"):
        file.unlink()
    *shown, last = sections(StudyResults(folder, TITLE, True))
    assert [s.name for s in shown] == [n for n in WHOLE if n != "added"] and last.name == "not_run"
    assert any("calib run mast" in words.text for words in section_blocks(last))
    errors = pd.read_csv(folder / "errors.csv")
    rows = blocks(folder, Table)["Errors before and after adding guy"].rows
    np.testing.assert_allclose([reader.number(r[3]) for r in rows], errors["rms"], atol=0.00501)


@pytest.mark.slow
def test_the_reason_for_adding_no_effect_is_shown(folder, reader):
    for file in folder.glob("added*"):
        file.unlink()
    (folder / "added.json").write_text('{"sentence": "None of them is added.", "conclusion": "", "effects": []}')
    read = reader(page(StudyResults(folder, TITLE, True)))
    assert "None of them is added." in read.text and "errors" in [a["id"] for a in read.named("section")]


# -- one file, nothing beside it ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("painted", ["some", pytest.param("all", marks=pytest.mark.slow)])
def test_nothing_is_loaded_from_anywhere(everything, read, reader, painted):
    if painted == "all":
        read = reader(page(StudyResults(everything, TITLE, True)))
    assert {"path", "use", "image"} <= {name for name, _ in read.elements}  # there are figures to look into
    assert not read.named("link") and not read.named("iframe") and not read.named("object")
    for _, attributes in read.elements:
        assert "src" not in attributes and attributes.get("href", "#").startswith(("#", "data:text/csv;charset=utf-8,"))
        assert not any(name.startswith("on") for name in attributes)
    style = "".join(read.styles)
    assert "@import" not in style and "url(" not in style
    own = [content for kind, content in read.scripts if kind != "application/json"]
    assert len(own) == 4
    for content in own:
        code = "".join(content).replace("http://www.w3.org/1999/xhtml", "")  # the name of a namespace
        assert not re.search(r"https?:|import\s*\(|fetch\(|eval\(|new (Function|Worker)\b", code)
    assert "three.js authors" in "".join(own[1])  # its licence wants the notice
    policy = next(a["content"] for a in read.named("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy and "http" not in policy and "form-action 'none'" in policy


def test_every_figure_has_a_text_alternative_and_a_caption(everything, read, blocks):
    figures = blocks(everything, (Picture, Viewer))
    assert len(read.named("figure")) == len(figures) == len(read.named("figcaption")) > 12
    drawings = [a for a in read.named("div") if a.get("class") == "drawing"]
    assert len(drawings) == len(figures)
    for name, figure in figures.items():
        assert len(figure.alt) > 20 and figure.caption.endswith("."), name
        assert "nan" not in figure.alt and "None" not in figure.alt, name
        more = {"tabindex": "0"} if name == "viewer" else {}
        assert {"role": "img", "aria-label": figure.alt, "class": "drawing", **more} in drawings


@pytest.mark.medium
def test_every_table_has_a_caption_heads_and_as_many_cells(everything, scalar, blocks):
    for folder in (everything, scalar):
        for caption, table in blocks(folder, Table).items():
            assert caption and table.rows, caption
            assert {len(row) for row in table.rows} == {len(table.heads)}, caption
            assert all("nan" not in cell for row in table.rows for cell in row), caption


def test_long_tables_and_further_matrices_are_folded_and_only_they(everything, read, blocks):
    tables, pictures = blocks(everything, Table), blocks(everything, Picture)
    long = [caption for caption, table in tables.items() if table.folded]
    assert all(len(tables[caption].rows) > LONGEST for caption in long)
    folded = [name for name, picture in pictures.items() if picture.folded]
    assert long and folded == ["sensitivity", "variance_share"]
    sections = [a for a in read.named("section") if a.get("class") == "folded"]
    assert len(read.named("details")) == len(long) + len(folded) + len(sections)


# -- escaping ----------------------------------------------------------------------------------------------------------

ODD = "</script><script>alert(\"1\")</script> & <b>'x'</b>"


@pytest.mark.slow
def test_names_are_shown_literally_whatever_characters_they_have(folder, reader):
    for file in folder.iterdir():
        if file.is_file() and file.name not in (
            "measured.csv",
            "comparison_before.csv",
            "mac_before.csv",
            "sensors.csv",
            "record.json",
        ):
            file.unlink()
    usual = reader(page(StudyResults(folder, TITLE, True)))
    mode = pd.read_csv(folder / "comparison_before.csv")["mode"].iloc[0]
    quoted = '"' + ODD.replace('"', '""') + '"'
    for file in [*folder.glob("*.csv")]:
        lines = file.read_text().splitlines(keepends=True)
        lines = [re.sub(rf"(?m)(^|,){mode}(,)", lambda m: m[1] + quoted + m[2], line) for line in lines]
        file.write_text("".join(lines))
    found = reader(page(StudyResults(folder, ODD, True)))
    assert len(found.elements) == len(usual.elements) and len(found.named("b")) == 0
    assert ODD in found.words[found.words.index(ODD)] and any(row[0] == ODD for row in found.tables["Measured modes"])
    for kind, content in found.scripts:
        if kind == "application/json":
            json.loads("".join(content))


# -- writing -----------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_the_page_is_written_beside_its_tables_and_is_the_same_each_time(folder):
    path = write_report(StudyResults(folder, TITLE, True)).path
    assert path == folder / "report.html"
    assert path.read_text(encoding="utf-8") == page(StudyResults(folder, TITLE, True))
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]


@pytest.mark.medium
def test_an_interruption_while_writing_leaves_the_old_page(folder, monkeypatch):
    path = write_report(StudyResults(folder, TITLE, True)).path
    old = path.read_bytes()
    monkeypatch.setattr(write, "page", lambda *given: "a new page")
    write_text = type(path).write_text

    def stop(self, content, **options):
        write_text(self, content[:3], **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(type(path), "write_text", stop)
    with pytest.raises(KeyboardInterrupt):
        write_report(StudyResults(folder, TITLE, True))
    assert path.read_bytes() == old and not [p for p in folder.iterdir() if p.name.startswith(".")]


@pytest.mark.medium
def test_every_figure_of_the_page_is_a_step_of_its_progress(everything, blocks):
    steps = []
    page(StudyResults(everything, TITLE, True), lambda stage, done, total: steps.append((done, total)))
    count = len(blocks(everything, Picture))
    assert count > 12 and steps == [(k, count) for k in range(count)]


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [("measured.csv", "natural_freq", "frequency"), ("effects.csv", "True", "maybe"), ("record.json", "{", "")],
)
def test_a_damaged_table_is_named_and_nothing_is_written(folder, name, old, new):
    file = folder / name
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=re.escape(name)):
        write_report(StudyResults(folder, TITLE, True))
    assert not (folder / "report.html").exists()


def test_a_missing_folder(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        write_report(StudyResults(tmp_path / "nowhere", TITLE, False))


def test_an_empty_folder_names_the_commands_to_run(tmp_path, reader):
    found = reader(page(StudyResults(tmp_path, TITLE, False)))
    assert [a["id"] for a in found.named("section")] == ["not_run"]
    assert "No comparison has been run yet." in found.text
