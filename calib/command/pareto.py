"""The command ``calib pareto``."""

from __future__ import annotations

from typing import Annotated

import typer

from calib.command.loaded import loaded_study
from calib.command.options import CachePath, ExecutorName, Quick, ResultsPath, StudyPath, Verbose, Workers
from calib.results.results import RESULTS


def pareto(
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
    verbose: Verbose = False,
) -> None:
    """Search the Pareto front of two groups of responses, by default frequencies against MAC.

    Marks its knee, the best design by the weights of the objective, and the fit by least squares. Needs a calibration.
    Interrupt it at any time: the same command resumes it and ends with the same result.
    """
    from calib.command.options import groups_named

    objectives = groups_named(group or ())
    with loaded_study("pareto", study, results, verbose, workers, quick, cache=cache, executor=executor) as loaded:
        loaded.pareto(population=population, generations=generations, seed=seed, objectives=objectives)
