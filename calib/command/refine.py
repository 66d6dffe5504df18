"""The command ``calib refine``."""

from __future__ import annotations

from typing import Annotated

import typer

from calib.command.loaded import loaded_study
from calib.command.options import ExecutorName, Quick, ResultsPath, StudyPath, Verbose, Workers
from calib.results.results import RESULTS


def refine(
    study: StudyPath,
    runs: Annotated[int, typer.Option("--runs", min=1, metavar="N", help="New runs.")] = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the points among which they are chosen.")] = 1,
    results: ResultsPath = RESULTS,
    workers: Workers = None,
    executor: ExecutorName = None,
    quick: Quick = False,
    verbose: Verbose = False,
) -> None:
    """Choose new runs where metamodels know least near what was measured.

    For a table of runs they are proposed, as a CSV of inputs; a model that computes is evaluated there, and its
    metamodels are built anew.
    """
    with loaded_study("refine", study, results, verbose, workers, quick, executor=executor) as loaded:
        loaded.refine(runs, seed=seed)
