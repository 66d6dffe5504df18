"""Listener of the command: bars while it computes, its answer and tables when it has finished."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from calib.api import progress
from calib.api.entries.entry import Entry, Warned, Words, count
from calib.api.listener import Listener
from calib.command import terminal
from calib.command.terminal import say, tell_answer, tell_entries
from calib.execution.stage import Progress
from calib.results.answer import Answer
from calib.results.results import RESULTS, Results
from calib.results.running import RunningNote
from calib.structure.reduction.cache import basis_cache
from calib.study.study_file import StudyFile, shell_argument

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
    from calib.missing.explanation import Explanation
    from calib.missing.findings import ExplanationResult
    from calib.report.html.write import Page
    from calib.study.several import AnyStudy
    from calib.study.study import LoadedStudy

_WITH_PAGE = ("run", "report")
"""Verbs whose answer is that of the report."""
_OF_RUN = ("explain", "before and after")
"""Steps of a run whose tables follow its answer; without them those of the last calibration do."""


@dataclass(frozen=True)
class AnalysisEntries:
    """What one analysis has to say.

    Attributes
    ----------
    verb : str
    title : str
        Line above it.
    answer : Answer or None
        None where the analysis has none of its own.
    place : Path or None
        Its report or its tables.
    entries : tuple of Entry
    """

    verb: str
    title: str
    answer: Answer | None = None
    place: Path | None = None
    entries: tuple[Entry, ...] = ()


class _Printing(Listener):
    """Collects what a command has to say, and prints it when the command ends, also by a fault.

    Parameters
    ----------
    verb : str
        The subcommand.
    verbose : bool
        Whether to print secondary tables, assumptions and files too.
    """

    def __init__(self, verb: str, verbose: bool = False, note: RunningNote | None = None) -> None:
        self.verb, self.verbose, self.note = verb, verbose, note
        self._collected: list[AnalysisEntries] = []
        self._begun = False
        self._pages: list[tuple[str, Page]] = []
        self._traces: tuple[str, Sequence[str]] = ("", ())

    def __enter__(self) -> _Printing:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.print_collected()

    # -- while it computes ---------------------------------------------------------------------------------------------

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        verb = self._collected[-1].verb if self._collected else self.verb
        with progress.bars(verb) as told:
            yield told if self.note is None else progress.noted(told, verb, self.note)

    def first(self, earlier: StudyFile, path: Path) -> None:
        say(f"{earlier.settings.title} comes first: {path} takes over what it finds.")

    def begins(self, study: StudyFile, verb: str) -> None:
        self._collected.append(AnalysisEntries(verb, f"{study.settings.title}: {verb}{_label(study)}"))

    def will_run(self, sentence: str) -> None:
        if sentence:  # now: the answer may be hours away
            self.at_once(sentence)

    def at_once(self, sentence: str) -> None:
        terminal.complain(sentence)

    def other_state(self, rows: int) -> None:
        if rows:
            belong, they = ("belongs", "it is") if rows == 1 else ("belong", "they are")
            rest = f"{belong} to another state of model or measurement; {they} kept but not used."
            self._add(Words(f"{count(rows, 'earlier evaluation')} {rest}", when="always"))

    def damaged(self, rows: int) -> None:
        if rows:
            were, they = ("was", "it counts") if rows == 1 else ("were", "they count")
            stored = count(rows, "stored row")
            self._add(Warned(f"{stored} of the ledger {were} changed since calib wrote it; {they} as not evaluated."))

    def repeated(self, study: StudyFile, found: Repeated) -> None:
        self._add(*(Words(sentence, when="always") for sentence in found.sentences))
        if found.points > found.failed:
            run = f"calib calibrate {shell_argument(study.file)}"
            self._add(Words(f"An analysis that is run again uses them, such as: {run}", when="always"))

    def listed(self, found: Designs, entries: Sequence[Entry], written: Path) -> None:
        self._answered(found.answer, written, entries)

    # -- results -------------------------------------------------------------------------------------------------------

    def compared(self, study: LoadedStudy, answer: ComparisonResult, folder: Results, undamped: bool) -> None:
        from calib.api.entries import compared

        place = folder.path / "comparison_before.csv"
        more = compared.undamped_entries(answer) if undamped else []
        self._answered(answer.answer, place, [*compared.compared_entries(study, answer, folder), *more])

    def sampled(self, study: LoadedStudy, answer: Sensitivity | Screening, folder: Results) -> None:
        from calib.analyses.sensitivity import Sensitivity
        from calib.api.entries import compared

        name = "selection" if isinstance(answer, Sensitivity) else answer.method
        self._answered(answer.answer, folder.path / f"{name}.csv", compared.sensitivity_entries(study, answer))

    def calibrated(self, study: AnyStudy, answer: Fitted, folder: Results) -> None:
        from calib.api.entries import calibrated

        self._answered(answer.answer, folder.path / "verdicts.csv", calibrated.calibrated_entries(study, answer))

    def bounded(self, answer: Intervals, folder: Results) -> None:
        from calib.api.entries import calibrated

        self._answered(answer.answer, folder.path / "intervals.csv", calibrated.interval_entries(answer))

    def pushed(self, answer: Robustness, folder: Results) -> None:
        from calib.api.entries import calibrated

        self._answered(answer.answer, folder.path / "robustness.csv", calibrated.robustness_entries(answer))

    def weighed(self, answer: Pareto, folder: Results) -> None:
        from calib.api.entries import calibrated

        self._answered(answer.answer, folder.path / "pareto.csv", calibrated.pareto_entries(answer))

    def refined(self, answer: Refined, folder: Results) -> None:
        from calib.api.entries import compared

        self._answered(answer.answer, folder.path / "proposed_runs.csv", compared.refined_entries(answer))

    def explained(self, study: AnyStudy, answer: ExplanationResult, folder: Results) -> None:
        from calib.api.entries import explained

        self._answered(
            answer.answer, folder.path / "effects.csv", explained.explained_entries(study, answer, self.verb == "run")
        )
        self._traces = (f"explain {study.file}", answer.traces)

    def may_add(self, study: StudyFile, found: Explanation) -> None:
        from calib.analyses.added import to_add
        from calib.api.entries import proposed

        if named := to_add(found):
            them = "them" if len(named.names) > 1 else "it"
            command = f"calib extend {shell_argument(study.file)} {' '.join(named.names)} --into FOLDER"
            self._add(Words(f"Add {them} with: {command}", when="always"))
        self._add(*proposed.may_propose(study, found))

    def proposed(self, study: StudyFile, result: ProposalResult, folder: Results, root: Path) -> None:
        from calib.api.entries import proposed

        entries = [*proposed.proposed_entries(result), *proposed.written_entries(result, root)]
        self._answered(result.answer, folder.path / "proposals.csv", entries)

    def extended(self, written: Extension) -> None:
        from calib.api.entries import explained

        self._add(*explained.of_extension(written, self.verb == "run"))

    def added(self, answer: Added, written: Extension, folder: Results) -> None:
        from calib.api.entries import explained

        self._add(*explained.of_added(answer, written, folder))

    def versions(self, found: Versions) -> None:
        from calib.api.entries import explained

        self._add(*explained.of_versions(found))

    def nothing_added(self, sentence: str) -> None:
        self._add(Words(sentence, when="always"))

    def to_draw(self, study: StudyFile, notes: Sequence[str], report: Path | None) -> None:
        self._add(*(Warned(sentence) for sentence in notes))
        if report is not None and self._collected[-1].answer is not None:
            self._collected[-1] = replace(self._collected[-1], place=report)
        if self.verb not in _WITH_PAGE and not study.test:
            self.print_collected()  # nobody waits for figures to read the answer

    def drawn(self, study: StudyFile, figures: Sequence[Path], page: Page | None, too_wide: Sequence[str] = ()) -> None:
        if too_wide:
            words = f"As wide as a page, since they are not legible in a column: {', '.join(too_wide)}"
            self._add(Words(f"{words}.", when="always"))
        if figures:
            self._add(Words("\nFigures, each beside its table:"), *(Words(f"  {path}") for path in figures))
        if page is not None:
            title = study.settings.title.removesuffix(f": {study.test}")  # the answer is that of all tests
            self._pages.append((f"{title}: {self.verb}{_label(study)}", page))

    def not_drawn(self, study: StudyFile, root: Path) -> None:
        place = "" if root == RESULTS else f" --results {shell_argument(root)}"
        self._add(Words(f"Draw figures with: calib report {shell_argument(study.file)}{place}", when="always"))

    def requested(self, figures: Sequence[Path]) -> None:
        self._add(*(Words(f"Drawn: {path}", "always") for path in figures))

    # -- the end -------------------------------------------------------------------------------------------------------

    def print_collected(self) -> None:
        """Print all that was collected, once."""
        collected, pages = self._collected, self._pages
        self._collected, self._pages = [], []
        if pages and self.verb in _WITH_PAGE:
            self._print_pages(collected, pages)
        else:
            for one in collected:
                if one.title:
                    say(f"\n{one.title}" if self._begun else one.title, style="bold")
                self._begun = True
                if one.answer is not None:
                    tell_answer(one.answer, one.place)
                tell_entries(one.entries, self.verbose)
        terminal.tell_traces(*self._traces)
        self._traces = ("", ())

    def _print_pages(self, collected: Sequence[AnalysisEntries], pages: Sequence[tuple[str, Page]]) -> None:
        """The answer of a run or of the stored results, as at the head of the report, and the tables behind it."""
        # A run draws its own page last, and the one of an extended study before; a report begins with its own.
        (title, page), *others = reversed(pages) if self.verb == "run" else pages
        say(title, style="bold")
        tell_answer(Answer(page.summary.found, page.summary.sure, page.summary.then), page.path)
        for _, other in others:
            say(f"See also: {other.path}")
        if self.verbose or self.verb == "report":
            for one in collected:
                if self.verb == "run":
                    say(f"\n{one.title}", style="bold")
                    if one.answer is not None:
                        tell_answer(one.answer, one.place)
                tell_entries(one.entries, self.verbose)
            return
        chosen = [one for one in collected if one.verb in _OF_RUN]
        for one in chosen or [one for one in collected if one.verb == "calibrate"][-1:]:
            tell_entries(one.entries, False)
        for one in collected:
            if one not in chosen and one.verb != "calibrate":
                tell_entries([entry for entry in one.entries if isinstance(entry, Warned)], False)

    def _add(self, *entries: Entry) -> None:
        if not self._collected:
            self._collected.append(AnalysisEntries(self.verb, ""))
        self._collected[-1] = replace(self._collected[-1], entries=(*self._collected[-1].entries, *entries))

    def _answered(self, answer: Answer, place: Path, entries: Sequence[Entry]) -> None:
        self._add(*entries)
        self._collected[-1] = replace(self._collected[-1], answer=answer, place=place)


def printing(verb: str, verbose: bool = False, note: RunningNote | None = None) -> _Printing:
    """The listener of one command, which also tells its progress to a note where there is one."""
    return _Printing(verb, verbose, note)


def _label(study: StudyFile) -> str:
    return "  [synthetic measurement]" if study.synthetic else ""


@contextmanager
def tell_cache(notes: Sequence[str], verbose: bool) -> Iterator[None]:
    """Tell at the end what was noted on the cache; with ``verbose`` also its place and size, where it is not empty."""
    try:
        yield
    finally:
        for note in notes:
            say(f"\n{note}")
        cache = basis_cache()
        if verbose and cache is not None and (files := cache.files):
            say(f"\nReduced bases in the cache: {len(files)}, {cache.size / 1e6:.1f} MB: {cache.folder}")
