"""None"""

import inspect

import numpy as np
import pytest
from pymoo.algorithms.soo.nonconvex.ga import comp_by_cv_and_fitness
from pymoo.core.algorithm import Algorithm
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.operators.crossover.ux import UniformCrossover
from pymoo.operators.selection.tournament import TournamentSelection

from calib.errors.errors import InputError
from calib.inference import genetic
from calib.inference.cases import scaled_violation
from calib.inference.genetic import GeneticSearch, GeneticSettings, reflect
from calib.problem.sampling import sample
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from tests.inference.genetic_searches import bowl, box, play

# -- the whole ---------------------------------------------------------------------------------------------------------


def test_ask_returns_whole_generations_starting_with_the_initial_population():
    space, settings = box(3), GeneticSettings(population=11, generations=7)
    initial = sample(space, 11, 5).points
    populations, _ = play(space, settings, initial=initial)
    assert populations.shape == (7, 11, 3)
    np.testing.assert_array_equal(populations[0], initial)
    assert GeneticSettings().population * GeneticSettings().generations == 7500


def test_same_seed_same_table_whatever_the_global_state():
    space, settings = box(4), GeneticSettings(population=10, generations=15)
    initial = sample(space, 10, 1).points
    np.random.seed(1)  # noqa: NPY002
    first, _ = play(space, settings, 3, initial=initial)
    np.random.seed(2)  # noqa: NPY002
    second, _ = play(space, settings, 3, initial=initial)
    other, _ = play(space, settings, 4, initial=initial)
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first[1], other[1])


@pytest.mark.medium
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_finds_the_bottom_of_a_bowl_in_ten_parameters(seed):
    space = box(10, -5.0, 15.0)
    populations, misfits = play(space, GeneticSettings(), seed, lambda x: np.sum((x - 2.0) ** 2, axis=1))
    found = populations.reshape(-1, 10)[np.argmin(misfits)]
    assert np.max(np.abs(found - 2.0)) < 0.02 * 20.0


def test_the_elite_is_never_lost():
    # Crossover and mutation at full rate destroy whatever they touch; only the elite can keep the best.
    settings = GeneticSettings(
        population=8, generations=40, crossover=1.0, mutation=1.0, sigma_start=1.0, sigma_end=1.0
    )
    space, rng = box(5), np.random.default_rng(1)
    search = GeneticSearch(space, settings, rng.random((8, 5)), 1)
    best, pool = np.inf, []
    while not search.done:
        x = search.ask()
        search.tell(bowl(x), np.zeros(8))
        best = min(best, bowl(x).min())
        pool.append(search._algorithm.pop.get("F").min())
        assert pool[-1] == best
    assert len(set(pool)) > 1


def test_only_the_elite_survives():
    settings = GeneticSettings(population=10, generations=6)
    search = GeneticSearch(box(3), settings, np.random.default_rng(1).random((10, 3)), 1)
    before = None
    while not search.done:
        x = search.ask()
        search.tell(bowl(x), np.zeros(10))
        now = search._algorithm.pop.get("X")
        if before is not None:
            elite = before[np.argmin(bowl(before))]
            expected = np.vstack([elite, x[np.argsort(bowl(x), kind="stable")[:-1]]])
            np.testing.assert_array_equal(np.sort(now, axis=0), np.sort(expected, axis=0))
        before = now


def test_elites_take_the_places_of_as_many_worst_children():
    settings = GeneticSettings(population=9, generations=5, elites=3, substitutes=3)
    search = GeneticSearch(box(2), settings, np.random.default_rng(2).random((9, 2)), 1)
    before = None
    while not search.done:
        x = search.ask()
        search.tell(bowl(x), np.zeros(9))
        now = search._algorithm.pop.get("F")[:, 0]
        if before is not None:
            np.testing.assert_array_equal(np.sort(now), np.sort([*np.sort(before)[:3], *np.sort(bowl(x))[:6]]))
        before = now


# -- the same, written out ---------------------------------------------------------------------------------------------


def written_out(space, settings, seed, misfit, violation, initial):
    """All populations of the search, its loop written out around pymoo's selection and crossover."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    problem = Problem(n_var=len(space.free), n_obj=1, n_ieq_constr=1, xl=space.lower, xu=space.upper)
    select, cross = TournamentSelection(func_comp=comp_by_cv_and_fitness), UniformCrossover(prob=settings.crossover)

    def mated(parents, count, sigma):
        pairs = select(problem, parents, -(-count // 2), 2, random_state=rng)
        x = cross(problem, pairs, random_state=rng).get("X")
        chosen, step = rng.random(x.shape) < settings.mutation, rng.standard_normal(x.shape)
        rng.random(len(x))  # pymoo's chance of an individual, which is 1
        moved = reflect(x + sigma * (space.upper - space.lower) * step, space.lower, space.upper)
        return np.where(chosen, np.where(space.integer, np.round(moved), moved), x)

    def ranked(x):
        broken = violation(x)
        return x[np.lexsort([np.where(broken == 0, misfit(x), np.inf), broken])]

    populations, pool = [np.array(initial, dtype=float)], np.array(initial, dtype=float)
    for generation in range(2, settings.generations + 1):
        parents, broken = Population.new("X", pool), violation(pool)
        parents.set("F", np.where(broken == 0, misfit(pool), np.inf)[:, None])
        parents.set("G", broken[:, None])
        children, sigma = [], settings.sigma(generation)
        for attempt in range(21):
            missing = settings.population - len(children)
            if missing:
                new = mated(parents, missing, sigma)
                if attempt < 20:  # the last ones may repeat
                    known = {tuple(child) for child in children}
                    new = [x for k, x in enumerate(new) if tuple(x) not in known | {tuple(y) for y in new[:k]}]
                children += list(new)[:missing]
        populations.append(np.array(children))
        places = settings.population - settings.elites
        pool = np.vstack([ranked(pool)[: settings.elites], ranked(populations[-1])[:places]])
    return np.array(populations)


MIXED = ParameterSpace(
    (*(Parameter(f"p{k}", 0.5, 0.0, 1.0) for k in range(3)), Parameter("n", 1, 1, 4, integer=True)),
    (LinearConstraint("sum", tuple((f"p{k}", 1.0) for k in range(3)), 1.4, 2.0),),
)
FEW = ParameterSpace((Parameter("n", 1, 1, 3, integer=True), Parameter("m", 0, 0, 1, integer=True)))


@pytest.mark.parametrize("repeated", [False, True])
@pytest.mark.parametrize(
    ("space", "population"),
    [(box(4, -2.0, 1.0), 9), *(pytest.param(*more, marks=pytest.mark.slow) for more in ((MIXED, 12), (FEW, 10)))],
)
def test_populations_are_those_of_the_loop_written_out(space, population, repeated):
    settings = GeneticSettings(population, 25, elites=2, substitutes=2, crossover=0.7, mutation=0.3)
    initial = sample(space, population, 3).points
    if repeated:
        initial[1::2] = initial[0]

    def tied(x):
        return np.round(bowl(x), 1)

    def violation(x):
        failed = np.where(np.round(100 * x.sum(axis=1)) % 7 == 0, 1e12, 0.0)
        return np.maximum(failed, scaled_violation(space, x))

    expected = written_out(space, settings, 5, tied, violation, initial)
    np.testing.assert_array_equal(play(space, settings, 5, tied, violation, initial)[0], expected)


def test_pymoo_is_given_operators_and_no_part_of_its_loop_is_replaced():
    own = [c for _, c in inspect.getmembers(genetic, inspect.isclass) if c.__module__ == genetic.__name__]
    derived = [c for c in own if any(b.__module__.startswith("pymoo") for b in c.__mro__)]
    assert len(derived) > 2 and not any(issubclass(c, Algorithm) for c in derived)
    for one in derived:
        assert {name for name, what in vars(one).items() if inspect.isfunction(what)} <= {"__init__", "do", "_do"}


# -- feasibility -------------------------------------------------------------------------------------------------------


def test_constraints_are_kept():
    space = ParameterSpace(
        tuple(Parameter(f"p{k}", 0.5, 0.0, 1.0) for k in range(4)),
        (LinearConstraint("sum", tuple((f"p{k}", 1.0) for k in range(4)), 2.0, 2.4),),
    )
    populations, misfits = play(
        space,
        GeneticSettings(generations=60),
        misfit=lambda x: x.sum(axis=1),  # pulls over the lower limit
        violation=lambda x: space.violation(x).sum(axis=1),
    )
    feasible = space.feasible(populations.reshape(-1, 4)).reshape(populations.shape[:2])
    assert feasible[0].all() and feasible[-20:].mean() > 0.3
    assert misfits[feasible].min() < 2.02


def test_infeasible_individuals_come_last_and_the_least_infeasible_first():
    def violation(x):
        return np.where(x[:, 0] < 0.8, 0.8 - x[:, 0], 0.0)

    settings = GeneticSettings(population=20, generations=40)
    initial = np.random.default_rng(1).random((20, 3)) * [0.3, 1.0, 1.0]
    populations, _ = play(box(3), settings, misfit=lambda x: x[:, 0], violation=violation, initial=initial)
    assert not np.any(violation(populations[0]) == 0)
    assert np.mean(violation(populations[-1]) == 0) > 0.5
    assert populations[-1][:, 0][violation(populations[-1]) == 0].min() < 0.85


def test_misfits_of_infeasible_individuals_do_not_matter():
    def violation(x):
        return np.where(x[:, 0] > 0.02, 1.0, 0.0)  # equal, as of points that could not be evaluated

    def noisy(x):
        return np.where(violation(x) > 0, np.nan, bowl(x))

    settings = GeneticSettings(population=10, generations=10)
    np.testing.assert_array_equal(
        play(box(3), settings, violation=violation)[0], play(box(3), settings, misfit=noisy, violation=violation)[0]
    )


# -- misuse ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "label"),
    [
        ({"population": 3}, "population is 3"),
        ({"generations": 0}, "generations is 0"),
        ({"elites": 0, "substitutes": 0}, "elites is 0"),
        ({"elites": 30, "substitutes": 30}, "elites is 30"),
        ({"elites": 2}, "substitutes is 1"),
        ({"crossover": 1.1}, "crossover is 1.1"),
        ({"mutation": -0.1}, "mutation is -0.1"),
        ({"sigma_start": 0.0}, "sigma_start is 0.0"),
        ({"sigma_end": float("nan")}, "sigma_end is nan"),
    ],
)
def test_settings_out_of_range(changes, label):
    with pytest.raises(InputError, match=label):
        GeneticSettings(**changes)


def test_a_wrong_initial_population():
    settings = GeneticSettings(population=4, generations=2)
    with pytest.raises(InputError, match="not \\(4, 2\\)"):
        GeneticSearch(box(2), settings, np.zeros((5, 2)), 1)
    with pytest.raises(InputError, match="outside"):
        GeneticSearch(box(2), settings, np.full((4, 2), 1.5), 1)
    with pytest.raises(InputError, match="outside"):
        GeneticSearch(box(2), settings, np.full((4, 2), np.nan), 1)
    with pytest.raises(InputError, match="fraction"):
        GeneticSearch(box(2, 0, 3, integer=True), settings, np.full((4, 2), 0.5), 1)


def test_wrong_misfits_are_refused():
    search = GeneticSearch(box(2), GeneticSettings(population=4, generations=2), np.full((4, 2), 0.5), 1)
    with pytest.raises(RuntimeError):
        search.tell(np.zeros(4), np.zeros(4))
    search.ask()
    for misfit, violation in (
        (np.zeros(3), np.zeros(3)),
        (np.full(4, np.nan), np.zeros(4)),
        (np.zeros(4), -np.ones(4)),
        (np.zeros(4), np.full(4, np.nan)),
    ):
        with pytest.raises(ValueError):
            search.tell(misfit, violation)
    search.tell(np.zeros(4), np.ones(4))


@pytest.mark.parametrize("kind", ["plain", "integers"])
def test_equalities_hold_in_every_generation(kind):
    """Of the sum of two parameters, beside a third that is free."""
    pair = tuple(Parameter(name, 10.0, 1.0, 100.0, integer=kind == "integers") for name in "ab")
    tied = ParameterSpace(
        (*pair, Parameter("c", 0.5, 0.0, 1.0)), (LinearConstraint("sum", (("a", 1.0), ("b", 1.0)), 90.0, 90.0),)
    )
    settings = GeneticSettings(population=20, generations=8)
    populations, _ = play(tied, settings, 1, lambda x: np.abs(x[:, 0] - 30.0), lambda x: scaled_violation(tied, x))
    later = populations[1:].reshape(-1, 3)
    met = tied.feasible(later)
    assert met.mean() > 0.6 and len(np.unique(later[met], axis=0)) > 40  # others leave their limits
    np.testing.assert_allclose(later[met][:, :2].sum(axis=1), 90.0, atol=1e-9)
    assert np.abs(later[met][:, 0] - 30.0).min() < 3.0
