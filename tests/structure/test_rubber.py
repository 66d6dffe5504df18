"""Relaxing and lossy parts against closed forms: the cubic of one mass, a law of constant loss, lines of FRFs."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial
from calib.structure.amplitude import amplitude_terms, level, with_level
from calib.structure.anywhere import at_one_of
from calib.structure.effects.attach import scaled_part, softened_part
from calib.structure.effects.extend import Addition, extend
from calib.structure.eigenproblem.derivatives import mode_derivatives
from calib.structure.elongations import MOST_MOTIONS, elongations
from calib.structure.frf import frf
from calib.structure.model import Part, StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.relaxation import ConstantLoss, Graded, lossy_parts, relaxing_parts
from calib.structure.rubber import relaxing_rubber, structural_damping

MASS, STIFF = 3.0, 3.0 * (2 * np.pi * 14.0) ** 2
BAND = (5.0, 50.0)


def one_mass():
    spring = Parameter("k", STIFF / 1e3, 0.1, 1e3, "kN/m")
    one = np.eye(1)
    return StructuralModel.from_matrices({"k": one}, MASS * one, dofs=[(1, "x")], parameters=[spring])


def three_masses():
    """The link between masses 1 and 2 depends on two parameters; mass 3 hangs at 2, and 1 on the ground."""
    ground, last = np.diag([4e4, 0.0, 0.0]), np.array([[0.0, 0, 0], [0, 1, -1], [0, -1, 1]])
    link = np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]])
    parameters = [
        Parameter("e", 2.0, 0.5, 8.0), Parameter("t", 10.0, 5.0, 20.0, "mm"),
        Parameter("k", 9.0, 1.0, 50.0, "kN/m"), Parameter("c", 3.0, 1.0, 50.0, "Ns/m"),
    ]  # fmt: skip
    return StructuralModel.from_matrices(
        {"ground": ground, "link": (3e10 * link, {"e": 1.0, "t": 3.0}), "last": (last, "k")},
        {"all": np.diag([2.0, 1.0, 0.5])}, {"damper": (ground / 4e4, "c")},
        dofs=[(1, "x"), (2, "x"), (3, "x")], parameters=parameters,
    )  # fmt: skip


def lossy(model, parts, band=BAND, most=0.6):
    size = Parameter("eta", 0.0, 0.0, most, prior_sd=0.1)
    return extend(model, [Effect("eta", "loss", "", "", size, lambda m: lossy_parts(m, parts, "eta", band))])


def relaxing(model, parts):
    corner = Parameter("corner", 9.0, 1.0, 90.0, "Hz")
    size = Parameter("x", 0.0, 0.0, 5.0, prior_sd=0.3)
    build = lambda m: relaxing_parts(m, parts, "x", "corner")  # noqa: E731
    return extend(model, [Effect("x", "rubber", "", "", size, build, (corner,), ({"x": 0.3, "corner": 9.0},))])


def eigenvalues(modes):
    return 2 * np.pi * (1j * modes.damped_freq - modes.damping_ratio * modes.natural_freq)


def condensed(model, values, lam, n):
    """Dynamic stiffness of the model's own motions."""
    k, c, m = (matrix.toarray() for matrix in model.matrices(values))
    z = k + lam * c + lam**2 * m
    return z[:n, :n] - z[:n, n:] @ np.linalg.solve(z[n:, n:], z[n:, :n])


# -- the standard linear solid -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [1e-3, 0.3, 2.0, 4.9])
@pytest.mark.parametrize("corner", [1.0, 14.0, 80.0])
def test_one_mass_on_a_relaxing_spring_has_the_roots_of_its_cubic(share, corner):
    """``m l^3 + m w l^2 + k (1 + x) l + k w = 0``: one pair, and one root that relaxes."""
    w = 2 * np.pi * corner
    roots = np.roots([MASS, MASS * w, STIFF * (1 + share), STIFF * w])
    modes = relaxing(one_mass(), ["k"]).modes({"x": share, "corner": corner}, 1)
    np.testing.assert_allclose(eigenvalues(modes), roots[roots.imag > 0], rtol=1e-9)
    relaxed = roots[abs(roots.imag) < 1e-9 * abs(roots)].real
    assert len(relaxed) == 1
    k, c, m = (a.toarray() for a in relaxing(one_mass(), ["k"]).matrices({"x": share, "corner": corner}))
    assert la.det(k + relaxed[0] * c + relaxed[0] ** 2 * m) == pytest.approx(0.0, abs=1e-9 * STIFF)


def test_the_largest_loss_of_a_relaxing_part_is_where_zener_has_it():
    share, corner = 0.8, 9.0
    freq = np.linspace(1.0, 30.0, 3000)
    model, values = relaxing(one_mass(), ["k"]), {"x": share, "corner": corner}
    stiff = frf(model, values, freq, np.eye(2)[:1], np.eye(2)[:1])[:, 0, 0]
    stiff = 1 / stiff + MASS * (2 * np.pi * freq) ** 2
    loss = stiff.imag / stiff.real
    assert freq[loss.argmax()] == pytest.approx(corner / np.sqrt(1 + share), abs=0.02)
    assert loss.max() == pytest.approx(share / (2 * np.sqrt(1 + share)), rel=1e-5)


def test_parts_relax_with_the_parameters_of_their_stiffness():
    model, base = relaxing(three_masses(), ["link", "last"]), three_masses()
    values = {"x": 0.7, "corner": 6.0, "e": 3.0, "t": 8.0, "k": 20.0}
    link, last = 3e10 * 3.0 * 8e-3**3, 20e3
    for lam in (0.2j, 30j - 2, 400j):
        more = 0.7 * lam / (lam + 2 * np.pi * 6.0)
        b, d = np.array([1.0, -1, 0]), np.array([0.0, 1, -1])
        expected = condensed(base, {n: v for n, v in values.items() if n in base.space}, lam, 3)
        expected = expected + more * (link * np.outer(b, b) + last * np.outer(d, d))
        np.testing.assert_allclose(condensed(model, values, lam, 3), expected, rtol=1e-9, atol=1e-9 * link)


@pytest.mark.parametrize("order", [("at once",), ("loss", "change"), ("change", "loss")])
@pytest.mark.parametrize("change", ["softening", "scaled", "flexibility", "one of two"])
def test_the_loss_of_a_part_follows_its_stiffness_whatever_changes_it(order, change):
    """``K_changed (1 + G)``, not ``K_changed + K G``, for every order in which the effects are added."""
    size = Parameter("x", 0.0, 0.0, 0.9, "-", prior_sd=0.1)
    builds = {
        "softening": lambda m: amplitude_terms(m, ["link"], "stiffness", size, "level"),
        "scaled": lambda m: Addition(stiffness=(scaled_part(m, "stiffness", "link", "x", -0.7),)),
        "flexibility": lambda m: Addition(stiffness=(softened_part(m, "link", "x"),)),
        "one of two": lambda m: at_one_of(
            [Addition(stiffness=(scaled_part(m, "stiffness", name, "x", -0.5),)) for name in ("link", "last")], "at"
        ),
    }
    where = (Parameter("at", 1, 1, 2, "-", integer=True),) if change == "one of two" else ()
    effects = {
        "change": Effect(
            "x", "change", "", "", size, builds[change], where, ({"x": 0.3, **({"at": 1.0} if where else {})},)
        ),
        "loss": structural_damping("eta", "the link", ["link"], BAND),
    }
    model, base = with_level(three_masses(), level(1.0)), three_masses()
    for step in order:
        model = extend(model, [effects["loss"], effects["change"]] if step == "at once" else [effects[step]])
    x = 4e5 if change == "flexibility" else 0.7
    values = {"eta": 0.3, "x": x, "level": 1.0, "e": 3.0, "t": 8.0, "k": 20.0}
    link = 3e10 * 3.0 * 8e-3**3
    left = {"softening": 0.3, "scaled": 1 - 0.49, "flexibility": 1 / (1 + link / 3e10 * x), "one of two": 0.65}[change]
    for lam in (20j, 30j - 2, 400j):
        loss = ConstantLoss(*BAND)(0.3, np.array([lam]))[0]
        b = np.array([1.0, -1, 0])
        more = link * (left * (1 + loss) - 1) * np.outer(b, b)
        expected = condensed(base, {n: v for n, v in values.items() if n in base.space}, lam, 3) + more
        np.testing.assert_allclose(condensed(model, values, lam, 3), expected, rtol=1e-9, atol=1e-9 * link)
    k, c, m = (a.toarray() for a in model.matrices(values))
    n = len(k)
    massless = np.diag(m) == 0
    inverse = -np.block([[np.linalg.solve(k, c), np.linalg.solve(k, m)], [-np.eye(n), np.zeros((n, n))]])
    mu = la.eigvals(inverse)
    assert massless.any() and (1 / mu[np.abs(mu) > 1e-9 * np.abs(mu).max()]).real.max() < 1e-6
    for name in ("x", "eta", "e", "t"):
        step = 1e-5 * values[name]
        high, low = (model.matrices({**values, name: values[name] + s * step})[0].toarray() for s in (1, -1))
        slope = model.matrix_derivatives(values, name)[0].toarray()
        np.testing.assert_allclose((high - low) / (2 * step), slope, rtol=1e-6, atol=1e-6 * abs(slope).max())


def test_a_part_of_which_nothing_is_left_cannot_be_solved():
    size = Parameter("size", 0.0, -9.0, 9.0, prior_sd=0.1)
    build = lambda m: Addition(stiffness=(scaled_part(m, "stiffness", "k", "size"),))  # noqa: E731
    scale = Effect("size", "size", "", "", size, build)
    model = extend(relaxing(one_mass(), ["k"]), [scale])
    with pytest.raises(EvaluationError, match="nothing is left of the stiffness of 'k'"):
        model.matrices({"x": 0.3, "size": -2.0})


# -- constant loss -----------------------------------------------------------------------------------------------------


def law(eta, band, lam):
    """Stiffness over that at the middle of the band, of a material whose loss factor is exactly constant."""
    a = 2 / np.pi * np.arctan(eta)
    return (lam / (2 * np.pi * np.sqrt(band[0] * band[1]))) ** a / np.cos(a * np.pi / 2)


@pytest.mark.parametrize("decades", [0.2, 0.5, 1.0, 1.3, 1.7, 2.0, 3.0])
@pytest.mark.parametrize(("eta", "error"), [(0.01, 0.007), (0.1, 0.025), (0.3, 0.08)])
def test_the_loss_factor_is_constant_over_the_band_and_the_stiffness_that_of_the_law(decades, eta, error):
    band = (3.0, 3.0 * 10**decades)
    loss, freq = ConstantLoss(*band), np.geomspace(*band, 301)
    assert len(loss.corners) == max(np.ceil(3 * (decades + np.log10(4))), 2)
    stiffness = 1 + loss(eta, 2j * np.pi * freq)
    assert abs(stiffness.imag / stiffness.real / eta - 1).max() < error
    assert stiffness[150].real == pytest.approx(1.0, abs=1e-12) and np.all(np.diff(stiffness.real) > 0)
    assert abs(stiffness / law(eta, band, 2j * np.pi * freq) - 1).max() < eta * (0.04 + 0.25 * eta)


@pytest.mark.parametrize("eta", [0.001, 0.1, 0.5])
@pytest.mark.parametrize("freq", [6.0, 14.0, 45.0])
def test_one_mass_has_the_eigenvalue_of_its_dynamic_stiffness(eta, freq):
    loss, stiff = ConstantLoss(*BAND), MASS * (2 * np.pi * freq) ** 2
    lam = 2j * np.pi * freq
    for _ in range(400):  # fixed point of m l^2 = -k (1 + G(l))
        lam = 1j * np.sqrt(stiff * (1 + complex(loss(eta, lam))) / MASS)
    modes = lossy(one_mass(), ["k"]).modes({"k": stiff / 1e3, "eta": eta}, 1)
    np.testing.assert_allclose(eigenvalues(modes), [lam], rtol=1e-8)


@pytest.mark.parametrize(
    ("eta", "freq_error", "ratio_error"), [(0.02, 5e-4, 0.006), (0.1, 3e-3, 0.025), (0.3, 0.012, 0.08)]
)
def test_one_mass_has_the_mode_of_a_constant_loss_factor(eta, freq_error, ratio_error):
    """``m l^2 + k (l/w)^a/cos(a pi/2) = 0``: an eigenvalue at the angle ``pi/(2 - a)``, of one damping ratio."""
    model, a = lossy(one_mass(), ["k"]), 2 / np.pi * np.arctan(eta)
    middle = 2 * np.pi * np.sqrt(BAND[0] * BAND[1])
    for freq in np.geomspace(*BAND, 9):
        stiff = MASS * (2 * np.pi * freq) ** 2
        size = (stiff / MASS / np.cos(a * np.pi / 2) / middle**a) ** (1 / (2 - a))
        mode = model.modes({"k": stiff / 1e3, "eta": eta}, 1)
        assert 2 * np.pi * mode.natural_freq[0] == pytest.approx(size, rel=freq_error)
        assert mode.damping_ratio[0] == pytest.approx(-np.cos(np.pi / (2 - a)), rel=ratio_error)


@pytest.mark.parametrize("eta", [0.02, 0.1, 0.3])
def test_complex_stiffness_gives_the_same_damping_and_no_change_of_frequency(eta):
    """``K (1 + i eta)``, which is not causal: frequencies differ by ``(eta/pi) ln(f/f_m)`` of themselves."""
    model = lossy(one_mass(), ["k"])
    for freq in np.geomspace(*BAND, 9):
        stiff = MASS * (2 * np.pi * freq) ** 2
        exact = 1j * np.sqrt(stiff * (1 + 1j * eta) / MASS)
        (mode,) = eigenvalues(model.modes({"k": stiff / 1e3, "eta": eta}, 1))
        stiffer = eta / np.pi * np.log(freq / np.sqrt(BAND[0] * BAND[1]))
        assert abs(mode) / abs(exact) == pytest.approx(1 + stiffer, abs=0.05 * eta + 0.2 * eta**2)
        assert -mode.real / abs(mode) == pytest.approx(-exact.real / abs(exact), rel=0.006 + 0.5 * eta)


def test_shares_of_springs_have_exact_derivatives():
    for power, ratio in ((1.0, 0.3), (0.5, 4.0)):
        share = Graded("eta", 0.4, ratio, power)
        for eta in (0.05, 0.4):
            step = 1e-6
            slope = (share({"eta": eta + step}) - share({"eta": eta - step})) / (2 * step)
            assert share.derivative({"eta": eta}, "eta") == pytest.approx(slope, rel=1e-7)
    assert share.derivative({"eta": 0.1}, "other") == 0.0 and share({"eta": 0.0}) == 0.0
    assert Graded("eta", 0.4, 3.0).derivative({"eta": 0.0}, "eta") == pytest.approx(0.4)
    assert Graded("eta", 0.4, 3.0, 0.5).derivative({"eta": 0.0}, "eta") == np.inf


def test_functions_are_those_of_the_complex_stiffness_at_each_line():
    model, base, loss = lossy(three_masses(), ["link", "last"]), three_masses(), ConstantLoss(*BAND)
    freq, eta = np.geomspace(*BAND, 13), 0.25
    rows = np.eye(3, model.n_dof)
    found = frf(model, {"eta": eta}, freq, rows, rows[:2])
    k, c, m = (a.toarray() for a in base.matrices({}))
    lossy_part = k - np.diag([4e4, 0, 0])
    for line, there in zip(freq, found, strict=True):
        lam = 2j * np.pi * line
        z = k + complex(loss(eta, lam)) * lossy_part + lam * c + lam**2 * m
        np.testing.assert_allclose(there, np.linalg.inv(z)[:, :2], rtol=1e-8, atol=1e-9 * abs(there).max())


def test_a_part_of_many_motions_is_lossy_in_all_of_them():
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((3, 6))
    whole, ground = rows.T @ rows, np.diag(rng.uniform(1.0, 2.0, 6))
    model = StructuralModel.from_matrices(
        {"part": 2e4 * whole, "ground": 1e4 * ground}, np.eye(6), dofs=[(k, "x") for k in range(6)]
    )
    loss, lam, eta = ConstantLoss(*BAND), 60j - 3, 0.2
    expected = condensed(model, {}, lam, 6) + complex(loss(eta, lam)) * 2e4 * whole
    found = lossy(model, ["part"])
    assert found.n_dof == 6 + 3 * len(loss.corners)
    np.testing.assert_allclose(condensed(found, {"eta": eta}, lam, 6), expected, rtol=1e-8, atol=1e-6)


# -- as any other effect -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [lambda m: lossy(m, ["link", "last"]), lambda m: relaxing(m, ["link", "last"])])
def test_magnitude_zero_is_the_base_model_and_the_eigenproblem_stays_regular(make):
    base, model = three_masses(), make(three_masses())
    for own, bare in zip(model.matrices({}), base.matrices({}), strict=True):
        np.testing.assert_array_equal(own[:3, :3].toarray(), bare.toarray())
        assert own[:3, 3:].count_nonzero() == 0
    np.testing.assert_allclose(eigenvalues(model.modes({}, 3)), eigenvalues(base.modes({}, 3)), rtol=1e-9)
    assert model.modes({}, 4).n_modes == 3  # states of dampers are no modes


@pytest.mark.parametrize(
    ("make", "names", "point"),
    [
        (lambda m: lossy(m, ["link", "last"]), ("eta", "e", "t", "k"), {"eta": 0.15}),
        (lambda m: relaxing(m, ["link"]), ("x", "corner", "e"), {"x": 0.6, "corner": 7.0}),
    ],
)
def test_derivatives_of_modes_are_exact(make, names, point):
    model = make(three_masses())
    values = model.space.complete(point)
    modes = model.modes(values, 3)
    found = mode_derivatives(model, values, modes, names).eigenvalue
    for name, slope in zip(names, found, strict=True):
        step = 1e-5 * values[name]
        up, down = (eigenvalues(model.modes({**values, name: values[name] + s * step}, 3)) for s in (1, -1))
        np.testing.assert_allclose(slope, (up - down) / (2 * step), rtol=1e-5, atol=1e-7 * abs(slope).max())


def test_a_reduced_model_has_the_same_modes(ladder):
    """A basis of all the model's own motions, beside the states of the dampers."""
    full = ladder(20)
    vectors = np.linalg.qr(np.random.default_rng(3).standard_normal((20, 20)))[0]
    space = full.space
    basis = Basis(
        vectors, full.fingerprint, space.names, np.array([p.value for p in space.parameters]),
        np.array([p.lower for p in space.parameters]), np.array([p.upper for p in space.parameters]), 0.0, 8, np.inf,
        0.95, 1e-4, np.zeros((0, len(space.names))), np.zeros((0, 4)), 1,
    )  # fmt: skip
    effect = structural_damping("eta", "the rungs", ["rungs"], (1.0, 100.0))
    reduced, values = ReducedModel(full, basis).extended([effect]), {"eta": 0.2, "k_rung": 3.0}
    found, expected = reduced.modes(values, 8), extend(full, [effect]).modes(values, 8)
    np.testing.assert_allclose(eigenvalues(found), eigenvalues(expected), rtol=1e-6)
    without = full.modes({"k_rung": 3.0}, 8)
    assert (found.damping_ratio > without.damping_ratio + 0.001).any()


# -- the effects -------------------------------------------------------------------------------------------------------


def test_effects_are_made_of_names():
    loss = structural_damping("loss", "the link", ["link"], band=BAND, plausible=0.2)
    rubber = relaxing_rubber("soft", "the link", ["link"], corner=(2.0, 32.0))
    for effect in (loss, rubber):
        assert effect.title and effect.lacks.endswith(".") and effect.look_for.endswith(".") and not effect.signed
    assert [point["soft_freq"] for point in rubber.grid] == pytest.approx([4.0, 8.0, 16.0])
    model = extend(three_masses(), [loss, rubber])
    k, c, _ = (a.toarray() for a in model.matrices({"loss": loss.magnitude.upper, "soft": 0.0}))
    assert la.eigvalsh(k).min() > 0 and la.eigvalsh(c).min() > -1e-12  # even at the largest loss
    wide = extend(one_mass(), [structural_damping("loss", "it", ["k"], (1.0, 1000.0))])
    assert la.eigvalsh(wide.matrices({"loss": 0.6})[0].toarray()).min() > 0
    assert "band of constant loss" in model.assumptions[-1].item


@pytest.mark.parametrize("band", [(5.0,), (50.0, 5.0), (0.0, 5.0), (1.0, np.inf), (-1.0, 2.0)])
def test_a_band_that_is_none_is_refused(band):
    with pytest.raises(InputError, match="lower one first"):
        structural_damping("loss", "it", ["link"], band)
    with pytest.raises(InputError, match="lower one first"):
        relaxing_rubber("loss", "it", ["link"], band)


def test_wrong_parts_are_refused():
    with pytest.raises(InputError, match="names no part"):
        structural_damping("loss", "it", [], BAND)
    for make in (structural_damping, relaxing_rubber):
        with pytest.raises(InputError, match="effect loss, parts: 'link' occurs twice; name each part once"):
            make("loss", "it", ["link", "last", "link"], BAND)
    with pytest.raises(InputError, match="0 parts 'lnk' of stiffness"):
        lossy(three_masses(), ["lnk"])
    part = Part("it", "stiffness", sp.csr_array(np.diag([1.0, -1.0])), Monomial(), (0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="part 'it': its stiffness is negative"):
        elongations(part)
    with pytest.raises(InputError, match="stiffness is negative"):
        elongations(replace(part, matrix=sp.csr_array(np.eye(2)), coefficient=Monomial(-1.0)))
    many = replace(part, matrix=sp.csr_array(sp.eye_array(MOST_MOTIONS + 1)))
    with pytest.raises(InputError, match=f"more than {MOST_MOTIONS} elastic motions; at most {MOST_MOTIONS}"):
        elongations(many)
