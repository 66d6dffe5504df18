"""Arguments and options that several subcommands share."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from calib.errors.errors import InputError


def possible(path: Path) -> Path:
    """A path as typed that this system can have; InputError for any other."""
    from calib.study.measurement_settings import possible_path

    try:
        return Path(possible_path(str(path)))
    except ValueError as fault:
        name = path.name if len(path.name) <= 60 else f"{path.name[:57]}..."
        raise InputError(str(fault), place=name, remedy="name another place") from None


def comma_separated(text: str | None) -> tuple[str, ...]:
    """Entries between commas."""
    return tuple(one.strip() for one in (text or "").split(",") if one.strip())


def assigned(text: str | None) -> dict[str, str]:
    """Names and values such as ``freq=f, frf=H``; InputError for an entry without both."""
    pairs = [one.partition("=") for one in comma_separated(text)]
    if wrong := next((name for name, _, value in pairs if not (name.strip() and value.strip())), None):
        raise InputError(
            f"{wrong!r:.40} assigns nothing", place="--variables", remedy="give pairs as its help shows them"
        )
    return {name.strip(): value.strip() for name, _, value in pairs}


def limits_of(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Limits such as ``natural_freq_1B=1.9:2.1`` by name, an empty end infinite; InputError for another form."""
    out = {}
    for text in texts:
        name, _, ends = text.rpartition("=")
        least, colon, most = ends.partition(":")
        try:
            out[name] = (float(least or "-inf"), float(most or "inf"))
        except ValueError:
            colon = ""
        if not (name and colon):
            raise InputError(f"{text!r:.40} names no limits", place="--limit", remedy="write them as its help shows")
    return out


def groups_named(texts: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Groups such as ``low=natural_freq_1*,mac_1*`` by name; InputError for another form."""
    pairs = [text.partition("=") for text in texts]
    if wrong := next(
        (text for text, pair in zip(texts, pairs, strict=True) if not (pair[0] and comma_separated(pair[2]))), ""
    ):
        raise InputError(f"{wrong!r:.40} names no group", place="--group", remedy="write it as its help shows")
    return {name: comma_separated(responses) for name, _, responses in pairs}


def require_used_options(
    context: typer.Context, unused: Sequence[str], form: str, remedy: str = "leave it out"
) -> None:
    """InputError for an option that was typed, but that this form of the command would ignore."""
    for option in context.command.params:
        source = context.get_parameter_source(option.name or "")
        if option.name in unused and source is not None and source.name == "COMMANDLINE":
            raise InputError(f"{form} does not use it", place=option.opts[0], remedy=remedy)


StudyPath = Annotated[Path, typer.Argument(metavar="STUDY", callback=possible, help="Folder with a study.toml.")]
ResultsPath = Annotated[
    Path, typer.Option("--results", metavar="DIR", callback=possible, help="Where <study>/ with the results goes.")
]
NewFolder = Annotated[
    Path, typer.Argument(metavar="FOLDER", callback=possible, help="A folder that does not exist yet.")
]
Quick = Annotated[
    bool, typer.Option("--quick", help="A quick run, with small searches; its results go to a sub-folder quick/.")
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", min=1, max=256, help="Worker processes [default: one per core where that pays]."),
]
NoFigures = Annotated[
    bool,
    typer.Option(
        "--no-figures", help="Draw no figures; 'calib report' draws them later. Those of older tables are removed."
    ),
]
ExecutorName = Annotated[
    str | None,
    typer.Option(
        "--executor", metavar="NAME",
        help="Who evaluates: processes, dask (a cluster on this machine), or dask://HOST:PORT [default: the study's].",
    ),
]  # fmt: skip
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Also assumptions, secondary tables and the list of files.")
]
CachePath = Annotated[
    Path | None,
    typer.Option(
        "--cache", metavar="DIR", callback=lambda path: path and possible(path),
        help="Folder of the reduced bases that studies share [default: calib in the user's cache folder].",
    ),
]  # fmt: skip
CaseName = Annotated[
    str | None, typer.Option("--case", metavar="NAME", help="Only this case; its results go to a sub-folder.")
]


class SensitivityMethod(StrEnum):
    """Methods of sensitivity analysis."""

    ranks = "ranks"
    morris = "morris"
    sobol = "sobol"


class CalibrationMethod(StrEnum):
    """Methods of calibration."""

    auto = "auto"
    genetic = "genetic"
    gauss_newton = "gauss-newton"
    cmcf = "cmcf"


class Quantity(StrEnum):
    """Quantity of FRFs."""

    receptance = "receptance"
    mobility = "mobility"
    accelerance = "accelerance"


class Estimator(StrEnum):
    """Estimator of FRFs from hammer records."""

    H1 = "H1"
    H2 = "H2"
    Hv = "Hv"


class Picture(StrEnum):
    """Pictures of designs."""

    matrix = "matrix"
    histograms = "histograms"
    history = "history"
    box = "box"


class Format(StrEnum):
    """Format of a figure."""

    png = "png"
    svg = "svg"
    pdf = "pdf"


class Width(StrEnum):
    """Width of a figure."""

    page = "page"
    column = "column"
