"""What is told of a study while it is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TypeAlias

from calib.missing.findings import Findings
from calib.questions.added import Added
from calib.questions.compare import Answer
from calib.questions.explanation import Explanation
from calib.questions.extend import Extension
from calib.questions.joint_calibration import Fitted
from calib.questions.sensitivity import Screening, Sensitivity
from calib.questions.versions import Versions
from calib.results import Results
from calib.study import Study
from calib.study_file import StudyFile

Sampled: TypeAlias = Callable[[int, int], None]
Searched: TypeAlias = Callable[[str, int, int, float], None]
Doing: TypeAlias = Callable[[str], None]


class Listener:
    """Is told what happens while a study is asked; this one keeps quiet, the command's prints it."""

    def samples(self) -> AbstractContextManager[Sampled]:
        """Takes samples done and their number."""
        return nullcontext(lambda done, total: None)

    def search(self) -> AbstractContextManager[Searched]:
        """Takes case, generation, number of generations and the best misfit so far."""
        return nullcontext(lambda case, generation, generations, best: None)

    def doing(self) -> AbstractContextManager[Doing]:
        """Takes what is being done, in words."""
        return nullcontext(lambda words: None)

    def first(self, earlier: StudyFile, path: Path) -> None:
        """An earlier study is calibrated first, since the one asked takes its values over."""

    def begins(self, study: StudyFile, verb: str) -> None:
        """A question begins."""

    def other_state(self, rows: int) -> None:
        """So many stored evaluations are of another state of the study."""

    def compared(self, study: Study, answer: Answer, folder: Results) -> None:
        """Model and measurement were compared."""

    def sampled(self, study: Study, answer: Sensitivity, folder: Results) -> None:
        """Parameters were judged by what they change."""

    def screened(self, answer: Screening, folder: Results) -> None:
        """The same by Morris or Sobol."""

    def calibrated(self, study: StudyFile, answer: Fitted, folder: Results) -> None:
        """Parameters were fitted."""

    def explained(self, study: StudyFile, answer: Explanation, folder: Results) -> None:
        """What the model lacks was asked."""

    def may_add(self, study: StudyFile, found: Findings) -> None:
        """The answer to that was asked by itself: what was named may be added."""

    def extended(self, written: Extension) -> None:
        """A study with more effects was written."""

    def added(self, answer: Added, written: Extension, folder: Results) -> None:
        """What was named was added and calibrated."""

    def nothing_added(self, sentence: str) -> None:
        """Why nothing was added."""

    def versions(self, found: Versions) -> None:
        """Errors over the versions of a model."""

    def drawn(self, figures: Sequence[Path], outdated: Mapping[str, str], report: Path | None) -> None:
        """Figures, and the report where there is one, were made."""
