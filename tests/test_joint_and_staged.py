"""Bogie and vehicle fitted together, beside the staged way in which the vehicle adopts what the bogie's fit found.

Both are least squares at full order on the synthetic measurements of the case study, with the same limits and priors;
the integers of the bogie are the true ones. What the studies leave out counts as exact where the information of the
two ways is compared, and as uncertain where the truth is.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.correlation.modal.residual import ModalResidual
from calib.inference.considered import At, changes_by_held
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.problem.joint import JointProblem
from calib.problem.problem import PairProblem
from calib.study.study import LoadedStudy
from calib.study.study_text import read_settings

ROOT = Path(__file__).resolve().parent.parent
BOGIE, VEHICLE = ROOT / "studies/bogie", ROOT / "studies/vehicle"
TRUTH = {
    name: value
    for study in ("bogie", "vehicle")
    for name, value in json.loads((ROOT / f"tests/truth/{study}.json").read_text("utf-8"))["parameters"].items()
}
ADOPTED = read_settings(VEHICLE / "study.toml").adopted.parameters

pytestmark = pytest.mark.whole


def posed(study):
    return PairProblem(ModalResidual(study.problem), study.search_space)


def left_out(study):
    """Standard deviations of what a study neither selects nor adopts."""
    return {name: sd for name, sd in study.held_sd.items() if name not in ADOPTED}


def known(problem, names, values, held=None):
    """Standard deviations of the named parameters from the rows of a problem; ``held`` those of parameters held."""
    widths = np.array([problem.space[n].prior_width for n in names])
    at = At(tuple(names), values, problem.residual(values), problem.jacobian(values, names), widths, False)
    return pd.Series(
        posterior(names, at.slope, widths, changes_by_held(problem, at, held or {}).of_estimates).std, list(names)
    )


@pytest.fixture(scope="module")
def both_ways():
    """Fitted values and standard deviations: of the bogie alone, of the vehicle on it, and of both together."""
    rig = LoadedStudy.load(BOGIE)
    bogie = posed(rig)
    bogie = replace(bogie, space=bogie.space.freeze({p.name: TRUTH[p.name] for p in bogie.space.free if p.integer}))
    first = fit(bogie, bogie.space, {})
    std = known(bogie, first.names, first.values)
    held = {name: float(std[name]) for name in ADOPTED if name in std}
    adopted = {name: first.values[name] for name in ADOPTED}
    whole = LoadedStudy.load(VEHICLE, adopted=adopted, adopted_sd=held)
    car = posed(whole)
    second = fit(car, car.space, {})
    staged = pd.concat([std, known(car, second.names, second.values, held)])
    joint = JointProblem({"bogie": bogie, "vehicle": car})
    together = fit(joint, joint.space, first.values | second.values)
    values = {**first.values, **{n: second.values[n] for n in second.names}}
    return joint, together, values, staged, held, left_out(rig) | left_out(whole)


def test_the_joint_fit_knows_no_parameter_worse_than_the_staged_one(both_ways):
    joint, together, _, staged, *_ = both_ways
    std = known(joint, together.names, together.values)
    assert set(std.index) == set(staged.index) and {"K_primary", "K_secondary_front"} <= set(std.index)
    assert (std <= 1.02 * staged[std.index]).all()  # the two ways end, and are linearised, at different values
    assert (std < 0.9 * staged[std.index]).any()


def test_each_test_alone_knows_less_of_what_both_share(both_ways):
    """At one point, where the information of both tests adds up."""
    joint, together, _, _, held, _ = both_ways
    std = known(joint, together.names, together.values)
    for part in joint.parts.values():
        values = {name: value for name, value in together.values.items() if name in part.space}
        names = [name for name in together.names if name in part.space]
        widths = np.array([joint.space[n].prior_width for n in names])
        alone = pd.Series(posterior(names, part.jacobian(values, names), widths).std, index=names)
        assert set(held) <= set(names)
        assert (std[list(held)] <= alone[list(held)] * (1 + 1e-9)).all()


def test_both_ways_agree_with_each_other_and_with_the_truth(both_ways):
    joint, together, staged_values, _, _, unselected = both_ways
    assert {"K_contact", "E_wood", "c_secondary", "RMI_cover", "m_base"} <= set(unselected)
    std = known(joint, together.names, together.values, unselected)
    for name in std.index:
        assert abs(together.values[name] - staged_values[name]) < 3 * std[name], name
    off = np.array([(together.values[name] - TRUTH[name]) / std[name] for name in std.index if name in TRUTH])
    assert len(off) == 15 and np.abs(off).max() < 3.5 and np.mean(off**2) < 2.5
