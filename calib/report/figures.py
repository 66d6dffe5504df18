"""The figures of a results folder, each drawn once: as SVG in the report and as files beside the tables."""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.art3d import Text3D

from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.report.draw import plan
from calib.report.drawing import Drawing
from calib.report.kept import Format, drawn_by
from calib.report.scene import upright
from calib.report.style import (
    COLUMN,
    HIGHEST,
    Width,
    add_heading,
    content,
    fill,
    picture_key,
    picture_width,
    style,
    take_dollars_literally,
    visible_texts,
    write,
)
from calib.report.svg import svg_text
from calib.report.tables import CurrentFolder
from calib.results.written import is_own


@dataclass(frozen=True)
class FigureRequest:
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
class RenderedFigure:
    """One figure: its ``svg`` element, empty unless a page shows it, and the content of its files by format."""

    svg: str
    files: Mapping[Format, bytes]
    narrow: bool = False
    """Whether the files are as wide as a column."""


class Figures:
    """Figures of one folder.

    Parameters
    ----------
    folder : Path or CurrentFolder
        The CSV tables, and optionally ``summary.json`` with a key ``best_case``; stale tables are hidden.
    title : str
        First part of every figure's heading.
    synthetic : bool
        Whether the measurement is synthetic; every file is then labelled so.
    prefix : str
        Beginning of the identifiers in a page that has the figures of several folders.
    axes : str
        What the axes of the structure mean, see `calib.report.scene.upright`.
    """

    def __init__(self, folder: Path | CurrentFolder, title: str, synthetic: bool, prefix: str = "", axes: str = ""):
        self.folder = folder if isinstance(folder, CurrentFolder) else CurrentFolder(Path(folder), frozenset())
        self.title = title
        self.synthetic = synthetic
        self.prefix = prefix
        self.axes = axes
        self._figures: dict[str, Figure] = {}
        self._rendered: Mapping[str, RenderedFigure] = {}
        self._render_all: Callable[[], Mapping[str, RenderedFigure]] | None = None
        self.too_wide: tuple[str, ...] = ()
        """Figures of the last `save` that are as wide as a page since they are not legible in a column."""

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
        with style(), upright(self.axes):
            self._figures[name] = figure = self.plan[name].draw()
            take_dollars_literally(figure)
            return svg_text(figure, identifier or f"{self.prefix}{name}")

    def render(self, name: str, request: FigureRequest) -> RenderedFigure:
        """Make one figure for page and files, without writing it; see `save` for what is raised."""
        svg = self.svg(name) if name in request.page else ""
        return RenderedFigure(svg, *self._content(self.plan[name], request.formats, request.width))

    def take(self, rendered: Callable[[], Mapping[str, RenderedFigure]]) -> None:
        """Use figures made elsewhere, for pages and files of what was asked for; all are made once one is needed."""
        self._render_all = rendered

    def _taken(self, name: str) -> RenderedFigure | None:
        if self._render_all is not None:
            (make, self._render_all) = self._render_all, None
            self._rendered = make()
        return self._rendered.get(name)

    def save(
        self, formats: Sequence[Format] = ("png",), progress: Progress = silent, width: Width = "page"
    ) -> list[Path]:
        """Write every figure beside its tables, in every format; nothing is computed anew.

        Parameters
        ----------
        formats : sequence of str
            Of `calib.report.style.FORMATS`.
        width : {"page", "column"}
            Width of the figures; one that is not legible in a column, or higher than a page, is as wide as a page.
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
        wide: list[str] = []
        for number, (name, drawing) in enumerate(self.plan.items()):
            progress("drawing figures", number, len(self.plan))
            known = self._taken(name)
            made = known or RenderedFigure("", *self._content(drawing, formats, width))
            written += write(made.files, self.folder.folder / name) or [self._picture(name)]
            wide += [name] if width == "column" and not made.narrow else []
        self.too_wide = tuple(wide)
        return written

    def _picture(self, name: str) -> Path:
        return self.folder.folder / f"{name}.png"

    def _key(self, drawing: Drawing, width: Width) -> str:
        """What a picture of the drawing shows and who draws it; empty where that is not known."""
        if not (own := drawing.key):
            return ""
        parts = (own, self.title, drawing.caption, self.synthetic, width, self.axes, drawn_by())
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def _content(self, drawing: Drawing, formats: Sequence[Format], width: Width) -> tuple[dict[Format, bytes], bool]:
        """Files of a drawing, and whether they are narrow; none where the only one, a PNG, is there already."""
        path, key = self._picture(drawing.name), self._key(drawing, width)
        if key and tuple(formats) == ("png",) and picture_key(path) == key and is_own(path):
            return {}, picture_width(path) == COLUMN
        narrow = self._narrow(drawing) if width == "column" else None
        with style(), upright(self.axes):
            figure = narrow or self._headed(self._page_wide(drawing), drawing.caption)
            return content(figure, drawing.name, formats, key), narrow is not None

    def _page_wide(self, drawing: Drawing) -> Figure:
        """The figure of the page where it is drawn already."""
        return self._figures.pop(drawing.name) if drawing.name in self._figures else drawing.draw()

    def _narrow(self, drawing: Drawing) -> Figure | None:
        """The figure in a column; None where that is not legible or higher than a page."""
        with style(COLUMN), upright(self.axes):
            figure = self._headed(drawing.draw(), drawing.caption)
            wrap_labels(figure)
            fit_cells(figure)
            width, height = figure.get_size_inches().tolist()
            return figure if width == COLUMN and height <= HIGHEST and is_legible(figure) else None

    def _headed(self, figure: Figure, caption: str) -> Figure:
        add_heading(figure, f"{self.title}: {caption}" if self.title else caption, self.synthetic)
        return figure


_LEAST = 1.0
"""Narrowest panel in inches of which a drawing can still be read."""
_LETTERS = 11.5
"""Letters of an axis' label on an inch of the width of the figure."""
_SMALLEST = 7.0
"""Smallest text in a column, in points."""
_APART = 1.2
"""Least width of a cell of a matrix over that of its number, so that numbers are read apart."""
_PIXEL = 1.0
"""Part of a text outside the figure that is not seen."""


def is_legible(figure: Figure) -> bool:
    """Whether every text lies inside the figure, none covers another of its panel, and every panel has room.

    In a column no text is smaller than 7 points either.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a font may lack characters: the figure is then marked where it is saved
        warnings.filterwarnings("error", message="constrained_layout not applied")  # no room is left for the panels
        try:
            figure.draw_without_rendering()
        except UserWarning:
            return False
    panels = [ax for ax in figure.axes if ax.axison and ax.get_label() != "<colorbar>"]
    if any(ax.get_window_extent().width < _LEAST * figure.dpi for ax in panels):
        return False
    whole = figure.bbox.padded(_PIXEL)
    beyond = [label for ax in figure.axes for axis in (ax.xaxis, ax.yaxis) for label in _ticks(axis, False)]
    texts = [text for text in visible_texts(figure) if _is_visible(text)]
    if figure.get_size_inches()[0] <= COLUMN and any(float(text.get_fontsize()) < _SMALLEST for text in texts):
        return False
    flat = [text for text in texts if not isinstance(text, Text3D)]  # those in space have no place in the figure
    boxes = _boxes(text for text in flat if not any(text is label for label in beyond))
    if not all(whole.contains(box.x0, box.y0) and whole.contains(box.x1, box.y1) for box in boxes):
        return False
    in_space = [[text for text in ax.texts if any(text is one for one in flat)] for ax in figure.axes if not ax.axison]
    return not any(
        _cover_each_other(_boxes(group)) for group in [*in_space, *(g for ax in panels for g in _groups(ax))]
    )


def wrap_labels(figure: Figure) -> None:
    """Break the labels of the axes where they would be longer than the figure is wide."""
    room = int(_LETTERS * float(figure.get_size_inches()[0]))
    for ax in figure.axes:
        lines = ax.get_xlabel().split("\n")
        ax.set_xlabel("\n".join(fill(line, room, break_long_words=False) for line in lines))


def fit_cells(figure: Figure) -> None:
    """Write the numbers in the cells of matrices as large as a column asks for.

    They lose the zero before the point where they need its room. Where they still have none, the colours stand alone;
    brackets stay.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # see is_legible
        figure.draw_without_rendering()
    for ax in figure.axes:
        own = [text for text in ax.texts if text.get_transform() is ax.transData]
        if not ax.images or not own:
            continue
        rows, columns = np.asarray(ax.images[-1].get_array()).shape
        frame = ax.get_window_extent()
        for text in own:
            text.set_fontsize(_SMALLEST)
        for shorten in (str, _without_zero, _brackets):
            for text in own:
                text.set_text(shorten(text.get_text()))
            boxes = _boxes(text for text in own if _is_visible(text))
            if all(_APART * box.width < frame.width / columns and box.height < frame.height / rows for box in boxes):
                break


def _without_zero(words: str) -> str:
    return re.sub(r"^(\W?)0\.(?=\d)", r"\1.", words).replace("1.00", "1")


def _brackets(words: str) -> str:
    return "()" if words.startswith("(") else ""


def _ticks(axis: Axis, inside: bool) -> list[Text]:
    """Labels of ticks inside the limits of an axis, or beyond them, where they are not drawn."""
    low, high = sorted(axis.get_view_interval())
    reach = 1e-6 * (high - low)
    found = [
        *zip(axis.get_majorticklocs(), axis.get_majorticklabels(), strict=False),
        *zip(axis.get_minorticklocs(), axis.get_minorticklabels(), strict=False),
    ]
    return [label for at, label in found if (low - reach <= at <= high + reach) == inside]


def _is_visible(text: Text) -> bool:
    return text.get_visible() and bool(text.get_text().strip())


def _groups(ax: Axes) -> list[list[Text]]:
    """Texts of a panel that must not cover each other: labels of an axis or the legend, with those written into it."""
    legend = ax.get_legend()
    groups = [[*_ticks(axis, True), *ax.texts] for axis in (ax.xaxis, ax.yaxis)]
    groups += [[*legend.get_texts(), *ax.texts]] if legend else []
    return [[text for text in group if _is_visible(text)] for group in groups]


def _boxes(texts: Iterable[Text]) -> list[Bbox]:
    """The frames of texts, without the lines that lead from them to a place."""
    return [Text.get_window_extent(text) for text in texts]


def _cover_each_other(boxes: list[Bbox]) -> bool:
    return any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
