"""Errors of a model at its resonances, which all lines and functions share."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.correlation.fault_rules import RULES
from calib.correlation.frf.nuisance import ChannelError, channel_nuisances, concerned
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.frf.resonances import ResonanceError
from calib.errors.errors import InputError
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.measurement.accuracy import Claim
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.problem.problem import PairProblem
from calib.problem.space import Parameter
from calib.structure.model import StructuralModel

K = np.array([[3e4, -1e4], [-1e4, 1e4]])
MODES = np.linalg.eigh(K)
RATIO = 0.01
FREQ = np.unique(np.concatenate([np.sqrt(w2) / (2 * np.pi) * (1 + RATIO * np.linspace(-4, 4, 17)) for w2 in MODES[0]]))
SENSORS = (Sensor(1, "x"), Sensor(2, "x"))
STD, SHARE = 0.01, 3.0


def truth(shifts=(0.0, 0.0), ratios=(RATIO, RATIO), k=2e4):
    """Receptances of two masses by their modes, whose frequencies are off by some relative errors."""
    squares, shapes = np.linalg.eigh(K + np.diag([k - 2e4, 0.0]))
    roots = np.sqrt(squares) * (1 + np.array(shifts))
    omega = 2 * np.pi * FREQ[:, None]
    each = 1 / (roots**2 - omega**2 + 2j * np.array(ratios) * roots * omega)
    return np.einsum("fm,im->fi", each, shapes * shapes[0])[:, :, None]


def measured(values, seed=None):
    rng = np.random.default_rng(seed)
    std = STD * np.abs(values)
    noise = 0.0 if seed is None else std * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    return MeasuredFRFs(FREQ, SENSORS, SENSORS[:1], "receptance", values + noise, std, 5)


@pytest.fixture(scope="module")
def pair():
    """The same two masses with one spring as a parameter, damped like the truth at its nominal value."""
    squares, shapes = MODES
    damping = shapes @ np.diag(2 * RATIO * np.sqrt(squares)) @ shapes.T
    return StructuralModel.from_matrices(
        {"k": np.diag([1.0, 0.0]), "rest": K - np.diag([2e4, 0.0])},
        np.eye(2),
        damping,
        dofs=[(1, "x"), (2, "x")],
        parameters=[Parameter("k", 2e4, 1e4, 3e4, "N/m")],
    )


def test_every_measured_resonance_has_two_with_priors(pair):
    errors = channel_nuisances(measured(truth(), 1), resonance=SHARE)
    assert [e.kind for e in errors] == ["frequency", "damping"] * 2
    np.testing.assert_allclose([e.freq for e in errors[::2]], np.sqrt(MODES[0]) / (2 * np.pi), rtol=1e-3)
    np.testing.assert_allclose([e.ratio for e in errors], RATIO, rtol=0.1)
    shift, loss = (e.parameter for e in errors[:2])
    assert loss.prior_sd == SHARE and shift.prior_sd == pytest.approx(SHARE * RATIO, rel=0.1)
    space = FRFProblem(pair, measured(truth()), errors).space
    assert space.names == ("k", *(e.parameter.name for e in errors)) and shift.unit == loss.unit == "%"


def test_they_move_a_resonance_and_change_its_damping(pair):
    """Against the modes themselves, to first order and but for the other mode; at 0 nothing changes."""
    known = [(f, 2 * RATIO * f) for f in np.sqrt(MODES[0]) / (2 * np.pi)]
    errors = [ResonanceError(kind, *at, SHARE) for at in known for kind in ("frequency", "damping")]
    problem = FRFProblem(pair, measured(truth()), tuple(errors))
    plain = problem.functions({})
    np.testing.assert_allclose(plain, truth(), rtol=1e-9)
    e = 1e-5
    for k in (0, 1):
        shift, loss = (errors[2 * k + j].parameter.name for j in (0, 1))
        for name, other in (
            (shift, truth(shifts=np.where(np.arange(2) == k, e, 0.0))),
            (loss, truth(ratios=RATIO * np.where(np.arange(2) == k, 1 + e, 1.0))),
        ):
            change, expected = problem.functions({name: 100 * e}) - plain, other - plain
            assert np.abs(change - expected).max() < 0.1 * np.abs(expected).max()


def test_derivatives_are_those_of_differences(pair):
    data = measured(truth(), 1)
    residual = FRFResidual(
        FRFProblem(pair, data, (ChannelError("gain", "1x"), *channel_nuisances(data, resonance=2.0)))
    )
    at = {p.name: p.value + 0.3 * p.prior_width for p in residual.space.parameters}
    names = tuple(reversed(at))
    for column, name in zip(residual.jacobian(at, names).T, names, strict=True):
        step = 1e-4 * residual.space[name].prior_width
        up, down = (residual.residual({**at, name: at[name] + s * step}) for s in (1, -1))
        np.testing.assert_allclose(column, (up - down) / (2 * step), atol=1e-5 * np.abs(column).max())


@pytest.mark.slow
def test_an_interval_holds_the_truth_where_resonances_are_off(pair):
    """A shift common to all lines does not average out: counted line by line the interval misses by far."""
    rng = np.random.default_rng(1)
    pulls = {False: [], True: []}
    for seed in range(30):
        shifts = SHARE / 100 * RATIO * rng.standard_normal(2)
        data = measured(truth(shifts), seed)
        for freed in pulls:
            errors = channel_nuisances(data, resonance=SHARE) if freed else ()
            residual = FRFResidual(FRFProblem(pair, data, errors))
            found = fit(PairProblem(residual, residual.space), residual.space)
            names = residual.space.names
            widths = np.array([residual.space[n].prior_width for n in names])
            slope = residual.jacobian(found.values, names)
            covariance = np.linalg.inv(slope.T @ slope + np.diag(widths**-2.0))
            pulls[freed].append((found.values["k"] - 2e4) / np.sqrt(covariance[0, 0]))
    apart, shared = (np.sqrt(np.mean(np.square(pulls[freed]))) for freed in (False, True))
    assert apart > 5 and 0.6 < shared < 1.4


def test_each_makes_another_problem_and_concerns_its_lines(pair):
    data = measured(truth(), 1)
    errors = channel_nuisances(data, resonance=SHARE)
    prints = {FRFProblem(pair, data, some).fingerprint for some in ((), *((e,) for e in errors))}
    assert len(prints) == 5
    low = data.in_band(0.0, 1.1 * errors[0].freq)
    assert concerned(errors, low) == errors[:2]
    with pytest.raises(InputError, match="was not measured"):
        FRFProblem(pair, low, errors)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("shape", 3.0, 0.1, 1.0), "kind is 'shape'"),
        (("damping", 0.0, 0.1, 1.0), "at 0 Hz"),
        (("damping", 3.0, -0.1, 1.0), "-0.1 Hz wide"),
        (("frequency", 3.0, 0.1, 0.0), "standard deviation is 0"),
        (("frequency", 3.0, 0.1, 1.01 * RULES.resonance_most), r"off by 5\.05 % at it.*give 5 % or less"),
    ],
)
def test_wrong_ones_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        ResonanceError(*given)


def test_the_largest_share_is_taken():
    assert ResonanceError("frequency", 3.0, 0.1, RULES.resonance_most).share == 5.0


def claiming(data, share):
    return replace(data, accuracy=Claim(share))


def test_a_claimed_share_leaves_open_what_a_fitted_error_of_that_size_would_change(pair):
    """Column by column the change of the residual by one standard deviation of the parameters of 3 %."""
    data = claiming(measured(truth()), SHARE / 100)
    shared = FRFResidual(FRFProblem(pair, data)).shared_errors
    fitted = FRFResidual(FRFProblem(pair, data, channel_nuisances(data, resonance=SHARE)))
    widths = {p.name: p.prior_width for p in fitted.space.parameters if p.name != "k"}
    changes = fitted.jacobian(fitted.space.values, tuple(widths)) * list(widths.values())
    np.testing.assert_allclose(-shared, changes, rtol=1e-6, atol=1e-9)
    assert np.linalg.norm(shared, axis=0).min() > 1


def test_nothing_is_shared_without_a_claim_and_where_it_is_fitted(pair):
    data, claimed = measured(truth()), claiming(measured(truth()), 0.01)
    errors = channel_nuisances(claimed, resonance=1.0)
    rows = len(FRFResidual(FRFProblem(pair, data)).rows)
    assert FRFResidual(FRFProblem(pair, data)).shared_errors.shape == (rows, 0)
    assert FRFResidual(FRFProblem(pair, claimed, errors)).shared_errors.shape == (rows, 0)
    assert FRFResidual(FRFProblem(pair, claimed, errors[:2])).shared_errors.shape == (rows, 2)  # of the other resonance


@pytest.mark.medium
def test_an_interval_knows_what_lines_share_where_nothing_is_fitted_for_it(pair):
    """Resonances are off by what is claimed: k scatters as widely as its standard deviation with these errors."""
    rng, pulls, narrow = np.random.default_rng(2), [], []
    for seed in range(30):
        data = claiming(measured(truth(SHARE / 100 * RATIO * rng.standard_normal(2)), seed), SHARE / 100)
        residual = FRFResidual(FRFProblem(pair, data))
        found = fit(PairProblem(residual, residual.space), residual.space)
        slope, prior = residual.jacobian(found.values, ("k",)), np.array([residual.space["k"].prior_width])
        for out, held in ((narrow, None), (pulls, residual.shared_errors)):
            out.append((found.values["k"] - 2e4) / posterior(("k",), slope, prior, held).std[0])
    assert np.sqrt(np.mean(np.square(narrow))) > 2 and 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.4


@pytest.mark.medium
def test_a_calibration_states_it_and_names_what_it_adds(pair):
    data = claiming(measured(truth(), 1), SHARE / 100)
    found = calib.Problem(pair, calib.FRFTest(data)).calibrate()
    residual = FRFResidual(FRFProblem(pair, data))
    slope, prior = residual.jacobian(found.values, ("k",)), np.array([residual.space["k"].prior_width])
    alone, wide = (posterior(("k",), slope, prior, held).std[0] for held in (None, residual.shared_errors))
    assert found.parameters.loc["k", "std"] == pytest.approx(wide, rel=1e-6) and wide > 2 * alone
    (row,) = found.statistics.considered.to_dict("records")
    assert row["parameter"] == "resonance_errors" and row["adds_to"] == "k" and row["matters"]
    assert row["std_without"] == pytest.approx(alone, rel=1e-6) and row["std_with"] == pytest.approx(wide, rel=1e-6)
    errors = channel_nuisances(data, resonance=SHARE)
    freed = calib.Problem(pair, calib.FRFTest(data, nuisances=errors)).calibrate()
    assert freed.parameters.loc["k", "std"] == pytest.approx(wide, rel=0.3)  # what the data say of these errors
