"""A folder of results without what must not be shown."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias


@dataclass(frozen=True)
class Shown:
    """A folder in which some files are as good as missing: they belong to another state of the study.

    Attributes
    ----------
    folder : Path
    hidden : frozenset of str
        Names of these files.
    """

    folder: Path
    hidden: frozenset[str]

    def __truediv__(self, name: str) -> Path:
        """Where a file is; a path to nothing for a hidden one."""
        return self.folder / ".hidden" / name if name in self.hidden else self.folder / name


Folder: TypeAlias = Path | Shown
