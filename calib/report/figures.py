"""The figures of a results folder, each drawn once: as SVG in the report and as files beside the tables."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from matplotlib.figure import Figure

from calib.errors import InputError
from calib.report.draw import plan
from calib.report.drawing import Drawing
from calib.report.legible import is_legible, wrap_labels
from calib.report.shown import Shown
from calib.report.style import COLUMN, Format, Width, add_heading, save, style, take_dollars_literally
from calib.report.svg import svg_text
from calib.stage import Progress, unheard


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
    """One figure: its ``svg`` element, empty unless a page shows it, and its files."""

    svg: str
    files: Sequence[Path]


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
        self._made: dict[str, Made] = {}
        self._help: tuple[Callable[[str], Made | None], Asked] | None = None

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
        if self._help is not None and not identifier:
            return self._shared(name).svg
        with style():
            self._drawn[name] = figure = self.plan[name].draw()
            take_dollars_literally(figure)
            return svg_text(figure, identifier or name)

    def made(self, name: str, asked: Asked) -> Made:
        """Draw one figure for page and files; see `save` for what is raised."""
        svg = self.svg(name) if name in asked.page else ""
        return Made(svg, self._written(self.plan[name], asked.formats, asked.width))

    @contextmanager
    def helped(self, take: Callable[[str], Made | None], asked: Asked) -> Iterator[None]:
        """While this lasts, figures that somebody else has made or is making are taken from there.

        Parameters
        ----------
        take : callable
            Gives a figure of that name; None where it is to be drawn here.
        asked : Asked
            What is made of each figure.
        """
        self._help = take, asked
        try:
            yield
        finally:
            self._help = None

    def _shared(self, name: str) -> Made:
        """A figure made elsewhere or here, once for page and files: then nobody waits for the files at the end."""
        assert self._help is not None
        if name not in self._made:
            (take, asked), self._help = self._help, None
            try:
                self._made[name] = take(name) or self.made(name, asked)
            finally:
                self._help = take, asked
        return self._made[name]

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
            if self._help is not None:
                written += self._shared(name).files
            else:
                written += self._written(drawing, formats, width)
        return written

    def _written(self, drawing: Drawing, formats: Sequence[Format], width: Width) -> list[Path]:
        narrow = self._narrow(drawing) if width == "column" else None
        with style():
            figure = narrow or self._headed(self._page_wide(drawing), drawing.caption)
            return save(figure, self.folder.folder / drawing.name, formats)

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
