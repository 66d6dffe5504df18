"""What stands first on the page agrees with the tables; the page of an extended study names what was added."""

import json
import re

import pandas as pd
import pytest

from calib.report.html import answer
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import page_summary
from calib.report.html.write import page, sections
from calib.report.numbers import with_unit
from tests.report.html.page_blocks import Picture, Table, section_blocks

TITLE = "A mast that may lack something"


@pytest.mark.medium
def test_the_picture_of_the_place_is_the_first_figure_and_shows_what_is_named(everything, read, blocks):
    assert read.named("figure")[0]["id"] == "answer"
    picture = blocks(everything, Picture)["answer"]
    assert "star: guy" in picture.alt
    size = pd.read_csv(everything / "effects.csv").set_index("name").loc["guy", "magnitude"]
    (row,) = blocks(everything, Table)["How much"].rows
    told = float(re.match(r"[\d.]+", row[1].replace(" ", ""))[0])
    assert told == pytest.approx(size, rel=1e-3)
    afterwards = blocks(everything, Table)["Parameters, calibrated without and with guy"]
    (own,) = [row for row in afterwards.rows if row[0] == "guy"]  # all that are counted as identified are listed
    assert own[2] == "N/m" and float(own[7]) == pytest.approx(size, rel=1e-3)  # and the magnitude is the one above


@pytest.mark.medium
def test_doubts_are_numbered_each_with_its_check(everything, results, text):
    stored = json.loads((everything / "explanation.json").read_text())["doubts"]
    assert stored
    body = text[text.index('<section id="doubts"') :]
    body = body[: body.index("</section>")]
    assert body.count("<li>") == body.count(">Check:<") == len(answer.doubts(results)) >= len(stored)
    assert [doubt for doubt, _ in answer.doubts(results)[: len(stored)]] == [one["doubt"] for one in stored]


@pytest.mark.medium
def test_a_test_order_keeps_the_case_of_units_and_names(everything, folder):
    steps = pd.read_csv(everything / "test_order.csv")
    row = {"step": 1, "kind": "mode", "what": "mode K1", "excite": "at K1", "sensors": "1x", "how": "band 1 to 2 Hz"}
    pd.DataFrame([row | {"narrows": "width of K"}], columns=steps.columns).to_csv(
        folder / "test_order.csv", index=False
    )
    (order,) = [one for one in sections(StudyResults(folder, TITLE, True)) if one.name == "order"]
    for words in ("mode K1", "at K1", "band 1 to 2 Hz", "width of K"):
        assert words in order.body


@pytest.mark.medium
def test_a_mode_that_an_effect_adds_and_nobody_measured_is_a_doubt(folder):
    added = json.loads((folder / "added.json").read_text())
    own = {"effect": "guy", "natural_freq": 20.0, "share": 0.8, "paired": ""}
    (folder / "added.json").write_text(json.dumps({**added, "own_modes": [own, {**own, "paired": "B1"}]}))
    found = [check for doubt, check in answer.doubts(StudyResults(folder, TITLE, True)) if "adds a mode" in doubt]
    assert len(found) == 1 and "18 Hz" in found[0] and "22 Hz" in found[0]


@pytest.mark.medium
def test_without_an_explanation_the_errors_of_all_modes_stand_first(folder):
    for name in ("explanation.json", *(file.name for file in folder.glob("added*"))):
        (folder / name).unlink()
    first, *others = sections(StudyResults(folder, TITLE, True))
    assert first.name == "afterwards" and not first.folded
    assert [b.name for b in section_blocks(first) if isinstance(b, Picture)] == ["comparison"]
    assert all(one.folded for one in others if one.name != "not_run")


@pytest.mark.medium
def test_a_comparison_alone_stands_open(folder):
    for name in ("explanation.json", "parameters.csv", "verdicts.csv", *(f.name for f in folder.glob("added*"))):
        (folder / name).unlink()
    shown = sections(StudyResults(folder, TITLE, True))
    assert [one.name for one in shown if not one.folded] == ["compared", "not_run"]


@pytest.mark.medium
def test_the_page_of_an_extended_study_names_what_was_added_and_links_to_the_first(everything):
    own = everything.parent / f"{everything.name}_extended"
    extended = StudyResults(own, f"{TITLE} + guy", True)
    summary = page_summary(extended)
    r = pd.read_csv(own / "verdicts.csv").set_index("parameter").loc["guy"]
    assert f"guy, about {with_unit(r['value'], r['unit'], 2)} (± " in summary.found
    assert (own / summary.first).resolve() == (everything / "report.html").resolve()
    assert f'href="{summary.first}"' in page(extended)
    assert page_summary(StudyResults(everything, TITLE, True)).first == ""
    captions = [b.caption for s in sections(extended) for b in section_blocks(s) if isinstance(b, Table)]
    assert "Errors of the model with guy, calibrated" in captions
