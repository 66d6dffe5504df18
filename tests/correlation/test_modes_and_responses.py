"""Modes and scalar responses in one fit: a structure whose modes and whose weight were measured."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.inference.identify import posterior
from calib.inference.integers import fit_mixed
from calib.missing.goodness import goodness, overall
from calib.problem.joint import JointProblem
from calib.problem.problem import PairProblem
from calib.problem.space import ParameterSpace


@dataclass(frozen=True)
class At:
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray


def test_modes_and_scalar_responses_are_fitted_together(build, twin):
    model, truth = build(), {"k_along": 46.0, "k_across": 12.5, "mass": 8.5, "c_end": 500.0}
    space = model.space.freeze({"c_end": 500.0})
    modes = PairProblem(ModalResidual(ModalProblem(model, twin(model, truth), mode_count=6)), space)
    scale = ParameterSpace((replace(model.space["mass"], prior_sd=1.0),))
    weighed = ResponseResidual(
        FunctionProblem(scale, lambda v: {"weight": 6 * v["mass"]}, {"weight": (51.0, 0.05)}, "")
    )
    joint = JointProblem({"modes": modes, "scale": PairProblem(weighed, scale)})
    found = fit_mixed(joint, joint.space).best
    names = joint.space.free_names
    assert [found.values[n] for n in names] == pytest.approx([truth[n] for n in names], rel=1e-3)
    slope = joint.jacobian(found.values, names)
    for k, name in enumerate(names):
        step = 1e-5 * found.values[name]
        ends = [joint.residual({**found.values, name: found.values[name] + s}) for s in (step, -step)]
        np.testing.assert_allclose(slope[:, k], (ends[0] - ends[1]) / (2 * step), rtol=2e-4, atol=1e-4)
    alone = posterior(names, modes.jacobian(found.values, names), np.full(len(names), np.inf))
    both = posterior(names, slope, np.full(len(names), np.inf))
    k = names.index("mass")
    assert both.std[k] < 0.05 / 6 * 1.001 and alone.std[k] > 10 * both.std[k]  # modes determine ratios to mass only
    labels, freq, change = joint.frequencies(found.values, names)
    assert len(labels) == len(freq) == len(change) > 3 and change.shape[1] == len(names)
    assert {row.test for row in joint.rows} == {"modes", "scale"} and len(joint.rows) == len(slope)
    kinds, blocks = goodness(
        At(found.residual, found.jacobian, np.array([space[n].prior_width for n in names])),
        joint,
    )
    assert overall(kinds, blocks) > 0.9 and set(kinds["kind"]) == {row.kind for row in joint.rows}
