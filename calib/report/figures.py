"""The figures of a results folder, each drawn once: as SVG in the report and as files beside the tables."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

from matplotlib.figure import Figure

from calib.errors import InputError
from calib.report.draw import Drawing, plan
from calib.report.shown import Shown
from calib.report.style import Format, add_heading, save, style, take_dollars_literally
from calib.report.svg import svg_text
from calib.stage import Progress, unheard


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
        with style():
            self._drawn[name] = figure = self.plan[name].draw()
            take_dollars_literally(figure)
            return svg_text(figure, identifier or name)

    def save(self, formats: Sequence[Format] = ("png",), progress: Progress = unheard) -> list[Path]:
        """Write every figure beside its tables, in every format; nothing is computed anew.

        Parameters
        ----------
        formats : sequence of str
            Of `calib.report.style.FORMATS`.
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
        written = []
        for number, (name, drawing) in enumerate(self.plan.items()):
            progress("drawing figures", number, len(self.plan))
            with style():
                figure = self._drawn.pop(name, None) or drawing.draw()
                heading = f"{self.title}: {drawing.caption}" if self.title else drawing.caption
                add_heading(figure, heading, self.synthetic)
                written += save(figure, self.folder.folder / name, formats)
        return written
