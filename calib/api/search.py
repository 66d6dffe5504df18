"""Genetic searches behind a fit."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from calib.inference.agreement import Agreement, agreement, agreement_sentences
from calib.inference.cases import CaseResult, convergence_table, parameters_table
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
    """

    space: ParameterSpace
    cases: tuple[CaseResult, ...]

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
        """Whether the cases agree."""
        return agreement_sentences(self.agreement, None)
