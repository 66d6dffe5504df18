"""The command ``calib designs``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.command.loaded import loaded_study
from calib.command.options import Picture, Quick, ResultsPath, StudyPath, Verbose, possible
from calib.results.results import RESULTS


def designs(
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
    with loaded_study("designs", study, results, verbose, quick=quick) as loaded:
        loaded.designs(
            best, feasible=feasible, design=design, csv=csv, anthill=[anthill] if anthill else (), parallel=parallel,
            draw=[one.value for one in draw or ()],
        )  # fmt: skip
