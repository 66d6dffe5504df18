"""Callbacks that report the progress and results of a study's analyses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from calib.analyses.added import Added
from calib.analyses.case import SearchProgress
from calib.analyses.compare import ComparisonResult
from calib.analyses.explanation_result import ExplanationResult
from calib.analyses.extend import Extension
from calib.analyses.joint_calibration import Fitted
from calib.analyses.sensitivity import SampleProgress, Screening, Sensitivity
from calib.analyses.versions import Versions
from calib.missing.explanation import Explanation
from calib.missing.refits import Progress
from calib.results import Results
from calib.study import Study
from calib.study_file import StudyFile


class Listener:
    """Receives progress and results of a study's analyses; this one is silent, that of the command prints them."""

    def samples(self) -> AbstractContextManager[SampleProgress]:
        """Callback for the number of samples done and their total."""
        return nullcontext(lambda done, total: None)

    def search(self) -> AbstractContextManager[SearchProgress]:
        """Callback for case, generation, number of generations and the best misfit so far."""
        return nullcontext(lambda case, generation, generations, best: None)

    def doing(self) -> AbstractContextManager[Progress]:
        """Callback for the current step, in words."""
        return nullcontext(lambda words: None)

    def first(self, earlier: StudyFile, path: Path) -> None:
        """An earlier study is calibrated first, since this one adopts its values."""

    def begins(self, study: StudyFile, verb: str) -> None:
        """An analysis begins."""

    def other_state(self, rows: int) -> None:
        """Number of stored evaluations that belong to another state of the study."""

    def compared(self, study: Study, answer: ComparisonResult, folder: Results) -> None:
        """Model and measurement were compared."""

    def sampled(self, study: Study, answer: Sensitivity, folder: Results) -> None:
        """A sensitivity analysis by rank correlations is done."""

    def screened(self, answer: Screening, folder: Results) -> None:
        """A sensitivity analysis by Morris or Sobol is done."""

    def calibrated(self, study: StudyFile, answer: Fitted, folder: Results) -> None:
        """Parameters were fitted."""

    def explained(self, study: StudyFile, answer: ExplanationResult, folder: Results) -> None:
        """An explanation is done."""

    def may_add(self, study: StudyFile, found: Explanation) -> None:
        """An explanation was requested by itself: its named effects may be added."""

    def extended(self, written: Extension) -> None:
        """A study with more effects was written."""

    def added(self, answer: Added, written: Extension, folder: Results) -> None:
        """The named effects were added and the extended model calibrated."""

    def nothing_added(self, sentence: str) -> None:
        """No effect was added; the sentence says why."""

    def versions(self, found: Versions) -> None:
        """Errors over the versions of a model."""

    def drawn(self, figures: Sequence[Path], outdated: Mapping[str, str], report: Path | None) -> None:
        """Figures, and the report where there is one, were made."""
