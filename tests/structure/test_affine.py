"""Affine matrices: sums, derivatives, selected supports and the fingerprint."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from calib.errors.errors import InputError
from calib.structure.affine import AffineMatrix, Monomial, SelectedTerm, StretchPower, Term, parameter

N = 9
VALUES = {"a": 1.7, "b": 0.4, "c": 3.1, "here": 2.0, "there": -1.0}


def symmetric(seed, density=0.3):
    rng = np.random.default_rng(seed)
    dense = rng.standard_normal((N, N)) * (rng.random((N, N)) < density)
    return sp.csr_array(dense + dense.T)


def vectors(seed):
    rng = np.random.default_rng(seed)
    keys = [(i, j) for i in (1, 2, 3) for j in (-1, 0)]
    return {key: rng.standard_normal(N) * (rng.random(N) < 0.4) for key in keys}


def build(**changes):
    first = changes.get("first", symmetric(0))
    terms = (
        Term(changes.get("name", "t"), first, changes.get("coefficient", Monomial(2.0, (("a", 3.0), ("b", -1.0))))),
        Term("u", symmetric(1), parameter("c", 0.5)),
        Term("v", symmetric(2)),
    )
    selected = SelectedTerm(
        "s", changes.get("pick", parameter("b", 4.0)), ("here", "there"), changes.get("vectors", vectors(3))
    )
    return AffineMatrix(N, terms, (selected,))


positive = st.floats(0.1, 10.0)


@given(positive, positive, positive, st.sampled_from([1, 2, 3]), st.sampled_from([-1, 0]))
def test_matrix_is_the_sum_of_its_terms(a, b, c, here, there):
    found = build()({"a": a, "b": b, "c": c, "here": here, "there": there})
    picked = vectors(3)[(here, there)]
    expected = 2.0 * a**3 / b * symmetric(0) + 0.5 * c * symmetric(1) + symmetric(2)
    expected = expected.toarray() + 4.0 * b * np.outer(picked, picked)
    np.testing.assert_allclose(found.toarray(), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(found.toarray(), found.toarray().T, rtol=1e-14, atol=1e-14)


def test_pattern_never_changes_so_that_factors_can_be_compared():
    matrix = build()
    one, other = matrix(VALUES), matrix({**VALUES, "here": 3.0, "a": 0.2})
    assert np.array_equal(one.indices, other.indices) and np.array_equal(one.indptr, other.indptr)
    assert one.has_sorted_indices or np.all(np.diff(one.indices[: one.indptr[1]]) > 0)


def test_evaluations_do_not_disturb_each_other():
    matrix = build()
    before = matrix(VALUES).toarray()
    matrix({**VALUES, "a": 100.0, "here": 1.0}).data[:] = 0.0
    assert np.array_equal(matrix(VALUES).toarray(), before)


def test_stored_zeros_and_empty_vectors_have_no_effect():
    with_zero = sp.csr_array(sp.coo_array(([2.0, 0.0, 0.0], ([1, N - 1, 0], [1, N - 1, 3])), shape=(N, N)))
    empty = SelectedTerm("s", Monomial(), ("here",), {(1,): np.zeros(N), (2,): np.ones(N)})
    matrix = AffineMatrix(N, (Term("z", with_zero),), (empty,))
    assert matrix({"here": 1.0}).toarray().sum() == 2.0
    assert matrix({"here": 2.0}).toarray().sum() == 2.0 + N * N


def test_no_terms_is_zero():
    matrix = AffineMatrix(N, ())
    assert matrix.is_zero and not build().is_zero
    assert matrix({}).shape == (N, N) and matrix({}).nnz == 0


@pytest.mark.parametrize("combination", [(1, -1), (2, 0), (3, -1)])
def test_selected_term_is_of_rank_one_and_that_of_its_selectors(combination):
    term = SelectedTerm("s", Monomial(5.0), ("here", "there"), vectors(3))
    matrix = AffineMatrix(N, (), (term,))
    here, there = combination
    found = matrix({"here": float(here), "there": float(there)}).toarray()
    assert np.linalg.matrix_rank(found) == 1
    np.testing.assert_allclose(found, 5.0 * np.outer(vectors(3)[combination], vectors(3)[combination]), rtol=1e-14)
    assert term.choice({"here": here + 0.2, "there": there - 0.2}) == combination


@pytest.mark.parametrize("values", [{"here": 4.0, "there": 0.0}, {"here": 1.0, "there": 1.0}])
def test_an_unknown_position_is_refused(values):
    with pytest.raises(InputError, match=rf"s has no position for here = {values['here']:.0f}, there ="):
        build()({**VALUES, **values})


def test_wrong_matrices_are_refused_by_name():
    with pytest.raises(InputError, match="'t' is"):
        AffineMatrix(N + 1, (Term("t", symmetric(0)),))
    broken = symmetric(0)
    broken.data[2] = np.nan
    with pytest.raises(InputError, match="'t' holds entries that are not finite"):
        AffineMatrix(N, (Term("t", broken),))


power = st.sampled_from([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0])


@given(st.floats(-5, 5), st.lists(st.tuples(st.sampled_from("abc"), power), max_size=4), positive, positive, positive)
def test_derivative_is_that_of_the_value(factor, powers, a, b, c):
    monomial = Monomial(factor, tuple(powers))
    values = {"a": a, "b": b, "c": c}
    for name in "abc":
        h = 1e-5 * values[name]
        ahead, behind = (monomial({**values, name: values[name] + d}) for d in (h, -h))
        # the central difference is off by h^2/6 of the third derivative, at most (sum of powers)^3 of the value
        scale = abs(monomial(values)) / values[name]
        assert monomial.derivative(values, name) == pytest.approx((ahead - behind) / (2 * h), abs=1e-6 * scale + 1e-300)
    assert monomial.derivative(values, "d") == 0.0


def test_a_name_may_occur_twice():
    twice, square = Monomial(3.0, (("a", 1.0), ("a", 1.0))), Monomial(3.0, (("a", 2.0),))
    assert twice({"a": 1.3}) == pytest.approx(square({"a": 1.3}))
    assert twice.derivative({"a": 1.3}, "a") == pytest.approx(square.derivative({"a": 1.3}, "a"))


def nudged(matrix):
    out = matrix.copy()
    out.data[0] = np.nextafter(out.data[0], np.inf)
    return out


def other_vector():
    out = vectors(3)
    out[(2, 0)] = out[(2, 0)] + 1e-12
    return out


@pytest.mark.parametrize(
    "change",
    [
        {"first": nudged(symmetric(0))},
        {"name": "other"},
        {"coefficient": Monomial(2.0, (("a", 3.0), ("b", -2.0)))},
        {"coefficient": Monomial(2.0000001, (("a", 3.0), ("b", -1.0)))},
        {"coefficient": Monomial(2.0, (("a", 3.0), ("c", -1.0)))},
        {"pick": parameter("b", 4.1)},
        {"vectors": other_vector()},
        {"vectors": {k: v for k, v in vectors(3).items() if k != (2, 0)}},
    ],
)
def test_digest_changes_with_every_change(change):
    assert build(**change).digest() != build().digest()


def test_digest_is_that_of_the_content():
    assert build().digest() == build().digest()
    shuffled = vectors(3)
    shuffled = {key: shuffled[key] for key in reversed(shuffled)}
    assert build(vectors=shuffled).digest() == build().digest()
    assert AffineMatrix(4, ()).digest() != AffineMatrix(5, ()).digest()


def test_powers_on_intervals_join_to_one_function():
    # |x|^3 in two intervals in either direction: on the outer one x = start + t (end - start).
    terms = []
    for side in (1.0, -1.0):
        terms.append((1.0, StretchPower("x", 0.0, side * 1.0, 3)))
        terms += [(c, StretchPower("x", side * 1.0, side * 2.0, p, True)) for p, c in enumerate((1.0, 3.0, 3.0, 1.0))]
    for x in (-2.5, -2.0, -1.3, -1.0, -0.4, 0.0, 0.2, 1.0, 1.9, 2.2):
        assert sum(c * t({"x": x}) for c, t in terms) == pytest.approx(abs(x) ** 3)
        assert sum(c * t.derivative({"x": x}, "x") for c, t in terms) == pytest.approx(3 * x * abs(x))
    assert terms[0][1].derivative({"x": 0.3}, "y") == 0.0 and terms[0][1].names == {"x"}


def test_indices_of_terms_take_as_little_memory_as_solvers_need():
    where = np.arange(N, dtype=np.int64)
    wide = sp.csr_array(sp.coo_array((np.ones(N), (where, where)), shape=(N, N)))
    wide.indices, wide.indptr = wide.indices.astype(np.int64), wide.indptr.astype(np.int64)
    term = Term("t", wide)
    assert term.matrix.indices.dtype == term.matrix.indptr.dtype == np.int32
    assert wide.indices.dtype == np.int64
    assert Term("u", term.matrix).matrix is term.matrix
    one, other = AffineMatrix(N, (term,)), AffineMatrix(N, (Term("t", sp.csr_array(np.eye(N))),))
    assert one.digest() == other.digest()
    far = wide.copy()
    far.indices[3] = 2**32  # of 32 bits it would be 0
    with pytest.raises(InputError, match=str(2**32)):
        AffineMatrix(N, (Term("t", far),))


def test_what_scipy_does_to_a_matrix_in_place_leaves_the_terms_made_of_it_alone():
    """It sorts, adds up and drops entries in place where an operation needs that."""
    rows, cols = np.array([0, 0, 0, 1, 1, 2, 2]), np.array([2, 0, 0, 1, 2, 0, 1])
    given = sp.csr_array((np.array([3.0, 1.0, 2.0, 5.0, 0.0, 3.0, 0.0]), cols, np.array([0, 3, 5, 7])), shape=(3, 3))
    given.indices, given.indptr = given.indices.astype(np.int64), given.indptr.astype(np.int64)
    expected = np.zeros((3, 3))
    np.add.at(expected, (rows, cols), given.data)
    one, other = Term("k", given), Term("c", given)
    for matrix in (given, one.matrix):
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        for each in (given, one.matrix, other.matrix):
            np.testing.assert_array_equal(each.toarray(), expected)
