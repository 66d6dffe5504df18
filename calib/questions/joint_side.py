"""What an explanation of several tests needs of them beyond the decision itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.joint import TEST, of_test, said, stacked
from calib.missing.advice import Prospects
from calib.missing.findings import Findings, Trial
from calib.missing.joint import JointHypotheses
from calib.outcome import Outcome
from calib.questions.budget import Budget
from calib.questions.explanation import Explanation, Told
from calib.questions.side import Side


@dataclass(frozen=True, eq=False)
class JointSide:
    """Several tests, each against its own model under its own condition.

    Attributes
    ----------
    sides : mapping from str to Side
        By name of the test.
    hypotheses : JointHypotheses
        Those of the sides.
    told : Told
    """

    sides: Mapping[str, Side]
    hypotheses: JointHypotheses
    told: Told

    @classmethod
    def of(cls, sides: Mapping[str, Side]) -> JointSide:
        """The sides as one; seed and number of draws are those of the first."""
        told = {test: side.told for test, side in sides.items()}
        first = next(iter(told.values()))
        of_all = Told(
            assumed="; ".join(of_test(test, one.assumed) for test, one in told.items() if one.assumed),
            accuracy="; ".join(of_test(test, one.accuracy) for test, one in told.items()),
            notes=said({test: one.notes for test, one in told.items()}),
            disagreements=stacked({test: one.disagreements for test, one in told.items()}),
            held_sd={name: sd for one in told.values() for name, sd in one.held_sd.items()},
            seed=first.seed,
            draws=first.draws,
        )
        return cls(sides, JointHypotheses({test: side.hypotheses for test, side in sides.items()}), of_all)

    @property
    def relative_std(self) -> np.ndarray:
        """See `calib.questions.side.Side`."""
        return np.concatenate([side.relative_std for side in self.sides.values()])

    @property
    def budget_of_fits(self) -> float:
        """Solves of all models together: every fit solves each of them."""
        return sum(side.budget_of_fits for side in self.sides.values())

    def notes(self) -> list[str]:
        """Those of every test."""
        return list(said({test: side.notes() for test, side in self.sides.items()}))

    def errors(self, stages: dict[str, Trial], scale: float) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data over all tests; notes and figures of each.

        ``rms`` and ``expected`` are over the rows of all tests, ``p`` is the smallest of the tests' times their number.
        What one test expects is told from its own data alone, which know the parameters less well than all do.
        """
        parts, notes, figures = [], [], dict[str, object]()
        for test, side in self.sides.items():
            table, told, more = side.errors(self._of(test, stages), scale)
            parts.append(table)
            notes += [of_test(test, note) for note in told]
            figures |= {of_test(test, name): value for name, value in more.items()}
        return _together(pd.concat(parts, ignore_index=True)), notes, figures

    def failing(self) -> set[str]:
        """Effects with which a model of any test failed somewhere."""
        return {name for side in self.sides.values() for name in side.failing()}

    def failed(self) -> list[Outcome]:
        """Points at which the user's code failed, test by test."""
        return [outcome for side in self.sides.values() for outcome in side.failed()]

    def prospects(self, found: Findings) -> Prospects | None:
        """What to measure next is told of one test at a time."""
        return None

    def budget(self, found: Findings) -> Budget | None:
        """What a finer mesh would look like is told of one test at a time."""
        return None

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Kind, place and sensor of every local change."""
        return {name: place for side in self.sides.values() for name, place in side.places().items()}

    def tables(self, stages: dict[str, Trial]) -> dict[str, pd.DataFrame]:
        """The tables of every test, those of one name below each other with a column ``test``.

        A test that has no table of a name has no rows there.
        """
        found: dict[str, dict[str, pd.DataFrame]] = {}
        for test, side in self.sides.items():
            for name, table in side.tables(self._of(test, stages)).items():
                found.setdefault(name, {})[test] = table
        return {name: stacked(tables) for name, tables in found.items()}

    def seen(self, test: str, answer: Explanation) -> Explanation:
        """What one test says of an answer: its own errors, in the stages of the joint ones, and its own rows."""
        found = answer.findings
        last = next((stage for stage in answer.errors["stage"] if stage != "before"), "")
        stages = {"before": found.base} | ({last: found.chosen} if last and found.chosen is not None else {})
        errors = self.sides[test].errors(self._of(test, stages), found.noise_scale)[0]
        errors = errors[list(answer.errors.columns.drop("scatter"))].assign(scatter=answer.errors["scatter"].iloc[0])
        tables = {}
        for name, table in answer.tables.items():
            own = table[table[TEST] == test].drop(columns=TEST) if TEST in table else table
            if TEST not in table or len(own):
                tables[name] = own
        return replace(answer, errors=errors, tables=tables)

    def _of(self, test: str, stages: dict[str, Trial]) -> dict[str, Trial]:
        return {stage: self.hypotheses.of(test, trial) for stage, trial in stages.items()}


def together(sides: Mapping[str, Side]) -> Side:
    """What all tests ask; one alone asks for itself."""
    return JointSide.of(sides) if len(sides) > 1 else next(iter(sides.values()))


def _together(table: pd.DataFrame) -> pd.DataFrame:
    """Errors of several tests as those of one, group by group and stage by stage."""
    rows = []
    for (stage, group), own in table.groupby(["stage", "group"], sort=False):
        weight = own["rows"] / own["rows"].sum()
        rms, expected = (float(np.sqrt((weight * own[name] ** 2).sum())) for name in ("rms", "expected"))
        p = min(1.0, len(own) * float(own["p"].min()))
        rows.append((group, int(own["rows"].sum()), rms, expected, p, int(own["unpaired"].sum()), stage))
    return pd.DataFrame(rows, columns=["group", "rows", "rms", "expected", "p", "unpaired", "stage"])
