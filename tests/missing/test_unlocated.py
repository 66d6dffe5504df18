"""A bad fit in which nothing stands out has its own verdict, which names what fits worst."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.missing.decision import decide
from calib.missing.goodness import by_sensor, misfit_at
from calib.missing.recommendation import Recommendation
from calib.missing.tables import effects_table
from calib.missing.verdict import verdict_of

pytestmark = pytest.mark.usefixtures("fewer_samples")


@pytest.fixture(scope="module")
def spoiled(toy):
    """The channel S7 is off in mode M5, in a direction that no parameter, effect or local perturbation has."""
    made = toy(effects=3, perturbations=3, sensors=20)
    own = np.array([(row.mode, row.kind) == ("M5", "shape") for row in made.rows]) * 1.5
    own[[k for k, row in enumerate(made.rows) if (row.mode, row.sensor) == ("M5", "S7")]] = 14.0
    known = np.column_stack(list(made.columns.values()))
    hidden = own - known @ np.linalg.lstsq(known, own, rcond=None)[0]
    return replace(made, columns={**made.columns, "hidden": hidden})


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_the_worst_sensor_and_mode_are_named(spoiled, seed):
    one = spoiled.drawn(np.random.default_rng(seed), {"hidden": 1.0})
    found = decide(one)
    assert found.base_adequacy.p_family > 0.01 > found.base_adequacy.p_fit
    assert found.verdict == "misfit_unlocated" and found.credible == () and not found.names_something
    assert found.base_adequacy.sensors.iloc[0]["sensor"] == "S7"
    effects = effects_table(found, {}, {})
    told = verdict_of(found, effects, effects.head(0), Recommendation("Recommendation.", "Recommendation."))
    text = " ".join((*told.sentences, told.answer.then))
    assert "at S7 (" in text and "of mode M5" in text and "nan" not in text
    assert "Recommendation." not in text and "(score" not in text  # no place of no significance


def test_the_repeat_that_disagrees_where_the_fit_is_worst_is_named_first(spoiled):
    found = decide(spoiled.drawn(np.random.default_rng(0), {"hidden": 1.0}))
    rows = [
        ("run 1", "M1", "S2", 9.0),
        ("run 4", "M5", "S7", 5.0),
        ("run 1", "M2", "S3", 4.0),
        ("run 2", "", "S7", 7.0),
    ]
    table = pd.DataFrame(rows, columns=["repeat", "mode", "sensor", "times"])
    where = misfit_at(found.base_adequacy, table)
    assert where == {"sensor": "S7", "mode": "M5", "kind": "shape", "repeats": ["run 2", "run 4", "run 1"]}
    effects = effects_table(found, {}, {})
    text = " ".join(verdict_of(found, effects, effects.head(0), None, table).sentences)
    assert all(repeat in text for repeat in where["repeats"])
    assert misfit_at(found.base_adequacy, table.head(0))["repeats"] == []
    quiet = verdict_of(found, effects, effects.head(0), None, table.head(0)).sentences
    assert not any("run" in words.split() for words in quiet)


def test_a_significant_score_is_not_unlocated(toy):
    found = decide(toy(perturbations=12).drawn(np.random.default_rng(1), {"A7": 1.5}))
    assert found.base_adequacy.p_family < 0.01 and found.verdict == "none_explains"


def test_misfit_by_sensor_adds_up(toy):
    one = toy().drawn(np.random.default_rng(3), {})
    fit = one.calibrated()
    table = by_sensor(fit, replace(one, fitted_factors={("M0", "shape"): 2}))
    shapes = np.array([row.kind == "shape" for row in one.rows])
    assert table["chi2"].sum() == pytest.approx(np.sum(fit.residual[shapes] ** 2))
    plain = by_sensor(fit, one)
    assert plain["dof"].sum() - table["dof"].sum() == pytest.approx(2.0)
    assert set(table["sensor"]) == {f"S{k}" for k in range(10)} and table["p"].is_monotonic_increasing
