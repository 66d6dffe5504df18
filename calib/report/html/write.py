"""Write the page: one self-contained file that opens offline."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import count
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.report.html import (
    calibrated,
    comparison,
    effects,
    explanation,
    fails,
    sensitivity,
    space,
    verified,
)
from calib.report.html.cells import FILTERS, filled, is_words
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import Summary, page_summary
from calib.results.written import replacing

NAME = "report.html"
SECTIONS = (
    *("stale", "measured", "compared", "fails", "sensitivity", "calibrated", "pulled", "effects", "verdict", "steps"),
    *("proposals", "suspect", "added", "next", "errors", "candidate_fits", "assumptions", "versions", "not_run"),
)
"""The sections in their order on the page, each a template; one without content is omitted."""
VIEWER = "viewer"
"""The figure that can be turned; the others are drawings."""
LONGEST = 12
"""Rows of the longest table that is shown unfolded."""
ASKED = {
    "calibrated": calibrated, "comparison": comparison, "effects": effects, "explanation": explanation, "fails": fails,
    "sensitivity": sensitivity, "space": space, "verified": verified,
}  # fmt: skip
"""Modules that templates ask for what is computed from the tables."""


@dataclass(frozen=True)
class PageSection:
    """A section of the page.

    Attributes
    ----------
    name : str
        Identifier in the page, and name of its template.
    title : str
    body : Markup
    """

    name: str
    title: str
    body: Markup


@dataclass
class _Numbers:
    """Numbers of the figures in their order on the page."""

    names: list[str] = field(default_factory=list)

    def __call__(self, name: str) -> int:
        self.names.append(name)
        return len(self.names)


@cache
def templates() -> Environment:
    """The templates of the page."""
    loader = PackageLoader("calib.report.html", "template")
    made = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    made.filters.update(FILTERS)
    made.tests["words"] = is_words
    made.globals.update(ASKED, filled=filled, longest=LONGEST)
    return made


@dataclass(frozen=True)
class Contents:
    """What a section holds beside words and tables: numbers of figures, their drawings, and tables as addresses."""

    number: Callable[[str], int]
    drawing: Callable[[str], Markup] = lambda name: Markup()
    file: Callable[[str], str] = lambda table: ""


def section(name: str, results: StudyResults, contents: Contents) -> PageSection | None:
    """Return a section; None without tables for it."""
    values: dict[str, Any] = {"results": results, **vars(contents)}
    made = templates().get_template(f"section/{name}.html.j2").make_module(values)
    body = Markup(made).strip()
    return PageSection(name, vars(made)["title"], body) if body else None


def sections(results: StudyResults, contents: Contents | None = None) -> tuple[PageSection, ...]:
    """Return the sections for which there are tables, without drawings and files unless ``contents`` holds them."""
    contents = contents or Contents(_Numbers())
    return tuple(found for name in SECTIONS if (found := section(name, results, contents)) is not None)


def pictures(results: StudyResults) -> list[str]:
    """Return the names of the drawings in these sections, in their order."""
    numbers = _Numbers()
    sections(results, Contents(numbers))
    return [name for name in numbers.names if name != VIEWER]


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


def write_report(results: StudyResults, progress: Progress = silent) -> Page:
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
    return Page(path, page_summary(results))


def page(results: StudyResults, progress: Progress = silent) -> str:
    """Return the HTML of the whole page."""
    done, total, number = count(), len(pictures(results)), _Numbers()

    def drawing(name: str) -> Markup:
        progress("drawing the report", next(done), total)
        return Markup(results.figures.svg(name))

    def file(table: str) -> str:
        return _address(results.folder / f"{table}.csv")

    found = sections(results, Contents(number, drawing, file))
    scripts = ("report.js", "three.min.js", "viewer.js") if VIEWER in number.names else ("report.js",)
    template = templates().get_template("page.html.j2")
    return template.render(
        results=results,
        summary=page_summary(results),
        sections=found,
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
