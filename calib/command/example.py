"""The command ``calib new``: annotated studies that run, one for each kind of model."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from string import Template
from typing import Annotated

import typer

from calib.command import terminal
from calib.command.options import NewFolder, Verbose
from calib.errors.errors import InputError
from calib.results.written import write_new_folder

FILES = {
    "study.toml": "study.toml",
    "model.py": "model.py.txt",
    "modes.csv": "modes.csv",
    "shapes.csv": "shapes.csv",
    "sensors.csv": "sensors.csv",
}
"""Name in the new folder and name of its template, of the example with elements of its own."""
_OF_MODES = {"modes.csv": "building_modes.csv", "shapes.csv": "building_shapes.csv"}
_OF_NUMBERS = {"responses.csv": "building_responses.csv"}
KINDS = {
    "matrices": {"model.py": "building_matrices.py.txt", **_OF_MODES, "sensors.csv": "building_sensors.csv"},
    "modes": {"model.py": "building_modes.py.txt", **_OF_MODES},
    "function": {"model.py": "building_function.py.txt", **_OF_NUMBERS},
    "table": {"runs.csv": "building_runs.csv", **_OF_NUMBERS},
}
"""The same for each kind of model, beside its study file."""
_STUDY = "building_study.toml"
_MODES = 'files = ["modes.csv"]                    # one file a repeat: .csv, .uff, .unv, .mat\nshapes = ["shapes.csv"]'
_NUMBERS = 'responses = "responses.csv"              # response, value, std'
_TEXTS = {
    "matrices": ("from matrices", '"model.py:building"', f'{_MODES}\nsensors = "sensors.csv"'),
    "modes": ("from a solver of modes", '"model.py:building"', _MODES),
    "function": ("from a function", '"model.py:building"', _NUMBERS),
    "table": (
        "from a table of runs",
        '"runs.csv"                         # a row a run\nmodel_options = { inputs = ["k1", "k2", "k3"] }',
        _NUMBERS,
    ),
}
"""Title, model and measurement in the study file of each kind."""


def write_example(folder: Path, kind: str = "") -> list[Path]:
    """Write an example into a new or empty folder; nothing is left behind when that fails.

    Parameters
    ----------
    folder : Path
    kind : str
        One of `KINDS`; empty for the example with elements of its own.
    """
    template = resources.files("calib") / "template"
    if not kind:
        return write_new_folder(folder, {name: (template / source).read_bytes() for name, source in FILES.items()})
    title, model, measurement = _TEXTS[kind]
    text = Template((template / _STUDY).read_text("utf-8"))
    pairing = "\n[pairing]\nmode_count = 3                           # modes of the model to solve\n"
    study = text.substitute(
        title=f'"A building of three storeys, {title}"', model=model, measurement=measurement,
        pairing=pairing if "modes.csv" in KINDS[kind] else "",
    )  # fmt: skip
    contents = {name: (template / source).read_bytes() for name, source in KINDS[kind].items()}
    return write_new_folder(folder, {"study.toml": study.encode(), **contents})


def new(
    folder: NewFolder,
    matrices: Annotated[bool, typer.Option("--matrices", help="Of mass and stiffness matrices.")] = False,
    modes: Annotated[bool, typer.Option("--modes", help="Of a function or solver that returns modes.")] = False,
    function: Annotated[bool, typer.Option("--function", help="Of a function that returns numbers.")] = False,
    table: Annotated[bool, typer.Option("--table", help="Of runs that are done, in a table.")] = False,
    verbose: Verbose = False,
) -> None:
    """Write an annotated example study with its own model and data, to put yours in their place.

    Without an option the model assembles finite elements itself.
    """
    from calib.api.entries.entry import count
    from calib.study.study_file import shell_argument

    asked = [kind for kind, wanted in zip(KINDS, (matrices, modes, function, table), strict=True) if wanted]
    if len(asked) > 1:
        words = " and ".join(f"--{kind}" for kind in asked)
        raise InputError(f"{words} exclude each other", place="calib new", remedy="name one kind of model")
    written = write_example(folder, asked[0] if asked else "")
    terminal.say(f"Written: {folder}, an example study of {count(len(written), 'file')}.")
    for path in written if verbose else ():
        terminal.say(f"  {path}")
    terminal.say(f"Run it with: calib run {shell_argument(folder)}")
