"""The section on proposals says what the tables say."""

import json

import pandas as pd
import pytest

from calib.hypotheses.proposals.words import COLUMNS, PLACES
from calib.report.html.study_results import StudyResults
from calib.report.html.write import sections
from calib.report.tables import CurrentFolder
from tests.report.html.page_blocks import Table, Words, section_blocks

ANSWER = {"found": "Proposed: a mass.", "sure": "Ln Bayes 20.", "then": "Look there."}


@pytest.fixture
def folder(tmp_path):
    rows = [
        (1, "hung", "hung mass", "sensor 3y", 1.0, 0.0, 0.0, 12.5, 11.0, 14.0, "kg", 7.25, 18.0, 20.0, 9.0, 7, True, "",
         "mass of a; mass of b; mass of c; mass of d", "A mass on a spring"),
        (2, "soft", "stiffness", "beam", 2.0, 0.0, 0.0, -25.0, -30.0, -20.0, "%", None, 8.0, 9.0, 5.0, 3, False,
         "K has a pull of 4", "", "Stiffness of beam"),
    ]  # fmt: skip
    pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(tmp_path / "proposals.csv", index=False)
    places = [(1, "hung mass", "sensor 3y", True, True, 18.0, 1.0, 0.0, 0.0)]
    pd.DataFrame(places, columns=list(PLACES)).to_csv(tmp_path / "proposal_places.csv", index=False)
    (tmp_path / "proposals.json").write_text(json.dumps({"sentences": ["Not tried: a mount (no convergence)."]}))
    record = {"study": "s", "analyses": {"propose": {"answer": ANSWER}}}
    (tmp_path / "record.json").write_text(json.dumps(record))
    return tmp_path


def section(folder):
    return {s.name: s for s in sections(StudyResults(CurrentFolder(folder, frozenset()), "title", True))}.get(
        "proposals"
    )


def test_it_has_the_answer_what_was_not_tried_and_every_proposal(folder):
    found = section_blocks(section(folder))
    words = [block.text for block in found if isinstance(block, Words)]
    assert words == [ANSWER["found"], ANSWER["sure"], "Not tried: a mount (no convergence).", ANSWER["then"]]
    (table,) = [block for block in found if isinstance(block, Table)]
    assert [row[:2] for row in table.rows] == [("1", "A mass on a spring"), ("2", "Stiffness of beam")]
    assert table.rows[0][2] == "12.5 kg (11 to 14), at 7.25 Hz" and table.rows[0][6:8] == (
        "yes", "mass of a; mass of b; mass of c …",
    )  # fmt: skip
    assert table.rows[1][2] == "−25 % (−30 to −20)"
    assert table.rows[1][3:7] == ("9.0", "3", "8.0", "no") and table.rows[1][8] == "K has a pull of 4"


def test_without_a_proposal_the_reason_stands_alone(folder):
    for name in ("proposals", "proposal_places"):
        pd.read_csv(folder / f"{name}.csv").iloc[:0].to_csv(folder / f"{name}.csv", index=False)
    assert all(isinstance(block, Words) for block in section_blocks(section(folder)))


def test_there_is_no_section_before_proposals_were_sought(folder):
    (folder / "record.json").write_text(json.dumps({"study": "s", "analyses": {}}))
    assert section(folder) is None
