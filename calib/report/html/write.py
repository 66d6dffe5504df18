"""Write the page: one self-contained file that opens offline."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
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
    answer,
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
from calib.report.html.study_results import REPORT, StudyResults
from calib.report.html.summary import Summary, page_summary
from calib.results.written import replacing

ANSWER = ("stale", "place", "order", "afterwards", "doubts")
"""The sections that stand first and open: the answer. All others are folded."""
SECTIONS = (
    *(*ANSWER, "measured", "compared", "fails", "sensitivity", "calibrated", "pulled", "effects", "verdict", "steps"),
    *("proposals", "suspect", "added", "next", "errors", "candidate_fits", "assumptions", "versions", "not_run"),
)
"""The sections in their order on the page, each a template; one without content is omitted."""
OF_TEST = "test"
"""The section of one of several tests."""
OF_SEVERAL = (
    *(*ANSWER, "calibrated", "evidence", "pulled", "effects", "verdict", "steps", "proposals", "suspect", "added"),
    *("next", OF_TEST, "candidate_fits", "assumptions", "versions", "not_run"),
)
"""Those of several tests together; each test has one."""
VIEWER, PARALLEL = "viewer", "parallel"
"""The figure that can be turned, and the one whose axes can be brushed; the others are drawings."""
LONGEST = 12
"""Rows of the longest table that is shown unfolded."""
ASKED = {
    "answer": answer, "calibrated": calibrated, "comparison": comparison, "effects": effects,
    "explanation": explanation, "fails": fails, "sensitivity": sensitivity, "space": space, "verified": verified,
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
    folded : bool
        Whether it is unfolded on request only.
    """

    name: str
    title: str
    body: Markup
    folded: bool = False


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
    """What a section holds beside words and tables: numbers of figures, their drawings, and tables as addresses.

    Names of figures that are numbered begin with the prefix of one of several tests.
    """

    number: Callable[[str], int]
    drawing: Callable[[StudyResults, str], Markup] = lambda results, name: Markup()
    file: Callable[[StudyResults, str], str] = lambda results, table: ""


def section(name: str, results: StudyResults, contents: Contents) -> PageSection | None:
    """Return a section; None without tables for it."""
    values: dict[str, Any] = {
        "results": results,
        "number": lambda figure: contents.number(results.prefix + figure),
        "drawing": partial(contents.drawing, results),
        "file": partial(contents.file, results),
    }
    made = templates().get_template(f"section/{name}.html.j2").make_module(values)
    body = Markup(made).strip()
    folded = name not in (*ANSWER, "not_run") and not (name == "compared" and comparison.is_all(results))
    return PageSection(results.prefix + name, vars(made)["title"], body, folded) if body else None


def outline(results: StudyResults) -> Iterator[tuple[StudyResults, str]]:
    """The sections of a page in their order, each with the results that it shows."""
    if results.prefix:
        yield results, OF_TEST
    else:
        for name in OF_SEVERAL if results.tests else SECTIONS:
            yield from ((one, name) for one in (results.tests if name == OF_TEST else (results,)))


def sections(results: StudyResults, contents: Contents | None = None) -> tuple[PageSection, ...]:
    """Return the sections for which there are tables, without drawings and files unless ``contents`` holds them."""
    contents = contents or Contents(_Numbers())
    return tuple(found for own, name in outline(results) if (found := section(name, own, contents)) is not None)


def pictures(results: StudyResults) -> list[str]:
    """Return the names of the drawings in these sections, in their order; of several tests those of all together."""
    numbers = _Numbers()
    for own, name in outline(results):
        if own is results:
            section(name, own, Contents(numbers))
    return [name for full in numbers.names if (name := full.removeprefix(results.prefix)) not in (VIEWER, PARALLEL)]


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
    text, path = page(results, progress), results.folder / REPORT
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return Page(path, page_summary(results))


def page(results: StudyResults, progress: Progress = silent) -> str:
    """Return the HTML of the whole page."""
    done, number = count(), _Numbers()
    total = sum(len(pictures(one)) for one in (results, *results.tests))

    def drawing(own: StudyResults, name: str) -> Markup:
        progress("drawing the report", next(done), total)
        return Markup(own.figures.svg(name))

    def file(own: StudyResults, table: str) -> str:
        return _address(own.folder / f"{table}.csv")

    found = sections(results, Contents(number, drawing, file))
    scripts = ["report.js"]
    for figure, files in ((VIEWER, ("three.min.js", "viewer.js")), (PARALLEL, ("parallel.js",))):
        scripts += files if any(name.endswith(figure) for name in number.names) else ()
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
