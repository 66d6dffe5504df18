"""Callbacks that report the progress and results of a study's analyses."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from calib.api.progress import in_python
from calib.execution.stage import Progress, silent

if TYPE_CHECKING:
    from calib.analyses.added import Added
    from calib.analyses.again import Repeated
    from calib.analyses.calibration import Fitted
    from calib.analyses.compare import ComparisonResult
    from calib.analyses.designs import Designs
    from calib.analyses.extend import Extension
    from calib.analyses.intervals import Intervals
    from calib.analyses.pareto import Pareto
    from calib.analyses.propose import ProposalResult
    from calib.analyses.refine import Refined
    from calib.analyses.robustness import Robustness
    from calib.analyses.screening import Screening
    from calib.analyses.sensitivity import Sensitivity
    from calib.analyses.versions import Versions
    from calib.api.entries.entry import Entry
    from calib.missing.explanation import Explanation
    from calib.missing.findings import ExplanationResult
    from calib.report.html.write import Page
    from calib.results.results import Results
    from calib.study.several import AnyStudy
    from calib.study.study import LoadedStudy
    from calib.study.study_file import StudyFile


class Listener:
    """Receives progress and results of a study's analyses; this one is silent, that of the command prints them."""

    def progress(self) -> AbstractContextManager[Progress]:
        """Callback for the present stage of an analysis."""
        return nullcontext(silent)

    def first(self, earlier: StudyFile, path: Path) -> None:
        """An earlier study is calibrated first, since this one adopts its values."""

    def begins(self, study: StudyFile, verb: str) -> None:
        """An analysis begins."""

    def will_run(self, sentence: str) -> None:
        """How often an analysis will start the study's solver; empty for other models."""

    def at_once(self, sentence: str) -> None:
        """What must not wait until an analysis ends, such as that a cluster has no workers; a warning."""
        warnings.warn(sentence, stacklevel=2)

    def other_state(self, rows: int) -> None:
        """Number of stored evaluations that belong to another state of the study."""

    def damaged(self, rows: int) -> None:
        """Number of stored rows that were found damaged, and computed again where they were needed."""

    def repeated(self, study: StudyFile, found: Repeated) -> None:
        """Failed points were evaluated again."""

    def listed(self, found: Designs, entries: Sequence[Entry], written: Path) -> None:
        """Designs were listed; ``written`` is their file, or the folder of the study."""

    def compared(self, study: LoadedStudy, answer: ComparisonResult, folder: Results, undamped: bool) -> None:
        """Model and measurement were compared; ``undamped`` where undamped frequencies are asked for as well."""

    def sampled(self, study: LoadedStudy, answer: Sensitivity | Screening, folder: Results) -> None:
        """A sensitivity analysis by rank correlations is done."""

    def calibrated(self, study: AnyStudy, answer: Fitted, folder: Results) -> None:
        """Parameters were fitted."""

    def bounded(self, answer: Intervals, folder: Results) -> None:
        """Intervals of the fitted parameters were computed."""

    def pushed(self, answer: Robustness, folder: Results) -> None:
        """Samples of the posterior were pushed through the model."""

    def weighed(self, answer: Pareto, folder: Results) -> None:
        """Two groups of responses were weighed against each other."""

    def refined(self, answer: Refined, folder: Results) -> None:
        """New runs were proposed or evaluated."""

    def explained(self, study: AnyStudy, answer: ExplanationResult, folder: Results) -> None:
        """An explanation is done."""

    def may_add(self, study: StudyFile, found: Explanation) -> None:
        """An explanation was requested by itself: its named effects may be added."""

    def proposed(self, study: StudyFile, result: ProposalResult, folder: Results, root: Path) -> None:
        """Proposals were composed; ``root`` is the root folder of all results."""

    def extended(self, written: Extension) -> None:
        """A study with more effects was written."""

    def added(self, answer: Added, written: Extension, folder: Results) -> None:
        """The named effects were added and the extended model calibrated."""

    def nothing_added(self, sentence: str) -> None:
        """No effect was added; the sentence says why."""

    def versions(self, found: Versions) -> None:
        """Errors over the versions of a model."""

    def to_draw(self, study: StudyFile, notes: Sequence[str], report: Path | None) -> None:
        """Figures, and the report where there is one, are next; what is told of older results becomes a warning."""
        for sentence in notes:
            warnings.warn(f"{sentence}.", stacklevel=2)

    def drawn(self, study: StudyFile, figures: Sequence[Path], page: Page | None, too_wide: Sequence[str] = ()) -> None:
        """Figures, and the report where there is one, were made; some ``too_wide`` for a column."""

    def not_drawn(self, study: StudyFile, root: Path) -> None:
        """Figures of the tables as they are now were not wanted; ``root`` is the root folder of all results."""

    def requested(self, figures: Sequence[Path]) -> None:
        """Figures that the user named were drawn."""


class Showing(Listener):
    """Shows how far an analysis is, on a terminal or below a notebook's cell; nothing else."""

    def __init__(self) -> None:
        self._verb = "report"  # which begins no analysis

    def begins(self, study: StudyFile, verb: str) -> None:
        """Keeps the name of the analysis."""
        self._verb = verb

    def progress(self) -> AbstractContextManager[Progress]:
        """See `calib.api.progress.in_python`."""
        return in_python(self._verb)
