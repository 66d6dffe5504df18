"""The correlation view tells what the tables of the comparison hold."""

import numpy as np
import pandas as pd
import pytest

from calib.report.numbers import fixed, percent


@pytest.mark.medium
def test_the_matrix_and_the_pairs_are_those_of_the_tables(page, key, here):
    found = page.get(f"study/{key}/correlation").json()["correlation"]
    (stage,) = found["stages"]
    mac = pd.read_csv(here / "results/mast/mac_before.csv").set_index("mode")
    compared = pd.read_csv(here / "results/mast/comparison_before.csv")
    np.testing.assert_array_equal(np.array(stage["mac"]), mac.to_numpy())
    assert [one["name"] for one in stage["measured"]] == list(mac.index)
    assert [f"{one['number']} ({one['freq']} Hz)" for one in stage["model"]] == list(mac.columns)
    for pair, row in zip(stage["pairs"], compared.to_dict("records"), strict=True):
        assert (pair["mode"], pair["model_mode"]) == (row["mode"], row["model_mode"])
        assert (pair["error"], pair["mac"]) == (percent(row["freq_error"], 2, sign=True), fixed(row["mac"], 3))


@pytest.mark.medium
def test_every_paired_model_mode_has_its_motion(page, key):
    found = page.get(f"study/{key}/correlation").json()["correlation"]
    (stage,), scene = found["stages"], found["scene"]
    motions = found["motions"]["before calibration"]
    assert set(motions) == {str(pair["model_mode"]) for pair in stage["pairs"]}
    by_mode = {mode["name"]: mode["motion"] for mode in scene["stages"][0]["modes"]}
    for pair in stage["pairs"]:
        assert motions[str(pair["model_mode"])] == by_mode[pair["mode"]]


@pytest.mark.medium
def test_a_study_without_a_comparison_has_none(here, page_of):
    import shutil
    from pathlib import Path

    shutil.rmtree(here / "results")
    page = page_of(Path("mast"))
    (one,) = page.get("studies").json()["studies"]
    assert page.get(f"study/{one['key']}/correlation").json()["correlation"] is None
