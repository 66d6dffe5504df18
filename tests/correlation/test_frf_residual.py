"""The whitened residual of FRFs: rows, derivatives, a fit with right standard deviations, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.rules import RULES
from calib.errors.errors import EvaluationError, InputError
from calib.inference.gauss_newton import fit
from calib.measurement.accuracy import frf_claim
from calib.measurement.modal import Sensor
from calib.problem.prior import Prior
from calib.problem.problem import PairProblem
from calib.structure.model import StructuralModel
from calib.study.loading import module_of

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
FREQ, TRUE, truth, measured = WORLD.FREQ, WORLD.TRUE, WORLD.truth, WORLD.measured
NODES = {"responses": WORLD.RESPONSES, "references": WORLD.REFERENCES}


@pytest.fixture(scope="module")
def chain():
    return WORLD.chain()


@pytest.fixture(scope="module")
def residual(chain):
    return FRFResidual(FRFProblem(chain, measured(1)))


def test_rows_are_labelled_and_stacked_alike(residual):
    rows, data = residual.rows, residual.problem.measured
    assert len(rows) == 2 * 60 * 6 == len(residual.residual(TRUE))
    expected = []
    for row in rows:
        at = (
            int(np.argmin(np.abs(FREQ - row.freq))), NODES["responses"].index(int(row.sensor[0])),
            NODES["references"].index(int(row.sensor[3])),
        )  # fmt: skip
        expected.append((data.values[at].real if row.part == "re" else data.values[at].imag) / data.std[at])
    np.testing.assert_allclose(residual.of(np.zeros_like(data.values)), expected, rtol=1e-12)
    assert {r.kind for r in rows} == {"frf"} and {r.mode for r in rows} == {""}
    assert rows[0].sensor == "1x/1x" and rows[0].freq == FREQ[0]


def test_derivatives_are_those_of_differences(residual):
    names = ("k", "c", "m")
    exact = residual.jacobian(TRUE, names)
    for p, name in enumerate(names):
        step = 1e-5 * TRUE[name]
        up, down = (residual.residual({**TRUE, name: TRUE[name] + s * step}) for s in (1, -1))
        np.testing.assert_allclose(
            exact[:, p], (up - down) / (2 * step), rtol=1e-5, atol=1e-7 * np.abs(exact[:, p]).max()
        )
    assert residual.jacobian(TRUE, ()).shape == (720, 0)


@pytest.mark.medium
def test_at_the_truth_it_is_standard_normal():
    chi = []
    for seed in range(30):
        data = measured(seed)
        own = np.stack([(data.values - truth(TRUE)).real, (data.values - truth(TRUE)).imag]) / data.std
        chi.append(np.mean(own**2))
    assert 0.97 < np.mean(chi) < 1.06


@pytest.mark.slow
def test_a_fit_finds_the_truth_within_its_standard_deviations(chain):
    pulls = []
    for seed in range(12):
        problem = PairProblem(FRFResidual(FRFProblem(chain, measured(seed))), chain.space)
        found = fit(problem, chain.space, prior=Prior.none())
        slope = problem.jacobian(found.values, ("k", "c", "m"))
        std = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
        pulls.append([(found.values[n] - TRUE[n]) / s for n, s in zip(TRUE, std, strict=True)])
        assert std[0] < 50 and 0.7 < found.misfit / 720 < 1.35
    assert np.all(np.abs(pulls) < 4) and 0.6 < np.std(pulls) < 1.4


def test_assurances_are_one_at_the_truth_and_less_elsewhere(chain):
    residual = FRFResidual(FRFProblem(chain, replace(measured(repeats=1), std=np.full((60, 3, 2), 1e-3))))
    right = residual.responses(residual.solve(TRUE))
    assert set(right) == {f"{kind} {r}x/{q}x" for kind in ("frac", "amplitude") for r in (1, 3, 4) for q in (1, 4)}
    np.testing.assert_allclose(list(right.values()), 1.0, rtol=1e-9)
    elsewhere = residual.responses(residual.solve({}))
    assert max(value for name, value in elsewhere.items() if name.startswith("frac")) < 0.99
    np.testing.assert_allclose(residual.residual(TRUE), 0.0, atol=1e-9)


def test_entries_that_were_not_measured_have_no_row(chain):
    data = measured(1)
    values = data.values.copy()
    values[:, 1, 0] = np.nan
    residual = FRFResidual(FRFProblem(chain, replace(data, values=values)))
    assert len(residual.rows) == len(residual.residual(TRUE)) == 2 * 60 * 5
    assert "3x/1x" not in {row.sensor for row in residual.rows} and len(residual.responses(residual.solve(TRUE))) == 10
    assert residual.std_dof["frf"] == 2 * 3 * 300 - 10


def test_without_repeats_a_share_of_the_modulus_is_assumed(chain):
    residual = FRFResidual(FRFProblem(chain, measured(1, repeats=1)))
    np.testing.assert_allclose(residual.relative_std, RULES.unknown_frf_std, rtol=1e-12)
    assert residual.std_dof["frf"] == np.inf


def test_a_claimed_accuracy_widens_the_rows_and_counts_as_known(chain):
    plain, data = FRFResidual(FRFProblem(chain, measured(1))), measured(1)
    claimed = FRFResidual(FRFProblem(chain, replace(data, accuracy=frf_claim("3 %"))))
    rows = claimed.residual(TRUE) / plain.residual(TRUE)
    np.testing.assert_allclose(rows, plain.std / claimed.std, rtol=1e-10)
    size = np.abs(claimed.std**2 - plain.std**2) ** 0.5
    np.testing.assert_allclose(size, 0.03 * plain.std / plain.relative_std, rtol=1e-9)
    share = np.mean((plain.std / claimed.std) ** 2)
    assert claimed.std_dof["frf"] == pytest.approx(plain.std_dof["frf"] / share**2)
    assert claimed.fingerprint != plain.fingerprint
    equal = replace(data, std=0 * data.std, accuracy=frf_claim("3 %"))  # repeats without any scatter
    assert np.isfinite(FRFResidual(FRFProblem(chain, equal)).residual(TRUE)).all()


def test_fingerprints_tell_measurements_and_models_apart(chain):
    first = FRFResidual(FRFProblem(chain, measured(1)))
    assert first.fingerprint == FRFResidual(FRFProblem(chain, measured(1))).fingerprint
    assert first.fingerprint != FRFResidual(FRFProblem(chain, measured(2))).fingerprint
    other = FRFProblem(chain, replace(measured(1), quantity="mobility"))
    assert first.problem.fingerprint != other.fingerprint
    # a ledger keeps the assurances under it, which depend on what was measured
    assert first.problem.fingerprint != FRFProblem(chain, measured(2)).fingerprint
    assert first.problem.fingerprint == FRFProblem(chain, measured(1)).fingerprint


def test_what_cannot_be_weighted_or_placed_is_refused(chain):
    data = measured(1)
    with pytest.raises(InputError, match="1x over 1x at 2 Hz is not positive"):
        FRFResidual(FRFProblem(chain, replace(data, std=0 * data.std)))
    with pytest.raises(InputError, match="no FRF was measured"):
        FRFResidual(FRFProblem(chain, replace(data, values=np.full_like(data.values, np.nan))))
    with pytest.raises(InputError, match="9x"):
        FRFProblem(chain, replace(data, references=(Sensor(9, "x"), Sensor(4, "x"))))
    undamped = StructuralModel.from_matrices(
        [[1.0]], [[1.0]], dofs=pd.DataFrame({"node": [1], "direction": "x"})
    )  # fmt: skip
    line = np.array([1 / (2 * np.pi), 1.0])
    ones = np.ones((2, 1, 1))
    one = replace(
        data, freq=line, responses=(Sensor(1, "x"),), references=(Sensor(1, "x"),), values=ones + 0j, std=ones
    )
    with pytest.raises(EvaluationError, match="without damping"):
        FRFResidual(FRFProblem(undamped, one)).solve({})
