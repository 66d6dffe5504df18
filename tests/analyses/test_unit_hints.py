"""Hints at values in other units when model and measurement are compared; the shipped studies give none."""

import re
from pathlib import Path

import pytest

from calib.analyses.compare import comparison_at
from calib.command.example import write_example
from calib.study.study import LoadedStudy

ROOT = Path(__file__).parents[2]
CHEAP = (
    "five_mass_chain",
    "four_storey_rig",
    "four_storey_rig_masses",
    "four_storey_rig_wide",
    "bogie",
    pytest.param("hidden_effect", marks=pytest.mark.slow),  # a whole vehicle
)


@pytest.fixture
def example(tmp_path):
    write_example(tmp_path / "mast")
    return tmp_path / "mast"


def hints(folder):
    study = LoadedStudy.load(folder)
    return comparison_at(study, study.model.space.values).hints


def scaled(text, factor):
    head, *rows = [line for line in text.splitlines() if not line.startswith("#")]
    out = [head]
    for row in rows:
        cells = row.split(",")
        cells[1] = f"{factor * float(cells[1]):.9g}"
        if cells[3]:
            cells[3] = f"{factor * float(cells[3]):.9g}"
        out.append(",".join(cells))
    return "\n".join(out) + "\n"


def test_radians_a_second(example):
    assert hints(example) == ()
    modes = example / "modes.csv"
    modes.write_text(scaled(modes.read_text(), 6.283185))
    (hint,) = hints(example)
    assert "rad/s" in hint


def test_a_parameter_value_far_from_that_of_the_model(example):
    file = example / "study.toml"
    text = file.read_text()
    file.write_text(re.sub(r"(?m)^value = 2.0 .*\nlimits = .*\nsearch = .*", "value = 2e6\nlimits = [3e5, 5e6]", text))
    (hint, *_) = hints(example)
    assert "[parameters.K_base] value" in hint


@pytest.mark.parametrize("name", CHEAP)
def test_shipped_studies_give_no_hint(name):
    assert hints(ROOT / "studies" / name) == ()
