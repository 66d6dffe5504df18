"""Write the page: one self-contained file that opens offline."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import resources
from itertools import count
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from calib.errors.errors import InputError
from calib.execution.stage import Progress, unheard
from calib.report.html import (
    added,
    calibrated,
    compared,
    effects,
    explained,
    fails,
    measured,
    proposed,
    provenance,
    recommended,
    stepped,
    suspected,
    variance_share,
    verified,
)
from calib.report.html.page import Picture, Section, Viewer
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import Summary, summary
from calib.results.written import replacing

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
    stepped.section,
    proposed.section,
    suspected.section,
    added.section,
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


def pictures(results: StudyResults) -> list[str]:
    """Return the names of the figures in these sections, in their order."""
    return [block.name for section in sections(results) for block in section.blocks if isinstance(block, Picture)]


@dataclass(frozen=True)
class Page:
    """A report that was written.

    Attributes
    ----------
    path : Path
    summary : Summary
        What its head says.
    """

    path: Path
    summary: Summary


def write_report(results: StudyResults, progress: Progress = unheard) -> Page:
    """Write ``report.html`` from the tables of a folder, beside them; nothing is computed anew.

    Raises
    ------
    InputError
        The folder is missing, or a table is damaged; nothing is written then.
    """
    if not results.figures.folder.folder.is_dir():
        raise InputError("there is no such folder of results", place=results.figures.folder.folder)
    text, path = page(results, progress), results.folder / NAME
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return Page(path, summary(results))


def page(results: StudyResults, progress: Progress = unheard) -> str:
    """Return the HTML of the whole page."""
    loader = PackageLoader("calib.report.html", "template")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    shown = sections(results)
    blocks = [block for section in shown for block in section.blocks]
    drawn, pictures = count(), sum(isinstance(block, Picture) for block in blocks)

    def svg(picture: Picture) -> Markup:
        progress("drawing the report", next(drawn), pictures)
        return Markup(results.figures.svg(picture.name))

    environment.filters["svg"] = svg
    environment.filters["file"] = lambda table: _address(results.folder / f"{table}.csv")
    environment.globals["number"] = count(1).__next__
    in_space = any(isinstance(block, Viewer) for block in blocks)
    scripts = ("report.js", "three.min.js", "viewer.js") if in_space else ("report.js",)
    return environment.get_template("report.html").render(
        results=results,
        summary=summary(results),
        sections=shown,
        style=Markup(_file("report.css")),
        scripts=[Markup(_file(name)) for name in scripts],
    )


_PLAIN = " ,;:.+-_/()[]{}*=!?@$|^~"
"""Characters that an address in an attribute may hold as they are."""


_LONG = re.compile(r"(?<=[,\n])-?\d*\.\d{5,}(?:e[+-]?\d+)?(?=[,\r\n])")
"""A field with a number of many digits."""


def _address(path: Path) -> str:
    """A table as an address that holds all of it, its numbers with six significant digits."""
    text = _LONG.sub(lambda found: f"{float(found[0]):.6g}", path.read_text(encoding="utf-8"))
    return f"data:text/csv;charset=utf-8,{quote(text, safe=_PLAIN)}"


def _file(name: str) -> str:
    return (resources.files("calib.report.html") / "template" / name).read_text(encoding="utf-8")
