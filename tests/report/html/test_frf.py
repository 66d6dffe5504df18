"""The page of a study of FRFs: its sections hold the numbers of the tables."""

import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest

from calib.report.html.study_results import StudyResults
from calib.study.loading import module_of
from tests.report.html.page_blocks import Picture, Table, Words, page_blocks

WORLD = module_of(Path(__file__).resolve().parents[2] / "template/frf_chain.py")


@pytest.fixture(scope="module")
def chain(run, tmp_path_factory):
    """Results of a chain on a spring that its model lacks."""
    folder = WORLD.write_study(tmp_path_factory.mktemp("frf") / "chain", ground=WORLD.HIDDEN)
    return run(folder, ["compare"], ["calibrate"])


@pytest.fixture
def blocks(chain):
    return page_blocks(StudyResults(chain, "chain", True))


def tables(blocks):
    return {block.caption: block for block in blocks if isinstance(block, Table)}


def number(cell):
    return float(cell.replace("−", "-"))


@pytest.mark.medium
def test_every_measured_function_is_told_with_its_use(chain, blocks):
    found = tables(blocks)["Every measured FRF"]
    expected = pd.read_csv(chain / "measured.csv")
    names = (expected["response"] + "/" + expected["reference"]).tolist()
    assert [row[0] for row in found.rows] == names
    assert [int(row[1]) for row in found.rows] == expected["lines"].tolist()
    assert [number(row[3]) for row in found.rows] == pytest.approx(expected["freq_max"].tolist(), rel=1e-4)
    assert [row[4] for row in found.rows] == ["validation" if held else "fitted" for held in expected["held_out"]]
    (intro,) = [b.text for b in blocks if isinstance(b, Words) and "frequency response functions" in b.text]
    held = [name for name, out in zip(names, expected["held_out"], strict=True) if out]
    assert (f"Validation data, in no fit: {', '.join(held)}." if held else "No function is kept") in intro


@pytest.mark.medium
def test_notes_on_the_measurement_are_reported(chain, tmp_path):
    folder = Path(shutil.copytree(chain, tmp_path / "chain"))
    record = json.loads((folder / "record.json").read_text("utf-8"))
    (folder / "record.json").write_text(json.dumps(record | {"notes": ["channel 2 was repaired"]}), "utf-8")
    every = page_blocks(StudyResults(folder, "chain", True))
    assert every.count(Words("Channel 2 was repaired.", "reported")) == 1


@pytest.mark.medium
@pytest.mark.parametrize("stage", ["before", "after"])
def test_every_function_is_compared_as_in_the_table(chain, blocks, stage):
    expected = pd.read_csv(chain / f"comparison_{stage}.csv").sort_values("frac", kind="stable")
    (found,) = [own for words, own in tables(blocks).items() if words.startswith("Every function") and
                ("before" in words) == (stage == "before")]  # fmt: skip
    assert [row[0] for row in found.rows] == (expected["response"] + "/" + expected["reference"]).tolist()
    for k, column, factor, tolerance in ((2, "frac", 1, 6e-4), (3, "amplitude", 1, 6e-4), (4, "error", 100, 6e-2)):
        cells = [number(row[k]) for row in found.rows]
        assert cells == pytest.approx((factor * expected[column]).tolist(), abs=tolerance)
    assert [number(row[5]) for row in found.rows] == pytest.approx(expected["in_std"].tolist(), rel=6e-3)


def test_its_figures_stand_once_and_their_words_name_the_worst_line(chain, blocks):
    pictures = [block for block in blocks if isinstance(block, Picture)]
    for name in ("frf_overlays", "frac", "frf_lines"):
        assert [picture.name for picture in pictures].count(name) == 1
    lines = pd.read_csv(chain / "frf_lines_after.csv")
    worst = lines.loc[lines["in_std"].idxmax()]
    (caption,) = [picture.caption for picture in pictures if picture.name == "frf_lines"]
    numbers = re.search(r"is ([\d.]+) standard deviations at ([\d.]+) Hz", caption)
    assert [float(n) for n in numbers.groups()] == pytest.approx([worst["in_std"], worst["freq"]], rel=6e-3)
