"""The ``calib`` command: one subcommand per analysis.

What computes is imported when a subcommand runs: ``calib --version`` and every ``--help`` need none of it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from calib.command import terminal
from calib.command.compare import compare_model
from calib.command.designs import list_designs, pareto_of_study, refine_samples, spread_of_fit
from calib.command.example import new
from calib.command.loaded import loaded_study
from calib.command.matrices import deck, import_to_study
from calib.command.measured import identify_modes_of_files, look_at_files
from calib.command.options import (
    CachePath,
    CalibrationMethod,
    CaseName,
    ExecutorName,
    Format,
    NoFigures,
    Quick,
    ResultsPath,
    SensitivityMethod,
    StudyPath,
    Verbose,
    Width,
    Workers,
    possible,
)  # fmt: skip
from calib.errors.errors import InputError
from calib.execution import interrupt
from calib.results.results import RESULTS
from calib.results.version import __version__
from calib.results.written import noting_kept

app = typer.Typer(
    name="calib",
    help="Calibrate structural-dynamics models against vibration measurements.\n\n"
    "A study is a folder with a study.toml that names a model and a measurement; 'calib new' writes an example.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


app.command(short_help="Write an annotated example study.")(new)


@app.command("schema", short_help="Print the JSON schema of study.toml.")
def print_schema() -> None:
    """Print the JSON schema of study.toml, with which editors complete and check its keys."""
    from calib.study.schema import schema

    typer.echo(json.dumps(schema(), indent=1))


app.command("modes", short_help="Identify modes from FRFs, hammer records or ambient records.")(identify_modes_of_files)
app.command("import", short_help="Make a study of matrices of a finite-element code.")(import_to_study)
app.command("look", short_help="Look at measured files, without a model.")(look_at_files)
app.command("compare", short_help="Compare model and measurement without fitting.")(compare_model)


@app.command("sensitivity", short_help="Find which parameters matter.")
def sensitivity_of_study(
    study: StudyPath,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    method: Annotated[
        SensitivityMethod, typer.Option("--method", help="Method; morris and sobol vary inputs freely between limits.")
    ] = SensitivityMethod.ranks,
    ignore_constraints: Annotated[
        bool, typer.Option("--ignore-constraints", help="Let morris and sobol ignore the constraints.")
    ] = False,
    residuals: Annotated[
        str | None, typer.Option("--residuals", metavar="RESPONSE", help="Draw its metamodel against the model.")
    ] = None,
    surface: Annotated[
        tuple[str, str, str] | None,
        typer.Option("--surface", metavar="RESPONSE X Y", help="Draw its metamodel over two parameters."),
    ] = None,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Find which parameters matter: Latin hypercube, rank correlations, variance shares, selection, metamodels."""
    how = method.value
    figures = not no_figures
    with loaded_study(
        "sensitivity", study, results, verbose, workers, quick, method=how, executor=executor, figures=figures
    ) as loaded:
        loaded.sensitivity(
            method.value,
            ignore_constraints=ignore_constraints,
            residuals=[residuals] if residuals else (),
            surfaces=[surface] if surface else (),
        )


app.command("refine", short_help="New runs where they help the metamodels most.")(refine_samples)


@app.command("calibrate", short_help="Fit the parameters, and compare before and after.")
def calibrate_study(
    study: StudyPath,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    case: CaseName = None,
    quick: Quick = False,
    method: Annotated[
        CalibrationMethod | None, typer.Option("--method", help="Method [default: that of the study].")
    ] = None,
    cache: CachePath = None,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Fit the parameters in several independent cases, and compare the model before and after.

    Interrupt it at any time: the same command resumes it and ends with the same result.
    """
    how = None if method is None else method.value
    with loaded_study(
        "calibrate", study, results, verbose, workers, quick, cache=cache, case=case, method=how, executor=executor,
        figures=not no_figures,
    ) as loaded:  # fmt: skip
        loaded.calibrate(case, method=None if method is None else method.value)


@app.command("intervals", short_help="Intervals of fitted parameters that assume no linear model.")
def intervals_of_fit(
    study: StudyPath,
    parameter: Annotated[
        list[str] | None, typer.Option("--parameter", metavar="NAME", help="Only this one; may be repeated.")
    ] = None,
    samples: Annotated[
        int, typer.Option("--samples", min=0, metavar="STEPS", help="Also sample the posterior, with so many steps.")
    ] = 0,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    cache: CachePath = None,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Intervals of the fitted parameters by the profile likelihood, beside those of their standard deviations.

    One is moved from its fitted value while all others are fitted again, until the data exclude what lies beyond.
    """
    figures = not no_figures
    with loaded_study(
        "intervals", study, results, verbose, workers, quick, cache=cache, executor=executor, figures=figures
    ) as loaded:
        loaded.intervals(parameter or (), samples=samples)


app.command("robustness", short_help="Responses over what is known of the fitted parameters.")(spread_of_fit)
app.command("pareto", short_help="Weigh two groups of responses against each other.")(pareto_of_study)
app.command("designs", short_help="List evaluated designs, the best first.")(list_designs)
app.command(short_help="Write the solver's deck with the calibrated values.")(deck)


@app.command("open", short_help="Open the live page of a study.")
def open_page(
    study: Annotated[
        Path, typer.Argument(metavar="[STUDY]", callback=possible, help="A study, or a folder with studies below it.")
    ] = Path("."),
    results: ResultsPath = RESULTS,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Port [default: any that is free].")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Open the live page of a study: searches as they run, what was found, and the next command as a button.

    Without a study it lists those below the present folder. The page answers on this computer alone; closing it stops
    nothing. Needs: pip install 'calib[workbench]'.
    """
    from calib.workbench.server import serve

    serve(study, results, port, browser, terminal.say)


@app.command("again", short_help="Evaluate failed points once more.")
def repeat_failed(
    study: StudyPath,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    verbose: Verbose = False,
) -> None:
    """Evaluate failed points once more, such as those without a licence; others stay. Analyses then use them."""
    with loaded_study("again", study, results, verbose, workers, executor=executor) as loaded:
        loaded.again()


@app.command("explain", short_help="Find which physical effect the model lacks.")
def explain_study(
    study: StudyPath,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    cache: CachePath = None,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Find which physical effect the model lacks: a verdict, its evidence, and the recommended next measurement.

    Calibrates by least squares, tests every effect of the study's library and every local perturbation of the model,
    fits the most promising ones, and tests the remaining misfit.
    """
    figures = not no_figures
    with loaded_study(
        "explain", study, results, verbose, workers, quick, cache=cache, executor=executor, figures=figures
    ) as loaded:
        loaded.explain()


@app.command("propose", short_help="Compose effects that nobody listed.")
def propose_effects(
    study: StudyPath,
    rank: Annotated[int, typer.Option("--rank", min=1, max=20, metavar="N", help="Proposals that are written.")] = 5,
    results: ResultsPath = RESULTS,
    quick: Quick = False,
    cache: CachePath = None,
    verbose: Verbose = False,
) -> None:
    """Compose effects that nobody listed, where 'explain' found a misfit that no effect of the library explains.

    Changed parts, masses, hung masses, springs, dampers and joints are composed from the local perturbations, fitted
    and ranked. The best are written as code, in a study among the results that has them in its library.
    """
    with loaded_study("propose", study, results, verbose, quick=quick, cache=cache) as loaded:
        loaded.propose(rank)


@app.command("extend", short_help="Write a new study whose model has more effects.")
def extend_study(
    study: StudyPath,
    effects: Annotated[list[str], typer.Argument(metavar="EFFECT...", help="Possible causes that the study lists.")],
    into: Annotated[
        Path, typer.Option("--into", metavar="FOLDER", callback=possible, help="A folder that does not exist yet.")
    ],
    results: ResultsPath = RESULTS,
    verbose: Verbose = False,
) -> None:
    """Write a new study whose model also has the named effects; this study stays as it is."""
    from calib.study.study_file import shell_argument

    with loaded_study("extend", study, results, verbose) as loaded:
        written = loaded.extend(effects, into)
    place = "" if written.results == RESULTS else f" --results {shell_argument(written.results)}"
    terminal.say(f"Calibrate it with: calib calibrate {shell_argument(written.path)}{place}")


@app.command(short_help="Write report.html and figures from stored results.")
def report(
    study: StudyPath,
    results: ResultsPath = RESULTS,
    formats: Annotated[
        list[Format],
        typer.Option("--format", help="Format of the figures beside the report; give it again for a further one."),
    ] = [Format.png],  # noqa: B006
    width: Annotated[
        Width,
        typer.Option(
            "--width",
            help="Width of these figures: 190 mm, or 90 mm for a journal's column; one that is not legible in a column "
            "stays as wide as a page.",
        ),
    ] = Width.page,
    verbose: Verbose = False,
) -> None:
    """Write report.html, one file that opens anywhere, from the stored results, and redraw every figure.

    Nothing is computed, and no code of the study is run.
    """
    with loaded_study("report", study, results, verbose, load=False) as known:
        known.report(tuple(dict.fromkeys(one.value for one in formats)), width.value)


@app.command(short_help="Run every analysis and write report.html.")
def run(
    study: StudyPath,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    cache: CachePath = None,
    verbose: Verbose = False,
) -> None:
    """Run every analysis: compare, sensitivity, calibrate, explain, add the named effects; draw, write report.html.

    'explain' runs where the study has a library of effects. Effects that it names are added: the extended study is
    written among the results and calibrated too, and the errors before and after are reported.
    """
    with loaded_study("run", study, results, verbose, workers, quick, cache=cache, executor=executor) as loaded:
        loaded.run()


def _version(requested: bool) -> None:
    if requested:
        terminal.say(f"calib {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    pass


def main() -> None:
    """What the entry point runs when everything that it needs is imported."""
    from calib.execution.worker import quiet_libraries

    terminal.write_to_any_code_page()
    quiet_libraries()
    code = execute(sys.argv[1:])
    interrupt.leave(code)
    sys.exit(code)


def execute(arguments: list[str]) -> int:
    """Run one command line and return its exit code.

    Bad input gives one sentence and code 2, an interrupt code 130; an unexpected failure logs its traceback, code 1.
    """
    try:
        with noting_kept() as set_aside:
            try:
                app(args=arguments, prog_name="calib")
            finally:
                interrupt.command_over()
                terminal.tell_set_aside(set_aside)
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
        if code == interrupt.CODE:
            terminal.complain(interrupt.WORDS)
        return code or int(terminal.output_lost())
    except InputError as fault:
        terminal.complain_of_input(fault, arguments)
        return 2
    except Exception as fault:  # the last resort: a sentence and the log instead of a bare traceback
        if interrupt.pressed():
            terminal.complain(interrupt.WORDS)
            return interrupt.CODE
        terminal.complain_of_unexpected(fault, arguments)
        return 1
    return int(terminal.output_lost())


if __name__ == "__main__":
    main()
