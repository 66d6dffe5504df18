"""Figures of a folder, made by all processes that share tasks, and put into pages and files by this one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from calib.execution.stage import Progress
from calib.execution.tasks import each
from calib.report.figures import Asked, Figures, Made
from calib.report.tables import Shown


def make_all(figures: Figures, asked: Asked, progress: Progress) -> dict[str, Made]:
    """Make all figures of a folder; they are the same whoever makes them.

    Parameters
    ----------
    figures : Figures
    asked : Asked
        What is made of each figure.
    progress : callable
        Called before every figure that this process makes.

    Raises
    ------
    InputError
        A table is damaged.
    """
    names = list(figures.plan)
    given = _Given(figures.folder, figures.title, figures.synthetic, asked)
    found = each(_make_one, given, names, lambda done: progress("drawing figures", done, len(names)))
    return dict(zip(names, found, strict=True))


@dataclass(frozen=True)
class _Given:
    """What every process needs; each reads the tables itself."""

    folder: Shown
    title: str
    synthetic: bool
    asked: Asked

    @cached_property
    def figures(self) -> Figures:
        return Figures(self.folder, self.title, self.synthetic)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "figures"}


def _make_one(given: _Given, name: str) -> Made:
    return given.figures.made(name, given.asked)
