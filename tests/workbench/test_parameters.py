"""The parameters' view tells what the tables hold, and where each acts."""

import math

import numpy as np
import pandas as pd
import pytest

from calib.report.html.study_results import StudyResults
from calib.report.numbers import with_unit
from calib.workbench.parameters import parameters


@pytest.fixture
def found(page, key):
    return page.get(f"study/{key}/parameters").json()["parameters"]


def test_every_parameter_is_listed_with_its_limits_and_prior(found, here):
    table = pd.read_csv(here / "results/mast/parameter_space.csv").set_index("parameter")
    assert [one["name"] for one in found["rows"]] == list(table.index)
    for one in found["rows"]:
        row = table.loc[one["name"]]
        lower = row["lower"] if math.isnan(row["search_lower"]) else row["search_lower"]
        assert (one["lower"], one["nominal"], one["prior_sd"]) == (lower, row["value"], row["prior_sd"])
        assert one["nominal_words"] == with_unit(row["value"], row["unit"]) and one["value"] is None


def test_each_is_marked_where_it_acts(found, here):
    places = pd.read_csv(here / "results/mast/model_places.csv")
    named = set(places["parameters"].dropna().str.split(";").explode().str.strip())
    assert {layer["name"] for layer in found["layers"]} == named != set()


def test_fitted_values_are_those_of_the_verdicts(here):
    """Tables in the place of those of a calibration: the page reads them and computes nothing."""
    names = pd.read_csv(here / "results/mast/parameter_space.csv")["parameter"].tolist()
    fitted = pd.DataFrame(
        {"parameter": names, "unit": "-", "sentence": "Identified.", "value": 2.0, "lower": 1.0, "upper": 3.0,
         "ratio": 0.5, "std": 0.1, "spread": np.nan, "identified": True, "low": 1.804, "high": 2.196}
    )  # fmt: skip
    fitted.to_csv(here / "results/mast/verdicts.csv", index=False)
    related = pd.DataFrame(np.eye(len(names)), index=pd.Index(names, name="parameter"), columns=names)
    related.iloc[0, 1] = related.iloc[1, 0] = -0.8
    fitted_parameters = fitted.assign(case="A1", search_value=np.nan, on_limit=False, stable=True)
    fitted_parameters.to_csv(here / "results/mast/parameters.csv", index=False)
    related.to_csv(here / "results/mast/posterior_correlation.csv")
    first, second, *_ = parameters(StudyResults(here / "results/mast", "", True))["rows"]
    assert (first["value"], first["low"], first["high"], first["identified"]) == (2.0, 1.804, 2.196, True)
    assert first["partners"] == [f"{names[1]} −0.80"] and second["partners"] == [f"{names[0]} −0.80"]
