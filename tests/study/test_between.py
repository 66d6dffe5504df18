"""A frame that was stiffened between two tests, and one that was not."""

import json

import pandas as pd
import pytest

from calib.command import cli
from tests.study.conftest import STIFF, write_study, write_test


def explained(folder, results):
    assert cli.execute(["explain", str(folder), "--results", str(results)]) == 0
    told = json.loads((results / "frame/explanation.json").read_text("utf-8"))
    return pd.read_csv(results / "frame/test_differences.csv"), [s for s in told["sentences"] if "between the t" in s]


@pytest.fixture
def frame(tmp_path, monkeypatch, undrawn):
    monkeypatch.chdir(tmp_path)
    return write_study(tmp_path / "frame")


@pytest.mark.slow
def test_a_frame_that_was_stiffened_between_the_tests_is_told(frame, tmp_path):
    write_test(frame, "loaded", 1500.0, 2, factor=1.12)
    table, (said,) = explained(frame, tmp_path / "results")
    first = table.iloc[0]
    assert (first["parameter"], first["test"]) == ("k", "loaded") and abs(first["z"]) > 5
    assert first["change_low"] < 0.06 * STIFF < first["change_high"]
    assert said.startswith("Between the tests") and "k in loaded by about" in said and first["differs"]


@pytest.mark.slow
def test_nothing_differs_between_tests_of_the_same_frame(frame, tmp_path):
    table, (said,) = explained(frame, tmp_path / "results")
    assert {"k", "contact_3"} == set(table["parameter"]) and table["z"].abs().max() < 4
    assert said.startswith("No parameter differs between the tests")
