"""The linear start of a fit of FRFs: where it leads, what it leaves alone, and where it cannot be posed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp

import calib
from calib.analyses.fit_statistics import ObjectiveTerms
from calib.analyses.least_squares import fitted
from calib.correlation.frf.nuisance import ChannelError
from calib.hypotheses.linear_start import linear_start, linear_starts
from calib.inference.gauss_newton import FitResult
from calib.inference.starts import UntilLowestTwice
from calib.measurement.modal import Sensor
from calib.study.loading import module_of

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
TRUE = {**WORLD.TRUE, "links": 1.0}
NEAR = 0.05
"""Of stiffness and mass at the start, relative: the half-power width of the chain's modes is 3 to 5 % of frequency."""


def problem_of(model, frfs, nuisances=()):
    return calib.Problem(model, calib.FRFTest(frfs, nuisances=nuisances))


def start_of(problem):
    posed = problem.fit_problem
    return linear_start(posed.pair, posed.space, posed.space.values)


def fit_from(problem, point):
    return fitted(problem.fit_problem, ObjectiveTerms(), [point], 40)


@pytest.fixture(scope="module")
def frfs():
    return WORLD.measured(1)


@pytest.mark.slow
# Nominal values up to 50 % off, from which least squares end in another minimum.
@pytest.mark.parametrize(
    "wrong",
    [
        {"k": 1e4, "m": 2.3, "links": 0.5},
        pytest.param({"k": 6e3, "m": 1.2, "links": 0.6}, marks=pytest.mark.slow),
        pytest.param({"k": 1.8e4, "m": 3.4, "links": 0.65}, marks=pytest.mark.slow),
        pytest.param({"k": 6e3, "m": 2.3, "links": 1.5}, marks=pytest.mark.slow),
    ],
)
def test_it_leads_to_the_truth_where_least_squares_alone_end_elsewhere(frfs, wrong):
    problem = problem_of(WORLD.chain(stiff_links=True, **wrong), frfs)
    alone = fit_from(problem, problem.space.values)
    assert alone.p_fit < 1e-6 and max(abs(alone.values[n] / TRUE[n] - 1) for n in ("k", "m", "links")) > 0.1
    start = start_of(problem)
    assert all(abs(start[n] / TRUE[n] - 1) < NEAR for n in ("k", "m", "links"))
    fit = problem.calibrate(starts=1, progress=False)
    assert fit.statistics.p_fit > 1e-3
    assert all(abs(fit.values[n] - true) < 4 * fit.parameters.loc[n, "std"] for n, true in TRUE.items())


def test_a_parameter_in_stiffness_and_mass_is_found(frfs):
    """A factor of every spring but the lowest and of the equal masses, such as the section of a bar."""
    model, size = WORLD.chain(), calib.Parameter("size", 1.5, 0.5, 2.0, "-")
    k0, _, m0 = WORLD.by_hand({"k": 0.0, "c": 0.0, "m": 0.0})
    k1, c, m1 = WORLD.by_hand({"k": 1.0, "c": WORLD.TRUE["c"], "m": WORLD.TRUE["m"]})
    model = calib.StructuralModel.from_matrices(
        {"k": k1 - k0, "springs": (k0, "size")},
        {"own": (m0, "size"), "last": m1 - m0},
        {"all": c},
        dofs=[(n, "x") for n in range(1, WORLD.N + 1)],
        parameters=[calib.Parameter("k", 7e3, 5e3, 2e4, "N/m"), size],
    )
    start = start_of(problem_of(model, frfs))
    assert abs(start["size"] - 1) < NEAR and abs(start["k"] / WORLD.TRUE["k"] - 1) < 2 * NEAR


def test_sensors_between_degrees_of_freedom_start_as_those_on_them(frfs):
    """The same chain in coordinates of which none is the motion of a mass."""
    wrong = {"k": 8e3, "m": 1.6, "links": 0.7}
    plain = WORLD.chain(stiff_links=True, **wrong)
    turn = np.eye(WORLD.N) + 0.4 * np.random.default_rng(0).standard_normal((WORLD.N, WORLD.N))
    k0, _, m0 = WORLD.by_hand({"k": 0.0, "c": 0.0, "m": 0.0}, links=0.0)
    parts = [
        WORLD.by_hand({"k": k, "c": c, "m": m}, links=s)
        for k, c, m, s in ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    ]
    dampers = WORLD.by_hand({"k": 0.0, "c": 0.0, "m": 0.0})[1]

    def turned(matrix):
        return turn.T @ matrix @ turn

    model = calib.StructuralModel.from_matrices(
        {"k": turned(parts[0][0] - k0), "links": turned(parts[3][0] - k0)},
        {"m": turned(parts[2][2] - m0), "own": turned(m0)},
        {"c": turned(parts[1][1] - dampers), "dampers": turned(dampers)},
        dofs=pd.DataFrame({"node": range(1, WORLD.N + 1), "direction": "x"}),
        parameters=plain.space,
    )
    model = replace(model, dofs=replace(model.dofs, expansion=model.dofs.expansion @ sp.csr_array(turn)))
    rows = model.sensor_rows(frfs.responses)
    assert (np.count_nonzero(np.abs(rows) > 1e-3, axis=1) > 1).all()
    ours, theirs = problem_of(model, frfs), problem_of(plain, frfs)
    np.testing.assert_allclose(ours.fit_problem.pair.solve(TRUE), theirs.fit_problem.pair.solve(TRUE), rtol=1e-8)
    start = start_of(theirs)
    assert start_of(ours) == pytest.approx(start, rel=1e-6) and start["k"] != wrong["k"]


def test_errors_of_channels_stay_and_limits_hold(frfs):
    gain = ChannelError("gain", "3x", prior_sd=5.0)
    problem = problem_of(WORLD.chain(k=8e3), frfs, [gain])
    point = {**problem.space.values, "gain_3x": 1.25}
    start = linear_start(problem.fit_problem.pair, problem.space, point)
    assert start["gain_3x"] == 1.25 and set(start) == set(problem.space.names)
    assert abs(start["k"] / WORLD.TRUE["k"] - 1) < NEAR
    narrow = problem.space.replace("k", upper=9e3)
    assert linear_start(problem.fit_problem.pair, narrow, narrow.values)["k"] == 9e3


def test_only_free_parameters_are_moved(frfs):
    problem = problem_of(WORLD.chain(k=8e3, m=2.3, c=12.0), frfs).keep(["k"])
    start = start_of(problem)
    assert (start["m"], start["c"]) == (2.3, 12.0) and abs(start["k"] / WORLD.TRUE["k"] - 1) < NEAR


def test_the_quantity_does_not_matter(frfs):
    omega = 2j * np.pi * frfs.freq[:, None, None]
    start = start_of(problem_of(WORLD.chain(), frfs))
    for quantity, power in (("mobility", 1), ("receptance", 2)):
        other = replace(
            frfs, quantity=quantity, values=frfs.values / omega**power, std=frfs.std / np.abs(omega) ** power
        )
        # Lines near resonances are those of another curve.
        assert start_of(problem_of(WORLD.chain(), other)) == pytest.approx(start, rel=0.05, abs=1.0)


@pytest.mark.parametrize(
    "places",
    [
        {"responses": (3, 4), "references": (1,)},
        {"responses": (1, 3), "references": (1, 4)},  # of one reference alone the response at its place was measured
    ],
)
def test_there_is_none_without_a_response_at_every_reference(places):
    problem = problem_of(WORLD.chain(), WORLD.measured(1, **places))
    assert start_of(problem) is None and linear_starts(problem.fit_problem, problem.space.values) == ()
    assert set(problem.calibrate(starts=1, progress=False).values) == {"k", "c", "m"}  # from the nominal values


def test_there_is_none_for_sensors_that_measure_the_same_motion(frfs):
    twice = replace(
        frfs,
        responses=(Sensor(1, "x", (0.0, 0.0, 0.0)), Sensor(9, "x", (0.0, 0.0, 0.0)), Sensor(4, "x", (3.0, 0.0, 0.0))),
        references=(Sensor(1, "x", (0.0, 0.0, 0.0)), Sensor(4, "x", (3.0, 0.0, 0.0))),
    )
    rows = WORLD.chain().sensor_rows(twice.responses)
    assert np.array_equal(rows[0], rows[1])
    assert start_of(problem_of(WORLD.chain(), twice)) is None


def test_there_is_none_where_a_function_was_not_measured(frfs):
    values = frfs.values.copy()
    values[:, 1, 1] = np.nan
    assert start_of(problem_of(WORLD.chain(), replace(frfs, values=values))) is None


def test_there_is_none_where_nothing_is_free_but_channels(frfs):
    problem = problem_of(WORLD.chain(), frfs, [ChannelError("gain", "3x")]).keep(["gain_3x"])
    assert start_of(problem) is None


@pytest.mark.slow
def test_it_serves_every_test_of_frfs_of_a_joint_fit():
    """Each test sees one reference."""
    one, other = (WORLD.measured(seed, references=(q,)) for seed, q in ((1, 1), (2, 4)))
    tests = [calib.FRFTest(one, name="one"), calib.FRFTest(other, name="other")]
    problem = calib.Problem(WORLD.chain(stiff_links=True, k=6e3, m=1.2, links=0.6), tests)
    (start,) = linear_starts(problem.fit_problem, problem.space.values)
    assert all(abs(start[n] / TRUE[n] - 1) < 2 * NEAR for n in ("k", "m", "links"))
    fit = problem.calibrate(starts=1, progress=False)
    assert all(abs(fit.values[n] - true) < 4 * fit.parameters.loc[n, "std"] for n, true in TRUE.items())


def test_priors_decide_where_the_equations_say_nothing(frfs):
    """Two springs side by side: only their sum is seen, and equal priors hold their difference."""
    k0, c, m = WORLD.by_hand({**WORLD.TRUE, "k": 0.0})
    k1 = WORLD.by_hand({**WORLD.TRUE, "k": 1.0})[0] - k0
    model = calib.StructuralModel.from_matrices(
        {"rest": k0, "one": k1, "two": (k1, "two")}, m, c,
        dofs=[(n, "x") for n in range(1, WORLD.N + 1)],
        parameters=[calib.Parameter("one", 5e3, 1e3, 2e4, "N/m"), calib.Parameter("two", 4e3, 1e3, 2e4, "N/m")],
    )  # fmt: skip
    problem = problem_of(model, frfs)
    start = linear_start(problem.fit_problem.pair, problem.space, {"one": 3e3, "two": 7e3})
    assert abs((start["one"] + start["two"]) / WORLD.TRUE["k"] - 1) < NEAR
    assert start["one"] - start["two"] == pytest.approx(1e3, abs=20.0)


def test_it_linearises_again_where_matrices_are_not_linear(frfs):
    """The springs as the cube of a thickness, 25 % off: one linearisation leaves the thickness a tenth off."""
    k0, c, m = WORLD.by_hand(WORLD.TRUE, links=0.0)
    k1 = WORLD.by_hand(WORLD.TRUE)[0]
    model = calib.StructuralModel.from_matrices(
        {"rest": k0, "springs": (k1 - k0, {"h": 3})}, m, c,
        dofs=[(n, "x") for n in range(1, WORLD.N + 1)],
        parameters=[calib.Parameter("h", 0.75, 0.5, 2.0, "-")],
    )  # fmt: skip
    assert abs(start_of(problem_of(model, frfs))["h"] - 1) < 0.04


@pytest.mark.slow
def test_a_rejected_calibration_starts_further(frfs):
    """Without a drive point there is no linear start, and least squares from the nominal values end in a minimum."""
    few = frfs.without(["1x"], ["4x"])
    problem = problem_of(WORLD.chain(stiff_links=True, k=6e3, m=1.2, links=0.6), few)
    alone = fit_from(problem, problem.space.values)
    assert alone.fits is False
    fit = problem.calibrate(method="gauss-newton", starts=1, progress=False)
    assert fit.statistics.fits and fit.statistics.criterion < 0.1 * alone.criterion
    assert all(abs(fit.values[n] - true) < 4 * fit.parameters.loc[n, "std"] for n, true in TRUE.items())
    (note,) = (words for words in fit.calibration.notes if "further start" in words)
    assert f"{alone.criterion:.4g}" in note and f"{fit.statistics.criterion:.4g}" in note


def test_two_fits_at_the_lowest_sum_of_squares_are_enough():
    until = UntilLowestTwice()
    ends = [_end(3.0), None, _end(2.0), _end(2.0, converged=False), _end(2.05)]
    assert [until(ends[: k + 1]) for k in range(5)] == [False, False, False, False, True] and until.tried == 5


def _end(misfit, converged=True):
    return FitResult((), {}, misfit, 0.0, 1, 1, 1, converged, "", (), (), (), np.zeros(0), np.zeros((0, 0)))
