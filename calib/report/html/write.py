"""Writes the page: one file that opens anywhere, offline, and needs nothing beside it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from types import MappingProxyType

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from calib.errors import InputError
from calib.report.html import (
    advised,
    calibrated,
    compared,
    effects,
    explained,
    fails,
    influence,
    measured,
    provenance,
    verified,
)
from calib.report.html.answers import Answers
from calib.report.html.look import as_json, plain_json
from calib.report.html.page import Plot, Section, Shapes
from calib.report.html.summary import summary
from calib.report.shown import Shown
from calib.written import replacing

NAME = "report.html"
STORY = (
    provenance.stale,
    measured.section,
    compared.section,
    fails.section,
    influence.section,
    calibrated.section,
    explained.strained,
    effects.section,
    explained.verdict,
    advised.section,
    verified.errors,
    explained.tried,
    provenance.assumptions,
    provenance.versions,
    provenance.not_asked,
)
"""The sections in the order in which they are told; one without an answer is left out."""


def sections(answers: Answers) -> tuple[Section, ...]:
    """Return the sections of the story for which there are tables."""
    return tuple(found for tell in STORY if (found := tell(answers)) is not None)


def write_report(
    folder: Path,
    title: str,
    synthetic: bool,
    stale: Mapping[str, str] = MappingProxyType({}),
    hidden: frozenset[str] = frozenset(),
) -> Path:
    """Write ``report.html`` from the tables of a folder, beside them; nothing is computed anew.

    Parameters
    ----------
    folder : Path
    title : str
        Of the study.
    synthetic : bool
        Whether the measurement is invented, which the page says at once.
    stale : mapping from question to str
        Questions that were asked of another state of the study, with a sentence about each.
    hidden : frozenset of str
        Names of tables that hold their answers; the page shows none of them.

    Raises
    ------
    InputError
        The folder is missing, or a table is damaged; nothing is written then.
    """
    if not folder.is_dir():
        raise InputError("there is no such folder of results", place=folder)
    text = page(Answers(Shown(folder, hidden), title, synthetic, stale))
    with replacing(folder / NAME) as draft:
        draft.write_text(text, encoding="utf-8")
    return folder / NAME


def page(answers: Answers) -> str:
    """Return the whole page."""
    loader = PackageLoader("calib.report.html", "template")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["data"] = _data
    environment.tests["plot"] = lambda block: isinstance(block, Plot)
    return environment.get_template("report.html").render(
        answers=answers,
        summary=summary(answers),
        sections=sections(answers),
        style=Markup(_file("report.css")),
        script=Markup(_file("report.js")),
        plotly=Markup(get_plotlyjs()),
    )


def _data(block: Plot | Shapes) -> Markup:
    """A figure as the script reads it; nothing in it can end the element that holds it."""
    return Markup(as_json(block.figure) if isinstance(block, Plot) else plain_json(block.scene))


def _file(name: str) -> str:
    return (resources.files("calib.report.html") / "template" / name).read_text(encoding="utf-8")
