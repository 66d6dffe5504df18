"""The SQLite file of a ledger: opening it, transactions, and its faults in one sentence."""

from __future__ import annotations

import os
import shutil
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from calib.errors.errors import InputError

_COMPANIONS = 2**17
"""Bytes below which a disk counts as full."""
_AT_ONCE = 500
"""Values per query; SQLite limits the number of variables in a statement."""
_SHARE_FREE, _LEAST_FREE = 0.5, 256
"""Share and number of unused pages above which a file is made smaller."""

T = TypeVar("T")


class Database(sqlite3.Connection):
    """One SQLite file; made with `connected`.

    Attributes
    ----------
    path : Path
    rollbacks : int
        Number of transactions rolled back: what was read in one may never have been stored.
    """

    path: Path
    rollbacks: int = 0

    @contextmanager
    def explaining(self) -> Iterator[None]:
        """Turn a fault of the file into an InputError."""
        try:
            yield
        except sqlite3.Error as fault:
            raise _explained(fault, self.path) from None
        except UnicodeDecodeError:  # a text in it, or in SQLite's complaint about it, is no text any more
            raise _explained(sqlite3.DatabaseError("malformed text"), self.path) from None

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """All or nothing, whatever happens inside."""
        with self.explaining():
            self.execute("BEGIN IMMEDIATE")
            try:
                yield
                self.execute("COMMIT")
            except BaseException:
                self.rollbacks += 1
                if self.in_transaction:  # SQLite may have rolled back by itself, on a full disk for one
                    self.execute("ROLLBACK")
                raise

    def among(self, query: str, values: Iterable[T], *more: object) -> Iterator[Any]:
        """Rows of a query at given values, in parts that SQLite takes.

        Parameters
        ----------
        query : str
            With ``{}`` where the marks of the values stand, which must be its first variables.
        values : iterable
        *more : object
            Its further variables.
        """
        wanted = list(dict.fromkeys(values))
        for start in range(0, len(wanted), _AT_ONCE):
            part = wanted[start : start + _AT_ONCE]
            yield from self.execute(query.format(marks(part)), (*part, *more))

    def use_write_ahead_log(self, busy_seconds: float) -> None:
        """Let readers and one writer work at once; InputError where that cannot be set."""
        until = time.monotonic() + busy_seconds
        with self.explaining():
            while True:  # SQLite does not wait for another process that sets the same mode
                try:
                    self.execute("PRAGMA journal_mode = WAL")
                    break
                except sqlite3.OperationalError as fault:
                    if "locked" not in str(fault) or time.monotonic() > until:
                        raise
                    time.sleep(0.02)
            # A killed process loses nothing by this, a power cut at most the last transactions, and never the order.
            self.execute("PRAGMA synchronous = NORMAL")
            # Some builds of SQLite overwrite what is deleted with zeros.
            self.execute("PRAGMA secure_delete = OFF")

    def shrink(self) -> None:
        """Return unused pages to the disk, where they are most of the file."""
        with self.explaining():
            (pages,), (free,) = (self.execute(f"PRAGMA {n}").fetchone() for n in ("page_count", "freelist_count"))
        if free > max(_LEAST_FREE, _SHARE_FREE * pages):
            with suppress(sqlite3.Error):  # the file is whole without it, and the next command tries again
                self.execute("VACUUM")


def connected(path: Path, busy_seconds: float) -> Database:
    """The file, opened for writing and made if necessary; InputError where it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise InputError(
            f"the folder cannot be made ({fault.strerror})", place=path.parent, remedy="choose another --results"
        ) from None
    # SQLite would leave companion files behind that cannot be written either, even once the ledger can.
    if path.is_file() and not os.access(path, os.W_OK):
        raise _explained(sqlite3.OperationalError("readonly"), path)
    try:
        database = sqlite3.connect(path, timeout=busy_seconds, isolation_level=None, factory=Database)
    except sqlite3.Error as fault:
        raise _explained(fault, path) from None
    database.path = path
    # A damaged text is read like any other: the checksum of its row tells.
    database.text_factory = lambda text: text.decode("utf-8", "surrogateescape")
    return database


def marks(values: Sequence[object]) -> str:
    """As many variables of a statement."""
    return ", ".join("?" * len(values))


_REMEDIES = (
    ("locked", "another process is writing to it", "wait until that one has ended, or give this one its own --results"),
    ("full", "the disk is full", "free some space and start again; nothing recorded is lost"),
    ("readonly", "it cannot be written", "make file and folder writable, or choose another --results"),
    ("unable to open", "it cannot be opened or made", "make its folder writable, or choose another --results"),
    ("not a database", "it is not a ledger", "move it away; a new one is made"),
    ("malformed", "it is damaged", "move it away; a new one is made"),
    ("disk i/o", "the disk reports an error", "check disk and connection, or choose another --results"),
)


def _explained(fault: sqlite3.Error, path: Path) -> InputError:
    """A fault of SQLite as a sentence with a remedy."""
    text = str(fault)
    with suppress(OSError):
        # Without room for its companion files SQLite reports an error of the disk.
        if "disk i/o" in text.lower() and shutil.disk_usage(path.parent).free < _COMPANIONS:
            text = "full"
    for sign, problem, remedy in _REMEDIES:
        if sign in text.lower():
            return InputError(problem, place=path, remedy=remedy)
    return InputError(f"the ledger cannot be used ({text})", place=path, remedy="move it away; a new one is made")
