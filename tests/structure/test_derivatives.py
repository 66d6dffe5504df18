"""Analytic derivatives against central differences, closed forms and invariances."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.execution.tasks import shared_by, unreported
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial, Term, parameter
from calib.structure.eigenproblem import derivatives, mode_systems
from calib.structure.eigenproblem.derivatives import beside_roots, eigen_derivatives, eigenvalues, mode_derivatives
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.modes import Modes
from models.railway import bogie_on_rig

N = 7


@dataclass(frozen=True)
class Small:
    """Seven masses with every kind of coefficient; dense or sparse."""

    space: ParameterSpace
    stiffness: AffineMatrix
    damping: AffineMatrix
    mass: AffineMatrix
    dense: bool

    def _shown(self, matrix):
        return matrix.toarray() if self.dense else matrix

    def matrices(self, values):
        si = self.space.si(self.space.complete(values))
        return tuple(self._shown(m(si)) for m in (self.stiffness, self.damping, self.mass))

    def matrix_derivatives(self, values, name):
        si, factor = self.space.si(self.space.complete(values)), self.space[name].si_factor
        return tuple(self._shown(m.derivative(si, name) * factor) for m in (self.stiffness, self.damping, self.mass))

    def modes(self, values, count):
        si = self.space.si(self.space.complete(values))
        c = self.damping(si)
        return solve_modes(self.stiffness(si), None if self.damping.is_zero else c, self.mass(si), count)


def random_matrix(rng, rank, scale):
    b = rng.standard_normal((N, rank))
    return sp.csr_array(scale * b @ b.T)


def small(seed: int, damped: bool = True, dense: bool = True) -> Small:
    rng = np.random.default_rng(seed)
    space = ParameterSpace(
        (
            Parameter("k", 3.0, 1.0, 9.0, "kN/m"),
            Parameter("E", 70.0, 50.0, 90.0, "GPa"),
            Parameter("h", 2.0, 1.0, 3.0, "mm"),
            Parameter("c", 1.0 if damped else 0.0, 0.0, 3.0, "kNs/m"),
            Parameter("m", 2.0, 0.0, 5.0, "kg"),
            Parameter("place", 1.0, 0.0, 2.0, integer=True),
        )
    )
    plate = Monomial(1e-9, (("E", 1.0), ("h", 3.0)))
    return Small(
        space,
        AffineMatrix(
            N,
            (
                Term("ground", random_matrix(rng, N, 400.0)),
                Term("spring", random_matrix(rng, 2, 1.0), parameter("k")),
                Term("plate", random_matrix(rng, 3, 1e9), plate),
            ),
        ),
        AffineMatrix(N, (Term("damper", random_matrix(rng, 2, 2e-3), parameter("c")),) if damped else ()),
        AffineMatrix(
            N,
            (
                Term("own", sp.csr_array(np.diag(rng.uniform(1, 3, N)))),
                Term("added", random_matrix(rng, 1, 0.3), parameter("m")),
                Term("sheet", random_matrix(rng, 2, 100.0), parameter("h")),
            ),
        ),
        dense,
    )


def one_sign(modes: Modes, reference: np.ndarray) -> np.ndarray:
    return modes.shapes * np.sign(np.sum(reference.conj() * modes.shapes, axis=0).real)


def differences(model, values, modes, name, half, count):
    """Central differences of fourth order, of everything that has a derivative."""
    ends = {s: model.modes({**values, name: values[name] + s * half}, modes.n_modes) for s in (2, 1, -1, -2)}
    quantities = (
        eigenvalues,
        lambda m: one_sign(m, modes.shapes),
        lambda m: m.natural_freq,
        lambda m: m.damped_freq,
        lambda m: m.damping_ratio,
    )
    return tuple(
        (8 * (f(ends[1]) - f(ends[-1])) - (f(ends[2]) - f(ends[-2])))[..., :count] / (12 * half) for f in quantities
    )


def close(found, expected, rel):
    """Equal within a fraction of the largest entry of a column."""
    scale = np.max(np.abs(expected), axis=0)
    np.testing.assert_allclose(found / np.where(scale, scale, 1), expected / np.where(scale, scale, 1), atol=rel)


@pytest.mark.mostly_slow(3)
@pytest.mark.parametrize(("dense", "limit"), [(True, N), (False, N), (False, N - 1)])
@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("seed", [0, 1, 3])  # of seed 2 two modes are 0.06 % apart and cross within the step
def test_every_kind_of_parameter_on_random_systems(monkeypatch, seed, damped, dense, limit):
    monkeypatch.setattr(derivatives, "DENSE_LIMIT", limit)
    model = small(seed, damped, dense)
    values = model.space.values
    modes = model.modes(values, N)
    names = ("k", "E", "h", "m", *(("c",) if damped else ()))
    found = mode_derivatives(model, values, modes, names)
    assert found.regular.all()
    assert np.iscomplexobj(found.shapes) == damped
    for q, name in enumerate(names):
        half = 1e-3 * values[name]
        expected = differences(model, values, modes, name, half, modes.n_modes)
        parts = (found.eigenvalue, found.shapes, found.natural_freq, found.damped_freq, found.damping_ratio)
        for part, target in zip(parts, expected, strict=True):
            close(part[q], target, 5e-6)


@pytest.mark.slow
def test_the_bogie_at_full_order():
    model = bogie_on_rig()
    values = {**model.space.values, "K_primary": 700.0}
    modes = model.modes(values, 10)
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((5, model.n_dof))
    names = ("K_primary", "c_primary", "m_girder_centre", "E_wood")
    found = mode_derivatives(model, values, modes, names, range(8), rows)
    assert found.shapes.shape == (4, 5, 8)
    assert found.regular.all()
    for q, name in enumerate(names):
        expected = differences(model, values, modes, name, 1e-3 * values[name], 8)
        close(found.eigenvalue[q], expected[0], 1e-6)
        close(found.shapes[q], rows @ expected[1], 5e-5)  # iterated to a residual of 5e-7 of the forces
        close(found.natural_freq[q], expected[2], 1e-6)
        close(found.damping_ratio[q], expected[4], 1e-6)


def test_modes_and_rows_are_selected():
    model = small(3)
    modes = model.modes({}, N)
    rows = np.eye(N)[[4, 1]]
    whole = mode_derivatives(model, {}, modes, ("k", "place"))
    some = mode_derivatives(model, {}, modes, ("k", "place"), [5, 2], rows)
    np.testing.assert_allclose(some.shapes, whole.shapes[:, [4, 1]][:, :, [5, 2]], rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(some.eigenvalue, whole.eigenvalue[:, [5, 2]])
    assert not np.any(some.shapes[1]) and not np.any(some.eigenvalue[1])  # integers count as fixed
    bare = mode_derivatives(model, {}, modes, ("k", "place"), [5, 2], np.zeros((0, N)))
    np.testing.assert_allclose(bare.natural_freq, some.natural_freq)
    assert bare.shapes.shape == (2, 0, 2)


def test_a_damper_on_an_undamped_model():
    """Half the modal damping over omega, the textbook ratio; the shape becomes complex."""
    rng = np.random.default_rng(5)
    k, c, m = (random_matrix(rng, N, 1.0) + sp.csr_array(np.eye(N) * x) for x in (5.0, 0.1, 1.0))
    zero = sp.csc_array((N, N))
    modes = solve_modes(sp.csc_array(k), None, sp.csc_array(m), N)
    found = eigen_derivatives(k, zero, m, [(zero, c, zero)], modes, ("c",))
    omega = 2 * np.pi * modes.natural_freq
    modal = np.einsum("ij,ij->j", modes.shapes, c @ modes.shapes)
    np.testing.assert_allclose(found.damping_ratio[0], modal / (2 * omega))
    np.testing.assert_allclose(found.natural_freq[0], 0.0, atol=1e-12)
    small_c = 1e-4
    damped = solve_modes(sp.csc_array(k), sp.csc_array(small_c * c), sp.csc_array(m), N)
    for i in range(N):  # the complex shape, scaled to the real one
        shape = damped.shapes[:, i]
        scale = (modes.shapes[:, i] @ m @ modes.shapes[:, i]) / (modes.shapes[:, i] @ m @ shape)
        np.testing.assert_allclose((shape * scale).imag / small_c, found.shapes[0, :, i].imag, atol=1e-3)


def nearly_repeated(gap: float, damped: bool) -> tuple:
    """Two oscillators of nearly equal frequency, mixed by a rotation, beside a third one."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    k = turn @ np.diag([100.0, 100.0 * (1 + gap), 300.0]) @ turn.T
    c = turn @ np.diag([1.0, 1.0, 2.0]) @ turn.T * (1.0 if damped else 0.0)
    dk = turn @ np.array([[1.0, 0.5, 0.2], [0.5, 2.0, 0.3], [0.2, 0.3, 1.0]]) @ turn.T
    modes = solve_modes(sp.csc_array(k), sp.csc_array(c) if damped else None, sp.csc_array(np.eye(3)), 3)
    return k, c, np.eye(3), dk, modes


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("gap", [1e-1, 1e-3, 1e-5])
def test_close_modes_lose_no_digits(gap, damped):
    """The sum over all modes is exact here; the bordered solve must agree with it however close they are."""
    k, c, m, dk, modes = nearly_repeated(gap, damped)
    zero = np.zeros((3, 3))
    found = eigen_derivatives(k, c, m, [(dk, zero, zero)], modes, ("k",))
    assert found.regular.all()
    lam, shapes = eigenvalues(modes), modes.shapes
    if damped:
        lam, shapes = np.concatenate([lam, lam.conj()]), np.hstack([shapes, shapes.conj()])
    for i in range(3):
        own = shapes[:, i]
        force = dk @ own
        apart = lam[i] - lam if damped else (lam[i] ** 2 - lam**2).real
        expected = sum(-shapes[:, j] * (shapes[:, j] @ force) / apart[j] for j in range(len(lam)) if j != i)
        # The component along the shape itself follows from the normalisation.
        if damped:
            scale = (own @ force) * (own @ own) - (2 * lam[i] * m + c) @ own @ expected
            expected = expected + scale * own
        np.testing.assert_allclose(found.shapes[0, :, i], expected, rtol=1e-5, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("damped", [True, False])
def test_a_repeated_eigenvalue_is_flagged(damped):
    k, c, m, dk, modes = nearly_repeated(0.0, damped)
    zero = np.zeros((3, 3))
    found = eigen_derivatives(k, c, m, [(dk, zero, zero), (k, zero, zero)], modes, ("k", "all"))
    assert found.regular.tolist() == [False, False, True]
    assert np.isnan(found.shapes[:, :, :2]).all() and np.isfinite(found.shapes[:, :, 2]).all()
    # The mean over the pair does not depend on the choice of its shapes.
    h = 1e-4
    ends = [
        solve_modes(sp.csc_array(k + s * h * dk), sp.csc_array(c) if damped else None, sp.csc_array(m), 3)
        for s in (1, -1)
    ]
    mean = np.mean((ends[0].natural_freq - ends[1].natural_freq)[:2]) / (2 * h)
    np.testing.assert_allclose(found.natural_freq[0, :2], mean, rtol=1e-5)
    # A parameter that does not split the pair leaves the mode regular.
    whole = eigen_derivatives(k, c, m, [(k, zero, zero)], modes, ("all",))
    assert whole.regular.all() and np.isfinite(whole.shapes).all()


def test_scaling_all_matrices_changes_the_scale_only():
    """Scaling K, C and M together leaves eigenvalues; the derivative of a shape is -1/2 of itself."""
    model = small(4)
    k, c, m = model.matrices({})
    modes = model.modes({}, N)
    found = eigen_derivatives(k, c, m, [(k, c, m)], modes, ("all",))
    np.testing.assert_allclose(found.eigenvalue, 0.0, atol=1e-8 * np.abs(eigenvalues(modes)).max())
    np.testing.assert_allclose(found.shapes[0], -0.5 * modes.shapes, rtol=1e-6, atol=1e-8 * np.abs(modes.shapes).max())


@pytest.mark.parametrize("damped", [True, False])
def test_without_parameters_there_are_no_derivatives(damped):
    model = small(3, damped)
    values = model.space.values
    found = mode_derivatives(model, values, model.modes(values, 4), ())
    assert found.eigenvalue.shape == found.natural_freq.shape == (0, 4) and found.shapes.shape == (0, N, 4)
    assert found.regular.all()


def test_unknown_names_are_refused():
    model = small(0)
    modes = model.modes({}, 3)
    with pytest.raises(InputError, match="unknown parameter 'zeta'"):
        mode_derivatives(model, {}, modes, ("zeta",))
    with pytest.raises(InputError, match=r"outside 0\.\.2"):
        mode_derivatives(model, {}, modes, ("k",), [3])


def test_only_parameters_at_a_root_are_moved_and_within_their_limits():
    space = ParameterSpace(
        tuple(Parameter(n, 0.0, low, high) for n, low, high in (("a", 0, 4), ("b", -2, 0), ("c", 0, 1)))
    )
    roots, names = frozenset({"a", "b"}), ("a", "b", "c")
    assert beside_roots(space, roots, {}, names) == pytest.approx({"a": 4e-6, "b": -2e-6, "c": 0.0}, rel=1e-9)
    assert beside_roots(space, roots, {"a": 1.0}, ("a", "c")) == {"a": 1.0, "b": 0.0, "c": 0.0}


@pytest.mark.medium
def test_sparse_derivatives_are_the_same_whoever_shares_their_modes():
    model = bogie_on_rig()
    modes, rows = model.modes({}, 4), np.eye(model.n_dof)[[3, 40, 700]]
    done = []

    def elsewhere(function, shared, items, told=unreported):
        done.append(list(items))
        copies = [pickle.loads(pickle.dumps((shared, item))) for item in items]  # as another process gets them
        return [function(*copy) for copy in reversed(copies)][::-1]

    names = ["K_primary", "c_primary"]
    own = mode_derivatives(model, {}, modes, names, [0, 2, 3], rows)
    with shared_by(elsewhere):
        other = mode_derivatives(model, {}, modes, names, [0, 2, 3], rows)
        mode_derivatives(model, {}, modes, names, [1], rows[:0])  # without shapes nothing is worth sending
    assert [sorted(j for _, some in tasks for j in some) for tasks in done] == [[0, 2, 3]]
    assert {shift is None for shift, _ in done[0]} == {True, False}  # solved together, and by a factor with a border
    for field in ("eigenvalue", "shapes", "natural_freq", "damping_ratio", "regular"):
        assert getattr(own, field).tobytes() == getattr(other, field).tobytes()


@pytest.mark.parametrize("damped", [True, False])
def test_products_of_all_modes_at_once_are_those_one_by_one(monkeypatch, damped):
    model = small(1, damped)
    modes, names = model.modes(model.space.values, N), ("k", "E", "h", "c", "m")
    at_once = mode_derivatives(model, {}, modes, names, [4, 0, 2])
    monkeypatch.setattr(mode_systems, "_AT_ONCE", 0)
    alone = mode_derivatives(model, {}, modes, names, [4, 0, 2])
    close(at_once.eigenvalue.T, alone.eigenvalue.T, 1e-13)
    close(at_once.shapes.reshape(-1, 3), alone.shapes.reshape(-1, 3), 1e-11)


@pytest.mark.parametrize("at_once", [0, 10**6])
def test_modes_of_a_small_model_are_shared_too_and_no_digit_changes(monkeypatch, at_once):
    monkeypatch.setattr(mode_systems, "_AT_ONCE", at_once)
    model, done = small(1), []
    modes, rows = model.modes(model.space.values, N), np.eye(N)[:3]

    def elsewhere(function, shared, items, told=unreported):
        done.append(len(items))
        there, task = pickle.loads(pickle.dumps((function, shared)))
        return [there(task, item) for item in reversed(items)][::-1]

    own = mode_derivatives(model, {}, modes, ("k", "c", "m"), [4, 0, 2], rows)
    with shared_by(elsewhere):
        other = mode_derivatives(model, {}, modes, ("k", "c", "m"), [4, 0, 2], rows)
    assert done == [3]
    for field in ("eigenvalue", "shapes", "natural_freq", "damping_ratio", "regular"):
        assert getattr(own, field).tobytes() == getattr(other, field).tobytes()
