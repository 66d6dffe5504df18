"""Ctrl-C and its like, handled exactly once, and the end of a process that something keeps from ending.

A second press must not disturb the shutdown that the first one has started. Nor may the first be lost: Python's
KeyboardInterrupt vanishes where compiled code calls a Python function and discards its exception (NumPy does while it
builds an array of strings), and the command would go on.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from multiprocessing.reduction import ForkingPickler
from types import FrameType
from typing import TypeVar

T = TypeVar("T")

CODE = 130
"""Exit code of an interrupted command, as in shells."""
WORDS = "interrupted; the same command again completes it"
PATIENCE = 5.0
"""Seconds a command has to shut down; an interrupt after them ends the process at once."""
END_REQUESTS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))
"""Signals by which a batch system, a shutdown or a closed terminal ends a command: handled as Ctrl-C."""
LEFT_RUNNING = "the model has left running what does not end by itself; it was ended"
TURN = 0.05
"""Seconds of one turn of a wait; see `_sleep`."""
SLOW = 12
"""Times as long as `PATIENCE` that a process may take to end of which nothing is left running."""
LOOK = 0.1
"""Seconds between two checks of whether the raised interrupt is still being handled."""
SEEN = 1.0
"""Longest wait, in seconds: Python sees an interrupt that comes just before one only at its end."""


class _Press:
    """State of an interrupt, from its arrival to the end of the command."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        self.raised_at: float | None = None
        self.answered = self.watching = self.held = self.waiting = self.end_requested = False
        self.code: int | None = None

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.code is not None:
            os._exit(self.code)
        if self.held:
            self.waiting = True
            return
        since = None if self.raised_at is None else time.monotonic() - self.raised_at
        if not self.answered and (since is None or (since > LOOK and _lost())):
            self.raised_at = time.monotonic()
            self.watch()
            raise KeyboardInterrupt
        if since is not None and since > PATIENCE:
            os.write(2, f"calib: {WORDS}\n".encode())
            os._exit(CODE)

    def watch(self) -> None:
        if not hasattr(signal, "setitimer"):
            return
        if signal.getsignal(signal.SIGALRM) is signal.SIG_DFL:
            signal.signal(signal.SIGALRM, self.look)
        if signal.getsignal(signal.SIGALRM) == self.look:  # not the alarm of a user's model
            self.watching = True
            signal.setitimer(signal.ITIMER_REAL, LOOK, LOOK)

    def look(self, number: int, frame: FrameType | None) -> None:
        if not self.answered and _lost():
            self.interrupt(signal.SIGINT, frame)

    def answer(self) -> None:
        self.answered = True
        if self.watching:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


_press = _Press()


def once() -> None:
    """From here to `command_over` the first interrupt raises KeyboardInterrupt, and later ones are ignored.

    It is raised again where something has swallowed it, that is, where neither it nor an exception raised because of it
    is being handled. If the shutdown takes longer than `PATIENCE`, the next interrupt ends the process; worker
    processes end with it. `END_REQUESTS` count as interrupts. Those that are already handled in another way, or
    ignored, stay so.
    """
    mine = [sign for sign in END_REQUESTS if signal.getsignal(sign) is signal.SIG_DFL]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        mine.append(signal.SIGINT)
    if mine:
        _press.begin()
    for sign in mine:
        signal.signal(sign, _press.interrupt)


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Defer an interrupt to the end of a block that must not be left half done.

    Blocking the signal is not enough, because another thread of the process may receive it.
    """
    _press.held = True
    try:
        yield
    finally:
        _press.held = False
        if _press.waiting:
            _press.waiting = False
            _press.interrupt(signal.SIGINT, None)


def command_over() -> None:
    """The command is over: no interrupt is raised any more while the process ends."""
    _press.answer()


def leave(code: int) -> None:
    """Everything is said and written: the process ends within `PATIENCE`, or at the next interrupt, with that code.

    A thread of the user's model that never ends, or a process that it has started, would keep it for ever.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or none
            stream.flush()
    _press.code = code
    end_within(PATIENCE, code, f"calib: {LEFT_RUNNING}\n")


def end_within(seconds: float, code: int, words: str = "") -> None:
    """End this process with a code unless it has ended by then; ``words`` go to the error stream.

    Words say that something is left running. Where nothing is, the process is only slow, as on a busy machine: it has
    `SLOW` times as long, and ends without them.
    """

    def end() -> None:
        _sleep(seconds)
        left = _left_running()
        if words and not left:
            _sleep(SLOW * seconds)
            left = _left_running()
        if left:
            with contextlib.suppress(OSError):
                os.write(2, words.encode())
        os._exit(code)

    threading.Thread(target=end, daemon=True).start()


def _sleep(seconds: float) -> None:
    """Sleep in short turns, each of which takes longer where the machine is busy, as all that is waited for does."""
    for _ in range(round(seconds / TURN)):
        time.sleep(TURN)


def _left_running() -> bool:
    """Whether a thread or a process is running for which Python waits at its end."""
    threads = (one for one in threading.enumerate() if not one.daemon and one is not threading.main_thread())
    return any(threads) or any(not child.daemon for child in multiprocessing.active_children())


class Following:
    """A call for a new process; what it needs is imported there when `obey_parent` makes it.

    Parameters
    ----------
    *call : object
        A function that is defined in a module, and its arguments.
    content : bytes
        The same as its process receives it.
    """

    def __init__(self, *call: object, content: bytes = b""):
        self._call, self.content = call, content

    def __reduce__(self) -> tuple[partial[Following], tuple[()]]:
        return partial(Following, content=bytes(ForkingPickler.dumps(self._call))), ()


def next_of(ended: queue.SimpleQueue[T]) -> T:
    """The next item of a queue, however long that takes; an interrupt is seen within `SEEN`."""
    while True:
        with contextlib.suppress(queue.Empty):
            return ended.get(timeout=SEEN)


def obey_parent(task: Following) -> None:
    """Begin a new process: from now on, its parent alone decides when to stop, and it ends when the parent is gone.

    Otherwise it would wait for tasks for ever. Imports come later: on a busy machine they take long.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for sign in END_REQUESTS:
        if signal.getsignal(sign) is signal.SIG_DFL:
            # Unlike an ignored signal, this is not inherited by programs that a model starts, and may have to end.
            signal.signal(sign, _note_end_request)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, END_REQUESTS)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    function, *arguments = pickle.loads(task.content)
    function(*arguments)


def _note_end_request(number: int, frame: FrameType | None) -> None:
    _press.end_requested = True


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def end_requested() -> bool:
    """Whether somebody asked this process, which follows its parent, to end."""
    return _press.end_requested


def pressed() -> bool:
    """Whether an interrupt was raised: compiled code may turn it into another exception."""
    return _press.raised_at is not None


def _lost() -> bool:
    """Whether no exception being handled at this moment comes from an interrupt."""
    error, seen = sys.exc_info()[1], set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return False
        seen.add(id(error))
        error = error.__context__
    return True
