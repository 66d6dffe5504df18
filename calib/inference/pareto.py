"""Trade-off between two objectives: a search for the Pareto front, and the knee of that front."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

import numpy as np

from calib.errors.errors import EvaluationError, InputError
from calib.execution.evaluate import BatchEvaluator, Recorder
from calib.execution.outcome import Outcome, failure, point_key
from calib.inference.cases import FAILED, scaled_violation
from calib.inference.objective import Objective
from calib.problem.space import ParameterSpace

if TYPE_CHECKING:
    from calib.inference.genetic import GeneticSettings

FREQUENCIES, SHAPES = "frequencies", "shapes"
"""Names of the two groups of a study that names none."""
BENT = 0.1
"""Least distance of a knee below the line between the ends of a front, over that of the point that is best in both."""


@dataclass(frozen=True)
class ResponseGroup:
    """One of two objectives: the mean error of some responses.

    Attributes
    ----------
    name : str
    weights : mapping from str to float
        Weight of each of its responses in the mean, 1 where all count alike in the objective of a search.
    weight : float
        Weight of that mean in the objective of a search, which is the weighted sum over both groups.
    """

    name: str
    weights: Mapping[str, float]
    weight: float

    @classmethod
    def of(cls, name: str, responses: tuple[str, ...], objective: Objective) -> ResponseGroup:
        """The group of the responses that match; InputError where a pattern matches none."""
        known = objective.weights
        chosen = dict[str, float]()
        for pattern in responses:
            found = {one: weight for one, weight in known.items() if one == pattern or fnmatchcase(one, pattern)}
            if not found:
                raise InputError(
                    f"{pattern!r} matches no response of the objective", place=f"pareto, {name}",
                    remedy=f"the responses are {', '.join(list(known)[:12])}" + ", ..." * (len(known) > 12),
                )  # fmt: skip
            chosen |= found
        alike = set(chosen.values())
        if alike == {0.0}:
            words = f"the responses of {name!r} have no weight in the objective"
            raise InputError(words, place="pareto", remedy="choose others, or give them weight")
        if len(alike) == 1:
            (common,) = alike
            return cls(name, dict.fromkeys(chosen, 1.0), common * len(chosen))
        return cls(name, chosen, float(len(chosen)))

    def __call__(self, terms: Mapping[str, float]) -> float:
        """Mean error, from the error of every response."""
        return math.fsum(weight * terms[name] for name, weight in self.weights.items()) / len(self.weights)


def groups_of(objective: Objective, named: Mapping[str, tuple[str, ...]]) -> tuple[ResponseGroup, ResponseGroup]:
    """The two objectives; without names the frequencies and the shapes of all tests.

    Raises
    ------
    InputError
        For a response in both, for names that match none, and for no names where no shapes were measured.
    """
    if not named:
        of_shapes = tuple(name for name in objective.weights if name.rpartition(": ")[2].startswith("mac_"))
        others = tuple(name for name in objective.weights if name not in of_shapes)
        if not (of_shapes and others):
            raise InputError(
                "no shapes were measured, so that frequencies cannot be weighed against MAC", place="pareto",
                remedy="name two groups of responses in 'objectives'",
            )  # fmt: skip
        alone = all(name.rpartition(": ")[2].startswith("natural_freq_") for name in others)
        named = {FREQUENCIES if alone else f"{FREQUENCIES} and responses": others, SHAPES: of_shapes}
    first, second = (ResponseGroup.of(name, tuple(responses), objective) for name, responses in named.items())
    if both := [name for name in first.weights if name in second.weights]:
        words = f"{both[0]!r} belongs to {first.name!r} and to {second.name!r}"
        raise InputError(words, place="pareto", remedy="name it in one of them")
    return first, second


def search_front(
    space: ParameterSpace,
    objective: Objective,
    groups: tuple[ResponseGroup, ResponseGroup],
    settings: GeneticSettings,
    evaluator: BatchEvaluator,
    ledger: Recorder,
    fingerprint: str,
    initial: np.ndarray,
    seed: int,
    progress: Callable[[int, int], None] = lambda generation, generations: None,
) -> dict[str, Outcome]:
    """Search the front by NSGA-II (Deb et al. 2002); after an interruption it resumes from the ledger.

    Individuals that break a limit or constraint are never evaluated.

    Parameters
    ----------
    space, objective, settings, evaluator, ledger, fingerprint
        As in `calib.inference.cases.run_case`.
    groups : pair of Group
    initial : ndarray (population, n_free)
    seed : int
    progress : callable
        Called with the generation and their number.

    Returns
    -------
    mapping from str to Outcome
        Every individual that could be evaluated, by its key, in the order of requests.

    Raises
    ------
    EvaluationError
        When no individual of a whole population could be evaluated; with the last error.
    """
    from calib.inference.genetic import GeneticSearch

    search = GeneticSearch(space, settings, initial, seed, objectives=2)
    found = dict[str, Outcome]()
    fault, evaluated = EvaluationError("every individual broke a limit or constraint"), 0
    while not search.done:
        generation, points = search.generation, search.ask()
        violation = scaled_violation(space, points)
        values = [space.complete(x) for x in points]
        feasible = np.flatnonzero(violation == 0).tolist()
        outcomes = ledger.evaluate(fingerprint, [values[k] for k in feasible], evaluator, lambda done: None)
        errors = np.full((len(points), 2), np.nan)
        for k, outcome in zip(feasible, outcomes, strict=True):
            if outcome.status == "ok":
                terms = objective.terms(outcome.responses)
                errors[k] = [group(terms) for group in groups]
            if np.isfinite(errors[k]).all():
                found.setdefault(point_key(values[k]), outcome)
            else:
                violation[k] = FAILED
                fault = failure(outcome) if outcome.error else EvaluationError("an error is not finite")
        evaluated += len(feasible)
        if not found and evaluated >= settings.population:
            raise fault
        search.tell(errors, violation)
        progress(generation, settings.generations)
    if not found:
        raise fault
    return found


def front_of(errors: np.ndarray) -> np.ndarray:
    """Which rows (n, 2) no other one dominates, sorted by the first error; of equal ones the first."""
    order = np.lexsort([errors[:, 1], errors[:, 0]])
    lowest = np.minimum.accumulate(errors[order, 1])
    new = np.concatenate([[True], lowest[1:] < lowest[:-1]])
    return np.asarray(order[new])


def knee_of(errors: np.ndarray) -> int | None:
    """Row of a sorted front (n, 2) that lies farthest below the line between its ends, each axis over its range.

    There a gain in either error costs most of the other one (Das 1999). None where no row lies below that line by
    `BENT`: along a straight front no design is preferable.
    """
    if len(errors) < 3:
        return None
    low, high = errors.min(axis=0), errors.max(axis=0)
    below = 1.0 - ((errors - low) / (high - low)).sum(axis=1)
    best = int(np.argmax(below))
    return best if below[best] > BENT else None
