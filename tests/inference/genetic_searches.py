"""Spaces, misfits and short searches for the tests of the genetic algorithm."""

import numpy as np
import pytest

from calib.inference.genetic import GeneticSearch
from calib.problem.sampling import sample
from calib.problem.space import Parameter, ParameterSpace


def box(n, lower=0.0, upper=1.0, integer=False):
    return ParameterSpace(tuple(Parameter(f"p{k}", lower, lower, upper, integer=integer) for k in range(n)))


def bowl(x):
    return np.sum((x - 0.3) ** 2, axis=1)


def play(space, settings, seed=1, misfit=bowl, violation=lambda x: np.zeros(len(x)), initial=None):
    """All populations, (generations, population, n_free), with their misfits."""
    if initial is None:
        initial = sample(space, settings.population, seed).points
    search = GeneticSearch(space, settings, initial, seed)
    populations, misfits = [], []
    while not search.done:
        assert search.generation == len(populations) + 1
        x = search.ask()
        np.testing.assert_array_equal(x, search.ask())
        populations.append(x)
        misfits.append(misfit(x))
        search.tell(misfits[-1], violation(x))
    assert search.generation == settings.generations
    with pytest.raises(RuntimeError):
        search.ask()
    return np.array(populations), np.array(misfits)


def copied(children, parents):
    """Which genes of children occur in the same column of their generation's parents."""
    return np.array([[np.any(parents[:, j] == child[j]) for j in range(len(child))] for child in children])
