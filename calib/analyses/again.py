"""Failed points of a study evaluated again: what failed for want of a licence need not fail any more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from calib.analyses.failures import reasons, reasons_sentence
from calib.analyses.joint_responses import Responses
from calib.analyses.provenance.places import Workers, open_evaluator
from calib.analyses.provenance.recorded import ModesEvaluator, ledger_keys_of_modes, recorded
from calib.execution.outcome import Outcome, point_key
from calib.execution.stage import Progress, silent
from calib.results.ledger import Ledger
from calib.study.several import AnyStudy


@dataclass(frozen=True)
class Repeated:
    """Points that had failed and were evaluated again.

    Attributes
    ----------
    points : int
        All of them.
    failed : int
        Those that failed again.
    why_failed : str
        Why; empty where none did.
    """

    points: int
    failed: int
    why_failed: str

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was found, in words."""
        if not self.points:
            return ("No point of the study as it is has failed.",)
        points, have = ("point", "has") if self.points == 1 else ("points", "have")
        found = f"{self.points} {points} that had failed {have} been evaluated again, {self.failed} failed again."
        return (found, *([self.why_failed] if self.why_failed else []))


def again(study: AnyStudy, ledger: Ledger, workers: Workers = None, progress: Progress = silent) -> Repeated:
    """Evaluate every failed point of the study as it is once more; points with results stay as they are.

    Parameters
    ----------
    study : Study
        With one test or several; those of a function have failed points.
    ledger : Ledger
        Each result becomes the next attempt at its point.
    workers : int, Injected, optional
        See `calib.analyses.provenance.places.open_evaluator`.
    progress : Progress
    """
    found: dict[str, Outcome] = {}

    def points(key: str) -> list[Mapping[str, float]]:
        return [outcome.values for outcome in ledger.failed(key)]

    def note(outcomes: list[Outcome]) -> None:
        found.update({point_key(outcome.values): outcome for outcome in outcomes})
        progress("evaluating again", len(found))

    with ledger.failed_again():
        for one in study.studies:
            kept = recorded(one, ledger)
            own = kept.problem.fingerprint
            keys = {key: points(key) for key in ledger_keys_of_modes(kept.problem, one.library_digest)}
            asked = points(own)
            if not (asked or any(keys.values())):
                continue
            with open_evaluator(kept, workers, len(asked) + sum(map(len, keys.values()))) as evaluator:
                numbers = evaluator.numbers if isinstance(evaluator, ModesEvaluator) else evaluator
                for key, some in keys.items():
                    note(ledger.evaluate(key, some, numbers))
                note(ledger.evaluate(own, asked, evaluator))
        if len(study.studies) > 1:
            responses = Responses.of(study.each(lambda one: recorded(one, ledger)))
            if asked := points(responses.fingerprint):
                with responses.evaluator(study, workers) as evaluator:
                    note(ledger.evaluate(responses.fingerprint, asked, evaluator))
    left = [outcome for outcome in found.values() if outcome.status == "failed"]
    return Repeated(len(found), len(left), reasons_sentence(study.search_space, reasons(left), len(found)))
