"""The ``calib`` command: one verb a question."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from calib import __version__, console, interrupt, progress
from calib.errors import InputError
from calib.example import write_example
from calib.missing.findings import Findings
from calib.questions import added as addition
from calib.questions import calibrate as calibration
from calib.questions import compare as comparison
from calib.questions import explain as explanation
from calib.questions import extend as extension
from calib.questions import phases, places
from calib.questions import sensitivity as influence
from calib.questions.explanation import Explanation
from calib.questions.isolation import isolated
from calib.questions.reduction import fingerprints
from calib.questions.stale import stale_answers
from calib.questions.stored import modes_kept
from calib.questions.versions import write_versions
from calib.report.draw import draw_all
from calib.report.html.write import NAME as REPORT
from calib.report.html.write import write_report
from calib.results import Results
from calib.settings import possible_path
from calib.settings import schema as settings_schema
from calib.study import Study, StudyFile, shell_argument
from calib.threads import one_thread
from calib.written import is_own, noting_kept

app = typer.Typer(
    name="calib",
    help="Calibrate structural-dynamics models against vibration measurements.\n\n"
    "A study is a folder with a study.toml that names a model and a measurement; 'calib new' writes an example.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _possible(path: Path) -> Path:
    try:
        return Path(possible_path(str(path)))
    except ValueError as fault:
        name = path.name if len(path.name) <= 60 else f"{path.name[:57]}..."
        raise InputError(str(fault), place=name, remedy="name another place") from None


StudyPath = Annotated[Path, typer.Argument(metavar="STUDY", callback=_possible, help="Folder with a study.toml.")]
ResultsPath = Annotated[
    Path, typer.Option("--results", metavar="DIR", callback=_possible, help="Where <study>/ with the results goes.")
]
NewFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", callback=_possible, help="A folder that does not exist yet.")
]
Quick = Annotated[
    bool, typer.Option("--quick", help="A small search for a first look; its results go to a sub-folder quick/.")
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", min=1, max=256, help="Worker processes [default: one a core where that pays]."),
]
CaseName = Annotated[
    str | None, typer.Option("--case", metavar="NAME", help="Only this case; its results go to a sub-folder.")
]
DEFAULT_RESULTS = Path("results")


class SensitivityMethod(StrEnum):
    """Ways to measure sensitivity."""

    ranks = "ranks"
    morris = "morris"
    sobol = "sobol"


class CalibrationMethod(StrEnum):
    """Ways to calibrate."""

    genetic = "genetic"
    gauss_newton = "gauss-newton"


@app.command()
def new(folder: NewFolder) -> None:
    """Write an annotated example study with its own model and data."""
    for path in write_example(folder):
        console.say(str(path))
    console.say(f"Run it with: calib run {shell_argument(folder)}")


@app.command()
def schema() -> None:
    """Print the JSON schema of study.toml, by which editors complete and check its keys."""
    typer.echo(json.dumps(settings_schema(), indent=1))


@app.command()
def compare(study: StudyPath, results: ResultsPath = DEFAULT_RESULTS) -> None:
    """Compare model and measurement, nothing fitted: how far apart, and where it fails."""
    loaded = _load(study, results)
    folder = places.results_of(loaded, results)
    _compare(loaded, folder)
    _draw(loaded, folder, results)


@app.command()
def sensitivity(
    study: StudyPath,
    results: ResultsPath = DEFAULT_RESULTS,
    workers: Workers = None,
    quick: Quick = False,
    method: Annotated[
        SensitivityMethod, typer.Option("--method", help="How; morris and sobol vary inputs freely between limits.")
    ] = SensitivityMethod.ranks,
    ignore_constraints: Annotated[
        bool, typer.Option("--ignore-constraints", help="Let morris and sobol leave constraints out of account.")
    ] = False,
) -> None:
    """Find which parameters matter: Latin hypercube, rank correlations, influence, and a selection with reasons."""
    loaded = _load(study, results, workers, quick)
    folder = places.results_of(loaded, results, quick)
    if method is SensitivityMethod.ranks:
        _sensitivity(loaded, folder, results, workers, quick)
    else:
        _screen(loaded, folder, results, workers, quick, method, ignore_constraints)
    _draw(loaded, folder, results)


@app.command()
def calibrate(
    study: StudyPath,
    results: ResultsPath = DEFAULT_RESULTS,
    workers: Workers = None,
    case: CaseName = None,
    quick: Quick = False,
    method: Annotated[
        CalibrationMethod | None, typer.Option("--method", help="How [default: the study's choice].")
    ] = None,
) -> None:
    """Search parameter values that fit, in several independent cases, and compare before with after.

    Interrupt it at any time: started again, it continues where it was and ends with the same result.
    """
    loaded = _load(study, results, workers, quick)
    calibration.chosen_cases(loaded, case)
    folder = places.results_of(loaded, results, quick, case, method.value if method else None)
    _calibrate(loaded, folder, results, workers, case, quick, method.value if method else None)
    _draw(loaded, folder, results)


@app.command()
def explain(study: StudyPath, results: ResultsPath = DEFAULT_RESULTS) -> None:
    """Find which physical effect the model lacks: a verdict, what supports it, and what to measure next.

    Calibrates by least squares, tests every effect of the study's library and every local change of the model, fits
    the promising ones, and checks what is left.
    """
    loaded = _load(study, results)
    folder = places.results_of(loaded, results)
    console.tell_what_to_add(loaded, _explain(loaded, folder, results).findings)
    _draw(loaded, folder, results)


@app.command()
def extend(
    study: StudyPath,
    effects: Annotated[list[str], typer.Argument(metavar="EFFECT...", help="Of the study's library of effects.")],
    into: Annotated[
        Path, typer.Option("--into", metavar="FOLDER", callback=_possible, help="A folder that does not exist yet.")
    ],
    results: ResultsPath = DEFAULT_RESULTS,
) -> None:
    """Write a new study whose model has one effect more, or several; the old one stays as it is."""
    written = extension.extend(_load(study, results), effects, into)
    console.tell_extension(written)
    root = places.root_for(written.file, results)
    place = "" if root == DEFAULT_RESULTS else f" --results {shell_argument(root)}"
    console.say(f"Calibrate it with: calib calibrate {shell_argument(written.file)}{place}")


@app.command()
def report(study: StudyPath, results: ResultsPath = DEFAULT_RESULTS) -> None:
    """Tell all earlier answers in report.html, one file that opens anywhere, and draw every figure anew.

    Nothing is computed, and no code of the study is run.
    """
    loaded = StudyFile.read(study)
    if not places.answers_of(loaded, results):
        remedy = f"ask first: calib run {shell_argument(study)}"
        raise InputError("there are no results to draw", place=results / loaded.name, remedy=remedy)
    _draw_anew(loaded, results)


@app.command()
def run(
    study: StudyPath, results: ResultsPath = DEFAULT_RESULTS, workers: Workers = None, quick: Quick = False
) -> None:
    """Ask everything: compare, sensitivity, calibrate, explain, add what is named; draw, and write report.html.

    A study that names effects which its model may lack is explained. What is missing, if anything is named, is added:
    the extended study is written among the results and calibrated too, and the errors before and after are told.
    """
    loaded = _load(study, results, workers, quick)
    folder = places.results_of(loaded, results, quick)
    _compare(loaded, folder)
    _sensitivity(loaded, folder, results, workers, quick)
    calibrated = _calibrate(loaded, folder, results, workers, None, quick, None)
    if loaded.candidates:
        found = _explain(loaded, folder, results).findings
        if extended := _add(loaded, folder, results, workers, quick, calibrated, found):
            _draw(*extended, results, whole_report=True)
    _draw(loaded, folder, results, whole_report=True)


def _version(asked: bool) -> None:
    if asked:
        console.say(f"calib {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    pass


# -- reading a study ---------------------------------------------------------------------------------------------------


def _load(path: Path, root: Path, workers: int | None = None, quick: bool = False) -> Study:
    """The study, its function in a child process; one whose values it takes over comes first, if it has no answer."""
    *earlier, asked = phases.in_order(path)
    taken, before = phases.Found({}, {}), None
    for file in earlier:
        study = before = _taking_over(file, taken, before)
        found = phases.values_found(study, root, quick)
        if found is None:
            console.say(f"{study.settings.title} comes first: {path} takes over what it finds.")
            folder = places.results_of(study, root, quick)
            _fit(study, folder, root, workers, quick)
            _draw(study, folder, root)
            found = phases.values_found(study, root, quick)
        taken = found or phases.Found({}, {})
    return _taking_over(asked, taken, before)


def _taking_over(file: Path, taken: phases.Found, before: Study | None) -> Study:
    study = Study.load(file, *taken)
    if before is not None:
        phases.require_same_units(study, before)
    return isolated(study)


# -- verbs, once the study is read -------------------------------------------------------------------------------------


def _compare(study: Study, folder: Results) -> None:
    console.head(study, "compare")
    console.tell_comparison(study, comparison.compare(study, folder), folder)


def _sensitivity(study: Study, folder: Results, root: Path, workers: int | None, quick: bool) -> None:
    console.head(study, "sensitivity")
    with places.ledger_of(study, root) as ledger, progress.samples() as step:
        console.tell_stale(ledger.other_fingerprints(*fingerprints(study, places.results_of(study, root))))
        answer = influence.sensitivity(study, folder, ledger, workers, quick, step)
    console.tell_sensitivity(study, answer, folder)


def _screen(
    study: Study,
    folder: Results,
    root: Path,
    workers: int | None,
    quick: bool,
    method: SensitivityMethod,
    ignore_constraints: bool,
) -> None:
    console.head(study, f"sensitivity, {method.value.capitalize()}")
    name: Literal["morris", "sobol"] = "morris" if method is SensitivityMethod.morris else "sobol"
    with places.ledger_of(study, root) as ledger, progress.samples() as step:
        answer = influence.screen(study, folder, ledger, name, workers, quick, ignore_constraints, step)
    console.tell_screening(answer, folder)


def _calibrate(
    study: Study,
    folder: Results,
    root: Path,
    workers: int | None,
    case: str | None,
    quick: bool,
    method: calibration.Method | None,
) -> calibration.Calibration:
    study = influence.selected_by_measures(study, places.results_of(study, root, quick))
    console.head(study, "calibrate")
    with places.ledger_of(study, root) as ledger, progress.search() as step:
        console.tell_stale(ledger.other_fingerprints(*fingerprints(study, places.results_of(study, root))))
        home = places.results_of(study, root)
        answer = calibration.calibrate(study, folder, ledger, workers, case, quick, method, step, home)
    console.tell_calibration(study, answer, folder)
    return answer


def _fit(study: Study, folder: Results, root: Path, workers: int | None, quick: bool) -> calibration.Calibration:
    """Calibrate, and ask before which parameters matter where the study leaves their choice to that."""
    if isinstance(study.settings.selection, str):
        _sensitivity(study, folder, root, workers, quick)
    return _calibrate(study, folder, root, workers, None, quick, None)


def _explain(study: Study, folder: Results, root: Path) -> Explanation:
    console.head(study, "explain")
    with progress.told() as step, modes_kept(study, lambda: places.ledger_of(study, root)) as asked:
        answer = explanation.explain(asked, folder, step, places.results_of(study, root))
    console.tell_explanation(study, answer, folder)
    console.tell_traces(f"explain {study.file}", answer.traces)
    return answer


def _add(
    study: Study,
    folder: Results,
    root: Path,
    workers: int | None,
    quick: bool,
    calibrated: calibration.Calibration,
    found: Findings,
) -> tuple[Study, Results] | None:
    """Extend the study by what an explanation names, calibrate it too, and tell what that brings.

    Returns the extended study and where its answers are; None when nothing is named.
    """
    console.head(study, "extend")
    named = addition.to_add(found)
    if named is None:
        console.say(addition.write_nothing_added(study, found, folder, quick).sentence)
        return None
    begin_at = {n: v for n, v in named.state.values.items() if n in named.state.question.space.free_names}
    written = extension.extend_among(study, named.names, folder.path, begin_at)
    console.tell_extension(written)
    extended = _load(written.file, root, workers, quick)
    own = places.results_of(extended, root, quick)
    after = _fit(extended, own, root, workers, quick)
    answer = addition.write_added(study, calibrated, named, extended, after, folder, quick)
    if not quick:
        write_versions(extended, root)
    console.head(study, "before and after")
    console.tell_added(answer, written, own)
    return extended, own


def _draw_anew(study: StudyFile, root: Path) -> None:
    """Every figure and report of a study, and of those that its runs have extended it to."""
    folders = places.answers_of(study, root)
    if Results(root / study.name) in folders:  # versions are those of whole answers
        console.tell_versions(write_versions(study, root))
    for folder in folders:
        _draw(study, folder, root, whole_report=True)
    written = [file for folder in folders if (file := extension.found_among(study, folder.path))]
    for file in written[:1]:  # that of a quick look has its answers in the same place
        _draw_anew(StudyFile.read(file), root)


def _draw(study: StudyFile, folder: Results, root: Path, whole_report: bool = False) -> None:
    """Draw what the tables hold; the report is written when asked for, and where there is one, which is older now."""
    title, synthetic = study.settings.title, study.synthetic
    told = whole_report or folder.has(REPORT)
    stale = stale_answers(study, folder, None if root == DEFAULT_RESULTS else root)
    try:
        figures = draw_all(folder.path, title, synthetic, stale.files)
        written = write_report(folder.path, title, synthetic, stale.sentences, stale.files) if told else None
    except OSError as fault:
        raise InputError(
            f"a figure or the report cannot be written ({fault.strerror})",
            place=folder.path,
            remedy="free some space and draw again with 'calib report', or choose another --results",
        ) from None
    if stale.files:
        folder.remove(*(png.name for png in folder.path.glob("*.png") if is_own(png) and png not in figures))
    console.tell_figures(figures)
    console.tell_outdated(stale.sentences)
    if written is not None:
        console.tell_report(written)


# -- leaving -----------------------------------------------------------------------------------------------------------


def main() -> None:
    """Entry point of the command."""
    interrupt.once()
    console.write_to_any_code_page()
    sys.exit(answer(sys.argv[1:]))


def answer(arguments: list[str]) -> int:
    """Run one command line and return its exit code.

    Bad input is one sentence and code 2, an interrupt 130; an unexpected failure leaves its traceback in a log, code 1.
    """
    try:
        with noting_kept() as kept:
            try:
                with one_thread():  # the matrices are small: several threads of one product wait for each other
                    app(args=arguments, prog_name="calib")
            finally:
                interrupt.answered()
                console.tell_kept(kept)
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
        if code == interrupt.CODE:
            console.complain(interrupt.WORDS)
        return code
    except InputError as fault:
        console.complain_of_input(fault, arguments)
        return 2
    except Exception as fault:
        console.complain_of_unexpected(fault, arguments)
        return 1
    return 0


if __name__ == "__main__":
    main()
