"""Figures that are there already: what those of a folder were drawn from, kept beside them.

Nothing here imports matplotlib, so that figures that stay as they are cost no import of it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import Literal, TypeAlias

from calib.report.tables import CurrentFolder
from calib.results.code_digest import code_digest
from calib.results.written import is_own, replacing

Format: TypeAlias = Literal["svg", "png", "pdf"]
FORMATS: tuple[Format, ...] = ("svg", "png", "pdf")
"""Formats of files, in the order in which they are written: the last removes the words under the mouse."""
_FILE = "figures.sha256"
_BEGUN = "begun"
"""In the place of a state while figures are drawn."""
_RECORD = "record.json"
"""The only file of results that decides no figure by all that is in it, since it tells when an analysis was made."""


@dataclass(frozen=True)
class KeptFigures:
    """Figures of one folder of results.

    Attributes
    ----------
    folder : CurrentFolder
    looks : tuple
        What decides how they look beside tables and code: titles, axes, formats and width, as ``repr`` states them.
    """

    folder: CurrentFolder
    looks: tuple[object, ...]

    @property
    def there(self) -> list[Path] | None:
        """All of them, in the order in which they are drawn; None where one is to be drawn, or where that is unknown.

        They are there while tables, code and looks are those of the last drawing, and nobody has changed a picture.
        """
        state, paths = self._noted
        return paths if state == self._state and all(map(is_own, paths)) else None

    @property
    def outdated(self) -> list[Path] | None:
        """Pictures of other tables than those that are there now; None where none was drawn, or of these tables alone.

        After a drawing that was interrupted they are all that calib has made there.
        """
        state, paths = self._noted
        if not state or state.split()[0] == self._state.split()[0]:
            return None
        every = [file for kind in FORMATS for file in self.folder.folder.glob(f"*.{kind}")]
        return [path for path in (every if state == _BEGUN else paths) if is_own(path)]

    def begin(self) -> None:
        """Figures are about to be drawn, of the tables as they are now; OSError where that cannot be noted."""
        _ = self._state
        self._write(_BEGUN, ())

    def note(self, figures: Sequence[Path]) -> None:
        """These are all, drawn now; OSError where that cannot be noted."""
        self._write(self._state, figures)

    def forget(self) -> None:
        """None is there any more; OSError where that cannot be noted."""
        self._file.unlink(missing_ok=True)

    def _write(self, state: str, figures: Sequence[Path]) -> None:
        with replacing(self._file) as draft:  # logged: a folder of several tests may hold nothing else
            draft.write_text("\n".join([state, *(path.name for path in figures), ""]), "utf-8")

    @property
    def _noted(self) -> tuple[str, list[Path]]:
        """State of the last drawing, and its pictures; empty without one."""
        try:
            state, *names = self._file.read_text("utf-8").splitlines()
        except (OSError, ValueError):
            return "", []
        return state, [self.folder.folder / name for name in names]

    @property
    def _file(self) -> Path:
        return self.folder.folder / _FILE

    @cached_property
    def _state(self) -> str:
        """Digest of tables, and of code and looks, as they are when first asked for: before anything is drawn."""
        tables = hashlib.sha256(repr(sorted(self.folder.hidden)).encode())
        for file in sorted(self.folder.folder.iterdir()):
            if file.suffix in (".csv", ".json") and file.name != _RECORD and not file.name.startswith("."):
                content = file.read_bytes()
                tables.update(f"{file.name} {len(content)}\n".encode(errors="surrogateescape") + content)
        looks = hashlib.sha256(repr((drawn_by(), self.looks)).encode())
        return f"{tables.hexdigest()} {looks.hexdigest()}"


@cache
def drawn_by() -> str:
    """The code that draws: that of this room, and matplotlib."""
    return f"{code_digest('calib.report.draw', 'calib.report.figures')} {metadata.version('matplotlib')}"
