"""``calib look``: what measured files hold, before any model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.command import terminal
from calib.command.options import Quantity, Verbose, assigned, listed, possible


def look(
    files: Annotated[list[Path], typer.Argument(metavar="FILES...", help="Modes, shapes, FRFs, records, places.")],
    into: Annotated[
        Path, typer.Option("--into", metavar="FOLDER", callback=possible, help="Folder of the table and the picture.")
    ] = Path("look"),
    quantity: Annotated[Quantity | None, typer.Option("--quantity", help="Where the files do not state it.")] = None,
    unit: Annotated[str | None, typer.Option("--unit", help="Such as g/N; where not stated.")] = None,
    averages: Annotated[int | None, typer.Option("--averages", help="Averages behind a single file.")] = None,
    channels: Annotated[
        str | None, typer.Option("--channels", metavar="12z/3z,...", help="Functions or sensors, where not named.")
    ] = None,
    variables: Annotated[
        str | None, typer.Option("--variables", metavar="freq=f,frf=H", help="Names in .mat files and workbooks.")
    ] = None,
    length_unit: Annotated[str | None, typer.Option("--length-unit", help="Such as mm; where not stated.")] = None,
    synthetic: Annotated[bool, typer.Option("--synthetic", help="No structure was measured.")] = False,
    verbose: Verbose = False,
) -> None:
    """Say what measured files hold, and what is odd in it: units, nodes, auto-MAC, complexity, coherence, indicators.

    Files of one kind are repeats. Writes look.csv and look.png.
    """
    from calib.api.look import look as look_at
    from calib.execution.tasks import one_thread

    with one_thread():
        found = look_at(
            files, quantity=None if quantity is None else quantity.value, unit=unit, averages=averages,
            channels=listed(channels), variables=assigned(variables), length_unit=length_unit, synthetic=synthetic,
        )  # fmt: skip
        written = found.save(into)
    terminal.tell_entries(found.entries, verbose)
    terminal.say(f"Written: {', '.join(map(str, written))}")
