"""The command ``calib open``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.command import terminal
from calib.command.options import ResultsPath, possible
from calib.results.results import RESULTS


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
