"""Proposed: the result of `Explained.propose`, effects that nobody listed, with their code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from calib.analyses.propose import ProposalResult, ProposalStart, compose_for
from calib.api.display import Displayed
from calib.api.entries.entry import Entry
from calib.api.progress import in_python
from calib.errors.arguments import integer
from calib.errors.errors import InputError
from calib.hypotheses.proposals.code import library_text
from calib.hypotheses.proposals.words import not_sought
from calib.missing.explanation import OPEN, Explanation
from calib.problem.effect import Effect
from calib.study.several import AnyStudy


@dataclass(frozen=True, eq=False, repr=False)
class Proposed(Displayed):
    """Effects composed from local perturbations, best first; none where nothing can be proposed, which it then says.

    Attributes
    ----------
    result : ProposalResult
    """

    result: ProposalResult

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The proposals, for `Problem.explain` or `Problem.with_effects`; none where the measurement is the suspect."""
        found = self.result.proposals
        if found is None or found.measurement:
            return ()
        return tuple(p.composed.effect for p in found.ranked if isinstance(p.composed.effect, Effect))

    @property
    def code(self) -> str:
        """Text of a file of Python with these effects as a library; empty without any."""
        found = self.result.proposals
        return library_text(found.ranked, "a problem", found.base.names) if found is not None and self.effects else ""

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is proposed, how sure that is, and what would discriminate."""
        answer = self.result.answer
        return (answer.found, answer.sure, *self.result.sentences)

    @property
    def lines(self) -> Mapping[str, str]:
        """The same in three lines, and where the rest is."""
        return {**self.result.answer.labelled, "Evidence": ".table; .effects and their .code"}

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer."""
        from calib.api.entries.proposed import proposed_entries

        return proposed_entries(self.result)

    @property
    def table(self) -> pd.DataFrame:
        """One row per proposal, best first."""
        return self.result.table

    def __repr__(self) -> str:
        return f"Proposed({', '.join(e.name for e in self.effects)})"


def proposed(study: AnyStudy, found: Explanation, rank: int, progress: bool) -> Proposed:
    """See `calib.api.explained.Explained.propose`."""
    count = integer(rank, 1, "rank")
    if len({one.model_key for one in study.studies}) > 1:
        raise InputError(
            "the problem has several models, of each of which other effects would be composed", place="propose",
            remedy="propose for a problem of one model",
        )  # fmt: skip
    if found.verdict not in OPEN:
        named = (*found.credible, *(fault.name for fault, _ in found.faulty))
        return Proposed(ProposalResult(None, not_sought(found.verdict, named, "add what was named: with_named()")))
    with in_python("propose", progress) as step:
        return Proposed(compose_for(study, None, ProposalStart.of(found), count, step))
