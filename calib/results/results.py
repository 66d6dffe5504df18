"""The folder of a study's tables and figures; every file is written atomically."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.errors.errors import InputError
from calib.execution.temporary import clear_abandoned
from calib.results import written
from calib.results.former_names import RECORD, TABLES

if TYPE_CHECKING:
    import pandas as pd

RESULTS = Path("results")
"""Where results go unless another place is named."""
_REMEDY = "choose another place with --results DIR, or free the folder"
_MOVE = "move what is there away, or choose another place with --results DIR"
NUMBER = "%.10g"
"""How tables hold numbers: ten digits."""
OWNER = "owner.json"
"""Names the study that a folder of results belongs to."""
_DRAFTS = re.compile(rf"^\.(probe-.*|calib-extend-.*|.+\.\d+){re.escape(written.DRAFT)}$")
_ABANDONED = 600.0
"""Seconds after which a draft counts as abandoned."""


@dataclass(frozen=True)
class Results:
    """One folder of results.

    A new file replaces the one that calib wrote there before; any other file is kept, see `calib.results.written`.

    Attributes
    ----------
    path : Path
    of : (Path, Path) or None
        Folder of all results of a study and the study's file, which becomes its owner with the first file written.
    """

    path: Path
    of: tuple[Path, Path] | None = field(default=None, compare=False)

    @staticmethod
    def at(root: Path, study_name: str, part: str = "") -> Results:
        """Open (and make) ``root/study_name/part``.

        InputError when it cannot be written, holds a study, or holds files without the log of what calib has written.
        """
        home = root / study_name
        clear_abandoned()
        for path in (home, home / part) if part else (home,):
            _refuse_foreign(path)
        for path in (home, home / part) if part else (home,):
            try:
                path.mkdir(parents=True, exist_ok=True)
                _clear_drafts(path)
                with tempfile.NamedTemporaryFile(dir=path, prefix=".probe-", suffix=written.DRAFT):
                    pass
            except OSError as fault:
                raise InputError(
                    f"results cannot be written there ({fault.strerror})", place=path, remedy=_REMEDY
                ) from None
        return Results(path)

    def claim(self) -> None:
        """Record the study as the owner of the folder, where it is known; InputError when it cannot be written."""
        if self.of is not None and _recorded(self.of[0]) is None:
            home, own = self.of[0].resolve(), self.of[1].resolve()
            leading = Path(os.path.relpath(own, home)).as_posix() if own.drive == home.drive else ""
            Results(self.of[0]).write_json("owner", {"study": own.as_posix(), "from_here": leading})

    def check_owner(self, study_file: Path) -> None:
        """InputError when the folder, or one that holds it, belongs to another study."""
        if owner(self.path.resolve().parent):
            raise InputError("it lies within the results of a study", place=self.path, remedy=_MOVE)
        self._refuse_old_names()
        if not self.belongs_to(study_file):
            raise InputError(
                f"these are results of another study, {owner(self.path)[0]}",
                place=self.path,
                remedy=f"choose another place with --results DIR; if that study has moved, write its path into {OWNER}",
            )

    def _refuse_old_names(self) -> None:
        """InputError for tables and keys of the record under a former name."""
        record = self.path / "record.json"
        try:
            keys = json.loads(record.read_text(encoding="utf-8")) if record.is_file() else {}
        except (OSError, ValueError, RecursionError):
            keys = {}
        for names, there, place in (
            (RECORD, keys if isinstance(keys, dict) else {}, record),
            (TABLES, {name for name in TABLES if self.has(name)}, self.path),
        ):
            for old in sorted(set(names) & set(there)):
                raise InputError(
                    f"{old!r} is called {names[old]!r} now: an older version of calib wrote them", place=place,
                    remedy="move the folder away and run the study again",
                )  # fmt: skip

    def belongs_to(self, study_file: Path) -> bool:
        """Whether the folder belongs to that study; a folder without an owner belongs to any.

        A study written among the results of another keeps its identity in whichever of their subfolders it lies.
        """
        known = owner(self.path)
        return not known or _one_place(study_file.resolve()) in map(_one_place, known)

    def write_table(self, name: str, table: pd.DataFrame, index: bool = False) -> Path:
        """Write ``name.csv`` for `read_table`; floats keep ten digits. InputError when it cannot be."""
        from calib.results.cell import guarded_table  # late: the command needs the constants of this module only

        return self._write(f"{name}.csv", guarded_table(table).to_csv(index=index, float_format=NUMBER))

    def write_json(self, name: str, content: Mapping[str, Any]) -> Path:
        """Write ``name.json``; numbers that are not finite become null. InputError when it cannot be written."""
        return self._write(f"{name}.json", json.dumps(json_value(content), indent=2, allow_nan=False) + "\n")

    def has(self, name: str) -> bool:
        """Whether a file of that name (with suffix) exists."""
        return (self.path / name).exists()

    def remove(self, *names: str) -> None:
        """Delete outdated results; InputError when one cannot be deleted."""
        for name in names:
            try:
                written.remove(self.path / name)
            except OSError as fault:
                raise InputError(
                    f"it is outdated and cannot be deleted ({fault.strerror})",
                    place=self.path / name,
                    remedy=_REMEDY,
                ) from None

    def _write(self, name: str, text: str) -> Path:
        target = self.path / name
        self.claim()
        try:
            with written.replacing(target) as draft:
                draft.write_text(text, encoding="utf-8")
        except OSError as fault:
            raise InputError(f"it cannot be written ({fault.strerror})", place=target, remedy=_REMEDY) from None
        return target


def owner(folder: Path) -> tuple[Path, ...]:
    """Study files that a folder of results may belong to: at the recorded path, and at the recorded relative path.

    The second finds a study that was moved together with its results. Empty where the folder has no owner.
    """
    if (recorded := _recorded(folder)) is None:
        return ()
    study, leading = recorded
    return (Path(study), *([(folder.resolve() / leading).resolve()] if leading else []))


def _recorded(folder: Path) -> tuple[str, str] | None:
    """The two paths of a study that `OWNER` holds; None without that file."""
    try:
        stored = json.loads((folder / OWNER).read_text("utf-8"))
        return str(stored["study"]), str(stored["from_here"])
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            "it does not name the study of these results", place=folder / OWNER, remedy="move the folder away"
        ) from None


def _one_place(study_file: Path) -> Path:
    """Canonical path of a study that was written into a subfolder of another's results, such as ``quick/``."""
    folder = study_file.parent
    part, home = folder.parent, folder.parent.parent
    # Unlike `Path.is_file`, this does not raise where a folder may not be read: that is then another study.
    if not os.path.isfile(part / OWNER) and os.path.isfile(home / OWNER):
        return home / folder.name / study_file.name
    return study_file


def _refuse_foreign(folder: Path) -> None:
    """InputError for a folder whose files calib did not write."""
    if (folder / "study.toml").exists():
        raise InputError("results would be written over the files of a study", place=folder, remedy=_MOVE)
    try:
        there = [p.name for p in sorted(folder.iterdir()) if not p.name.startswith(".") and not p.is_dir()]
    except OSError:  # no such folder, or no permission to read it
        return
    if there and written.LOG not in there:
        raise InputError(
            f"it holds files ({', '.join(there[:3])}{', ...' * (len(there) > 3)}) and no {written.LOG}, "
            "the list of what calib has written",
            place=folder,
            remedy=_MOVE,
        )


def _clear_drafts(folder: Path) -> None:
    """Delete drafts that killed processes left behind; a running process needs none for that long."""
    for draft in filter(lambda path: _DRAFTS.match(path.name), folder.glob(f".*{written.DRAFT}")):
        with contextlib.suppress(OSError):
            if time.time() - draft.stat().st_mtime > _ABANDONED:
                shutil.rmtree(draft) if draft.is_dir() else draft.unlink()


def as_stored(values: Mapping[str, float]) -> dict[str, float]:
    """Values as they come back from a table: to ten digits."""
    return {name: float(NUMBER % value) for name, value in values.items()}


def json_value(value: Any) -> Any:
    """Values as plain Python types, with None for numbers that are not finite: JSON has none."""
    if isinstance(value, Mapping):
        return {str(key): json_value(own) for key, own in value.items()}
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [json_value(own) for own in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
