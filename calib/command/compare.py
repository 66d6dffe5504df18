"""The ``compare`` command: a study, or files of computed and of measured modes without one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.command import terminal
from calib.command.loaded import loaded_study
from calib.command.options import NoFigures, Quick, ResultsPath, Verbose, possible, require_used_options
from calib.errors.errors import InputError
from calib.results.results import RESULTS

_OF_STUDIES = "results", "undamped", "quick", "no_figures"
_OF_FILES = (
    "shapes",
    "modes_shapes",
    "node_limit",
    "sensors",
    "coordinates",
    "length_unit",
    "measured_length_unit",
    "into",
)
"""Options of one of the two forms alone."""


def compare_model(
    context: typer.Context,
    study: Annotated[
        Path | None, typer.Argument(metavar="[STUDY]", help="Folder with a study.toml; or use the options below.")
    ] = None,
    results: ResultsPath = RESULTS,
    computed: Annotated[
        Path | None, typer.Option("--modes", metavar="FILE", help="Modes that a finite-element code has computed.")
    ] = None,
    modes_shapes: Annotated[
        Path | None, typer.Option("--modes-shapes", metavar="CSV", help="Computed shapes, where --modes is a table.")
    ] = None,
    measured: Annotated[
        list[Path] | None, typer.Option("--measured", metavar="FILE", help="Measured modes; again for a repeat.")
    ] = None,
    shapes: Annotated[Path | None, typer.Option("--shapes", metavar="CSV", help="Measured shapes.")] = None,
    sensors: Annotated[Path | None, typer.Option("--sensors", metavar="CSV", help="Places of measured nodes.")] = None,
    coordinates: Annotated[
        Path | None, typer.Option("--coordinates", metavar="FILE", help="Computed nodes: table, deck or mesh.")
    ] = None,
    length_unit: Annotated[str | None, typer.Option("--length-unit", help="Of computed nodes, such as mm.")] = None,
    measured_length_unit: Annotated[
        str | None, typer.Option("--measured-length-unit", help="Of measured nodes in universal files, such as mm.")
    ] = None,
    node_limit: Annotated[
        float | None,
        typer.Option("--node-limit", metavar="M", help="Largest distance of a measured node from a computed one, m."),
    ] = None,
    into: Annotated[
        Path, typer.Option("--into", metavar="FOLDER", callback=possible, help="Report and tables of --modes.")
    ] = Path("compared"),
    undamped: Annotated[
        bool, typer.Option("--undamped", help="Also the frequencies of stiffness and mass alone.")
    ] = False,
    quick: Quick = False,
    no_figures: NoFigures = False,
    verbose: Verbose = False,
) -> None:
    """Compare model and measurement without fitting: errors, MAC, and where the model fails.

    Without a study: --modes with what a finite-element code has computed (.unv, .frd, .f06, .dat, .csv and others), and
    --measured with measured modes.
    """
    if computed is not None or measured:
        from calib.api.fe_comparison import compare_files

        remedy = "leave it out; --into names the folder of the report and the tables"
        require_used_options(context, _OF_STUDIES, "the comparison of files", remedy)
        found, written = compare_files(
            study, computed, measured or [], into, shapes=shapes, sensors=sensors, coordinates=coordinates,
            modes_shapes=modes_shapes, length_unit=length_unit, measured_length_unit=measured_length_unit,
            node_limit=node_limit,
        )  # fmt: skip
        for label, text in found.lines.items():
            if label != "Evidence":
                terminal.say(f"{label}:".ljust(10) + text)
        terminal.say(f"Results:  {written[0]}")
        terminal.tell_entries(found.entries, verbose)
        return
    if study is None:
        raise InputError("nothing is named", place="compare", remedy="name a study, or --modes and --measured")
    require_used_options(context, _OF_FILES, "the comparison of a study", "leave it out; files are named in study.toml")
    with loaded_study("compare", possible(study), results, verbose, quick=quick, figures=not no_figures) as loaded:
        loaded.compare(undamped=undamped)
