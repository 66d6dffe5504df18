"""Commands on designs: those evaluated, new ones, the front of two groups of responses, the spread of the fit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.command.loaded import loaded_study
from calib.command.options import (
    CachePath,
    ExecutorName,
    NoFigures,
    Picture,
    Quick,
    ResultsPath,
    StudyPath,
    Verbose,
    Workers,
    groups_named,
    limits_of,
    possible,
    require_used_options,
)
from calib.results.results import RESULTS


def list_designs(
    context: typer.Context,
    study: StudyPath,
    best: Annotated[int, typer.Option("--best", min=1, metavar="N", help="Designs that are printed.")] = 12,
    feasible: Annotated[bool, typer.Option("--feasible", help="Leave out those that failed.")] = False,
    design: Annotated[int | None, typer.Option("--design", metavar="NUMBER", help="Values of this one alone.")] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv", metavar="FILE", callback=lambda path: path and possible(path), help="File of the whole table."
        ),
    ] = None,
    anthill: Annotated[
        tuple[str, str] | None,
        typer.Option("--anthill", metavar="X Y", help="Draw a cloud of two columns."),
    ] = None,
    parallel: Annotated[bool, typer.Option("--parallel", help="Draw all designs over parallel axes.")] = False,
    draw: Annotated[
        list[Picture] | None, typer.Option("--draw", help="Draw what designs have in common; may be repeated.")
    ] = None,
    results: ResultsPath = RESULTS,
    quick: Quick = False,
    verbose: Verbose = False,
) -> None:
    """List the designs that searches and samples have evaluated: values, responses and errors, the best first."""
    if design is not None and not parallel and not draw:  # pictures mark the best ones
        require_used_options(context, ("best",), "--design, which tells one design alone,")
    with loaded_study("designs", study, results, verbose, quick=quick) as loaded:
        loaded.designs(
            best, feasible=feasible, design=design, csv=csv, anthill=[anthill] if anthill else (), parallel=parallel,
            draw=[one.value for one in draw or ()],
        )  # fmt: skip


def refine_samples(
    study: StudyPath,
    runs: Annotated[int, typer.Option("--runs", min=1, metavar="N", help="New runs.")] = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the points among which they are chosen.")] = 1,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Choose new runs where metamodels know least near what was measured.

    For a table of runs they are proposed, as a CSV of inputs; a model that computes is evaluated there, and its
    metamodels are built anew.
    """
    with loaded_study(
        "refine", study, results, verbose, workers, quick, executor=executor, figures=not no_figures
    ) as loaded:
        loaded.refine(runs, seed=seed)


def pareto_of_study(
    study: StudyPath,
    population: Annotated[
        int | None, typer.Option("--population", min=4, metavar="N", help="[default: that of the study, 40].")
    ] = None,
    generations: Annotated[
        int | None, typer.Option("--generations", min=2, metavar="N", help="[default: those of the study, 50].")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of the initial population.")] = None,
    group: Annotated[
        list[str] | None,
        typer.Option("--group", metavar="NAME=RESPONSE,...", help="One of the two; give it twice. * is any text."),
    ] = None,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    cache: CachePath = None,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Search the Pareto front of two groups of responses, by default frequencies against MAC.

    Marks its knee, the best design by the weights of the objective, and the fit by least squares. Needs a calibration.
    Interrupt it at any time: the same command resumes it and ends with the same result.
    """
    objectives = groups_named(group or ())
    with loaded_study(
        "pareto", study, results, verbose, workers, quick, cache=cache, executor=executor, figures=not no_figures
    ) as loaded:
        loaded.pareto(population=population, generations=generations, seed=seed, objectives=objectives)


def spread_of_fit(
    study: StudyPath,
    samples: Annotated[
        int | None, typer.Option("--samples", min=10, metavar="N", help="Samples [default: those of the study, 500].")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of the samples.")] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option("--limit", metavar="RESPONSE=LEAST:MOST", help="Allowed values; may be repeated, an end empty."),
    ] = None,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    cache: CachePath = None,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Push samples of the fitted parameters through the model: quantiles of its responses, shares outside limits.

    Uses the samples of 'calib intervals --samples' where there are some. Needs a calibration.
    """
    limits = limits_of(limit or ())
    with loaded_study(
        "robustness", study, results, verbose, workers, quick, cache=cache, executor=executor, figures=not no_figures
    ) as loaded:
        loaded.robustness(samples=samples, seed=seed, limits=limits)
