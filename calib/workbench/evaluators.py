"""Processes that evaluate the models of opened studies: no user's code runs in the server, and nothing blocks it."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from queue import Empty, SimpleQueue
from typing import Any

from calib.errors.errors import InputError

_MOST = 4
"""Studies whose models are kept at a time."""
_PATIENCE, _AT_FULL_ORDER = 60.0, 600.0
"""Seconds in which an evaluation must end: at a slider, and where a solution at full order was asked for."""
_PREPARING, _READY = 20.0, 600.0
"""Seconds after which a process that nobody asks ends: while it trains a basis, and when it is ready."""
_LOOKS = 5.0
"""Seconds between two looks for such processes."""


class ReducedEvaluator:
    """A process with the model of one test; see `calib.workbench.what_if`.

    Parameters
    ----------
    arguments : sequence of str
    stamp : object
        What changes when the study does.
    """

    def __init__(self, arguments: tuple[str, ...], stamp: Any):
        self.stamp, self.touched = stamp, time.monotonic()
        self.state: dict[str, Any] = {"stage": "starting", "done": 0, "total": 0}
        self.was_ready = False
        self._answers: SimpleQueue[dict[str, Any]] = SimpleQueue()
        self._lock = threading.Lock()
        self._complaints = tempfile.TemporaryFile()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "calib.workbench.what_if", *arguments], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=self._complaints, start_new_session=sys.platform != "win32",
        )  # fmt: skip
        threading.Thread(target=self._follow, daemon=True).start()

    @property
    def ended(self) -> bool:
        """Whether its process is gone."""
        return self._process.poll() is not None

    @property
    def idle(self) -> bool:
        """Whether nobody has asked it for long."""
        return time.monotonic() - self.touched > (_READY if "ready" in self.state else _PREPARING)

    def ask(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """What the model answers; InputError where it cannot be evaluated there, or not in time."""
        patience = _AT_FULL_ORDER if content.get("full") else _PATIENCE
        line = json.dumps(content, separators=(",", ":")).encode() + b"\n"
        with self._lock:
            self.touched = time.monotonic()
            try:
                assert self._process.stdin is not None
                self._process.stdin.write(line)
                self._process.stdin.flush()
                found = self._answers.get(timeout=patience)
            except OSError:
                raise InputError("the process with the model has ended", place="what if") from None
            except Empty:
                self.end()
                remedy = "compare and calibrate wait for a model as long as it takes; here it is read again"
                raise InputError(
                    f"the model took longer than {patience:.0f} s", place="what if", remedy=remedy
                ) from None
        if "fault" in found:
            raise InputError(str(found["fault"]), place="what if")
        return dict(found["found"])

    def end(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):
            self._process.kill()

    def _follow(self) -> None:
        """Take what it tells, until it ends."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            told = json.loads(line)
            if self.was_ready:
                self._answers.put(told)
            else:
                self.state, self.was_ready = told, "ready" in told
        if "fault" not in self.state:
            self._complaints.seek(0)
            last = self._complaints.read().decode("utf-8", "replace").strip().splitlines()[-1:]
            self.state = {"fault": " ".join(["the process with the model has ended", *last])}
        self._answers.put(self.state)


class Evaluators:
    """The processes of all pages, at most a few; one whose study has changed, or that nobody asks, is ended."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, ...], ReducedEvaluator] = {}
        self._lock = threading.Lock()
        self._watching = False

    def of(self, place: tuple[str, ...], arguments: tuple[str, ...], stamp: Any) -> ReducedEvaluator:
        """The process of a place of the page, started where there is none.

        One that failed before it was ready stays while ``stamp`` does. ``arguments`` are as in
        `calib.workbench.what_if`.
        """
        with self._lock:
            known = self._known.get(place)
            gone = known is not None and known.ended and (known.was_ready or "fault" not in known.state)
            if known is None or known.stamp != stamp or gone:
                self._drop(place)
                while len(self._known) >= _MOST:
                    self._drop(min(self._known, key=lambda key: self._known[key].touched))
                known = self._known[place] = ReducedEvaluator(arguments, stamp)
                if not self._watching:
                    self._watching = True
                    threading.Thread(target=self._watch, daemon=True).start()
            known.touched = time.monotonic()
            return known

    def ready(self, place: tuple[str, ...]) -> ReducedEvaluator:
        """The same as it is, for an answer without delay; InputError where it is not ready."""
        with self._lock:
            known = self._known.get(place)
        if known is None or "ready" not in known.state:
            raise InputError("the model is being read", place="what if", remedy="wait a moment")
        return known

    def _drop(self, place: tuple[str, ...]) -> None:
        known = self._known.pop(place, None)
        if known is not None:
            known.end()

    def _watch(self) -> None:
        while True:
            time.sleep(_LOOKS)
            with self._lock:
                for place in [key for key, one in self._known.items() if one.idle]:
                    self._drop(place)
                if not self._known:
                    self._watching = False
                    return
