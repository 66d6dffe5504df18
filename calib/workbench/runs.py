"""The commands that the page starts, as processes of their own, and those that were started elsewhere."""

from __future__ import annotations

import contextlib
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from calib.errors.errors import InputError
from calib.results.running import notes_in
from calib.workbench.studies import KnownStudy, Studies, is_within

OPTIONS: Mapping[str, tuple[str, ...]] = {
    "compare": ("quick",), "sensitivity": ("quick", "workers", "method"), "explain": ("quick", "workers"),
    "calibrate": ("quick", "workers", "case", "method"), "intervals": ("quick", "workers"),
    "run": ("quick", "workers"), "report": (), "propose": ("quick",), "again": ("workers",),
    "pareto": ("quick", "workers"), "refine": ("quick", "workers"), "robustness": ("quick", "workers"),
}  # fmt: skip
"""Commands that the page may start, with the options that it may give."""
KINDS: Mapping[str, str] = {
    "": "finite elements, assembled by a model in Python", "matrices": "mass and stiffness matrices",
    "modes": "a function or solver that returns modes", "function": "a function that returns numbers",
    "table": "runs that are done, in a table",
}  # fmt: skip
"""Kinds of example that `calib new` writes, by its option, and what their model is."""
_NAME = re.compile(r"[^\W_][\w -]{0,79}")
"""Names of new folders: no part of a path, and no option of a command."""
_WRITTEN = 60.0
"""Seconds in which an example must have been written."""
_CALIB = (sys.executable, "-m", "calib")
if sys.platform == "win32":
    _APART: Mapping[str, Any] = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    _END = signal.CTRL_BREAK_EVENT
else:
    _APART: Mapping[str, Any] = {"start_new_session": True}
    _END = signal.SIGTERM
_TAIL = 6000
"""Bytes of a command's output that are shown."""
_KEPT = 20
"""Commands that have ended and are still told."""


@dataclass
class StartedCommand:
    """A command that the page has started.

    Attributes
    ----------
    study : str
        Key of the study that the page shows it at.
    verb : str
    arguments : tuple of str
        After ``calib``.
    options : dict
    process : Popen
    output : file
        Everything that it prints. It has no name, so that the command goes on when the server is gone.
    began, ended : float
        Seconds since 1970; infinity until it has ended.
    then : list of (verb, arguments)
        Commands that follow when it succeeds.
    stopped : bool
    code : int or None
    """

    study: str
    verb: str
    arguments: tuple[str, ...]
    options: dict[str, Any]
    process: subprocess.Popen[bytes]
    output: IO[bytes]
    began: float
    then: list[tuple[str, tuple[str, ...]]] = field(default_factory=list)
    stopped: bool = False
    code: int | None = None
    ended: float = math.inf

    @property
    def tail(self) -> str:
        """The end of what it has printed."""
        size = os.fstat(self.output.fileno()).st_size
        start = max(0, size - _TAIL)
        if hasattr(os, "pread"):
            return os.pread(self.output.fileno(), _TAIL, start).decode("utf-8", "replace")
        self.output.seek(start)
        return self.output.read(_TAIL).decode("utf-8", "replace")

    @property
    def complaint(self) -> str:
        """The sentence with which it failed; empty without one."""
        return _complaint(self.tail)


class Commands:
    """Starts, stops and lists commands."""

    def __init__(self) -> None:
        self._started: list[StartedCommand] = []
        self._lock = threading.Lock()

    def start(self, study: KnownStudy, verb: str, options: Mapping[str, Any]) -> StartedCommand:
        """Start one command of `OPTIONS`; InputError for any other, and while another one runs."""
        if verb not in OPTIONS or not set(options) <= set(OPTIONS[verb]):
            raise InputError(f"the page does not start {verb!r} with such options", place="run")
        return self.start_all(study, [(verb, _arguments(study, verb, options))], dict(options))

    def start_all(
        self, study: KnownStudy, commands: Sequence[tuple[str, tuple[str, ...]]], options: dict[str, Any]
    ) -> StartedCommand:
        """Start the first of some commands; each further one follows when that before it has succeeded."""
        with self._lock:
            if any(one["state"] == "running" for one in self.listing(study)):
                raise InputError(
                    "a command runs on this study", place=study.name, remedy="stop it, or wait for its end"
                )
            (verb, arguments), *then = commands
            return self._start(study.key, verb, arguments, options, then)

    def _start(
        self, key: str, verb: str, arguments: tuple[str, ...], options: dict[str, Any], then: Sequence[Any]
    ) -> StartedCommand:
        output = tempfile.TemporaryFile()
        process = subprocess.Popen(
            [*_CALIB, *arguments], stdin=subprocess.DEVNULL, stdout=output,
            stderr=subprocess.STDOUT, **_APART,
        )  # fmt: skip
        one = StartedCommand(key, verb, arguments, options, process, output, time.time(), list(then))
        self._started.append(one)
        for old in [s for s in self._started if s.code is not None][:-_KEPT]:
            self._started.remove(old)
            old.output.close()
        threading.Thread(target=self._follow, args=(one,), daemon=True).start()
        return one

    def _follow(self, one: StartedCommand) -> None:
        code = one.process.wait()
        with self._lock:
            one.code, one.ended = code, time.time()
            if code == 0 and one.then and not one.stopped:
                (verb, arguments), *then = one.then
                self._start(one.study, verb, arguments, one.options, then)

    def stop(self, study: KnownStudy, pid: int) -> bool:
        """Interrupt a command on a study, wherever it was started; whether there was one."""
        for one in self.listing(study):
            if one["pid"] == pid and one["state"] == "running":
                for own in self._started:
                    own.stopped = own.stopped or own.process.pid == pid
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, _END)
                return True
        return False

    def listing(self, study: KnownStudy) -> list[dict[str, Any]]:
        """The commands on a study that run or have ended, the latest last; see `_told`.

        One that did not succeed is left out once later results were written, by whichever command.
        """
        written = study.written
        own = [one for one in self._started if one.study == study.key]
        own = [one for one in own if one.code in (None, 0) or one.ended > written]
        # The pid of a command that has ended may be another one's by now.
        notes = {n["pid"]: n for n in notes_in(study.home) if n["running"] or n["told"] > written}
        mine = {one.process.pid for one in own}
        running = {one.process.pid: Path(*one.arguments[1:2]).name for one in own if one.code is None}
        others = [notes_in(study.root / name) for name in set(running.values()) - {study.name}]
        far = {n["pid"]: n for told in others for n in told if n["pid"] in running}  # on an extended study
        found = [_told(one, (notes | far).get(one.process.pid) if one.code is None else None) for one in own]
        found += [_noted(note) for pid, note in notes.items() if pid not in mine]
        return sorted(found, key=lambda one: float(one["began"]))


def new_study(studies: Studies, name: Any, kind: Any) -> KnownStudy:
    """Write an example with `calib new` into a new folder directly below that of the page.

    Parameters
    ----------
    studies : Studies
    name : str
        Of the folder.
    kind : str
        One of `KINDS`.

    Raises
    ------
    InputError
        Where the page shows a single study, for a name with a path in it, and for whatever the command refuses.
    """
    if studies.is_study or not isinstance(kind, str) or kind not in KINDS:
        raise InputError("this page writes no such study", place="calib new")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        remedy = "use letters, digits, spaces, - and _, a letter or digit first"
        raise InputError(f"{name!r:.40} is no name of a folder", place="calib new", remedy=remedy)
    folder = studies.path / name
    if not is_within(folder, studies.path) or folder.resolve() == studies.root.resolve():
        raise InputError(f"{name!r} is not free for a study", place="calib new", remedy="choose another name")
    command = [*_CALIB, "new", str(folder), *([f"--{kind}"] if kind else [])]
    try:
        ended = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            timeout=_WRITTEN, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise InputError(f"it was not written in {_WRITTEN:.0f} s", place="calib new") from None
    found = next((one for one in studies.all().values() if one.file.parent.resolve() == folder.resolve()), None)
    if ended.returncode or found is None:
        raise InputError(_complaint(ended.stdout.decode("utf-8", "replace")) or "it was not written", place="calib new")
    return found


def _complaint(output: str) -> str:
    """The sentence with which a command failed; empty without one."""
    lines = [line for line in output.splitlines() if line.startswith(("Error: ", "calib: "))]
    return lines[-1].partition(": ")[2] if lines else ""


def _told(one: StartedCommand, note: Mapping[str, Any] | None) -> dict[str, Any]:
    """A command of the page."""
    state = "running" if one.code is None else "done" if one.code == 0 else "stopped" if one.stopped else "failed"
    known = note or {}
    return {
        "pid": one.process.pid, "verb": one.verb, "options": one.options, "began": one.began, "state": state,
        "command": f"calib {' '.join(one.arguments)}", "words": known.get("words") or _early(one),
        "stage": known.get("stage", ""), "done": known.get("done", 0), "total": known.get("total", 0),
        "left": known.get("left", ""), "stopping": one.stopped and one.code is None,
        "again": _again(one.verb, one.options),
        "sentence": one.complaint if state == "failed" else "", "tail": one.tail if state == "failed" else "",
    }  # fmt: skip


def _early(one: StartedCommand) -> str:
    return f"{one.verb}: reading the study" if one.code is None else ""


def _noted(note: Mapping[str, Any]) -> dict[str, Any]:
    """A command that was started elsewhere; its note outlives it only where its process was killed."""
    names = ("pid", "verb", "options", "began", "words", "stage", "done", "total", "left")
    state, sentence = ("running", "") if note["running"] else ("failed", "Its process was killed.")
    return {
        **{name: note.get(name) for name in names}, "state": state, "sentence": sentence, "tail": "",
        "command": f"calib {note['verb']}", "stopping": False, "again": _again(note["verb"], note.get("options") or {}),
    }  # fmt: skip


def _again(verb: str, options: Mapping[str, Any]) -> dict[str, Any] | None:
    """The options with which the page may give a command again; None for a command that it does not start so."""
    return dict(options) if set(options) <= set(OPTIONS.get(verb, ())) and verb in OPTIONS else None


def _arguments(study: KnownStudy, verb: str, options: Mapping[str, Any]) -> tuple[str, ...]:
    """Arguments of a command; InputError for an option of another type."""
    found = [verb, str(study.file.parent), "--results", str(study.root)]
    for name, value in options.items():
        if name == "quick" and isinstance(value, bool):
            found += ["--quick"] * value
        elif name == "workers" and isinstance(value, int) and not isinstance(value, bool):
            found += ["--workers", str(value)]
        elif name in ("case", "method") and isinstance(value, str) and not value.startswith("-"):
            found += [f"--{name}", value]
        else:
            raise InputError(f"{value!r:.40} is no value", place=f"--{name}")
    return tuple(found)


def adding(
    study: KnownStudy, effects: Sequence[str], quick: bool, calibrated: bool, written: KnownStudy | None = None
) -> list[tuple[str, tuple[str, ...]]]:
    """The commands that write a study with further effects among the results and calibrate it.

    The study itself is calibrated first where it was not: else nobody sees how far its errors fall.

    Parameters
    ----------
    study : KnownStudy
    effects : sequence of str
    quick : bool
        Whether to calibrate by a quick run.
    calibrated : bool
        Whether the study is.
    written : KnownStudy, optional
        The extended study, where it was written and its calibration stopped: that is resumed.
    """
    results = ("--results", str(study.root))
    before = [] if calibrated else [("calibrate", _arguments(study, "calibrate", {"quick": quick}))]
    if written is not None:
        return [*before, ("calibrate", _arguments(written, "calibrate", {"quick": quick}))]
    new = free_place(study, effects)
    return [
        *before,
        ("extend", ("extend", str(study.file.parent), *effects, "--into", str(new), *results)),
        ("calibrate", ("calibrate", str(new), *results, *(["--quick"] * quick))),
    ]


def free_place(study: KnownStudy, effects: Sequence[str]) -> Any:
    """Folder of the study with these effects, which does not exist yet."""
    plain = "_".join("".join(c if c.isalnum() else "_" for c in name) for name in effects)[:80]
    first = study.home / f"{study.name}_with_{plain}"
    places = (first, *(first.with_name(f"{first.name}_{number}") for number in range(2, 100)))
    return next(place for place in places if not place.exists() and not (study.root / place.name).exists())
