"""A figure that can be drawn: its name, its caption, and who draws it from which tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ParamSpec

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.report.style import owner_of
from calib.report.tables import Folder

_P = ParamSpec("_P")


@dataclass(frozen=True)
class Drawing:
    """A figure that can be drawn.

    Attributes
    ----------
    name : str
        Name of its file, without suffix.
    caption : str
        Part of its heading.
    draw : callable
        Returns it.
    tables : tuple of str
        The tables that it shows, CSV files of the folder without suffix.
    """

    name: str
    caption: str
    draw: Callable[[], Figure]
    tables: tuple[str, ...]


def bound(draw: Callable[_P, Axes | Figure], /, *data: _P.args, **looks: _P.kwargs) -> Callable[[], Figure]:
    """The function that draws the given data, whatever their names refer to by the time it is called.

    Parameters
    ----------
    draw : callable
        Returns the figure, or Axes in a figure of their own.
    *data, **looks
        Its arguments.
    """

    def figure() -> Figure:
        found = draw(*data, **looks)
        return owner_of(found) if isinstance(found, Axes) else found

    return figure


def existing(folder: Folder, names: Sequence[str]) -> tuple[str, ...]:
    """Of these tables those that the folder has, without suffix."""
    return tuple(name for name in names if (folder / f"{name}.csv").exists())
