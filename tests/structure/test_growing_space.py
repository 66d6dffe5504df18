"""A growing space is orthonormal in its scale, spans what was added, and projects as all at once would."""

import numpy as np
import pytest
import scipy.sparse as sp

from calib.structure.reduction.refinement import GrowingSpace

SIZE = 12


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def matrices(rng):
    any_of = rng.normal(size=(2, SIZE, SIZE))
    return tuple(sp.csc_array(one @ one.T) for one in any_of)


@pytest.fixture
def scale(rng):
    return rng.uniform(0.1, 10.0, (SIZE, 1))


def assert_projected(space, matrices, scale):
    basis = space.basis
    assert (scale * basis).T @ (scale * basis) == pytest.approx(np.eye(basis.shape[1]), abs=1e-13)
    for found, matrix in zip(space.projected, matrices, strict=True):
        assert found == pytest.approx(basis.T @ (matrix @ basis), rel=1e-11, abs=1e-11 * abs(found).max())


def test_what_is_added_in_turn_is_spanned_and_projected(matrices, scale, rng):
    space, added = GrowingSpace(matrices, scale), [rng.normal(size=(SIZE, k)) for k in (4, 2, 3)]
    for columns in added:
        space.add(columns)
    assert_projected(space, matrices, scale)
    within = np.linalg.lstsq(space.basis, np.hstack(added), rcond=None)[0]
    assert space.basis @ within == pytest.approx(np.hstack(added), abs=1e-11)


def test_columns_that_depend_on_others_become_further_directions(matrices, scale, rng):
    space, first = GrowingSpace(matrices, scale), rng.normal(size=(SIZE, 4))
    space.add(first)
    space.add(np.column_stack([2.0 * first[:, 0], first[:, 1] - first[:, 2], np.zeros(SIZE)]))
    assert space.basis.shape == (SIZE, 7)
    assert_projected(space, matrices, scale)


def test_a_direction_of_its_own_that_is_added_again(scale, rng):
    """Rounding noise of a part that nothing couples to others stays in that part, however often it is projected out."""
    apart = np.zeros((SIZE, SIZE))
    apart[1:, 1:] = np.eye(SIZE - 1)
    matrices = (sp.csc_array(np.eye(SIZE)), sp.csc_array(apart))
    first = np.zeros((SIZE, 1))
    first[0] = 1.0
    space = GrowingSpace(matrices, scale)
    space.add(np.hstack([first, apart @ rng.normal(size=(SIZE, 2))]))
    space.add(np.hstack([first, 1e-17 * first]))
    assert space.basis.shape == (SIZE, 5)
    assert_projected(space, matrices, scale)


def test_no_more_directions_than_there_are(matrices, scale, rng):
    space = GrowingSpace(matrices, scale)
    for count in (5, 5, 5):
        space.add(rng.normal(size=(SIZE, count)))
    assert space.basis.shape == (SIZE, SIZE)
    assert_projected(space, matrices, scale)
