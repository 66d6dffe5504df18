"""The figures of a study's script, each drawn from the tables that it wrote."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from calib.report.style import add_heading, save, style


@dataclass(frozen=True)
class FigureSet:
    """Figures of a folder of tables.

    Attributes
    ----------
    title : str
        Before every caption.
    figures : mapping from str to (str, callable)
        Caption and drawing of each, from the folder.
    last : str
        Table that is written last: without it the folder is not complete.
    measured : tuple of str
        Figures that show synthetic measurements.
    """

    title: str
    figures: Mapping[str, tuple[str, Callable[[Path], Figure]]]
    last: str
    measured: tuple[str, ...] = ()

    def drawn(self, folder: Path, name: str) -> Figure | None:
        """A figure with its heading; None where its tables are not at hand."""
        if not (folder / f"{self.last}.csv").is_file():
            return None
        caption, draw = self.figures[name]
        with style():
            figure = draw(folder)
            add_heading(figure, f"{self.title}: {caption}", name in self.measured)
        return figure

    def save_all(self, folder: Path) -> list[Path]:
        """Every figure as PNG beside its tables."""
        out = []
        for name in self.figures:
            figure = self.drawn(folder, name)
            if figure is not None:
                with style():
                    out += save(figure, folder / name)
        return out
