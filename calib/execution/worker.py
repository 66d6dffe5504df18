"""Tasks of worker processes: of calib's own pool, with the board that its parent watches, of an executor, and apart."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import multiprocessing.util
import os
import platform
import signal
import sys
import threading
import time
import traceback
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController, threadpool_limits

from calib.errors.errors import InputError
from calib.execution import interrupt
from calib.execution.interrupt import end_within
from calib.execution.outcome import WORKER_DIED, Function, Outcome, attempt, words_of

Source = Callable[[], Function]
T = TypeVar("T")

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


@contextlib.contextmanager
def environment(script: bool = True) -> Iterator[None]:
    """Environment that new processes inherit: one thread for numerical libraries, and Ctrl-C and its like blocked.

    ``script`` tells whether they need definitions of the running script. If not, they do not import it: without a
    guarded main part it would run again in every process.
    """
    with _starting, contextlib.nullcontext() if script else _without_script():
        yield from _inherited()


_starting = threading.RLock()
"""Threads of one process start others in turn: what these inherit belongs to the whole process."""


def _inherited() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    mask = None
    if hasattr(signal, "pthread_sigmask"):
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *interrupt.END_REQUESTS})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextlib.contextmanager
def _without_script() -> Iterator[None]:
    """Hide the path of the main module, from which `multiprocessing` would run it again."""
    main: dict[str, Any] = vars(sys.modules["__main__"])
    kept = {name: value for name, value in main.items() if name in ("__file__", "__spec__")}
    try:
        main.pop("__file__", None)
        main["__spec__"] = None
        yield
    finally:
        main.update(kept)


def built(source: Source) -> Function:
    """The function of a source; InputError where the set-up is wrong, RuntimeError for every other fault."""
    try:
        return source()
    except InputError:
        raise
    except Exception as fault:
        # A user's set-up may raise anything, and an exception of a class of its own may not survive the way back.
        failure = RuntimeError(f"the model cannot be built in a worker: {words_of(fault)}")
        failure.add_note(traceback.format_exc())
        raise failure from None


_FOR_EVER = 1e9
"""Seconds by which the start of a paused point lies ahead."""


class Board:
    """Shared memory in which every worker process notes its current point and start time."""

    def __init__(self, context: SpawnContext, workers: int):
        self._places = context.Value("i", 0)
        self._notes = context.Array("d", 2 * workers, lock=False)  # pairs of number and start; idle: 0

    def take_place(self) -> int:
        """A place of its own for a worker process."""
        with self._places.get_lock():
            self._places.value += 1
            return self._places.value - 1

    def note(self, place: int, number: int) -> None:
        """Work on the point of that number begins."""
        self._notes[2 * place] = number
        self._notes[2 * place + 1] = time.monotonic()

    def clear(self, place: int) -> None:
        """Work has ended."""
        self._notes[2 * place + 1] = 0.0

    @contextlib.contextmanager
    def paused(self, place: int) -> Iterator[None]:
        """While this lasts, the time of the present point stands still."""
        before, start = time.monotonic(), self._notes[2 * place + 1]
        self._notes[2 * place + 1] = before + _FOR_EVER
        try:
            yield
        finally:
            self._notes[2 * place + 1] = start + time.monotonic() - before

    def late(self, limit: float) -> dict[int, float]:
        """Points in progress for longer than the limit, with their elapsed time in seconds."""
        now = time.monotonic()
        pairs = list(zip(self._notes[::2], self._notes[1::2], strict=True))
        return {int(number): now - start for number, start in pairs if start and now - start > limit}


class _Worker:
    """State of a worker process between tasks."""

    function: Function | None = None
    fault: Exception | None = None
    limits: object = None
    board: Board
    place: int


def start(source: Source, board: Board) -> None:
    """Initialize a worker process; a model that cannot be built is reported by every task."""
    quiet_libraries()
    leave_after_work()
    try:
        _Worker.function = built(source)
    except (InputError, RuntimeError) as fault:
        _Worker.fault = fault
    _Worker.limits = threadpool_limits(1)
    _Worker.board, _Worker.place = board, board.take_place()


LEAVING = 1.0
"""Seconds a worker process has to end after its last task."""


def leave_after_work() -> None:
    """When its work is over, end this process within `LEAVING`: a thread of the model that never ends would keep it."""
    # Called before Python waits for threads and processes that a model has started.
    multiprocessing.util.Finalize(None, end_within, args=(LEAVING, 0), exitpriority=sys.maxsize)


def quiet_libraries() -> None:
    """Warnings of libraries and of a user's model do not reach the terminal, unless ``python -W`` asks for them.

    Nor do log records that nobody handles.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    logging.getLogger().addHandler(logging.NullHandler())


def ready(number: int, values: Mapping[str, float]) -> Outcome:
    """A task without work: it returns when this process has started."""
    return Outcome(dict(values), "ok", {})


def work(number: int, values: Mapping[str, float]) -> Outcome | Exception:
    """The task of one point, noted on the board while it lasts; a wrong set-up is returned, not raised."""
    if _Worker.fault is not None:
        return _Worker.fault
    assert _Worker.function is not None
    _Worker.board.note(_Worker.place, number)
    try:
        outcome = attempt(_Worker.function, values)
    except InputError as fault:
        return fault
    finally:
        _Worker.board.clear(_Worker.place)
    if outcome.status == "failed" and interrupt.end_requested():  # a solver that the same request has ended, say
        return replace(outcome, error=WORKER_DIED, trace="", at=None)
    return outcome


def pause(seconds: float) -> None:
    """Wait within a point; in a worker process that does not count for its time limit."""
    board: Board | None = getattr(_Worker, "board", None)
    if board is None:
        time.sleep(seconds)
        return
    with board.paused(_Worker.place):
        time.sleep(seconds)


def available_cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


# -- tasks of a given executor -----------------------------------------------------------------------------------------


class Sent:
    """A source that is sent with every task of an executor; each process builds its function once."""

    def __init__(self, source: Source):
        self.source = source
        self.name = uuid.uuid4().hex
        self.home = _process()

    def function(self) -> Function:
        """The function of the source, see `built`; in any process but the sender's, libraries then use one thread.

        In the sender's process `calib.execution.executor.ExecutorEvaluator` sets and restores the number of threads: it
        belongs to the process, and concurrent tasks would each restore a different value.
        """
        with _Built.lock:
            if self.name not in _Built.functions:
                function = built(self.source)
                if _process() != self.home:
                    _Built.limits = threadpool_limits(1)
                # OpenMP has a separate limit in every thread.
                _Built.openmp = ThreadpoolController().select(user_api="openmp")
                while len(_Built.functions) >= _KEPT:
                    del _Built.functions[next(iter(_Built.functions))]
                _Built.functions[self.name] = function
            return _Built.functions[self.name]

    def forget(self) -> None:
        """Release the function in this process."""
        with _Built.lock:
            _Built.functions.pop(self.name, None)


_KEPT = 4
"""Functions that a process keeps; several evaluators may share an executor."""


class _Built:
    """Functions that this process has built from sent sources."""

    lock = threading.Lock()
    functions: dict[str, Function] = {}  # noqa: RUF012
    limits: object = None
    openmp: ThreadpoolController


def _process() -> tuple[str, int]:
    return platform.node(), os.getpid()


def work_anywhere(sent: Sent, values: Mapping[str, float]) -> Outcome | Exception:
    """The task of one point in whatever process or thread; a wrong set-up is returned, not raised."""
    try:
        function = sent.function()
        with _Built.openmp.limit(limits=1):
            return attempt(function, values)
    except (InputError, RuntimeError) as fault:
        return fault


# -- one task in a process of its own ----------------------------------------------------------------------------------


class EndedError(Exception):
    """The process of a task ended without an answer; its words say how."""


def apart(function: Callable[..., T], *arguments: object) -> T:
    """What a function returns, from a process of its own: native code that ends it does no harm here.

    Parameters
    ----------
    function : callable
        Defined in a module, so that the other process can import it.
    *arguments : object
        What can be sent.

    Raises
    ------
    EndedError
        When that process ends without an answer.
    Exception
        What the function raises.
    """
    if multiprocessing.current_process().daemon:  # it may start none, and whoever started it expects that it may end
        return function(*arguments)
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    task = interrupt.Following(_alone, sending, function, arguments)
    process = context.Process(target=interrupt.obey_parent, args=(task,), daemon=True)
    try:
        with interrupt.held(), environment(script=False):
            process.start()
        sending.close()  # the other process has the only open end: its end is seen
        answer, fault = receiving.recv()
    except (EOFError, OSError):
        process.join()
        code = process.exitcode or 0
        raise EndedError(f"signal {-code}" if code < 0 else f"exit code {code}") from None
    finally:
        if process.pid is not None:
            process.kill()
            process.join()
        sending.close()
        receiving.close()
    if fault is not None:
        raise fault
    found: T = answer
    return found


def _alone(sending: Connection, function: Callable[..., object], arguments: tuple[object, ...]) -> None:
    """Do the task of `apart`; what native code prints reaches no terminal."""
    quiet_libraries()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        answer: tuple[object, Exception | None] = function(*arguments), None
    except Exception as fault:
        answer = None, fault
    sending.send(answer)
