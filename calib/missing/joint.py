"""Several tests asked together which effect their models lack: one decision over the rows of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.effect import Effect
from calib.joint import JointProblem, JointRows, of_test
from calib.missing.findings import Trial


@dataclass(frozen=True, eq=False)
class JointHypotheses(JointRows):
    """What several tests ask of effects and local changes; what has one name is one effect in all their models.

    Attributes
    ----------
    parts : mapping from str to Hypotheses
        By name of the test.
    """

    _questions: dict[frozenset[str], JointProblem] = field(init=False, repr=False, default_factory=dict)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Named candidates of all tests."""
        return tuple({e.name: e for part in self.parts.values() for e in part.effects}.values())

    @cached_property
    def atoms(self) -> tuple[Effect, ...]:
        """Unnamed local changes of all tests."""
        return tuple({e.name: e for part in self.parts.values() for e in part.atoms}.values())

    @property
    def evaluations(self) -> int:
        """Models solved so far, those of every test counted."""
        return sum(part.evaluations for part in self.parts.values())

    def question(self, names: tuple[str, ...]) -> JointProblem:
        """The models with the named effects or local changes, each in those tests whose model may lack it."""
        key = frozenset(names)
        if key not in self._questions:
            asked = {test: part.question(self._of(test, names)) for test, part in self.parts.items()}
            self._questions[key] = JointProblem(asked, {test: self._possible(test) for test in self.parts})
        return self._questions[key]

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        """Measured modes of all tests for which the models have no partner at named values."""
        question = self.question(names)
        return frozenset(
            of_test(test, mode)
            for test, part in self.parts.items()
            for mode in part.unpaired(self._of(test, names), question.own(test, values))
        )

    def of(self, test: str, trial: Trial) -> Trial:
        """What one test sees of a fit to all of them: its rows, its parameters, its effects."""
        part, state = self.parts[test], trial.state
        names = self._of(test, state.effects)
        question = part.question(names)
        rows = [k for k, row in enumerate(self.rows) if row.test == test]
        kept = [k for k, name in enumerate(state.names) if name in question.space]
        own = replace(
            state,
            effects=names,
            question=question,
            names=tuple(state.names[k] for k in kept),
            values={name: value for name, value in state.values.items() if name in question.space},
            residual=state.residual[rows],
            slope=state.slope[np.ix_(rows, kept)],
            prior_sd=state.prior_sd[kept],
            shift=state.shift[kept],
        )
        return replace(trial, effects=tuple(e for e in trial.effects if e.name in names), state=own)

    def _of(self, test: str, names: Sequence[str]) -> tuple[str, ...]:
        return tuple(name for name in names if name in self._possible(test))

    def _possible(self, test: str) -> frozenset[str]:
        """Effects and local changes that the test's model may lack."""
        return frozenset(e.name for e in (*self.parts[test].effects, *self.parts[test].atoms))
