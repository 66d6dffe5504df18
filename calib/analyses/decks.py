"""The calibrated model goes back: decks of a solver with the calibrated values, and a table of these."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from calib.analyses.answers import RELY
from calib.analyses.provenance.record import analyses_of
from calib.analyses.staged import required_calibration
from calib.errors.errors import EvaluationError, InputError
from calib.imports.deck import deck_name, deck_of, read_template
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.results.written import write_new_folder
from calib.study.several import AnyStudy

TABLE = "calibrated.csv"


def write_decks(study: AnyStudy, results: Results, into: Path) -> tuple[Path, ...]:
    """Write the decks of a study with its calibrated values, those of parameters that were not fitted nominal.

    Parameters
    ----------
    study : Study
        It names templates under ``decks`` and files beside them under ``deck_files``, or has a solver.
    results : Results
        With its calibration.
    into : Path
        A folder that does not exist yet.

    Returns
    -------
    tuple of Path
        The decks, the solver's other files and `TABLE`: ``parameter, value, std, unit, remark``, the last with what
        `caution` says.

    Raises
    ------
    InputError
        Without a calibration of the present state or without templates, and for a template that cannot be written.
    """
    first, settings = study.studies[0], study.settings
    solver = settings.solver
    templates = settings.decks or (solver.template if solver is not None else ())
    if not templates:
        raise InputError(
            "it names no deck", place=study.file,
            remedy='copy the deck into the study, write {{ NAME }} where values belong, and decks = ["deck.inp"]',
        )  # fmt: skip
    found = required_calibration(study, results)
    space = first.model.space
    values = {**space.values, **{name: value for name, value in found.values.items() if name in space}}
    contents = {deck_name(name): _deck(study.folder / name, space, values) for name in templates}
    beside = solver.files if solver is not None and not settings.decks else ()
    for name in settings.deck_files or beside:
        contents[Path(name).name] = _content(study.folder / name)
    rows = [(name, float(v), found.std.get(name), space[name].unit, caution(results)) for name, v in values.items()]
    table = pd.DataFrame(rows, columns=["parameter", "value", "std", "unit", "remark"])
    contents[TABLE] = table.assign(std=[_digits(std) for std in table["std"]]).to_csv(index=False).encode()
    write_new_folder(into, contents)
    return tuple(into / name for name in contents)


def caution(results: Results) -> str:
    """Why the calibrated values are to be used with care, as the calibration said; empty where it may be relied on."""
    answer = analyses_of(results).get("calibrate", {}).get("answer", {})
    then = str(answer.get("then", ""))
    return "" if then in ("", RELY) else f"{answer.get('found', '').partition(':')[0]}. {then}"


def _digits(std: float | None) -> str:
    return "" if std is None or math.isnan(std) else f"{std:.4g}"


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as fault:
        raise InputError(f"it cannot be read ({fault.strerror})", place=file) from None


def _deck(file: Path, space: ParameterSpace, values: Mapping[str, float]) -> bytes:
    """The deck of one template."""
    text, _ = read_template(file, space.names)
    try:
        return deck_of(text, space.parameters, values).encode()
    except EvaluationError as fault:
        raise InputError(str(fault), place=file) from None
