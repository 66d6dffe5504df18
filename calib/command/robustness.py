"""The command ``calib robustness``."""

from __future__ import annotations

from typing import Annotated

import typer

from calib.command.loaded import loaded_study
from calib.command.options import CachePath, ExecutorName, Quick, ResultsPath, StudyPath, Verbose, Workers
from calib.results.results import RESULTS


def robustness(
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
    verbose: Verbose = False,
) -> None:
    """Push samples of the fitted parameters through the model: quantiles of its responses, shares outside limits.

    Uses the samples of 'calib intervals --samples' where there are some. Needs a calibration.
    """
    from calib.command.options import limits_of

    limits = limits_of(limit or ())
    with loaded_study("robustness", study, results, verbose, workers, quick, cache=cache, executor=executor) as loaded:
        loaded.robustness(samples=samples, seed=seed, limits=limits)
