"""Without shapes a measured mode keeps its model mode when parameters move."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from calib.correlation.modal.problem import ModalProblem
from calib.measurement.mac import mac
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Term, parameter
from calib.structure.effects.extend import Addition, extend
from calib.structure.eigenproblem.mode_tracking import Point, follow, successors
from calib.structure.modes import Modes

COUNT = 7


def at(model, **values):
    complete = model.space.complete(values)
    return Point(complete, model.modes(complete, COUNT))


def in_small_steps(model, start, end, columns, steps=400):
    """Continuation in small steps, as reference."""
    for share in np.linspace(0, 1, steps + 1)[1:]:
        here = at(model, **{n: (1 - share) * start.values[n] + share * v for n, v in end.values.items()})
        columns = follow(model, start, here, columns, halvings=0)
        start = here
    return columns


@pytest.mark.parametrize("damped", [False, True])
def test_modes_that_cross_change_numbers(build, damped):
    model = build(damped=damped, grounded=False)  # the two directions are uncoupled
    start, end = at(model, c_end=50.0), at(model, c_end=50.0, k_across=29.0)
    found = follow(model, start, end, np.arange(5))
    similarity = mac(start.modes.shapes, end.modes.shapes)
    assert found.tolist() == np.argmax(similarity[:5], axis=1).tolist() != list(range(5))


def test_modes_that_veer_keep_their_numbers_though_their_shapes_are_exchanged(build):
    model = build(damped=False)  # the directions are coupled
    start, end = at(model, k_along=20.0, k_across=16.0), at(model, k_along=20.0, k_across=25.0)
    columns = np.arange(4)
    oracle = in_small_steps(model, start, end, columns)
    assert follow(model, start, end, columns, halvings=0).tolist() != oracle.tolist()
    assert follow(model, start, end, columns).tolist() == oracle.tolist()


def test_frequencies_tell_modes_apart_that_look_alike_where_there_is_no_mass_matrix():
    freq = np.array([10.0, 20.0])
    start = Modes(freq, freq, np.zeros(2), np.array([[1.0, 1.0], [1.0, 0.9]]))
    end = replace(start, natural_freq=1.05 * freq, shapes=start.shapes[:, ::-1])  # noise exchanges them
    of_sensors, similarity = successors(start, end, np.arange(2))
    assert of_sensors.tolist() == [0, 1] and (similarity < 1).all()
    of_masses, similarity = successors(start, end, np.arange(2), lambda shapes: shapes)
    assert of_masses.tolist() == [1, 0] and similarity == pytest.approx([1.0, 1.0])


class Counted:
    """A model that counts its solves."""

    def __init__(self, model):
        self.model, self.space, self.solved = model, model.space, 0

    def weighted(self, values, shapes):
        return self.model.weighted(values, shapes)

    def modes(self, values, count):
        self.solved += 1
        return self.model.modes(values, count)


def test_uncoupled_modes_cross_without_a_solve(build):
    model = Counted(build(damped=False, grounded=False))
    start, end = at(model.model, k_across=8.0), at(model.model, k_across=29.0)
    columns = np.arange(4)
    found = follow(model, start, end, columns)
    assert model.solved == 0
    assert found.tolist() == in_small_steps(model.model, start, end, columns).tolist() != columns.tolist()


@pytest.mark.parametrize("grounded", [False, True])
def test_a_mode_that_leaves_the_solved_ones_is_no_longer_tracked(build, grounded):
    model = build(damped=False, grounded=grounded)
    start, end = (Point(v, model.modes(v, COUNT)) for v in (
        model.space.complete({"k_across": k}) for k in (8.0, 29.0)))  # fmt: skip
    whole = follow(model, start, end, np.arange(4))
    n = max(whole.tolist())  # the mode that ends highest is left out
    few_start, few_end = (Point(p.values, model.modes(p.values, n)) for p in (start, end))
    columns = np.array([c for c in range(4) if c < n])
    expected = [j if j < n else -1 for j in whole[columns].tolist()]
    assert follow(model, few_start, few_end, columns).tolist() == expected
    assert follow(model, few_start, few_end, np.array([-1, 0])).tolist() == [-1, expected[0]]
    assert grounded or -1 in expected


def test_a_measured_mode_whose_model_mode_has_left_is_reported(build, twin):
    model = build(damped=False, grounded=False)
    measured = twin(model, model.space.complete({"k_across": 8.0}), order=(0, 1, 2, 3), shapes=False)
    whole = ModalProblem(model, measured, mode_count=COUNT, reference={"k_across": 8.0})
    index = whole.compare({"k_across": 29.0}).pairing.model_index
    n = int(index.max())
    assert 4 <= n < COUNT
    found = replace(whole, mode_count=n).compare({"k_across": 29.0})
    gone = int(np.argmax(index))
    assert found.lost == (measured.names[gone],) and found.pairing.model_index[gone] == -1
    assert np.delete(found.pairing.model_index, gone).tolist() == np.delete(index, gone).tolist()
    assert np.isnan(found.freq_error[gone]) and replace(whole, mode_count=n).compare({"k_across": 8.0}).lost == ()


def test_a_problem_without_shapes_tracks_its_modes(build, twin):
    model = build(damped=False, grounded=False)
    measured = twin(model, model.space.complete({"k_across": 12.0}), order=(0, 1, 2, 3), shapes=False)
    problem = ModalProblem(model, measured, mode_count=COUNT)
    first = problem.compare(model.space.values)
    assert first.pairing.model_index.tolist() == [0, 1, 2, 3]
    there = problem.compare({"k_across": 29.0})
    similarity = mac(first.modes.shapes[:, :4], there.modes.shapes)
    assert there.pairing.model_index.tolist() == np.argmax(similarity, axis=1).tolist() != [0, 1, 2, 3]
    assert problem.compare(model.space.values).pairing.model_index.tolist() == [0, 1, 2, 3]


def test_the_point_where_modes_are_paired_may_be_chosen(build, twin):
    model = build(damped=False, grounded=False)
    measured = twin(model, model.space.complete({"k_across": 29.0}), order=(0, 1, 2, 3), shapes=False)
    problem = ModalProblem(model, measured, mode_count=COUNT, reference={"k_across": 29.0})
    assert problem.compare({"k_across": 29.0}).pairing.model_index.tolist() == [0, 1, 2, 3]
    assert problem.compare({}).pairing.model_index.tolist() != [0, 1, 2, 3]
    assert problem.fingerprint != ModalProblem(model, measured, mode_count=COUNT).fingerprint


def test_a_mode_more_in_the_test_or_in_the_model_shifts_no_other(build, twin):
    model = build(damped=False)
    truth = model.space.complete({"k_along": 41.0, "k_across": 11.3})
    lacking = twin(model, truth, order=(0, 2, 3, 4), shapes=False)
    assert ModalProblem(model, lacking, mode_count=COUNT).compare({}).pairing.model_index.tolist() == [0, 2, 3, 4]


@pytest.fixture
def with_hung_mass():
    """Adds one mass to a model, on its own spring to the ground; its link to the model has magnitude 0."""

    def make(model, freq):
        rate = (2 * np.pi * freq) ** 2

        def hung(model):
            n = model.n_dof
            own = sp.csr_array(([1.0], ([n], [n])), shape=(n + 1, n + 1))
            arm = sp.csr_array(np.outer(v := np.eye(n + 1)[n] - np.eye(n + 1)[n - 1], v))
            return Addition(
                stiffness=(Term("own", rate * own), Term("hung", arm, parameter("hung"))),
                mass=(Term("own", own),),
                n_added=1,
            )

        magnitude = Parameter("hung", 0.0, 0.0, 1e4, "N/m", prior_sd=1e3)
        return extend(model, [Effect("hung", "Hung mass", "It is left out.", "Look there.", magnitude, hung)])

    return make


def test_an_uncoupled_added_motion_takes_no_partner_away(build, twin, with_hung_mass):
    """Without shapes its frequency alone would favour it."""
    model = build(damped=False)
    measured = twin(model, model.space.complete({"k_along": 42.0}), order=(0, 1, 2, 3), shapes=False)
    base = ModalProblem(model, measured, mode_count=COUNT)
    wider = with_hung_mass(model, measured.natural_freq[2])
    extended = replace(base, model=wider, mode_count=COUNT + 1, base=base)
    for values in ({}, {"k_along": 45.0}):
        ours, theirs = extended.evaluate(values), base.evaluate(values)
        assert ours == pytest.approx(theirs, nan_ok=True)
    alone = replace(extended, base=None).evaluate({})
    assert alone["natural_freq_M3"] == pytest.approx(measured.natural_freq[2]) != base.evaluate({})["natural_freq_M3"]


def test_a_choice_of_the_users_is_the_same_mode_beside_an_added_motion(build, twin, with_hung_mass):
    """An added mode below the chosen one shifts its number."""
    model = build(damped=False)
    measured = twin(model, model.space.complete({"k_along": 42.0}), order=(0, 1, 2, 3), shapes=False)
    base = ModalProblem(model, measured, mode_count=COUNT, override={"M3": 4, "M4": 3})
    extended = replace(base, model=with_hung_mass(model, 0.5), mode_count=COUNT + 1, base=base)
    for values in ({}, {"k_along": 40.5}, {"k_along": 42.0}):
        found = base.compare(values).pairing.model_index
        assert found.tolist()[2:] == [3, 2]
        assert extended.compare(values).pairing.model_index.tolist() == (found + 1).tolist()
        assert extended.evaluate(values) == pytest.approx(base.evaluate(values), nan_ok=True)


def test_a_choice_among_modes_of_the_extended_model_holds_everywhere(build, twin, with_hung_mass):
    model = build(damped=False)
    measured = twin(model, model.space.complete({"k_along": 42.0}), order=(0, 1, 2, 3), shapes=False)
    base = ModalProblem(model, measured, mode_count=COUNT)
    wider = with_hung_mass(model, 0.5)
    extended = replace(base, model=wider, mode_count=COUNT + 1, base=base, override={"M3": 1, "M4": 4})
    for values in ({}, {"k_along": 40.5}):
        assert extended.compare(values).pairing.model_index.tolist() == [1, 2, 0, 3]


def test_the_result_does_not_depend_on_earlier_evaluations(build, twin):
    model = build(damped=False, grounded=False)
    measured = twin(model, model.space.values, order=(0, 1, 2, 3), shapes=False)
    points = [{"k_across": v} for v in (8.0, 29.0, 15.0)]
    one = ModalProblem(model, measured, mode_count=COUNT)
    forward = [one.evaluate(p) for p in points]
    again = [ModalProblem(model, measured, mode_count=COUNT).evaluate(p) for p in reversed(points)]
    np.testing.assert_equal(forward, again[::-1])
