"""Commands on measured files, without a model: what they hold, and the modes in them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.command import terminal
from calib.command.options import Estimator, Quantity, Verbose, assigned, comma_separated, possible


def look_at_files(
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
            channels=comma_separated(channels), variables=assigned(variables), length_unit=length_unit,
            synthetic=synthetic,
        )  # fmt: skip
        written = found.save(into)
    terminal.tell_entries(found.entries, verbose)
    terminal.say(f"Written: {', '.join(map(str, written))}")


def identify_modes_of_files(
    files: Annotated[list[Path], typer.Argument(metavar="FILES...", help="Universal files, tables, workbooks, .mat.")],
    into: Annotated[
        Path, typer.Option("--into", metavar="FOLDER", callback=possible, help="Folder of the tables and the figure.")
    ] = Path("modes"),
    sensors: Annotated[Path | None, typer.Option("--sensors", metavar="CSV", help="Places of the nodes, m.")] = None,
    quantity: Annotated[Quantity | None, typer.Option("--quantity", help="Where the files do not state it.")] = None,
    unit: Annotated[str | None, typer.Option("--unit", help="Such as g/N, or g of records; where not stated.")] = None,
    averages: Annotated[int | None, typer.Option("--averages", help="Averages behind a single file.")] = None,
    channels: Annotated[
        str | None, typer.Option("--channels", metavar="12z/3z,...", help="Functions, where files do not name them.")
    ] = None,
    variables: Annotated[
        str | None, typer.Option("--variables", metavar="freq=f,frf=H", help="Names in .mat files, or the sheet.")
    ] = None,
    estimator: Annotated[Estimator, typer.Option("--estimator", help="Of hammer records.")] = Estimator.H1,
    exponential_window: Annotated[
        float | None,
        typer.Option("--exponential-window", metavar="S", help="Time constant of the window that the data bear, s."),
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option("--band", metavar="LOW HIGH", help="Lines that are used, Hz.")
    ] = None,
    accept: Annotated[
        list[float] | None, typer.Option("--accept", metavar="FREQ", help="Keep the refused mode near this, Hz.")
    ] = None,
    synthetic: Annotated[bool, typer.Option("--synthetic", help="No structure was measured.")] = False,
    verbose: Verbose = False,
) -> None:
    """Identify modes from FRFs, hammer records or records of responses, and say where modes do not describe these.

    Writes modes.csv and shapes.csv for a study, and the stabilisation diagram. Poles count that are stable over model
    orders and whichever repeat is left out; no pole is picked by hand. Time records need: pip install 'calib[ambient]'.
    """
    from calib.api import progress
    from calib.api.modes import identify_modes
    from calib.execution.tasks import one_thread
    from calib.measurement.files.read_frf import FRFReading

    with one_thread(), progress.bars("modes") as told:
        how = FRFReading(
            None if quantity is None else quantity.value, unit, sensors, averages, comma_separated(channels),
            assigned(variables), None, estimator.value, exponential_window, synthetic,
        )  # fmt: skip
        written = identify_modes(files, into, how, band=band, accept=accept or (), progress=told)
    terminal.tell_entries(written.entries, verbose)
