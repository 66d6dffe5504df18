"""Genetic algorithm with generational replacement and an elite, or NSGA-II, through an ask/tell interface.

The loop is pymoo's, and NSGA-II's selection and survival; the operators here are passed to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pymoo.algorithms.moo.nsga2 import NSGA2, binary_tournament
from pymoo.algorithms.soo.nonconvex.ga import GA, comp_by_cv_and_fitness
from pymoo.core.duplicate import DuplicateElimination
from pymoo.core.evaluator import Evaluator
from pymoo.core.mating import Mating
from pymoo.core.mutation import Mutation
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.core.survival import Survival
from pymoo.operators.crossover.ux import UniformCrossover
from pymoo.operators.selection.tournament import TournamentSelection
from pymoo.problems.static import StaticProblem

from calib.errors.errors import InputError
from calib.problem.sampling import Narrow
from calib.problem.space import ParameterSpace


@dataclass(frozen=True)
class GeneticSettings:
    """Settings of the search; the defaults are those of Ribeiro et al. (2013) where they are published.

    Attributes
    ----------
    population, generations : int
        ``population * generations`` points are requested, the initial population included.
    elites, substitutes : int
        The best individuals of a generation, and the worst children of the next that they replace; equal numbers.
    crossover : float
        Probability, per pair of parents, of a uniform crossover (assumed meaning); other pairs are copied.
    mutation : float
        Probability per gene.
    sigma_start, sigma_end : float
        Standard deviation of the Gaussian mutation over the range between the limits; it falls linearly from the first
        to the last generation of children. The end is assumed.

    Raises
    ------
    InputError
        For a value outside its range.
    """

    population: int = 30
    generations: int = 250
    elites: int = 1
    substitutes: int = 1
    crossover: float = 0.5
    mutation: float = 0.15
    sigma_start: float = 0.10
    sigma_end: float = 0.01

    def __post_init__(self) -> None:
        checks = (
            ("population", self.population >= 4, "at least 4"),
            ("generations", self.generations >= 1, "at least 1"),
            ("elites", 1 <= self.elites < self.population, "at least 1 and fewer than the population"),
            ("substitutes", self.substitutes == self.elites, "as many as elites, since each takes one place"),
            ("crossover", 0 <= self.crossover <= 1, "from 0 to 1"),
            ("mutation", 0 <= self.mutation <= 1, "from 0 to 1"),
            ("sigma_start", 0 < self.sigma_start <= 1, "above 0 and at most 1"),
            ("sigma_end", 0 < self.sigma_end <= 1, "above 0 and at most 1"),
        )
        for label, good, allowed in checks:
            if not good:
                raise InputError(
                    f"{label} is {getattr(self, label)}", place="genetic algorithm", remedy=f"allowed is {allowed}"
                )

    def sigma(self, generation: int) -> float:
        """Standard deviation of the mutation that makes a generation, counted from 1 (the initial population)."""
        if self.generations < 3:
            return self.sigma_start
        share = (generation - 2) / (self.generations - 2)
        return self.sigma_start + (self.sigma_end - self.sigma_start) * min(max(share, 0.0), 1.0)


class GeneticSearch:
    """Minimisation by ask and tell: `ask` returns a population, `tell` takes its misfits and violations.

    Infeasible individuals lose every tournament against feasible ones and are ranked among themselves by their
    violation (Deb 2000). Same settings, initial population, seed and misfits: same populations.

    Of several objectives the search is NSGA-II (Deb et al. 2002): parents and children compete by the front to which
    they belong, then by their distance along it. Crossover and mutation are the same, the elite is not used.

    Parameters
    ----------
    space : ParameterSpace
        Limits and integer flags of the free parameters.
    settings : GeneticSettings
    initial : ndarray (population, n_free)
        First population.
    seed : int
    objectives : int
        Misfits of each individual.

    Raises
    ------
    InputError
        When the initial population has another shape, leaves the limits, or has fractions in an integer parameter.
    """

    def __init__(
        self, space: ParameterSpace, settings: GeneticSettings, initial: np.ndarray, seed: int, objectives: int = 1
    ):
        start = np.array(initial, dtype=float)
        expected = (settings.population, len(space.free))
        if start.shape != expected:
            raise InputError(f"the initial population is {start.shape}, not {expected}", place="genetic algorithm")
        if not np.all((start >= space.lower) & (start <= space.upper)):
            raise InputError("an initial individual is outside the limits", place="genetic algorithm")
        self._space = space
        if np.any(start[:, space.integer] != np.round(start[:, space.integer])):
            raise InputError("an integer parameter starts at a fraction", place="genetic algorithm")
        self.settings = settings
        # Limits only: pymoo evaluates nothing here. Its individuals are coordinates along the scales.
        lower, upper = space.coordinates(space.lower), space.coordinates(space.upper)
        self._problem = Problem(n_var=len(space.free), n_obj=objectives, n_ieq_constr=1, xl=lower, xu=upper)
        # A stream of its own: a sampler given the same seed would otherwise produce the same numbers.
        stream = np.random.SeedSequence(seed, spawn_key=(1,))
        one = objectives == 1
        mating = _FilledMating(
            TournamentSelection(func_comp=comp_by_cv_and_fitness if one else binary_tournament),
            UniformCrossover(prob=settings.crossover),
            _ShrinkingGaussian(settings, space),
            eliminate_duplicates=_AmongChildren(),
            n_max_iterations=20,
        )
        # The initial population stays as it is given, with individuals that occur twice.
        given = {"sampling": space.coordinates(start), "mating": mating, "eliminate_duplicates": False}
        if one:
            self._algorithm = GA(settings.population, survival=_ChildrenAndElite(settings.elites), **given)
        else:
            self._algorithm = NSGA2(settings.population, **given)
        self._algorithm.setup(self._problem, termination=("n_gen", settings.generations), seed=stream)
        self._asked: Population | None = None

    @property
    def generation(self) -> int:
        """Number of the current generation, from 1; the last one when done."""
        return min(self._algorithm.n_gen or 1, self.settings.generations)

    @property
    def done(self) -> bool:
        """Whether all generations are evaluated."""
        return not self._algorithm.has_next()

    def ask(self) -> np.ndarray:
        """The individuals of this generation, shape (population, n_free); the same until `tell` is called."""
        if self.done:
            raise RuntimeError("the search is done")
        if self._asked is None:
            self._asked = self._algorithm.ask()
        return self._space.of_coordinates(self._asked.get("X").astype(float))

    def tell(self, misfit: np.ndarray, violation: np.ndarray) -> None:
        """Report misfit and violation of the individuals that `ask` returned.

        Parameters
        ----------
        misfit : ndarray (population,) or (population, objectives)
            Finite where the violation is 0; ignored elsewhere.
        violation : ndarray (population,)
            0 for a feasible individual, positive otherwise.
        """
        if self._asked is None:
            raise RuntimeError("tell was called before ask")
        n = len(self._asked)
        misfit, violation = np.asarray(misfit, dtype=float), np.asarray(violation, dtype=float)
        if misfit.size != n * self._problem.n_obj or len(misfit) != n or violation.shape != (n,):
            raise ValueError(f"misfit {misfit.shape} and violation {violation.shape} are not ({n},)")
        misfit, feasible = misfit.reshape(n, -1), violation == 0
        if not (np.all(violation >= 0) and np.all(np.isfinite(misfit[feasible]))):
            raise ValueError("a violation is negative or NaN, or the misfit of a feasible individual is not finite")
        # NaN would tie at random in a tournament.
        reported = StaticProblem(self._problem, F=np.where(feasible[:, None], misfit, np.inf), G=violation[:, None])
        Evaluator().eval(reported, self._asked)
        self._algorithm.tell(infills=self._asked)
        self._asked = None


class _ChildrenAndElite(Survival):
    """The best of the parents replace the worst children."""

    def __init__(self, elites: int):
        super().__init__(filter_infeasible=False)  # feasibility is ranked here
        self.elites = elites

    def _do(self, problem: Problem, pop: Population, *args: Any, algorithm: Any, **kwargs: Any) -> Population:
        new = pop.get("n_gen") == algorithm.n_gen
        parents, children = pop[~new], pop[new]
        best = parents[_ranking(parents)[: self.elites]]
        return Population.merge(best, children[_ranking(children)[: len(children) - self.elites]])


def _ranking(pop: Population) -> np.ndarray:
    """Indices from best to worst: by violation, then by misfit; the first one wins a tie."""
    misfit, violation = pop.get("F", "CV")
    return np.lexsort([misfit[:, 0], violation[:, 0]])


class _FilledMating(Mating):
    """Mating that repeats children where a small integer space has too few different ones."""

    def do(self, problem: Problem, pop: Population, n_offsprings: int, *args: Any, **kwargs: Any) -> Population:
        children = super().do(problem, pop, n_offsprings, *args, **kwargs)
        missing = n_offsprings - len(children)
        if missing > 0:
            repeating = Mating(self.selection, self.crossover, self.mutation)
            children = Population.merge(children, repeating.do(problem, pop, missing, *args, **kwargs))
        return children


class _AmongChildren(DuplicateElimination):
    """Drops children equal to an earlier child; one equal to a parent may live, as it costs no evaluation.

    pymoo's own eliminations keep the last of equal ones, and compare with the parents too.
    """

    def do(self, pop: Population, *others: Population, **kwargs: Any) -> Population:
        earlier = others[1] if len(others) > 1 else ()
        seen = {individual.X.tobytes() for individual in earlier}
        keep = []
        for k, individual in enumerate(pop):
            key = individual.X.tobytes()
            if key not in seen:
                seen.add(key)
                keep.append(k)
        return pop[keep]


class _ShrinkingGaussian(Mutation):
    """Gaussian mutation, gene by gene, with a standard deviation that falls over the generations; reflected at limits.

    Of narrow constraints one parameter follows from the others; where it leaves its limits the child is infeasible.
    pymoo's own mutation resamples points out of bounds without regard to the seed, and keeps its standard deviation.
    """

    def __init__(self, settings: GeneticSettings, space: ParameterSpace):
        super().__init__(prob=1.0)
        self.settings = settings
        self.integer = space.integer
        self.narrow = Narrow.of(space)

    def _do(
        self,
        problem: Problem,
        x: np.ndarray,
        *args: Any,
        algorithm: Any,
        random_state: np.random.Generator,
        **kwargs: Any,
    ) -> np.ndarray:
        sigma = self.settings.sigma(algorithm.n_gen)
        chosen = random_state.random(x.shape) < self.settings.mutation
        step = sigma * (problem.xu - problem.xl) * random_state.standard_normal(x.shape)
        moved = reflect(x + step, problem.xl, problem.xu)
        moved = np.where(self.integer, np.round(moved), moved)
        return self.narrow.filled(np.where(chosen, moved, x))


def reflect(x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Reflect points at their limits until they are inside; points inside stay as they are.

    Parameters
    ----------
    x : ndarray (n, n_free)
    lower, upper : ndarray (n_free,)
    """
    width = upper - lower
    turn = np.mod((x - lower) / width, 2.0)
    folded = np.clip(lower + width * np.where(turn > 1.0, 2.0 - turn, turn), lower, upper)
    return np.where((x >= lower) & (x <= upper), x, folded)
