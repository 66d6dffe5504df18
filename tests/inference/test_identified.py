"""Identified is a statement on the data: against what is needed, never against a range of limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses.fit_statistics import ObjectiveTerms, fit_problem, statistics_at
from calib.errors.errors import InputError
from calib.inference.identify import faults, identify, needed_std
from calib.inference.verdicts import parameter_verdicts
from calib.problem.parameter import Parameter
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.study.limits import search_space
from calib.study.settings import StudySettings
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]


def parameter(value=50.0, lower=10.0, upper=90.0, unit="kN/m", **more):
    return Parameter("k", value, lower, upper, unit, **more)


def test_what_is_needed_is_a_tenth_of_the_nominal_value_unless_the_study_states_it():
    assert needed_std(parameter()) == needed_std(parameter(lower=1.0, upper=900.0)) == 5.0
    assert needed_std(parameter(-50.0, -90.0, -10.0)) == 5.0
    assert needed_std(parameter(needed=0.5)) == 0.5
    assert needed_std(parameter(0.0, -1.0, 1.0, prior_sd=0.2)) == 0.2
    assert needed_std(parameter(0.0, -1.0, 1.0, needed=0.02)) == 0.02
    # The magnitude of an effect that cannot begin at 0.
    assert needed_std(parameter(0.01, 0.01, 16.0, "mm", prior_sd=1.5)) == 1.5
    # A coordinate: its zero is arbitrary. A length is not.
    assert needed_std(parameter(0.5, -2.0, 2.0, "m", prior_sd=0.3)) == 0.3
    assert needed_std(parameter(1.2, 0.9, 1.5, "mm", prior_sd=0.05)) == pytest.approx(0.12)
    # Of an integer the neighbours must be improbable, whatever its prior.
    assert needed_std(parameter(5.0, 2.0, 8.0, integer=True)) == 0.2
    assert needed_std(parameter(5.0, 2.0, 8.0, integer=True, needed=1.0)) == 1.0


def test_the_same_data_identify_the_same_parameters_whatever_the_limits():
    g, values = np.diag([1 / 3.0, 1 / 6.0]), {"a": 50.0, "b": 50.0}  # standard deviations of 3 and 6
    for lower, upper in ((30.0, 70.0), (0.0, 100.0), (-5000.0, 5000.0)):
        space = ParameterSpace(tuple(Parameter(n, 50.0, lower, upper, prior_sd=400.0) for n in "ab"))
        found = identify(space, "ab", g, values=values)
        assert found.parameters["identified"].tolist() == [True, False]
        table = parameter_verdicts(space, values, found)
        assert table["needed"].tolist() == [5.0, 5.0] and table["not_identified"].tolist() == ["", "wide"]
        assert "6" in table.loc[1, "sentence"] and "needed, 5." in table.loc[1, "sentence"]
    stated = space.replace("b", needed=7.0)
    assert identify(stated, "ab", g, values=values).parameters["identified"].all()
    assert faults(stated["b"], 6.9, 0.99) == () and faults(stated["b"], 7.1, 0.99) == ("wide",)


@pytest.mark.parametrize("needed", [0.0, -1.0, float("nan"), float("inf")])
def test_what_is_needed_must_be_a_positive_number(needed):
    with pytest.raises(InputError, match="needed is") as caught:
        parameter(needed=needed)
    assert "parameter k" in str(caught.value) and "kN/m" in str(caught.value)


@pytest.mark.slow
def test_wider_limits_of_the_search_leave_the_bogies_identified_parameters_as_they_are(tmp_path):
    """At values near those that the twin was made from."""
    study = LoadedStudy.load(ROOT / "studies/bogie")
    at = {
        "K_primary": 705.0, "c_primary": 14.9, "m_girder_centre": 90.0, "m_girder_ends": 22.0, "m_crossbar": 97.0,
        "K_block": 10390.0, "K_rod_upper": 9.7, "K_rod_lower": 29.2, "pos_long_left": 5.0, "pos_long_right": 8.0,
    }  # fmt: skip

    def verdicts(search):
        keys = study.settings.model_dump(exclude_none=True)
        for name, limits in search.items():
            keys["parameters"].setdefault(name, {})["search"] = limits
        space = search_space(study.sensitivity_space, StudySettings.model_validate(keys), study.place)
        one = replace(study, search_space=space)
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            found = statistics_at(fit_problem(one, ledger), ObjectiveTerms.of(one), at)
        found = replace(found, p_fit=1.0)  # of a rejected fit none is identified, whatever the limits
        return found.verdicts(space, {}).set_index("parameter").loc[[n for n in at if not n.startswith("pos_")]]

    narrow = verdicts({})
    wide = verdicts({"K_primary": (200.0, 2000.0), "c_primary": (2.0, 60.0), "K_block": (2000.0, 60000.0)})
    pd.testing.assert_series_equal(wide["std"], narrow["std"], rtol=0.15)  # priors follow the limits
    assert wide["needed"].tolist() == narrow["needed"].tolist()
    assert wide["identified"].tolist() == narrow["identified"].tolist()
    assert 0 < narrow["identified"].sum() < len(narrow)
