"""Genetic searches over a problem."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import pandas as pd

from calib.analyses.failures import reasons_sentence, stored_reasons
from calib.analyses.fit_statistics import FitStatistics, Shared, ended, fitted
from calib.api.pairs import kept_in
from calib.api.protocols import PosedProblem
from calib.api.responses import Responses
from calib.execution.executor import Injected
from calib.execution.stage import Progress, named
from calib.inference.agreement import Agreement, agreement, agreement_sentences
from calib.inference.cases import Case, CaseResult, convergence_table, parameters_table, run_case
from calib.inference.genetic import GeneticSettings
from calib.inference.rules import RULES
from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace


@dataclass(frozen=True, eq=False)
class Searched:
    """Independent runs of a genetic search, before any least squares.

    Attributes
    ----------
    space : ParameterSpace
        The searched space.
    cases : tuple of CaseResult
        One per seed.
    why_failed : str
        The most frequent reasons for failed points; empty without any.
    """

    space: ParameterSpace
    cases: tuple[CaseResult, ...]
    why_failed: str = ""

    @property
    def agreement(self) -> Agreement:
        """Whether the cases found one solution."""
        return agreement(self.cases, self.space)

    @property
    def best(self) -> tuple[CaseResult, ...]:
        """The cases sorted by their misfit, the lowest first."""
        return tuple(sorted(self.cases, key=lambda case: case.misfit))

    @property
    def table(self) -> pd.DataFrame:
        """One row per case: ``case, misfit, asked, solved, reused, infeasible, failed``; see `CaseResult`."""
        columns = ["name", "misfit", "asked", "solved", "reused", "infeasible", "failed"]
        rows = [[getattr(case, column) for column in columns] for case in self.cases]
        return pd.DataFrame(rows, columns=["case", *columns[1:]])

    @property
    def parameters(self) -> pd.DataFrame:
        """Where each case ended; see `calib.inference.cases.parameters_table`."""
        return parameters_table(self.cases, self.space)

    @property
    def convergence(self) -> pd.DataFrame:
        """Misfit over the generations; see `calib.inference.cases.convergence_table`."""
        return convergence_table(self.cases)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Whether the cases agree, and why points failed."""
        return (*agreement_sentences(self.agreement, None), *([self.why_failed] if self.why_failed else []))


def searched(
    problem: PosedProblem,
    seeds: Sequence[int],
    settings: GeneticSettings,
    executor: Executor | Injected | None,
    told: Progress,
) -> Searched:
    """One case per seed, each from its own Latin hypercube; see `calib.api.problem.Problem.search`."""
    space, responses = problem.space, Responses.of(problem)
    objective, fingerprint, found = responses.objective, responses.fingerprint, []
    with kept_in(problem.ledger) as ledger, responses.evaluator(executor) as evaluator:
        for k, seed in enumerate(seeds, start=1):
            initial = sample(space, settings.population, seed).points
            case = Case(f"C{k}", seed)
            step = partial(named(told, case.name), "genetic search")
            found.append(run_case(case, space, objective, settings, evaluator, ledger, fingerprint, initial, step))
        why = reasons_sentence(space, *stored_reasons(ledger, [fingerprint]))
    return Searched(space, tuple(found), why)


def refined(problem: PosedProblem, search: Searched, told: Progress) -> FitStatistics:
    """Least squares from the end of each case; from the nominal values where the data clearly prefer that solution."""
    starts = [case.values for case in search.best]
    nominal = ended(problem.posed, [problem.space.values], RULES.refits_after_search, told)
    return fitted(
        problem.posed, problem.terms, starts, RULES.refits_after_search, shared=Shared(nominal, known=None), told=told
    )
