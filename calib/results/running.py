"""How far a running command is, told in a file beside its results, for whoever looks on from another process."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from calib.errors.errors import InputError
from calib.results.results import Results

if sys.platform != "win32":  # there, an open file cannot be deleted: that is the lock
    import fcntl

_NAME = ".running-{}.json"
_LENGTH = 4096
"""Bytes of a note."""
_KINDS = {"pid": int, "verb": str, "began": float, "told": float}
"""What every note has."""


class RunningNote:
    """The note of one command, from its first stage to its end.

    It is written where the folder of results exists already and belongs to no other study; what cannot be written is
    left out without a word. It vanishes with the command; one that was killed leaves it until the next command begins.

    Parameters
    ----------
    home : Path
        Folder of the study's results.
    verb : str
        The subcommand.
    options : mapping from str to value
        Its options as they were typed.
    study_file : Path, optional
        File of the study.
    """

    def __init__(self, home: Path, verb: str, options: Mapping[str, Any], study_file: Path | None = None):
        self._home, self._study = home, study_file
        self._file: IO[bytes] | None = None
        self._content: dict[str, Any] = {
            "pid": os.getpid(), "verb": verb, "options": dict(options), "began": time.time(), "stage": "", "words": "",
            "done": 0.0, "total": 0.0, "best": None, "left": "",
        }  # fmt: skip

    def __enter__(self) -> RunningNote:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
                (self._home / _NAME.format(os.getpid())).unlink()

    def tell(self, words: str, stage: str, done: float, total: float, best: float, left: str) -> None:
        """Write the present stage.

        Parameters
        ----------
        words, stage, left : str
            All in words, the stage alone, and the time left.
        done, total, best : float
            As `calib.execution.stage.Progress` tells them.
        """
        with contextlib.suppress(OSError):
            if self._file is None:
                self._open()
            known = best if math.isfinite(best) else None
            self._write(words=words, stage=stage, done=done, total=total, best=known, left=left)

    def _open(self) -> None:
        if not self._home.is_dir() or not self._is_own():
            raise FileNotFoundError(self._home)
        for note in notes_in(self._home):
            if not note["running"]:
                note["path"].unlink(missing_ok=True)
        self._file = (self._home / _NAME.format(os.getpid())).open("w+b")
        if sys.platform != "win32":
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _is_own(self) -> bool:
        try:
            return self._study is None or Results(self._home).belongs_to(self._study)
        except InputError:  # nobody knows whose it is
            return False

    def _write(self, **changed: Any) -> None:
        assert self._file is not None
        self._content |= {**changed, "told": time.time()}
        self._file.seek(0)
        # Of one length, so that whoever reads meanwhile finds no rest of an older one.
        self._file.write(json.dumps(self._content).encode().ljust(_LENGTH))
        self._file.flush()


def notes_in(home: Path) -> list[dict[str, Any]]:
    """The notes in a folder of results, the earliest command first.

    Each is what `RunningNote` wrote (``began`` and ``told``, the time of the last stage, in seconds since 1970), its
    ``path``, and ``running``: whether its process still lives. One that is being written at this moment is left out.
    """
    found = []
    for path in home.glob(_NAME.format("*")):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            content = json.loads(path.read_bytes())
            if all(isinstance(content.get(name), kind) for name, kind in _KINDS.items()):
                found.append({**content, "path": path, "running": _is_held(path)})
    return sorted(found, key=lambda note: float(note["began"]))


def _is_held(path: Path) -> bool:
    """Whether a living process keeps a note open."""
    if sys.platform == "win32":
        try:
            path.rename(path)
        except PermissionError:
            return True
        return False
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False
