"""The studies of a live page: those below a folder, their versions among the results, and their stored results."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import Any

from calib.analyses.provenance.places import LEDGER, root_for
from calib.api.figures import shown
from calib.errors.errors import InputError
from calib.report.html.study_results import REPORT, StudyResults
from calib.report.tables import CurrentFolder
from calib.results.results import OWNER, Results
from calib.results.written import LOG
from calib.study.study_file import StudyFile, study_file
from calib.study.study_text import base_of

_FILE = "study.toml"
_DEEPEST = 4
"""Folders below which no study is looked for."""
_MOST = 400
"""Studies that are listed."""
_STAMPED = (LOG, OWNER, "record.json")
"""Files of a folder of results, of which one changes whenever others are written."""
_KEPT = 24
"""Results that are kept in memory until they change."""


@dataclass(frozen=True)
class KnownStudy:
    """A study that the page may open.

    Attributes
    ----------
    key : str
        By which the page names it; no path ever comes from a page.
    file : Path
        Its ``study.toml``.
    root : Path
        Parent of the folder of its results.
    """

    key: str
    file: Path
    root: Path

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.file.resolve().parent.name

    @property
    def home(self) -> Path:
        """Folder of its results."""
        return self.root / self.name

    @property
    def ledger(self) -> Path:
        """File of its evaluations."""
        return self.home / LEDGER

    @property
    def parts(self) -> tuple[str, ...]:
        """Folders with results: empty for a full run, or the name of that of a quick run, a case or a method."""
        inside = sorted(log.parent for log in self.home.glob(f"*/{LOG}"))
        return tuple(
            "" if path == self.home else path.name
            for path in (self.home, *inside)
            if not path.is_symlink() and any(path.glob("*.csv"))
        )

    def stamp(self) -> tuple[Any, ...]:
        """What changes when its file or its results do."""
        of_tests = [log.parent for log in self.root.glob(f"{escape(self.name)}.*/{LOG}")]
        homes = [home / part for home in (self.home, *of_tests) for part in ("", *self.parts)]
        return tuple(map(_stamp, (self.file, *(home / name for home in homes for name in _STAMPED))))

    @property
    def written(self) -> float:
        """When its results were last written, in seconds since 1970; 0 without any."""
        _, *of_results = self.stamp()
        return max(changed for changed, _ in of_results) / 1e9


def stamp_of(study: KnownStudy, own: StudyFile) -> tuple[Any, ...]:
    """What changes when a study, its results, or a file that it names does."""
    return (study.stamp(), *map(_stamp, own.inputs), *map(_stamp, own.code_files))


def _stamp(path: Path) -> tuple[int, int]:
    try:
        known = path.stat()
    except OSError:
        return 0, 0
    return known.st_mtime_ns, known.st_size


class Studies:
    """The studies of a page.

    Parameters
    ----------
    path : Path
        A study, or a folder with studies below it.
    root : Path
        Parent of the folders of their results.
    """

    def __init__(self, path: Path, root: Path):
        self.path, self.root = path, root
        self._read: dict[tuple[str, str, str], tuple[Any, StudyResults]] = {}
        self._lock = threading.Lock()

    @property
    def is_study(self) -> bool:
        """Whether a single study was named."""
        return study_file(self.path).is_file()

    def all(self) -> dict[str, KnownStudy]:
        """The studies by key, each followed by its versions among the results."""
        files = [study_file(self.path)] if self.is_study else list(_below(self.path, self.root))
        found: dict[str, KnownStudy] = {}
        for file in files[:_MOST]:
            self._add(found, file, root_for(file, self.root))
        return found

    def _add(self, found: dict[str, KnownStudy], file: Path, root: Path) -> None:
        key = hashlib.sha256(str(file.resolve()).encode("utf-8", "surrogatepass")).hexdigest()[:12]
        if key in found:
            return
        found[key] = one = KnownStudy(key, file, root)
        inside = sorted({*one.home.glob(f"*/{_FILE}"), *one.home.glob(f"*/*/{_FILE}")})
        for version in inside:
            if is_within(version, one.home):
                self._add(found, version, root_for(version, self.root))

    def one(self, key: str) -> KnownStudy | None:
        """The study of that key."""
        return self.all().get(key)

    def parent(self, study: KnownStudy, known: dict[str, KnownStudy]) -> str:
        """Key of the study that it was extended from, among the known ones; empty without."""
        try:
            base = StudyFile.read(study.file).settings.base
        except InputError:
            return ""
        file = None if base is None else base_of(study.file, base)
        return next((key for key, one in known.items() if file and one.file.resolve() == file.resolve()), "")

    def results(self, study: KnownStudy, part: str = "", test: str = "") -> StudyResults:
        """Stored results of a study, or of one of its tests, as it is now; InputError where its file is wrong.

        A part that it does not have has no results. Links that lead out of the folder count as missing.
        """
        with self._lock:
            own = StudyFile.read(study.file, test)
            chosen = part if part in study.parts else ""
            stamp = stamp_of(study, own)
            known = self._read.get((study.key, part, test))
            if known is not None and known[0] == stamp:
                return known[1]
            several = own.settings.several and not own.test
            tests = tuple(_stored(study, one, chosen) for one in own.parts) if several else ()
            found = _stored(study, own, chosen, tests)
            while len(self._read) >= _KEPT:
                del self._read[next(iter(self._read))]
            self._read[study.key, part, test] = stamp, found
            return found

    def report(self, study: KnownStudy, part: str = "") -> Path | None:
        """The report of a study, of several tests together; None without one, or where it leads out of the folder."""
        path = self.results(study, part).folder / REPORT
        return path if path.is_file() and not path.is_symlink() else None


def _stored(study: KnownStudy, own: StudyFile, part: str, tests: tuple[StudyResults, ...] = ()) -> StudyResults:
    """One folder of results; an empty one where it belongs to another study."""
    folder = Results(study.root / own.name / part)
    if not folder.belongs_to(study.file):
        folder = Results(folder.path / "of another study")
    found = shown(own, folder, study.root, tests=tests).results
    hidden = found.folder.hidden if isinstance(found.folder, CurrentFolder) else frozenset()
    return replace(found, folder=CurrentFolder(folder.path, hidden | _leading_out(folder.path)))


def _below(folder: Path, root: Path) -> Iterator[Path]:
    """Studies below a folder, without those among results."""
    start = folder.resolve()
    for place, folders, files in os.walk(start):
        own = Path(place)
        depth = len(own.relative_to(start).parts)
        results = own == root.resolve() or LOG in files
        folders[:] = sorted(f for f in folders if not f.startswith((".", "_")) and depth < _DEEPEST and not results)
        if _FILE in files and not results and is_within(own / _FILE, start):
            yield folder / own.relative_to(start) / _FILE


def is_within(path: Path, folder: Path) -> bool:
    """Whether a path, with its links followed, lies in a folder."""
    return path.resolve().is_relative_to(folder.resolve())


def _leading_out(folder: Path) -> frozenset[str]:
    """Names of links in a folder of results that lead out of it."""
    try:
        return frozenset(p.name for p in folder.iterdir() if p.is_symlink() and not is_within(p, folder))
    except OSError:
        return frozenset()
