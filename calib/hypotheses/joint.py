"""Adapter of several tests that are explained together."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.execution.outcome import Outcome
from calib.execution.stage import Progress, silent
from calib.missing.adapter import Adapter
from calib.missing.between_tests import Differences, differences
from calib.missing.candidate_fit import CandidateFit
from calib.missing.discrepancy import Discrepancy
from calib.missing.explanation import Explanation
from calib.missing.facts import DiscretisationError, MeasurementFacts, Places
from calib.missing.joint import JointHypotheses
from calib.missing.recommendation import ExperimentalDesign
from calib.problem.degrees_of_freedom import behind, matched, p_value
from calib.problem.effect import Effect
from calib.problem.joint import of_test, prefixed, stacked


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
            notes=prefixed({test: one.notes for test, one in facts.items()}),
            disagreements=stacked({test: one.disagreements for test, one in facts.items()}),
            held_sd={name: sd for one in facts.values() for name, sd in one.held_sd.items()},
            seed=first.seed,
            samples=first.samples,
            freqs=first.freqs if len(facts) == 1 else {},  # a mode of several tests has several
        )
        return cls(adapters, JointHypotheses({test: adapter.hypotheses for test, adapter in adapters.items()}), of_all)

    @property
    def budget_of_fits(self) -> float:
        """Sum over the tests, since every fit solves each model."""
        return sum(adapter.budget_of_fits for adapter in self.adapters.values())

    @property
    def left_out_std(self) -> float:
        """The fewest of any test."""
        return min(adapter.left_out_std for adapter in self.adapters.values())

    def granting(self, faults: Sequence[str]) -> JointAdapter:
        """Each test with those of the faults that it may have."""
        own = {test: [e.name for e in one.hypotheses.faults if e.name in faults] for test, one in self.adapters.items()}
        return JointAdapter.of({test: adapter.granting(own[test]) for test, adapter in self.adapters.items()})

    def covering(self, fits: Iterable[CandidateFit]) -> JointAdapter:
        """Each test with its part of the fits; itself where all of them are represented."""
        stages = {str(k): one for k, one in enumerate(fits)}
        grown = {test: one.covering(self.fits_of(test, stages).values()) for test, one in self.adapters.items()}
        return self if all(grown[test] is one for test, one in self.adapters.items()) else JointAdapter.of(grown)

    def notes(self) -> list[str]:
        """The notes of every test."""
        return list(prefixed({test: adapter.notes() for test, adapter in self.adapters.items()}))

    def errors(
        self, stages: dict[str, CandidateFit], scale: float
    ) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data over all tests; notes and summary entries of each.

        ``rms`` and ``expected`` are over the rows of all tests. ``p`` of the used data is that of their sum of squares,
        of data left out in turn that of the worst group of any test, and of held-out data the smallest of the tests
        times their number (Bonferroni).
        """
        parts, notes, figures = [], [], dict[str, object]()
        for test, adapter in self.adapters.items():
            table, own, more = adapter.errors(self.fits_of(test, stages), scale)
            parts.append(table)
            notes += [of_test(test, note) for note in own]
            figures |= {of_test(test, name): value for name, value in more.items()}
        table = _together(pd.concat(parts, ignore_index=True))
        for stage, candidate_fit in stages.items():
            fit = table[(table["stage"] == stage) & (table["group"] == "fit")].iloc[0]
            chances = {
                "fit": self._p(candidate_fit, float(fit["rows"] * fit["rms"] ** 2)),
                "left_out": self._left_out_p(candidate_fit),
            }
            for group, p in chances.items():
                table.loc[(table["stage"] == stage) & (table["group"] == group), "p"] = p
        return table, notes, figures

    def predictions(
        self, candidate_fit: CandidateFit, wide: Discrepancy, scale: float
    ) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Those of every test that holds something out, with a column ``test``; the discrepancy is of all together."""
        own = {
            test: adapter.predictions(self.fits_of(test, {"": candidate_fit})[""], wide, scale)
            for test, adapter in self.adapters.items()
        }
        own = {test: tables for test, tables in own.items() if len(tables[0])}
        if not own:
            return pd.DataFrame(), pd.DataFrame()
        predicted, errors = (stacked({test: tables[k] for test, tables in own.items()}) for k in (0, 1))
        return predicted, errors

    def _p(self, candidate_fit: CandidateFit, squares: float) -> float:
        """p-value of the sum of squares over all rows; see `calib.problem.degrees_of_freedom.matched`."""
        fit, labelled = candidate_fit.fit, self.hypotheses
        scale, dof = matched(fit.slope, fit.prior_sd, sum(labelled.fitted_factors.values()))
        kinds = [row.kind for row in labelled.rows]
        counts = {kind: float(kinds.count(kind)) for kind in dict.fromkeys(kinds)}
        return float(p_value(squares / scale, dof, behind(counts, labelled.std_dof)))

    def _left_out_p(self, candidate_fit: CandidateFit) -> float:
        """p-value of the worst group of rows, each left out in turn of the joint fit (Bonferroni)."""
        fit, labelled = candidate_fit.fit, self.hypotheses
        groups = [row.mode or row.sensor for row in labelled.rows]
        std = {g: self.adapters[row.test].left_out_std for g, row in zip(groups, labelled.rows, strict=True)}
        factors: dict[Hashable, int] = dict.fromkeys(groups, 0)
        for (mode, _), number in labelled.fitted_factors.items():
            factors[mode] += number
        found = fit.left_out(groups)
        return found.p(factors, np.array([std[str(name)] for name in found.names]))

    def richer(self, name: str, progress: Progress = silent) -> JointAdapter | None:
        """The same with the next richer member in the place of an effect, in every test whose library has it."""
        found = {test: adapter.richer(name, progress) for test, adapter in self.adapters.items()}
        if not any(found.values()):
            return None
        return JointAdapter.of({test: found[test] or adapter for test, adapter in self.adapters.items()})

    @property
    def on_mesh(self) -> bool:
        """No: each test has the error of the mesh of its own model."""
        return False

    def with_effects(self, effects: Sequence[Effect]) -> JointHypotheses:
        """The hypotheses of all tests with further effects."""
        return JointHypotheses({test: adapter.with_effects(effects) for test, adapter in self.adapters.items()})

    def between(self, found: Explanation) -> Differences:
        """Which shared parameter differs between the tests, with the best explanation so far."""
        best = next(iter(found.blamed), found.chosen or found.base)
        return differences(best.fit, self.hypotheses, self.facts.seed, found.alpha)

    def failing(self) -> set[str]:
        """Effects with which a model of any test failed somewhere."""
        return {name for adapter in self.adapters.values() for name in adapter.failing()}

    def failed(self) -> list[Outcome]:
        """Points at which the user's code failed, test by test."""
        return [outcome for adapter in self.adapters.values() for outcome in adapter.failed()]

    def design(self, found: Explanation, progress: Progress = silent) -> ExperimentalDesign | None:
        """None: candidate measurements are proposed for single tests only."""
        return None

    def discretisation_error(self, found: Explanation) -> DiscretisationError | None:
        """None: the discretisation error is scored for single tests only."""
        return None

    def places(self) -> Places:
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
            for name, table in adapter.tables(self.fits_of(test, stages)).items():
                found.setdefault(name, {})[test] = table
        return {name: stacked(tables) for name, tables in found.items()}

    def fits_of(self, test: str, stages: dict[str, CandidateFit]) -> dict[str, CandidateFit]:
        """The parts of joint fits that one test has, by stage."""
        held_sd = self.facts.held_sd
        return {stage: self.hypotheses.of(test, candidate_fit, held_sd) for stage, candidate_fit in stages.items()}


def joined_adapter(adapters: Mapping[str, Adapter]) -> Adapter:
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
