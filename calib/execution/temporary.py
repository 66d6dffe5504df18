"""Temporary folders that bear calib's mark; those that a killed process has left behind are deleted."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import IO

if sys.platform != "win32":  # there, an open file cannot be deleted: that is the lock
    import fcntl

LOCK = "in_use.lock"
"""File in a temporary folder that its process keeps locked: the lock ends with the process, however that ends."""
_MARK = f"calib_{re.sub(r'[^A-Za-z0-9-]', '-', platform.node())}_"
_WITHOUT_LOCK = 3600.0
"""Seconds after which a folder counts as left behind that has no lock: one that is being made has none yet."""


class TemporaryFolder:
    """A new folder in the system's place for temporary files, deleted with all its content by `close`.

    Where the process is killed before, `clear_abandoned` deletes it.

    Attributes
    ----------
    path : Path
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix=_MARK, ignore_cleanup_errors=True)
        self.path = Path(self._folder.name)
        self._lock = _locked(self.path)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *fault: object) -> None:
        self.close()

    def close(self) -> None:
        """Delete the folder."""
        if self._lock is not None:
            self._lock.close()
        self._folder.cleanup()


def clear_abandoned() -> None:
    """Delete temporary folders of this user and host whose process has ended without deleting them.

    They are known by name, owner and lock. What cannot be deleted stays, without a word: another process may be
    deleting it.
    """
    for folder in Path(tempfile.gettempdir()).glob(f"{_MARK}*"):
        with contextlib.suppress(OSError):
            if not folder.is_symlink() and _is_own(folder) and _is_abandoned(folder):
                shutil.rmtree(folder, ignore_errors=True)


def _is_own(folder: Path) -> bool:
    return not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()


def _is_abandoned(folder: Path) -> bool:
    """Whether no process keeps the folder; OSError where one does."""
    lock = folder / LOCK
    if not lock.is_file():
        return time.time() - folder.stat().st_mtime > _WITHOUT_LOCK
    if sys.platform == "win32":
        lock.unlink()
        return True
    with lock.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return True


def _locked(folder: Path) -> IO[bytes] | None:
    """The open lock of a folder; None where the file system has no locks, and the folder counts as one without."""
    if sys.platform == "win32":
        return (folder / LOCK).open("wb")
    draft = folder / f"{LOCK}.part"
    file = draft.open("wb")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    draft.rename(folder / LOCK)  # locked before anybody can see it
    return file
