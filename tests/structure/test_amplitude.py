"""Parts that depend on the level of a test: matrices, derivatives, and what is refused."""

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.problem.space import Parameter
from calib.structure.amplitude import amplitude_dependence, level, with_level
from calib.structure.effects.extend import extend
from calib.structure.model import StructuralModel


def two_masses():
    link, ground = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.diag([1.0, 0.0])
    return StructuralModel.from_matrices(
        {"k": link, "ground": 5e4 * ground}, np.diag([2.0, 1.0]), {"c": link}, dofs=[(1, "x"), (2, "x")],
        parameters=[Parameter("k", 20.0, 1.0, 90.0, "kN/m"), Parameter("c", 30.0, 1.0, 90.0, "Ns/m")],
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["stiffness", "damping"])
def test_parts_lose_a_share_per_unit_of_the_level(kind):
    at = level(3.0)
    base = with_level(two_masses(), at)
    effect = amplitude_dependence("lost", "the link", ["k" if kind == "stiffness" else "c"], at, kind, 0.2)
    model = extend(base, [effect])
    for strain in (0.0, 1.0, 2.5):
        values = {"lost": 0.3, "level": strain, "k": 30.0, "c": 40.0}
        expected = {"k": 30.0, "c": 40.0}
        expected["k" if kind == "stiffness" else "c"] *= 1 - 0.3 * strain
        for own, bare in zip(model.matrices(values), two_masses().matrices(expected), strict=True):
            np.testing.assert_allclose(own.toarray(), bare.toarray(), rtol=1e-12)
        index = 0 if kind == "stiffness" else 1
        slope = model.matrix_derivatives(values, "lost")[index].toarray()
        value = 30e3 if kind == "stiffness" else 40.0
        np.testing.assert_allclose(slope, -strain * value * np.array([[1.0, -1.0], [-1.0, 1.0]]))
    nothing = model.matrices({"lost": 0.3})
    for own, bare in zip(nothing, two_masses().matrices({}), strict=True):
        np.testing.assert_array_equal(own.toarray(), bare.toarray())


def test_something_is_left_at_the_largest_level():
    effect = amplitude_dependence("lost", "the link", ["k"], level(4.0))
    model = extend(with_level(two_masses(), level(4.0)), [effect])
    stiffness = model.matrices({"lost": effect.magnitude.upper, "level": 4.0})[0].toarray()
    assert np.linalg.eigvalsh(stiffness).min() > 0 and effect.signed


def test_a_model_with_a_larger_level_than_the_effect_is_refused():
    """At level 3 a limit made for 1 would leave less than nothing of the part."""
    base = with_level(two_masses(), level(3.0))
    with pytest.raises(InputError, match=r"largest level of .*, 3, nothing would be left.*give the effect the level"):
        extend(base, [amplitude_dependence("lost", "it", ["k"], level(1.0))])
    smaller = with_level(two_masses(), level(1.0))
    assert "lost" in extend(smaller, [amplitude_dependence("lost", "it", ["k"], level(3.0))]).space


def test_a_part_that_is_named_twice_is_refused():
    """It would lose its share twice."""
    with pytest.raises(InputError, match="effect lost, parts: 'k' occurs twice; name each part once"):
        amplitude_dependence("lost", "it", ["k", "k"], level(1.0))


def test_what_cannot_be_is_refused():
    at = level(1.0)
    with pytest.raises(InputError, match=r"has no parameter 'level', the level of a test; add the level to the model"):
        extend(two_masses(), [amplitude_dependence("lost", "it", ["k"], at)])
    with pytest.raises(InputError, match="has 'level' already"):
        with_level(with_level(two_masses(), at), at)
    with pytest.raises(InputError, match="its kind is 'mass'"):
        amplitude_dependence("lost", "it", ["k"], at, "mass")
    with pytest.raises(InputError, match="names no part"):
        amplitude_dependence("lost", "it", [], at)
    with pytest.raises(InputError, match=r"level 'force' reaches from 0 to 2 kN/m"):
        amplitude_dependence("lost", "it", ["k"], Parameter("force", 0.0, 0.0, 2.0, "kN/m"))
    with pytest.raises(InputError, match=r"plausible size is 0\.5 at levels up to 3.*up to 0\.317"):
        amplitude_dependence("lost", "it", ["k"], level(3.0), plausible=0.5)
    with pytest.raises(InputError, match="0 parts 'x' of stiffness"):
        extend(with_level(two_masses(), at), [amplitude_dependence("lost", "it", ["x"], at)])
    for largest in (0.0, -1.0, np.inf):
        with pytest.raises(InputError, match=f"largest level is {largest:g}; give a positive number"):
            level(largest)
