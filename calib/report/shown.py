"""A results folder with its stale files hidden."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias


@dataclass(frozen=True)
class Shown:
    """A folder in which some files count as missing, since they belong to another state of the study.

    Attributes
    ----------
    folder : Path
    hidden : frozenset of str
        Names of the hidden files.
    """

    folder: Path
    hidden: frozenset[str]

    def __truediv__(self, name: str) -> Path:
        """Return the path of a file; for a hidden one a path that does not exist."""
        return self.folder / ".hidden" / name if name in self.hidden else self.folder / name


Folder: TypeAlias = Path | Shown
