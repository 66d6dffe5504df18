"""Effects at one of several places, and masses that slide, against each place by itself and closed forms."""

import numpy as np
import pytest
import scipy.linalg as la

from calib.errors.errors import InputError
from calib.structure.affine import AffineMatrix, Monomial, StretchPower, parameter
from calib.structure.anywhere import Chosen, at_one_of, sliding_mass
from calib.structure.effects.attach import hung_masses, outer_term
from calib.structure.effects.extend import Addition
from calib.structure.effects.products import Product


def matrix(terms, values):
    return sum(t.matrix.toarray() * t.coefficient(values) for t in terms)


def test_each_place_is_the_addition_there():
    hung = [hung_masses([row], "m", "f", 0.02) for row in np.eye(3)]
    anywhere, values = at_one_of(hung, "m_place"), {"m": 2.0, "f": 7.0}
    assert anywhere.n_added == 1
    for k, own in enumerate(hung, 1):
        for kind in ("stiffness", "damping", "mass"):
            found = matrix(getattr(anywhere, kind), {**values, "m_place": float(k)})
            np.testing.assert_array_equal(found, matrix(getattr(own, kind), values))


def test_the_root_of_a_hung_mass_is_known_at_any_place():
    """Its coupling goes with the root of the mass, whose derivative is infinite at 0."""
    hung = [hung_masses([row], "m", "f", 0.02) for row in np.eye(3)]
    alone, anywhere = (
        frozenset(name for terms in (a.stiffness, a.damping, a.mass) for name in AffineMatrix(4, tuple(terms)).roots)
        for a in (hung[0], at_one_of(hung, "m_place"))
    )
    assert alone == anywhere == {"m"}


def test_places_of_different_kinds_are_refused():
    spring = Addition(stiffness=(outer_term("k", [np.eye(3)[0]], parameter("k")),))
    with pytest.raises(InputError, match="different degrees of freedom"):
        at_one_of([spring, hung_masses([np.eye(3)[1]], "m", "f", 0.02)], "k_place")
    with pytest.raises(InputError, match="its places"):
        at_one_of([], "k_place")


def test_a_product_has_the_derivative_of_a_product():
    coefficient = Product(Monomial(3.0, (("m", 0.5),)), StretchPower("s", 1.0, 2.0, 3))
    at = {"m": 4.0, "s": 1.6}
    assert coefficient(at) == pytest.approx(6 * 0.6**3) and coefficient.names == {"m", "s"}
    assert coefficient.derivative(at, "m") == pytest.approx(0.75 * 0.6**3)
    assert coefficient.derivative(at, "s") == pytest.approx(6 * 3 * 0.6**2)
    twice = Product(parameter("m"), parameter("m"))
    assert twice.derivative(at, "m") == 8.0
    assert Product(parameter("m"), Chosen("p", 2)).derivative({"m": 4.0, "p": 2.0}, "m") == 1.0


def beam(x, length=6.0, modes=4):
    """Motion of a simply supported beam in its own shapes, (1, modes)."""
    return np.sin(np.arange(1, modes + 1) * np.pi * x / length)[None]


def test_a_mass_slides_along_a_simply_supported_beam():
    """The frequencies are those of the beam with the mass in the middle of nowhere in particular."""
    own = np.diag(np.arange(1.0, 5.0) ** 4)  # stiffness of the shapes over that of the first; mass 1/2 each
    sliding = sliding_mass(beam, "m", "s", (0.0, 6.0), 12)
    for s in (0.0, 0.37, 1.5, 2.81, 4.99, 6.0):
        mass = np.eye(4) / 2 + matrix(sliding.mass, {"m": 0.4, "s": s})
        exact = np.eye(4) / 2 + 0.4 * beam(s).T @ beam(s)
        np.testing.assert_allclose(la.eigvalsh(own, mass), la.eigvalsh(own, exact), rtol=2e-4)
    (first,) = la.eigvalsh([[1.0]], [[0.5 + matrix(sliding.mass, {"m": 0.4, "s": 1.5})[0, 0]]])
    assert first == pytest.approx(1 / (0.5 + 0.4 * np.sin(np.pi / 4) ** 2), rel=1e-4)


def test_a_sliding_mass_does_not_jump_and_is_nowhere_negative():
    sliding = sliding_mass(beam, "m", "s", (0.0, 6.0), 5)
    for cut in (1.2, 2.4, 3.6, 4.8):
        low, high = (matrix(sliding.mass, {"m": 1.0, "s": cut + e}) for e in (-1e-9, 1e-9))
        np.testing.assert_allclose(low, high, atol=1e-7)
    for s in np.linspace(0, 6, 61):
        assert la.eigvalsh(matrix(sliding.mass, {"m": 1.0, "s": s})).min() > -1e-12


def test_the_position_has_the_derivative_of_the_matrix():
    sliding, at, step = sliding_mass(beam, "m", "s", (0.0, 6.0), 6), {"m": 0.7, "s": 2.3}, 1e-6
    slope = sum(t.matrix.toarray() * t.coefficient.derivative(at, "s") for t in sliding.mass)
    high, low = (matrix(sliding.mass, {**at, "s": 2.3 + e}) for e in (step, -step))
    np.testing.assert_allclose(slope, (high - low) / (2 * step), rtol=1e-6, atol=1e-8)
