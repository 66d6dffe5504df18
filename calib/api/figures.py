"""Figures and reports of a study, from its stored results; no code of the study is run."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from calib.analyses.calibrate import Method
from calib.analyses.designs import Designs
from calib.analyses.extend import found_among
from calib.analyses.provenance import places
from calib.analyses.provenance.stale import stale_answers
from calib.analyses.versions import write_versions
from calib.api.figures_made import make_all
from calib.api.first_test import first_test_first
from calib.api.listener import Listener
from calib.errors.errors import InputError
from calib.report.figures import FigureRequest
from calib.report.html.study_results import StudyResults
from calib.report.html.write import NAME as REPORT
from calib.report.html.write import pictures, write_report
from calib.report.style import FORMATS, Format, Width, add_heading, owner_of, save, style
from calib.report.tables import CurrentFolder
from calib.results.results import RESULTS, Results
from calib.results.written import is_own
from calib.study.several import AnyStudy
from calib.study.study_file import StudyFile, shell_argument


def draw(
    study: StudyFile,
    folder: Results,
    root: Path,
    listener: Listener,
    report: bool = False,
    formats: Sequence[Format] = ("png",),
    width: Width = "page",
    workers: places.Workers = None,
) -> None:
    """Draw the figures of all tables in a folder; the report is written on request, and where an older one exists.

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

    Raises
    ------
    InputError
        Where a file cannot be written.
    """
    title, synthetic = study.settings.title, study.synthetic
    stale = stale_answers(study, folder, None if root == RESULTS else root)
    try:
        current = CurrentFolder(folder.path, stale.files)
        shown = StudyResults(current, title, synthetic, stale.sentences, stale.other_code)
        report = report or folder.has(REPORT)

        with listener.progress() as step, places.tasks_shared(workers):
            own = shown.figures
            own.take(lambda: make_all(own, FigureRequest(pictures(shown) if report else (), formats, width), step))
            written = write_report(shown, step) if report else None
            figures = own.save(formats, step, width)
    except OSError as fault:
        raise InputError(
            f"a figure or the report cannot be written ({fault.strerror})",
            place=folder.path,
            remedy="free some space and draw again with 'calib report', or choose another --results",
        ) from None
    if stale.files:
        old = [file for kind in FORMATS for file in folder.path.glob(f"*.{kind}")]
        folder.remove(*(file.name for file in old if is_own(file) and file not in figures))
    listener.drawn(study, figures, stale.told, written)


def draw_designs(
    found: Designs, study: StudyFile, folder: Path, clouds: Sequence[tuple[str, str]], parallel: int
) -> tuple[Path, ...]:
    """Draw clouds of two columns of designs, and their free parameters side by side with the best ones marked.

    Parameters
    ----------
    found : Designs
    study : StudyFile
    folder : Path
        Where ``anthill_*.png`` and ``designs_parallel.png`` go.
    clouds : sequence of (str, str)
        Columns.
    parallel : int
        Number of the best ones; 0 for no such picture.
    """
    from calib.report.designs import draw_anthill, draw_parallel

    written: list[Path] = []
    axes = [*found.space.free_names, "objective"]
    labels = {p.name: f"{p.name}, {p.unit}" for p in found.space.parameters if p.unit not in ("", "-")}
    drawings = [(f"anthill_{_plain(x)}_{_plain(y)}", partial(draw_anthill, found.table, x, y)) for x, y in clouds]
    if parallel:
        drawings.append(("designs_parallel", partial(draw_parallel, found.table, axes, "objective", parallel)))
    for name, drawing in drawings:
        with style():
            figure = owner_of(drawing(labels=labels))
            add_heading(figure, f"{study.settings.title}: designs", study.synthetic)
            written += save(figure, folder / name)
    return tuple(written)


def _plain(name: str) -> str:
    return re.sub(r"[^\w.-]+", "_", name)


def redraw(path: Path, root: Path, listener: Listener, formats: Sequence[Format], width: Width) -> Path:
    """Redraw all figures and reports of the study at a path; returns the report of the test that is shown first.

    Raises
    ------
    InputError
        Where there are no results.
    """
    study = StudyFile.read(path)
    home = Results(root / study.name)
    parts = [part for part in first_test_first(study.parts, home) if places.answers_of(part, root)]
    if not parts:
        remedy = f"run the study first: calib run {shell_argument(path)}"
        raise InputError("there are no results to draw", place=home.path, remedy=remedy)
    redraw_study(study, root, listener, formats, width)
    return root / parts[0].name / REPORT


def redraw_study(study: StudyFile, root: Path, listener: Listener, formats: Sequence[Format], width: Width) -> None:
    """Redraw every figure and report of a study, and of the extended studies among its results; see `draw`."""
    for part in first_test_first(study.parts, Results(root / study.name)):
        folders = places.answers_of(part, root)
        if Results(root / part.name) in folders:  # versions compare full results only
            listener.versions(write_versions(part, root))
        for folder in folders:
            draw(part, folder, root, listener, True, formats, width)
    together = places.answers_of(study, root)
    if study.settings.several:
        for folder in together:
            draw(study, folder, root, listener, False, formats, width)
    written = [file for folder in together if (file := found_among(study, folder.path))]
    for file in written[:1]:  # the extended study of a quick run has its results in the same place
        redraw_study(StudyFile.read(file), root, listener, formats, width)


def draw_tests(
    study: AnyStudy,
    root: Path,
    listener: Listener,
    quick: bool = False,
    workers: places.Workers = None,
    case: str | None = None,
    method: Method | None = None,
    report: bool = False,
) -> None:
    """Draw every test, the one shown first last, since a run tells what was drawn last first; then all together.

    Arguments as in `draw`; ``quick``, ``case`` and ``method`` choose the folders of results.
    """
    whole = places.results_of(study, root, quick, case, method)
    for part in reversed(first_test_first(study.studies, whole)):
        draw(part, places.results_of(part, root, quick, case, method), root, listener, report, workers=workers)
    if study.settings.several:
        draw(study, whole, root, listener, workers=workers)
