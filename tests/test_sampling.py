import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.problem.sampling import Narrow, sample
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace

SPACE = ParameterSpace(
    (
        Parameter("a", 1.0, 0.0, 10.0),
        Parameter("held", 5.0, 0.0, 10.0, distribution="fixed"),
        Parameter("b", 0.0, -1.0, 1.0),
        Parameter("step", 0.0, -2.0, 2.0, integer=True),
    )
)


def constrained(low: float, high: float) -> ParameterSpace:
    return ParameterSpace(SPACE.parameters, (LinearConstraint("sum", (("a", 1.0), ("held", 1.0)), low, high),))


def test_without_constraints_every_stratum_of_every_parameter_is_met_once():
    found = sample(SPACE, 50, seed=1)
    assert found.points.shape == (50, 3) and found.asked == found.accepted == 50 and found.acceptance == 1.0
    for column, low, width in ((0, 0.0, 10.0), (1, -1.0, 2.0)):
        strata = np.floor((found.points[:, column] - low) / width * 50).astype(int)
        assert sorted(strata) == list(range(50))


def test_integers_have_equal_shares_up_to_the_ends():
    values, counts = np.unique(sample(SPACE, 500, seed=2).points[:, 2], return_counts=True)
    assert values.tolist() == [-2, -1, 0, 1, 2] and counts.tolist() == [100] * 5


def test_same_seed_same_points():
    space = constrained(6.0, 8.0)
    first, again, other = (sample(space, 40, seed=s).points for s in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_accepted_points_keep_the_constraints_and_fill_the_region():
    found = sample(constrained(6.0, 8.0), 400, seed=3)  # 1 <= a <= 3: a fifth of the range
    assert found.points.shape == (400, 3)
    assert found.acceptance == pytest.approx(0.2, abs=0.02) and found.accepted >= 400
    a = found.points[:, 0]
    assert a.min() >= 1.0 and a.max() <= 3.0
    assert a.mean() == pytest.approx(2.0, abs=0.1) and a.std() == pytest.approx(2 / np.sqrt(12), abs=0.05)


def test_narrow_constraints_are_met_by_every_point_and_filled_evenly():
    found = sample(constrained(6.0, 6.01), 200, seed=4)
    assert found.points.shape == (200, 3) and found.acceptance == 1.0
    a = found.points[:, 0]
    assert a.min() >= 1.0 and a.max() <= 1.01
    assert a.mean() == pytest.approx(1.005, abs=5e-4) and a.std() == pytest.approx(0.01 / np.sqrt(12), rel=0.1)


def test_equalities_leave_as_many_fewer_free_parameters():
    """Two equalities, one of them over a parameter of the other, and a third that follows from both."""
    space = ParameterSpace(
        tuple(Parameter(name, 5.0, 0.0, 10.0) for name in "abc"),
        tuple(
            LinearConstraint(f"tie {k}", coefficients, value, value)
            for k, (coefficients, value) in enumerate(
                (((("a", 1.0), ("b", -1.0)), 1.0), ((("b", 2.0), ("c", 1.0)), 9.0), ((("a", 2.0), ("c", 1.0)), 11.0))
            )
        ),
    )
    a, b, c = sample(space, 300, seed=6).points.T
    np.testing.assert_allclose(a - b, 1.0, atol=1e-12)
    np.testing.assert_allclose(2 * b + c, 9.0, atol=1e-12)
    assert b.min() >= 0.0 and b.max() <= 4.5 and b.mean() == pytest.approx(2.25, abs=0.2)
    assert space.feasible(np.column_stack([a, b, c])).all()


def test_points_move_into_narrow_constraints_as_little_as_they_must():
    space = constrained(6.0, 6.01)
    points = np.array([[1.004, 0.3, 1.0], [3.0, 0.3, 1.0], [0.0, 0.3, 1.0]])
    np.testing.assert_allclose(Narrow.of(space).filled(points)[:, 0], [1.004, 1.01, 1.0])
    np.testing.assert_array_equal(Narrow.of(space).filled(points)[:, 1:], points[:, 1:])
    np.testing.assert_array_equal(Narrow.of(constrained(6.0, 8.0)).filled(points), points)


def test_an_equality_of_integers_is_solved_by_one_that_leaves_the_others_integers():
    counts = tuple(Parameter(name, 1.0, 0.0, 8.0, integer=True) for name in ("m", "n", "k"))
    tied = ParameterSpace(counts, (LinearConstraint("plates", (("m", 3.0), ("n", 1.0), ("k", 2.0)), 12.0, 12.0),))
    points = sample(tied, 200, 1).points
    assert (points == np.round(points)).all() and (points @ [3.0, 1.0, 2.0] == 12.0).all()
    assert Narrow.of(tied).pivots == (1,) and len(np.unique(points, axis=0)) > 12
    beside = LinearConstraint("at least", (("m", 1.0), ("k", 1.0)), 1.0, np.inf)  # an open end changes nothing
    both = ParameterSpace(counts, (beside, *tied.constraints))
    assert Narrow.of(both).pivots == (1,) and (sample(both, 50, 1).points @ [3.0, 1.0, 2.0] == 12.0).all()
    none = ParameterSpace(counts[:2], (LinearConstraint("pair", (("m", 2.0), ("n", 3.0)), 12.0, 12.0),))
    assert Narrow.of(none).pivots == ()  # neither follows in integers: points are drawn and kept where they meet it


def test_constraints_that_accept_next_to_nothing_are_named_with_their_rate():
    apart = constrained(6.0, 8.0)
    both = ParameterSpace(apart.parameters, (*apart.constraints, LinearConstraint("a", (("a", 1.0),), 2.99999, 5.0)))
    with pytest.raises(InputError, match=r"accept only \d+ of \d+ points \(.* %\)"):
        sample(both, 5, seed=5)
    with pytest.raises(InputError, match="no point within the limits"):
        sample(constrained(30.0, 40.0), 5, seed=5)


def test_nothing_to_sample_is_refused():
    with pytest.raises(InputError, match="no parameter is free"):
        sample(SPACE.keep([]), 5, seed=1)
    with pytest.raises(InputError, match="0 points"):
        sample(SPACE, 0, seed=1)
