"""Figures and reports of a study, from its stored results; no code of the study is run."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from calib.analyses.provenance import places
from calib.analyses.provenance.stale import Stale, stale_answers
from calib.api.listener import Listener
from calib.errors.errors import InputError
from calib.problem.joint import TEST
from calib.report.html.study_results import REPORT, StudyResults
from calib.report.kept import FORMATS, KeptFigures
from calib.report.tables import CurrentFolder, read_results
from calib.results.results import RESULTS, Results
from calib.results.written import is_own
from calib.study.several import JointStudy
from calib.study.study_file import StudyFile, shell_argument

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.report.kept import Format
    from calib.report.style import Width

_NUMBERED = re.compile(r"_\d+$")
"""End of the name of one of several pictures of a subject."""


@dataclass(frozen=True)
class Shown:
    """One folder of results as figures and pages show it."""

    study: StudyFile
    folder: Results
    stale: Stale
    results: StudyResults

    def kept(self, formats: Sequence[Format], width: Width) -> KeptFigures:
        """Its figures of an earlier drawing, in these formats and that width."""
        looks = self.results.title, self.results.synthetic, self.results.axes, tuple(formats), width
        return KeptFigures(CurrentFolder(self.folder.path, self.stale.files), looks)


def draw(
    study: StudyFile,
    folder: Results,
    root: Path,
    listener: Listener,
    report: bool = False,
    formats: Sequence[Format] = ("png",),
    width: Width = "page",
    workers: places.Workers = None,
    wanted: bool = True,
) -> None:
    """Draw the figures of a folder, and of the folders of its tests where there are several.

    The report is written on request, and where an older one exists; several tests have one together. Where figures are
    not ``wanted``, those of other tables are removed instead, and a report that shows such.

    Parameters
    ----------
    study : StudyFile
    folder : Results
    root : Path
        Parent of the study's results.
    listener : Listener
    report : bool
    formats : sequence of {"png", "svg", "pdf"}
        Formats of the figures beside the report.
    width : {"page", "column"}
        Of these figures; see `calib.report.style.save`.
    workers : int or Injected, optional
        See `calib.analyses.provenance.places.tasks_shared`.
    wanted : bool
        Whether to draw without a report; a report has its figures.

    Raises
    ------
    InputError
        Where a file cannot be written.
    """
    if study.test:
        folder.remove(REPORT)  # the tests have one together
    place = folder.path
    try:
        each = _shown(study, folder, root)
        whole = each[-1]
        report = not study.test and (report or (wanted and folder.has(REPORT)))
        if report:
            from calib.report.html import write  # with its templates, needed for pages alone
        for one in each:
            listener.to_draw(one.study, one.stale.told, place / REPORT if report and one is whole else None)
        kept = [one.kept(formats, width) for one in each]
        there = [] if report else [one.there for one in kept]
        if not report and None not in there:
            for one, paths in zip(each, there, strict=True):
                listener.drawn(one.study, paths or (), None)
            return
        if not (wanted or report):
            older = [one.outdated for one in kept]
            if any(paths is not None for paths in older):
                whole.folder.remove(REPORT)
            for one, earlier, paths in zip(each, kept, older, strict=True):
                if paths is not None:
                    one.folder.remove(*(path.name for path in paths))
                    earlier.forget()
            listener.not_drawn(study, root)
            return
        from calib.api.figures_made import make_all
        from calib.report.figures import FigureRequest

        with listener.progress() as step, places.tasks_shared(workers):
            for one, earlier in zip(each, kept, strict=True):
                place, own = one.folder.path, one.results.figures
                earlier.begin()
                request = FigureRequest(write.pictures(one.results) if report else (), formats, width)
                own.take(partial(make_all, own, request, step))
            place = whole.folder.path
            written = write.write_report(whole.results, step) if report else None
            for one, now in zip(each, kept, strict=True):
                place = one.folder.path
                figures = one.results.figures.save(formats, step, width)
                one.folder.remove(*_replaced(place, figures, everything=bool(one.stale.files)))
                if not (too_wide := one.results.figures.too_wide):  # which is told whenever they are asked for
                    now.note(figures)
                listener.drawn(one.study, figures, written if one is whole else None, too_wide)
    except OSError as fault:
        raise InputError(
            f"a figure or the report cannot be written ({fault.strerror})",
            place=place,
            remedy="free some space and draw again with 'calib report', or choose another --results",
        ) from None


def _replaced(folder: Path, figures: Sequence[Path], everything: bool) -> list[str]:
    """Names of older pictures that new ones replace: those that are now one or several, or all others."""
    stems = {file.stem for file in figures}
    subjects = {_NUMBERED.sub("", stem) for stem in stems}
    old = [file for kind in FORMATS for file in folder.glob(f"*.{kind}") if file not in figures and is_own(file)]
    gone = [file for file in old if file.stem not in stems and _NUMBERED.sub("", file.stem) in subjects]
    return [file.name for file in (old if everything else gone)]


def _shown(study: StudyFile, folder: Results, root: Path) -> list[Shown]:
    """The folders of several tests, the one shown first last, since what is drawn last leads; then that of all."""
    if not study.settings.several:
        return [shown(study, folder, root)]
    part = folder.path.relative_to(root / study.name).as_posix()
    parts = study.studies if isinstance(study, JointStudy) else study.parts
    found = list[Shown]()
    for one in first_test_first(parts, folder):
        own = Results(root / one.name / part)
        if any(own.path.glob("*.csv")):
            own = places.opened(one, root, "" if part == "." else part)
            own.remove(REPORT)
            found.append(shown(one, own, root, f"test{len(found) + 1}-"))
    return [*reversed(found), shown(study, folder, root, tests=tuple(one.results for one in found))]


def shown(
    study: StudyFile, folder: Results, root: Path, prefix: str = "", tests: tuple[StudyResults, ...] = ()
) -> Shown:
    """A folder of results as the study is now; nothing is computed or written.

    Parameters
    ----------
    study : StudyFile
    folder : Results
    root : Path
        Parent of the study's results.
    prefix, tests
        See `calib.report.html.study_results.StudyResults`.
    """
    stale = stale_answers(study, folder, None if root == RESULTS else root)
    current = CurrentFolder(folder.path, stale.files)
    results = StudyResults(
        current, study.settings.title, study.synthetic, stale.sentences, stale.other_code, tests, study.test, prefix
    )
    return Shown(study, folder, stale, results)


def write_named(
    figures: Sequence[tuple[str, Callable[[], Figure]]], title: str, synthetic: bool, folder: Path
) -> tuple[Path, ...]:
    """Draw figures that a user asked for, by name, each with a heading, and write them into a folder; their paths."""
    from calib.report.style import add_heading, save, style

    written: list[Path] = []
    for name, draw in figures:
        with style():
            figure = draw()
            add_heading(figure, title, synthetic)
            written += save(figure, folder / name)
    return tuple(written)


def file_name(name: str) -> str:
    """A name as a part of a file's name."""
    return re.sub(r"[^\w.-]+", "_", name)


def redraw(path: Path, root: Path, listener: Listener, formats: Sequence[Format], width: Width) -> Path:
    """Redraw all figures and the report of the study at a path; returns the report.

    Raises
    ------
    InputError
        Where there are no results.
    """
    study = StudyFile.read(path)
    home = Results(root / study.name)
    if not any(places.answers_of(one, root) for one in (study, *study.parts)):
        remedy = f"run the study first: calib run {shell_argument(path)}"
        raise InputError("there are no results to draw", place=home.path, remedy=remedy)
    redraw_study(study, root, listener, formats, width)
    return home.path / REPORT


def redraw_study(study: StudyFile, root: Path, listener: Listener, formats: Sequence[Format], width: Width) -> None:
    """Redraw every figure and report of a study, and of the extended studies among its results; see `draw`."""
    from calib.analyses.extend import found_among
    from calib.analyses.versions import write_versions

    found: dict[str, None] = {}
    for one in study.parts:
        folders = places.answers_of(one, root)
        if Results(root / one.name) in folders:  # versions compare full results only
            listener.versions(write_versions(one, root))
        found |= dict.fromkeys(folder.path.relative_to(root / one.name).as_posix() for folder in folders)
    own = [folder.path.relative_to(root / study.name).as_posix() for folder in places.answers_of(study, root)]
    for part in dict.fromkeys([*found, *own]):
        folder = places.opened(study, root, "" if part == "." else part)
        draw(study, folder, root, listener, True, formats, width)
    together = places.answers_of(study, root)
    written = [file for folder in together if (file := found_among(study, folder.path))]
    for file in written[:1]:  # the extended study of a quick run has its results in the same place
        redraw_study(StudyFile.read(file), root, listener, formats, width)


class _OfTest(Protocol):
    @property
    def test(self) -> str:
        """Name of the test; empty where there is only one."""
        ...


_T = TypeVar("_T", bound=_OfTest)


def first_test(folder: Results) -> str:
    """The test that `calib.missing.pattern.reduction_table` marks; empty where no effect is named, and without it."""
    from calib.report.why import BY_TEST

    name = f"{BY_TEST}.csv"
    if not folder.has(name):
        return ""
    table = read_results(folder.path / name, ["effects", TEST], flags=["shown_first"], may_be_empty=True)
    return next(iter(table.loc[table["shown_first"].astype(bool), TEST].astype(str)), "")


def first_test_first(parts: Iterable[_T], folder: Results) -> tuple[_T, ...]:
    """The parts of a study, of which `first_test` comes first; all others in the order of the study."""
    first = first_test(folder)
    return tuple(sorted(parts, key=lambda part: part.test != first))
