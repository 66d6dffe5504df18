"""``calib import`` and ``calib deck``: a model comes from a finite-element code, and goes back to it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.command import terminal
from calib.command.loaded import loaded_study
from calib.command.options import ResultsPath, StudyPath, Verbose, possible
from calib.results.results import RESULTS


def import_to_study(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILES...", help=".sti, .mtx, DMIG .pch, .op2, .op4, Harwell-Boeing, .mat, .npz; a study."
        ),
    ],
    to: Annotated[Path, typer.Option("--to", metavar="FOLDER", callback=possible, help="New folder of the study.")],
    dofs: Annotated[
        Path | None,
        typer.Option("--dofs", metavar="TABLE", help="Node and direction of each row, where not in a file."),
    ] = None,
    coordinates: Annotated[
        Path | None, typer.Option("--coordinates", metavar="FILE", help="Nodes: table in m, deck or mesh.")
    ] = None,
    units: Annotated[
        str | None, typer.Option("--units", help="Of the matrices: m-kg-N, mm-t-N, mm-kg-mN, in-lbf, in-kip, ft-lbf.")
    ] = None,
    stiffness: Annotated[
        list[str] | None, typer.Option("--stiffness", metavar="NAME", help="Matrix or file; again for a further part.")
    ] = None,
    mass: Annotated[list[str] | None, typer.Option("--mass", metavar="NAME", help="Matrix or file.")] = None,
    damping: Annotated[list[str] | None, typer.Option("--damping", metavar="NAME", help="Matrix or file.")] = None,
    computed: Annotated[
        Path | None, typer.Option("--modes", metavar="FILE", help="The code's own modes, to check the import.")
    ] = None,
    modes_shapes: Annotated[
        Path | None, typer.Option("--modes-shapes", metavar="CSV", help="Shapes, where these modes are a table.")
    ] = None,
    measured: Annotated[
        list[Path] | None, typer.Option("--measured", metavar="FILE", help="Measured modes; again for a repeat.")
    ] = None,
    shapes: Annotated[list[Path] | None, typer.Option("--shapes", metavar="CSV", help="Measured shapes.")] = None,
    sensors: Annotated[Path | None, typer.Option("--sensors", metavar="CSV", help="Places of measured nodes.")] = None,
    verbose: Verbose = False,
) -> None:
    """Make a study of the matrices that a finite-element code has written: stiffness, mass and damping.

    Checks rows, triangles, symmetry, mass and units, prints the first frequencies and compares them with the code's own
    (--modes). What lies beside a file under its name (.mas, .dof, .inp, .mapping) is read too. A study whose model is a
    solver, given in place of files, becomes one of matrices by some runs of the solver; others check it.
    """
    from calib.api.fe_import import import_matrices as import_them
    from calib.execution.tasks import one_thread

    with one_thread():
        found = import_them(
            files, dofs=dofs, coordinates=coordinates, units=units, stiffness=stiffness or (), mass=mass or (),
            damping=damping or (), modes=computed, modes_shapes=modes_shapes,
            measured=measured or (), shapes=shapes or (), sensors=sensors, to=to,
        )  # fmt: skip
    terminal.tell_entries(found.entries, verbose)
    for line in found.next_steps:
        terminal.say(line)


def deck(
    study: StudyPath,
    into: Annotated[
        Path, typer.Option("--into", metavar="FOLDER", callback=possible, help="A folder that does not exist yet.")
    ],
    results: ResultsPath = RESULTS,
    verbose: Verbose = False,
) -> None:
    """Write the templates of the study's solver, or those under 'decks', with the calibrated values. Run them there."""
    from calib.analyses.decks import caution
    from calib.api.entries.entry import Warned

    with loaded_study("deck", study, results, verbose) as loaded:
        for written in loaded.decks(into):
            terminal.say(f"Written: {written}")
        if words := caution(loaded.folder):
            terminal.tell_entries([Warned(words)], verbose)
