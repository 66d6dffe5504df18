"""Write the page: one self-contained file that opens offline."""

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
    calibrated,
    compared,
    effects,
    explained,
    fails,
    measured,
    provenance,
    recommended,
    variance_share,
    verified,
)
from calib.report.html.look import as_json, scalar_json
from calib.report.html.page import Plot, Section, Shapes
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import summary
from calib.report.shown import Shown
from calib.written import replacing

NAME = "report.html"
SECTIONS = (
    provenance.stale,
    measured.section,
    compared.section,
    fails.section,
    variance_share.section,
    calibrated.section,
    explained.pulls,
    effects.section,
    explained.verdict,
    recommended.section,
    verified.errors,
    explained.candidate_fits,
    provenance.assumptions,
    provenance.versions,
    provenance.not_run,
)
"""The sections in their order on the page; one without results is omitted."""


def sections(results: StudyResults) -> tuple[Section, ...]:
    """Return the sections for which there are tables."""
    return tuple(found for section in SECTIONS if (found := section(results)) is not None)


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
        Title of the study.
    synthetic : bool
        Whether the measurement is synthetic; the page then says so at the top.
    stale : mapping from analysis to str
        Analyses of another state of the study, with a sentence about each.
    hidden : frozenset of str
        Names of the tables with their results, none of which the page shows.

    Raises
    ------
    InputError
        The folder is missing, or a table is damaged; nothing is written then.
    """
    if not folder.is_dir():
        raise InputError("there is no such folder of results", place=folder)
    text = page(StudyResults(Shown(folder, hidden), title, synthetic, stale))
    with replacing(folder / NAME) as draft:
        draft.write_text(text, encoding="utf-8")
    return folder / NAME


def page(results: StudyResults) -> str:
    """Return the HTML of the whole page."""
    loader = PackageLoader("calib.report.html", "template")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["data"] = _data
    environment.tests["plot"] = lambda block: isinstance(block, Plot)
    return environment.get_template("report.html").render(
        results=results,
        summary=summary(results),
        sections=sections(results),
        style=Markup(_file("report.css")),
        script=Markup(_file("report.js")),
        plotly=Markup(get_plotlyjs()),
    )


def _data(block: Plot | Shapes) -> Markup:
    """A figure as JSON for the script; nothing in it can end the script element."""
    return Markup(as_json(block.figure) if isinstance(block, Plot) else scalar_json(block.scene))


def _file(name: str) -> str:
    return (resources.files("calib.report.html") / "template" / name).read_text(encoding="utf-8")
