"""Starts from which many measured shapes are fitted: what their equations of motion lead to, and whole fits."""

import math
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.analyses.fit_statistics import fit_problem
from calib.hypotheses.modal_start import ENOUGH, modal_leap
from calib.inference.even_weights import EvenWeights
from calib.inference.integers import fit_mixed
from calib.measurement.modal import MeasuredModes, Sensor

BENCH = Path(__file__).resolve().parents[1] / "benchmarks"
N, ZONES, MODES = 120, 4, 24
TRUTH = {"k1": 1.2, "k2": 0.8, "k3": 1.1, "m1": 0.9}
FAR = ({"k1": 0.5, "k2": 2.0, "k3": 0.5, "m1": 2.0}, {"k1": 2.0, "k2": 0.5, "k3": 2.0, "m1": 0.5})


def bar(damped=False):
    """Masses in a row between walls: three zones of stiffness, and the mass of a half."""
    stretch = np.diff(np.vstack([np.zeros(N), np.eye(N), np.zeros(N)]), axis=0)
    zone = np.arange(N + 1) * 3 // (N + 1)
    parts = {f"k{k + 1}": 1e6 * stretch[zone == k].T @ stretch[zone == k] for k in range(3)}
    half = np.diag(np.where(np.arange(N) < N // 2, 1.0, 0.0))
    names = list(TRUTH)
    return calib.StructuralModel.from_matrices(
        parts, {"m1": half, "rest": np.eye(N) - half}, {"c": 0.5 * np.eye(N)} if damped else None,
        dofs=[(k + 1, "x") for k in range(N)],
        parameters=[calib.Parameter(name, 1.0, 0.5, 2.0, "-", prior_sd=0.3) for name in names],
    )  # fmt: skip


def measured(model, noise=0.0, sensors=N):
    modes = model.modes(model.space.complete(TRUTH), MODES)
    at = tuple(Sensor(k + 1, "x") for k in np.linspace(0, N - 1, sensors).round().astype(int).tolist())
    shapes, rng = model.sensor_rows(at) @ modes.shapes, np.random.default_rng(4)
    shapes = (shapes / np.abs(shapes).max(axis=0)).astype(complex)
    shapes += noise * rng.standard_normal(shapes.shape)
    freq, nothing = modes.natural_freq * (1 + 0.1 * noise * rng.standard_normal(MODES)), np.full(MODES, np.nan)
    names = tuple(str(k + 1) for k in range(MODES))
    std = np.full(shapes.shape, max(noise, 0.01))
    return MeasuredModes(names, freq, freq, 0.002 * freq, nothing, nothing, at, shapes, std)


@cache
def problem(noise=0.0, sensors=N, damped=False):
    model = bar(damped)
    return fit_problem(calib.Problem(model, calib.ModalTest(measured(model, noise, sensors))).study(), None)


class Unstructured:
    """A problem of a model without matrices."""

    pair = None


def far_off(values):
    return max(abs(math.log(values[name] / own)) for name, own in TRUTH.items())


@pytest.mark.parametrize("start", FAR)
def test_exact_shapes_lead_to_the_truth_from_far_away(start):
    posed = problem()
    begin = posed.space.complete(start)
    assert far_off(begin) > 0.5
    assert far_off(modal_leap(posed)(begin)) < ENOUGH


@pytest.mark.slow
def test_with_noise_all_starts_lead_to_one_place_near_the_truth():
    posed = problem(0.03)
    ends = [modal_leap(posed)(posed.space.complete(start)) for start in (*FAR, {})]
    assert max(map(far_off, ends)) < 0.05
    for end in ends[1:]:
        assert all(end[name] == pytest.approx(ends[0][name], rel=0.02) for name in TRUTH)


@pytest.mark.slow
def test_a_fit_begins_where_it_leads_and_ends_at_the_optimum_that_lies_there():
    posed = problem(0.03)
    first = EvenWeights.of(posed, modal_leap(posed))
    ends = [fit_mixed(posed, posed.space, [start], first=first).best for start in FAR]
    plain = [fit_mixed(posed, posed.space, [start]).best for start in FAR]
    assert ends[0].misfit == pytest.approx(ends[1].misfit, abs=1e-3)
    assert far_off(ends[0].values) < 0.02 and all(ends[0].misfit <= one.misfit + 1e-3 for one in plain)
    assert ends[0].evaluations < min(one.evaluations for one in plain)


def test_nothing_is_led_where_the_equations_cannot_be_posed():
    begin = problem().space.complete(FAR[0])
    few = problem(sensors=1)
    assert modal_leap(few)(begin) == begin  # no mode can be told from another
    damped = problem(damped=True)
    assert modal_leap(damped)(begin) == begin
    assert modal_leap(Unstructured()) is None


@pytest.mark.whole
def test_five_hundred_sensors_and_a_hundred_modes():
    sys.path.insert(0, str(BENCH))
    try:
        import grillage as case
    finally:
        sys.path.remove(str(BENCH))
    model = case.grillage(26)
    fit = calib.Problem(model, calib.ModalTest(case.measured(model, 500, 100))).calibrate()
    names = model.space.names
    true = dict(zip(names, np.random.default_rng(500).uniform(0.8, 1.25, len(names)), strict=True))
    off = [(fit.values[name] - value) / fit.parameters["std"][name] for name, value in true.items()]
    assert np.max(np.abs(off)) < 4 and fit.parameters["identified"].all()
