"""Log of the files that calib has written, by content hash: no other file is ever replaced or deleted.

A folder that calib writes to holds `LOG`, with one line per file written, in the format of ``sha256sum``. A file whose
content is not logged was made or changed by someone else: it is kept under another name.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from itertools import count
from pathlib import Path

from calib.errors.errors import InputError

LOG = "written.sha256"
DRAFT = ".part"
"""Suffix of every file or folder that is being written."""
CHANGED = "it was changed after calib wrote it"
KEPT = "_kept"
"""Added to the stem of a file that was in the way and that calib did not write."""

FLAGS: Mapping[str, bool] = {
    **dict.fromkeys(("true", "1", "wahr", "vrai", "vero", "verdadero", "verdadeiro", "waar", "sant", "sand"), True),
    **dict.fromkeys(("false", "0", "falsch", "faux", "falso", "onwaar", "falskt", "falsk"), False),
}
"""Spellings of true and false, in lower case; spreadsheets translate them."""
_FLAG, _FLAG_OR_NUMBER = (
    re.compile(rb"(?<![^,\n])(?:%s)(?![^,\n])" % "|".join(names).encode(), re.IGNORECASE)
    for names in ([name for name in FLAGS if name.isalpha()], list(FLAGS))
)
"""An entry of a table that is one of these words, and one that is also 0 or 1."""

_noting: ContextVar[list[Path] | None] = ContextVar("noting", default=None)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path, which replaces ``path`` once it is written.

    A stop in between leaves the old file or none. A file at ``path`` that calib did not write, or that was changed
    since, is kept under a name that ends in `KEPT`. OSError when it cannot be written.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}{DRAFT}")
    try:
        yield draft
        _add(path.parent, _digest(draft), path.name)  # first: a stop here leaves a line too many, never one too few
        _keep(path)
        os.replace(draft, path)
    finally:  # also when interrupted
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """As `replacing`, for a file that the user has named: nothing is kept or logged."""
    draft = path.with_name(f".{path.name}.{os.getpid()}{DRAFT}")
    try:
        yield draft
        os.replace(draft, path)
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)


def remove(path: Path) -> None:
    """Delete a file that calib has written; any other is kept under another name. OSError when impossible."""
    _keep(path)
    path.unlink(missing_ok=True)


def is_own(path: Path) -> bool:
    """Whether calib has written that file as it is now."""
    return path.is_file() and not path.is_symlink() and _line(_digest(path), path.name) in _logged(path.parent)


def is_changed(path: Path) -> bool:
    """Whether there is a file that somebody else has written or changed since; False in a folder without a log.

    A table counts as unchanged where a spreadsheet has saved it with the same entries.
    """
    if not path.is_file() or not (path.parent / LOG).is_file() or is_own(path):
        return False
    known = _logged(path.parent)
    return not any(_line(hashlib.sha256(text).hexdigest(), path.name) in known for text in _before_a_spreadsheet(path))


def _before_a_spreadsheet(path: Path) -> Iterator[bytes]:
    """What a table may have been before a spreadsheet saved it.

    With other line ends, separators and decimal commas, and with true and false in another language.
    """
    text = path.read_bytes().removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n")
    for separated in (text, *(text.replace(b",", b".").replace(mark, b",") for mark in (b";", b"\t"))):
        yield separated
        for flag in (_FLAG, _FLAG_OR_NUMBER):
            yield flag.sub(lambda entry: str(FLAGS[entry[0].decode().lower()]).encode(), separated)


def require_unchanged(path: Path, remedy: str) -> None:
    """InputError for a file that `is_changed`."""
    if is_changed(path):
        raise InputError(CHANGED, place=path, remedy=remedy)


@contextlib.contextmanager
def noting_kept() -> Iterator[list[Path]]:
    """Yield a list that collects the new names of files that were in the way."""
    noted: list[Path] = []
    before = _noting.set(noted)
    try:
        yield noted
    finally:
        _noting.reset(before)


def note_folder(path: Path, name: str) -> None:
    """Log a folder with its present content as written by calib, under the given name in the folder above."""
    _add(path.parent, _digest_of_folder(path), f"{name}/")


def is_own_folder(path: Path) -> bool:
    """Whether calib has written that folder with its present content, and logged it under its name."""
    return not path.is_symlink() and _line(_digest_of_folder(path), f"{path.name}/") in _logged(path.parent)


def free_name(path: Path, end: str) -> Path:
    """An unused path beside ``path``: its name with ``end`` appended, and a number where that is taken."""
    stem, suffix = (path.name, "") if path.is_dir() else (path.stem, path.suffix)
    names = (path.with_name(f"{stem}{end}{number if number > 1 else ''}{suffix}") for number in count(1))
    return next(name for name in names if not os.path.lexists(name))


def _keep(path: Path) -> None:
    if os.path.lexists(path) and not path.is_dir() and not is_own(path):
        kept = path.rename(free_name(path, KEPT))
        if (noted := _noting.get()) is not None:
            noted.append(kept)


def _add(folder: Path, digest: str, name: str) -> None:
    """Add a line to the log, after completing one that an earlier stop left unfinished."""
    so_far, line = _log(folder), _line(digest, name)
    if line in so_far.splitlines():
        return
    torn = so_far and not so_far.endswith(b"\n")
    with (folder / LOG).open("ab") as stream:
        stream.write(b"\n" * bool(torn) + line + b"\n")


def _line(digest: str, name: str) -> bytes:
    """The line of the log about a file or folder."""
    return f"{digest}  {name}".encode(errors="surrogateescape")


def _logged(folder: Path) -> list[bytes]:
    """The lines of the log; none without it."""
    return _log(folder).splitlines()


def _log(folder: Path) -> bytes:
    try:
        return (folder / LOG).read_bytes()
    except FileNotFoundError:
        return b""


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _digest_of_folder(folder: Path) -> str:
    """Hash over the names and contents of all files below, without Python's caches."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and "__pycache__" not in p.relative_to(folder).parts)
    lines = "".join(f"{_digest(p)}  {p.relative_to(folder).as_posix()}\n" for p in files)
    return hashlib.sha256(lines.encode("utf-8", errors="surrogateescape")).hexdigest()


def write_new_folder(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    """Write files into a new or empty folder, all of them or none; returns them.

    Raises
    ------
    InputError
        Where the folder is not empty, or cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("it is not an empty folder", place=folder, remedy="name a new one")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=".calib-new-", dir=folder.parent))
    except OSError as fault:
        raise InputError(f"it cannot be made ({fault.strerror})", place=folder, remedy="name another place") from None
    try:
        for name, content in contents.items():
            (draft / name).write_bytes(content)
        draft.chmod(0o755)
        if folder.exists():
            folder.rmdir()
        draft.rename(folder)
    except OSError as fault:
        shutil.rmtree(draft, ignore_errors=True)
        raise InputError(
            f"it cannot be written ({fault.strerror})", place=folder, remedy="name another place"
        ) from None
    return [folder / name for name in contents]
