"""The figures of a results folder, each drawn once: as SVG in the report and as files beside the tables."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from matplotlib.figure import Figure

from calib.errors.errors import InputError
from calib.execution.stage import Progress, unheard
from calib.report.draw import plan
from calib.report.drawing import Drawing
from calib.report.legible import is_legible, wrap_labels
from calib.report.shown import Shown
from calib.report.style import COLUMN, Format, Width, add_heading, content, style, take_dollars_literally, write
from calib.report.svg import svg_text


@dataclass(frozen=True)
class Asked:
    """What is made of every figure of a folder.

    Attributes
    ----------
    page : collection of str
        Those that a page shows.
    formats : sequence of {"png", "svg", "pdf"}
        Of the files beside the tables.
    width : {"page", "column"}
        Of the files.
    """

    page: Collection[str]
    formats: Sequence[Format]
    width: Width


@dataclass(frozen=True)
class Made:
    """One figure: its ``svg`` element, empty unless a page shows it, and the content of its files by format."""

    svg: str
    files: Mapping[Format, bytes]


class Figures:
    """Figures of one folder.

    Parameters
    ----------
    folder : Path or Shown
        The CSV tables, and optionally ``summary.json`` with a key ``best_case``; stale tables are hidden.
    title : str
        First part of every figure's heading.
    synthetic : bool
        Whether the measurement is synthetic; every file is then labelled so.
    """

    def __init__(self, folder: Path | Shown, title: str, synthetic: bool):
        self.folder = folder if isinstance(folder, Shown) else Shown(Path(folder), frozenset())
        self.title = title
        self.synthetic = synthetic
        self._drawn: dict[str, Figure] = {}
        self._made: Mapping[str, Made] = {}
        self._make: Callable[[], Mapping[str, Made]] | None = None

    @cached_property
    def plan(self) -> dict[str, Drawing]:
        """The figures by name.

        Raises
        ------
        InputError
            The folder is missing, or a table is damaged.
        """
        if not self.folder.folder.is_dir():
            raise InputError("there is no such folder of results", place=self.folder.folder)
        return plan(self.folder)

    def svg(self, name: str, identifier: str = "") -> str:
        """Return a figure as an ``svg`` element for a page, without heading.

        Parameters
        ----------
        name : str
            Key of `plan`.
        identifier : str
            Beginning of the identifiers in the element; the name if it is empty.
        """
        if not identifier and (known := self._taken(name)) and known.svg:
            return known.svg
        with style():
            self._drawn[name] = figure = self.plan[name].draw()
            take_dollars_literally(figure)
            return svg_text(figure, identifier or name)

    def made(self, name: str, asked: Asked) -> Made:
        """Make one figure for page and files, without writing it; see `save` for what is raised."""
        svg = self.svg(name) if name in asked.page else ""
        return Made(svg, self._content(self.plan[name], asked.formats, asked.width))

    def take(self, made: Callable[[], Mapping[str, Made]]) -> None:
        """Use figures made elsewhere, for pages and files of what was asked for; all are made once one is needed."""
        self._make = made

    def _taken(self, name: str) -> Made | None:
        if self._make is not None:
            (make, self._make) = self._make, None
            self._made = make()
        return self._made.get(name)

    def save(
        self, formats: Sequence[Format] = ("png",), progress: Progress = unheard, width: Width = "page"
    ) -> list[Path]:
        """Write every figure beside its tables, in every format; nothing is computed anew.

        Parameters
        ----------
        formats : sequence of str
            Of `calib.report.style.FORMATS`.
        width : {"page", "column"}
            Width of the figures; one that is not legible in a column is as wide as a page.
        progress : callable
            Called before every figure.

        Returns
        -------
        list of Path
            The files in a fixed order.

        Raises
        ------
        InputError
            The folder is missing, or a table is damaged; nothing is written then.
        """
        written: list[Path] = []
        for number, (name, drawing) in enumerate(self.plan.items()):
            progress("drawing figures", number, len(self.plan))
            known = self._taken(name)
            files = known.files if known else self._content(drawing, formats, width)
            written += write(files, self.folder.folder / name)
        return written

    def _content(self, drawing: Drawing, formats: Sequence[Format], width: Width) -> dict[Format, bytes]:
        narrow = self._narrow(drawing) if width == "column" else None
        with style():
            figure = narrow or self._headed(self._page_wide(drawing), drawing.caption)
            return content(figure, drawing.name, formats)

    def _page_wide(self, drawing: Drawing) -> Figure:
        """The figure of the page where it is drawn already."""
        return self._drawn.pop(drawing.name) if drawing.name in self._drawn else drawing.draw()

    def _narrow(self, drawing: Drawing) -> Figure | None:
        """The figure in a column; None where that is not legible."""
        with style(COLUMN):
            figure = self._headed(drawing.draw(), drawing.caption)
            wrap_labels(figure)
            return figure if figure.get_size_inches()[0] == COLUMN and is_legible(figure) else None

    def _headed(self, figure: Figure, caption: str) -> Figure:
        add_heading(figure, f"{self.title}: {caption}" if self.title else caption, self.synthetic)
        return figure
