"""Adapter of several tests that are explained together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.analyses.adapter import Adapter
from calib.analyses.discretisation_error import DiscretisationError
from calib.analyses.explanation_result import ExplanationResult, MeasurementFacts
from calib.joint import TEST, of_test, said, stacked
from calib.missing.explanation import CandidateFit, Explanation
from calib.missing.joint import JointHypotheses
from calib.missing.recommendation import ExperimentalDesign
from calib.outcome import Outcome
from calib.stage import Progress, unheard


@dataclass(frozen=True, eq=False)
class JointAdapter:
    """Several tests, each against its own model under its own condition.

    Attributes
    ----------
    adapters : mapping from str to Adapter
        By name of the test.
    hypotheses : JointHypotheses
        Of all tests.
    facts : MeasurementFacts
    """

    adapters: Mapping[str, Adapter]
    hypotheses: JointHypotheses
    facts: MeasurementFacts

    @classmethod
    def of(cls, adapters: Mapping[str, Adapter]) -> JointAdapter:
        """Several adapters as one; seed and number of samples are those of the first."""
        facts = {test: adapter.facts for test, adapter in adapters.items()}
        first = next(iter(facts.values()))
        of_all = MeasurementFacts(
            assumed="; ".join(of_test(test, one.assumed) for test, one in facts.items() if one.assumed),
            accuracy="; ".join(of_test(test, one.accuracy) for test, one in facts.items() if one.accuracy),
            notes=said({test: one.notes for test, one in facts.items()}),
            disagreements=stacked({test: one.disagreements for test, one in facts.items()}),
            held_sd={name: sd for one in facts.values() for name, sd in one.held_sd.items()},
            seed=first.seed,
            samples=first.samples,
        )
        return cls(adapters, JointHypotheses({test: adapter.hypotheses for test, adapter in adapters.items()}), of_all)

    @property
    def budget_of_fits(self) -> float:
        """Sum over the tests, since every fit solves each model."""
        return sum(adapter.budget_of_fits for adapter in self.adapters.values())

    def notes(self) -> list[str]:
        """The notes of every test."""
        return list(said({test: adapter.notes() for test, adapter in self.adapters.items()}))

    def errors(
        self, stages: dict[str, CandidateFit], scale: float
    ) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data over all tests; notes and summary entries of each.

        ``rms`` and ``expected`` are over the rows of all tests; ``p`` is the smallest p-value of the tests times their
        number (Bonferroni). The expected error of a test uses its own data alone, which determine the parameters less
        well than all data do.
        """
        parts, notes, figures = [], [], dict[str, object]()
        for test, adapter in self.adapters.items():
            table, own, more = adapter.errors(self._of(test, stages), scale)
            parts.append(table)
            notes += [of_test(test, note) for note in own]
            figures |= {of_test(test, name): value for name, value in more.items()}
        return _together(pd.concat(parts, ignore_index=True)), notes, figures

    def failing(self) -> set[str]:
        """Effects with which a model of any test failed somewhere."""
        return {name for adapter in self.adapters.values() for name in adapter.failing()}

    def failed(self) -> list[Outcome]:
        """Points at which the user's code failed, test by test."""
        return [outcome for adapter in self.adapters.values() for outcome in adapter.failed()]

    def design(self, found: Explanation, progress: Progress = unheard) -> ExperimentalDesign | None:
        """None: candidate measurements are proposed for single tests only."""
        return None

    def discretisation_error(self, found: Explanation) -> DiscretisationError | None:
        """None: the discretisation error is scored for single tests only."""
        return None

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Kind, location (m) and sensor of every local perturbation and fault of a measurement, by name."""
        return {name: place for adapter in self.adapters.values() for name, place in adapter.places().items()}

    def labels(self) -> pd.DataFrame:
        """The labels of every test, with a column ``test``."""
        return stacked({test: adapter.labels() for test, adapter in self.adapters.items()})

    def tables(self, stages: dict[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """The tables of every test, stacked by name with a column ``test``.

        A test without a table of that name has no rows in it.
        """
        found: dict[str, dict[str, pd.DataFrame]] = {}
        for test, adapter in self.adapters.items():
            for name, table in adapter.tables(self._of(test, stages)).items():
                found.setdefault(name, {})[test] = table
        return {name: stacked(tables) for name, tables in found.items()}

    def seen(self, test: str, answer: ExplanationResult) -> ExplanationResult:
        """The result for one test: its own errors, in the stages of the joint ones, and its own rows."""
        found = answer.explanation
        last = next((stage for stage in answer.errors["stage"] if stage != "before"), "")
        stages = {"before": found.base} | ({last: found.chosen} if last and found.chosen is not None else {})
        errors = self.adapters[test].errors(self._of(test, stages), found.noise_scale)[0]
        errors = errors[list(answer.errors.columns.drop("std_from"))].assign(std_from=answer.errors["std_from"].iloc[0])
        tables = {}
        for name, table in answer.tables.items():
            own = table[table[TEST] == test].drop(columns=TEST) if TEST in table else table
            if TEST not in table or len(own):
                tables[name] = own
        return replace(answer, errors=errors, tables=tables)

    def _of(self, test: str, stages: dict[str, CandidateFit]) -> dict[str, CandidateFit]:
        return {stage: self.hypotheses.of(test, candidate_fit) for stage, candidate_fit in stages.items()}


def together(adapters: Mapping[str, Adapter]) -> Adapter:
    """The adapter of all tests together; of a single test its own."""
    return JointAdapter.of(adapters) if len(adapters) > 1 else next(iter(adapters.values()))


def _together(table: pd.DataFrame) -> pd.DataFrame:
    """Errors of several tests combined by group and stage."""
    rows = []
    for (stage, group), own in table.groupby(["stage", "group"], sort=False):
        weight = own["rows"] / own["rows"].sum()
        rms, expected = (float(np.sqrt((weight * own[name] ** 2).sum())) for name in ("rms", "expected"))
        p = min(1.0, len(own) * float(own["p"].min()))
        rows.append((group, int(own["rows"].sum()), rms, expected, p, int(own["unpaired"].sum()), stage))
    return pd.DataFrame(rows, columns=["group", "rows", "rms", "expected", "p", "unpaired", "stage"])
