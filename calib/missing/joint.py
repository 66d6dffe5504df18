"""Joint search over several tests for the effect that their models lack: one decision over all rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from calib.inference.other_rows import other_rows
from calib.missing.candidate_fit import CandidateFit
from calib.problem.candidate import Candidate
from calib.problem.joint import JointProblem, JointRows, of_test

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class JointHypotheses(JointRows):
    """Hypotheses of several tests; effects of the same name are one effect in all their models.

    Attributes
    ----------
    parts : mapping from str to Hypotheses
        Hypotheses of each test, by its name.
    """

    _fit_problems: dict[frozenset[str], JointProblem] = field(init=False, repr=False, default_factory=dict)

    @cached_property
    def effects(self) -> tuple[Candidate, ...]:
        """Named candidates of all tests."""
        return tuple({e.name: e for part in self.parts.values() for e in part.effects}.values())

    @cached_property
    def perturbations(self) -> tuple[Candidate, ...]:
        """Unnamed local perturbations of all tests."""
        return tuple({e.name: e for part in self.parts.values() for e in part.perturbations}.values())

    @cached_property
    def faults(self) -> tuple[Candidate, ...]:
        """Faults of the measurements of all tests."""
        return tuple({e.name: e for part in self.parts.values() for e in part.faults}.values())

    @property
    def row_freqs(self) -> np.ndarray:
        """Frequency of every row of all tests, (n_rows,), Hz; NaN where it has none."""
        return np.concatenate([part.row_freqs for part in self.parts.values()])

    @property
    def evaluations(self) -> int:
        """Number of model evaluations so far, over all tests."""
        return sum(part.evaluations for part in self.parts.values())

    def fit_problem(self, names: tuple[str, ...]) -> JointProblem:
        """The models with the named effects or local perturbations, each in those tests whose model may lack it."""
        key = frozenset(names)
        if key not in self._fit_problems:
            problems = {test: part.fit_problem(self._of(test, names)) for test, part in self.parts.items()}
            self._fit_problems[key] = JointProblem(problems, {test: self._possible(test) for test in self.parts})
        return self._fit_problems[key]

    def granting(self, faults: tuple[str, ...]) -> JointHypotheses:
        """The same with the magnitudes of some faults among the parameters of the tests that may have them."""
        own = {test: tuple(e.name for e in part.faults if e.name in faults) for test, part in self.parts.items()}
        return JointHypotheses(
            {test: part.granting(own[test]) if own[test] else part for test, part in self.parts.items()}
        )

    def linear_start(self, names: tuple[str, ...], values: Mapping[str, float]) -> dict[str, float] | None:
        """Values from linear solutions of all tests that have one; None where none has."""
        fit_problem = self.fit_problem(names)
        found: dict[str, float] = {}
        for test, part in self.parts.items():
            found |= part.linear_start(self._of(test, names), fit_problem.own(test, values)) or {}
        return {**values, **found} if found else None

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """Measured modes of all tests that the models leave unpaired at the given values."""
        fit_problem = self.fit_problem(names)
        return frozenset(
            of_test(test, mode)
            for test, part in self.parts.items()
            for mode in part.unpaired(self._of(test, names), fit_problem.own(test, values))
        )

    def of(self, test: str, candidate_fit: CandidateFit, held_sd: Mapping[str, float] = _NONE) -> CandidateFit:
        """Part of a joint fit that belongs to one test: its rows, its parameters, its effects.

        What the other tests say about these parameters is condensed to a few rows (`OtherRows`), so that the posterior
        covariance of the part is that of the joint fit. ``held_sd`` holds standard deviations of held parameters.
        """
        part, fit = self.parts[test], candidate_fit.fit
        names = self._of(test, fit.effects)
        fit_problem = part.fit_problem(names)
        rows = [k for k, row in enumerate(self.rows) if row.test == test]
        kept = [k for k, name in enumerate(fit.names) if name in fit_problem.space]
        data, slope = fit.augmented[: -len(fit.names) or None], fit.data_slope
        held = np.zeros((len(data), 0)) if fit.shared is None else fit.shared
        first = held.shape[1]
        if held_sd:
            more = -fit.fit_problem.jacobian(fit.values, tuple(held_sd)) * list(held_sd.values())
            held = np.hstack([held, np.pad(more, ((0, len(data) - len(more)), (0, 0)))])
        others = other_rows(slope, fit.prior_sd, data, fit.shift, rows, kept, held)
        shared = np.vstack([held[rows, :first], others.held[:, :first]])
        own = replace(
            fit,
            effects=names,
            fit_problem=fit_problem,
            names=tuple(fit.names[k] for k in kept),
            values={name: value for name, value in fit.values.items() if name in fit_problem.space},
            residual=fit.residual[rows],
            slope=fit.slope[np.ix_(rows, kept)],
            prior_sd=fit.prior_sd[kept],
            shift=fit.shift[kept],
            others=others._replace(held=others.held[:, first:]),
            shared=shared,
        )
        return replace(candidate_fit, effects=tuple(e for e in candidate_fit.effects if e.name in names), fit=own)

    def _of(self, test: str, names: Sequence[str]) -> tuple[str, ...]:
        return tuple(name for name in names if name in self._possible(test))

    def _possible(self, test: str) -> frozenset[str]:
        """Effects and local perturbations that the test's model may lack, and faults of its measurement."""
        part = self.parts[test]
        return frozenset(e.name for e in (*part.effects, *part.perturbations, *part.faults))
