"""The designs of the page are those that `calib designs` lists, number by number."""

import json
import math
from base64 import b64decode
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from calib.command import cli
from calib.problem.space import Parameter, ParameterSpace
from calib.workbench.designs import columns


def unpacked(text):
    return np.frombuffer(b64decode(text), "<f4")


def test_columns_hold_parameters_errors_in_percent_and_what_is_unknown():
    space = ParameterSpace((Parameter("a", 1.0, 0.1, 10.0, "N/m", scale="log"), Parameter("b", 1.0, 0.0, 2.0, "-")))
    table = pd.DataFrame({
        "design": [7, 3], "case": ["A", "other"], "generation": [4.0, math.nan], "status": ["ok", "failed"],
        "objective": [0.1, math.nan], "mean_error": [0.02, math.nan], "mean_mac": [math.nan, math.nan], "a": [0.5, 2.0],
        "b": [1.0, 1.5], "y": [3.3, math.nan], "error y": [0.1, math.nan],
    })  # fmt: skip
    found = columns(SimpleNamespace(table=table, space=space, outputs=("y",), sentences=("two designs",)))
    assert (found["count"], found["cases"], found["words"]) == (2, ["A", "other"], "two designs")
    assert unpacked(found["design"]).tolist() == [7, 3] and unpacked(found["status"]).tolist() == [0, 1]
    named = {one["name"]: one for one in found["columns"]}
    assert list(named) == ["a", "b", "objective", "mean_error", "error y"]
    assert [(one["unit"], one["input"], one["log"]) for one in found["columns"][:2]] == [
        ("N/m", True, True),
        ("", True, False),
    ]
    np.testing.assert_allclose(unpacked(named["error y"]["numbers"]), [10.0, math.nan], rtol=1e-6)
    assert named["error y"]["unit"] == named["mean_error"]["unit"] == "%"


@pytest.mark.slow  # a process reads them
def test_the_page_has_the_table_of_the_command(page, key, here):
    assert cli.execute(["calibrate", "mast", "--quick", "--workers", "1"]) == 0
    assert cli.execute(["designs", "mast", "--quick", "--csv", "designs.csv"]) == 0
    table = pd.read_csv("designs.csv")
    found = page.get(f"study/{key}/designs?part=quick").json()
    assert found["count"] == len(table)
    np.testing.assert_array_equal(unpacked(found["design"]), table["design"])
    for one in found["columns"]:
        known = table[one["name"]] * (100 if one["unit"] == "%" else 1)
        np.testing.assert_allclose(unpacked(one["numbers"]), known, rtol=1e-6)


@pytest.mark.slow
def test_without_designs_the_page_says_what_to_run(page, key):
    told = page.get(f"study/{key}/designs")
    assert told.status_code == 409 and "calib" in json.loads(told.text)["fault"]
