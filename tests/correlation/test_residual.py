"""The whitened residual: its rows, and its derivatives against central differences."""

import dataclasses

import numpy as np
import pytest

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.rows import ModalRow
from calib.correlation.standard_deviations import Floors, std_for
from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.effects.attach import maxwell_branches
from calib.structure.effects.extend import extend

TRUTH = {"k_along": 52.0, "k_across": 9.0, "c_end": 800.0, "mass": 11.0}
AWAY = {"k_along": 50.0, "k_across": 9.4, "c_end": 900.0, "mass": 10.5}
NAMES = ("k_along", "k_across", "c_end", "mass")


def made(build, twin, count=8, **options):
    model = build(damped=options.pop("damped", True))
    measured = twin(model, TRUTH, **options)
    return ModalResidual(ModalProblem(model, measured, mode_count=count))


def numeric(residual, values, step=1e-5):
    columns = []
    for name in NAMES:
        half = step * values[name]
        ends = [residual.residual({**values, name: values[name] + s * half}) for s in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * half))
    return np.column_stack(columns)


def test_rows_and_a_perfect_model(build, twin):
    residual = made(build, twin)
    assert residual.n_rows == 4 + 4 + 2 * 4 * 12
    assert residual.rows[0] == ModalRow("M1", "frequency")
    assert residual.rows[5] == ModalRow("M2", "damping")
    assert residual.rows[8] == ModalRow("M1", "shape", "1x", "re")
    assert residual.rows[8 + 12] == ModalRow("M1", "shape", "1x", "im")
    assert residual.n_fitted_factors == 8
    np.testing.assert_allclose(residual.residual(TRUTH), 0.0, atol=1e-6)
    away = residual.residual(AWAY)
    modes, measured = residual.problem.compare(AWAY), residual.problem.measured
    np.testing.assert_allclose(away[:4] * residual.std.freq, -np.log1p(modes.freq_error))
    ratio = modes.paired(modes.modes.damping_ratio) / measured.damping_ratio
    np.testing.assert_allclose(away[4:8] * residual.std.damping, -np.log(ratio))
    np.testing.assert_array_equal(residual.kinds == "shape", np.arange(residual.n_rows) >= 8)


def test_a_parameter_under_a_square_root_has_a_derivative_at_0(build, twin):
    """A Maxwell branch: its coupling grows with the square root of its stiffness k, the modes with k."""
    model = build()
    row = np.eye(model.n_dof)[3] - np.eye(model.n_dof)[9]
    magnitude, corner = Parameter("k", 0.0, 0.0, 5.0, "kN/m", prior_sd=1.0), Parameter("f", 2.0, 0.5, 9.0, "Hz")
    branch = Effect(
        "k", "k", "", "", magnitude, lambda m: maxwell_branches([row], "k", "f"), (corner,), ({"k": 1.0, "f": 2.0},)
    )
    problem = ModalProblem(extend(model, [branch]), twin(model, TRUTH), mode_count=9)
    residual = ModalResidual(problem)
    assert problem.model.roots == {"k"} and residual.regular(AWAY, ["mass"]) == problem.space.complete(AWAY)
    slope = residual.jacobian(AWAY, ["k", "mass"])
    at, beside = (residual.residual({**AWAY, "k": k}) for k in (0.0, 1e-3))
    assert slope[:, 0] @ at == pytest.approx((beside @ beside - at @ at) / 2e-3, rel=5e-3)  # that is exact
    np.testing.assert_allclose(slope[:, 1], residual.jacobian(AWAY, ["mass"])[:, 0], rtol=1e-3, atol=1e-2)
    assert np.abs(slope[:, 0]).max() > 1.0
    assert np.isfinite(residual.frequencies(AWAY, ["k"], residual.solve)[2]).all()


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("real", [True, False])
def test_jacobian_at_full_agreement(build, twin, damped, real):
    residual = made(build, twin, damped=damped, real=real)
    parts = 1 if real or not damped else 2
    assert residual.n_rows == 4 + (4 if damped else 0) + parts * 4 * 12
    if real and damped:
        # A complex model never meets a real shape exactly; what is compared then is the projected derivative.
        values = {**TRUTH, "c_end": 1e-3}
        residual = ModalResidual(
            dataclasses.replace(residual.problem, measured=twin(build(), values, real=True)), use_damping=False
        )
    else:
        values = TRUTH
    # Zero or very small damping has no accurate difference to compare with.
    pick = [0, 1, 2, 3] if damped and not real else [0, 1, 3]
    found, expected = residual.jacobian(values, NAMES), numeric(residual, values)
    scale = np.abs(expected[:, pick]).max(axis=0)
    assert scale.min() > 0
    np.testing.assert_allclose(found[:, pick] / scale, expected[:, pick] / scale, atol=1e-4)


@pytest.mark.parametrize("real", [True, False])
def test_gradient_is_exact_far_from_agreement(build, twin, real):
    residual = made(build, twin, noise=0.05, real=real)
    assert residual.residual(AWAY) @ residual.residual(AWAY) > 50
    found = residual.jacobian(AWAY, NAMES).T @ residual.residual(AWAY)
    for q, name in enumerate(NAMES):
        half = 1e-5 * AWAY[name]
        ends = [residual.residual({**AWAY, name: AWAY[name] + s * half}) for s in (1, -1)]
        assert found[q] == pytest.approx((ends[0] @ ends[0] - ends[1] @ ends[1]) / (4 * half), rel=1e-5, abs=1e-6)


def test_scale_and_phase_of_shapes_do_not_matter(build, twin):
    residual = made(build, twin, noise=0.05)
    measured = residual.problem.measured
    rotated = dataclasses.replace(measured, shapes=measured.shapes * np.exp(1j * np.arange(4)))
    other = ModalResidual(dataclasses.replace(residual.problem, measured=rotated))
    a, b = residual.residual(AWAY), other.residual(AWAY)
    assert a @ a == pytest.approx(b @ b, rel=1e-9)
    ja, jb = residual.jacobian(AWAY, NAMES), other.jacobian(AWAY, NAMES)
    np.testing.assert_allclose(ja.T @ ja, jb.T @ jb, rtol=1e-8)


def test_missing_entries_are_left_out(build, twin):
    residual = made(build, twin)
    measured = residual.problem.measured
    shapes, ratio = measured.shapes.copy(), measured.damping_ratio.copy()
    shapes[3, 1] = np.nan
    shapes[1:, 2] = np.nan  # a single sensor carries no information
    ratio[0], ratio[1] = np.nan, 0.0
    part = dataclasses.replace(measured, shapes=shapes, damping_ratio=ratio)
    problem = dataclasses.replace(residual.problem, measured=part, override={"M3": 3})
    less = ModalResidual(problem)
    assert less.n_rows == 4 + 2 + 2 * (12 + 11 + 12)
    assert ModalRow("M2", "shape", "2y", "im") not in less.rows
    assert np.isfinite(less.residual(AWAY)).all()
    assert less.jacobian(AWAY, NAMES).shape == (less.n_rows, 4)


def test_an_unpaired_mode_costs_more_than_any_partner(build, twin):
    residual = made(build, twin)
    wrong = dataclasses.replace(residual.problem, freq_window=(0.0, 0.5 * residual.problem.measured.natural_freq[-1]))
    narrow = ModalResidual(wrong)
    lost = narrow.problem.compare(TRUTH).pairing.unpaired_measured
    assert len(lost)
    assert narrow.rows == residual.rows
    vector = narrow.residual(TRUTH)
    assert vector[lost[0]] == pytest.approx(1 / narrow.std.freq[lost[0]])
    mine = [k for k, row in enumerate(narrow.rows) if row.mode == narrow.problem.measured.names[lost[0]]]
    np.testing.assert_array_equal(narrow.jacobian(TRUTH, NAMES)[mine], 0.0)
    assert vector @ vector > 100 * (residual.residual(AWAY) @ residual.residual(AWAY)) / residual.n_rows


def test_frequency_rows(build, twin):
    residual = made(build, twin, order=(2, 0, 1))
    labels, freq, jacobian = residual.frequencies(AWAY, NAMES, residual.solve)
    assert labels == ("M2", "M3", "M1", "model 4", "model 5", "model 6", "model 7", "model 8")
    np.testing.assert_allclose(freq, residual.problem.compare(AWAY).modes.natural_freq)
    whole = residual.jacobian(AWAY, NAMES)[:3] * residual.std.freq[:, None]
    np.testing.assert_allclose(jacobian[[2, 0, 1]], -whole)
    # All stiffness and mass together: every undamped frequency depends on their ratio only.
    undamped = made(build, twin, damped=False)
    _, _, slope = undamped.frequencies(AWAY, ("mass",), undamped.solve)
    np.testing.assert_allclose(slope[:, 0], -0.5 / AWAY["mass"], rtol=1e-9)


# -- standard deviations -----------------------------------------------------------------------------------------------


def with_std(build, twin, repeats):
    measured = twin(build(), TRUTH, noise=0.02)
    rng = np.random.default_rng(3)
    return dataclasses.replace(
        measured,
        n_repeats=repeats,
        freq_std=measured.natural_freq * rng.uniform(0.001, 0.01, 4),
        damping_std=measured.damping_ratio * rng.uniform(0.02, 0.1, 4),
        shape_std=rng.uniform(0.01, 0.03, measured.shapes.shape),
    )


def widened(repeats):
    """Widening factor of a standard deviation from so many repeats (JCGM 101:2008, 6.4.9.4)."""
    return np.sqrt((repeats - 1) / (repeats - 3))


def test_few_repeats_are_pooled_and_many_are_not(build, twin):
    few, many = with_std(build, twin, 5), with_std(build, twin, 100)
    none = Floors(freq=0.0, damping=0.0, shape=0.0)
    pooled, single = std_for(few, none), std_for(many, none)
    np.testing.assert_allclose(single.freq, widened(100) * many.freq_std / many.natural_freq)
    np.testing.assert_allclose(single.shape, widened(100) * many.shape_std)
    np.testing.assert_allclose(pooled.freq, np.sqrt(np.mean((many.freq_std / many.natural_freq) ** 2)))
    np.testing.assert_allclose(pooled.damping, np.sqrt(np.mean((single.damping / widened(100)) ** 2)))
    np.testing.assert_allclose(pooled.shape, np.sqrt(np.sum(many.shape_std**2) / (4 * 11)))
    given = with_std(build, twin, 1)  # by a file
    np.testing.assert_allclose(std_for(given, none).freq, given.freq_std / given.natural_freq)
    own = std_for(few, none, pool=False).freq
    np.testing.assert_allclose(own, widened(5) * few.freq_std / few.natural_freq)


def test_floors_and_unknown_std(build, twin):
    many = with_std(build, twin, 100)
    floors = Floors(freq=0.003, damping=0.04, shape=0.01)
    own = widened(100) * many.freq_std / many.natural_freq
    np.testing.assert_allclose(std_for(many, floors).freq, np.hypot(own, 0.003))
    bare = twin(build(), TRUTH)
    unknown = std_for(bare)
    np.testing.assert_allclose(unknown.freq, np.hypot(5e-3, 2e-4))
    np.testing.assert_allclose(unknown.damping, np.hypot(0.10, 0.02))
    np.testing.assert_allclose(unknown.shape, np.hypot(0.03, 5e-3))
    part = dataclasses.replace(many, freq_std=np.array([np.nan, 0.1, 0.1, 0.1]))
    assert np.isfinite(std_for(part).freq).all()
    with pytest.raises(InputError, match="unknown_freq is 0"):
        Floors(unknown_freq=0.0)
