"""What the workers of a cluster do: they evaluate points, each thread in a process of its own that may crash."""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import platform
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from calib.errors.errors import InputError
from calib.execution.evaluate import Evaluator
from calib.execution.outcome import Function, Outcome, words_of
from calib.execution.worker import Sent, Source, work_anywhere

_KEPT = 4
"""Idle processes that a worker keeps for evaluators other than the present one: a model may need much memory."""


C = TypeVar("C")
NO_DAEMON = "DASK_DISTRIBUTED__WORKER__DAEMON=False"
"""Setting of Dask by which workers may start processes."""


def library_versions() -> dict[str, str]:
    """Versions on which results, and whether a model can be sent, depend."""
    import numpy
    import scipy

    import calib

    python = ".".join(platform.python_version_tuple()[:2])
    return {"calib": calib.__version__, "Python": python, "numpy": numpy.__version__, "scipy": scipy.__version__}


@dataclass(frozen=True)
class Packed:
    """A source as it travels: a worker passes it on unread, and only the process that evaluates unpacks it.

    Attributes
    ----------
    content : bytes
        The pickled source, compressed.
    """

    content: bytes

    @staticmethod
    def of(source: Source, dumps: Callable[[Source], bytes]) -> Packed:
        """A source, pickled by ``dumps``."""
        return Packed(zlib.compress(dumps(source), 1))

    def __call__(self) -> Function:
        """The function of the source; InputError, with the name of this machine, where the set-up is wrong."""
        try:
            source: Source = pickle.loads(zlib.decompress(self.content))
            return source()
        except ImportError as fault:
            raise InputError(
                f"{platform.node()} cannot import what the model needs: {words_of(fault)}", place="executor",
                remedy="install it there, or start the workers where Python finds it",
            ) from None  # fmt: skip
        except InputError as fault:
            raise InputError(
                f"{fault.problem} (said by {platform.node()})", place=fault.place,
                remedy=fault.remedy or "workers need the study's folder and its results at the same paths",
            ) from None  # fmt: skip


@dataclass(frozen=True)
class Parcel:
    """What workers need of an evaluator; each of them receives it once.

    Attributes
    ----------
    sent : Sent
        With a `Packed` source.
    versions : mapping from str to str
        Those of the asking process.
    time_limit : float or None
        Seconds after which a point is abandoned.
    required : bool
        Whether a worker that cannot keep this limit is refused.
    """

    sent: Sent
    versions: Mapping[str, str]
    time_limit: float | None
    required: bool


@dataclass(frozen=True)
class ParcelOutcomes:
    """What a worker returns: outcomes of the points in their order, or the fault of a set-up."""

    worker: str
    outcomes: tuple[Outcome, ...]
    fault: Exception | None = None


def passed_on(content: C) -> C:
    """What tasks share itself: as the result of a task, it is made again when the worker that holds it is lost."""
    return content


def evaluate_parcel(parcel: Parcel, points: Sequence[Mapping[str, float]]) -> ParcelOutcomes:
    """Evaluate points, in a process that is kept for the parcel's next ones.

    A worker that is a daemon, as below a nanny by default, may have no process of its own: it evaluates them itself.
    """
    from distributed import get_worker

    name = str(get_worker().address)
    outcomes: list[Outcome] = []
    try:
        require_same(parcel.versions, name)
        if multiprocessing.current_process().daemon:
            outcomes += _in_this_process(parcel, points, name)
        else:
            with _child(parcel) as child:
                outcomes += child.evaluate(points)
    except (InputError, RuntimeError) as fault:
        return ParcelOutcomes(name, (), fault)
    return ParcelOutcomes(name, tuple(outcomes))


def require_same(wanted: Mapping[str, str], name: str) -> None:
    """InputError where this worker has other versions than the asking process."""
    own = library_versions()
    if other := [part for part in wanted if own[part] != wanted[part]]:
        theirs = " and ".join(f"{part} {own[part]}" for part in other)
        ours = " and ".join(f"{part} {wanted[part]}" for part in other)
        raise InputError(
            f"the worker {name} has {theirs}, and this process {ours}", place="executor",
            remedy="start it from the same environment: results could differ",
        )  # fmt: skip


def _in_this_process(parcel: Parcel, points: Sequence[Mapping[str, float]], name: str) -> list[Outcome]:
    if parcel.required:
        raise InputError(
            f"a point is allowed {parcel.time_limit:g} s, and the worker {name} cannot end one: it is a daemon, which "
            "may start no process", place="time limit",
            remedy=f"start workers with {NO_DAEMON}, or without nanny",
        )  # fmt: skip
    found = []
    for values in points:
        outcome = work_anywhere(parcel.sent, values)
        if isinstance(outcome, Exception):
            raise outcome
        found.append(outcome)
    return found


# -- processes of a worker ---------------------------------------------------------------------------------------------


class _Child:
    """A process that evaluates points of one parcel, for one thread of the worker at a time."""

    def __init__(self, parcel: Parcel):
        self.name = parcel.sent.name
        self.ended = False
        self._evaluator = Evaluator(parcel.sent.source, 1, parcel.time_limit, isolated=True)

    def evaluate(self, points: Sequence[Mapping[str, float]]) -> list[Outcome]:
        """Outcomes of the points, one after the other, until it is ended: a process that was killed is not replaced."""
        found = []
        for values in points:
            if self.ended:
                break
            found += self._evaluator.evaluate([values])
        return found

    def end(self) -> None:
        """End the process at once, whatever it does."""
        self.ended = True
        self._evaluator.close(at_once=True)


_lock = threading.Lock()
_idle: list[_Child] = []  # the latest used last
_busy: list[_Child] = []


@contextlib.contextmanager
def _child(parcel: Parcel) -> Iterator[_Child]:
    """A process for the points of a parcel: one that is idle, or a new one."""
    name = parcel.sent.name
    with _lock:
        child = next((one for one in _idle if one.name == name), None)
        if child is None:
            child = _Child(parcel)
        else:
            _idle.remove(child)
        _busy.append(child)
    try:
        yield child
    finally:
        with _lock:
            _busy.remove(child)
            if not child.ended:
                _idle.append(child)
            others = [one for one in _idle if one.name != name][:-_KEPT]
            _idle[:] = [one for one in _idle if one not in others]
        for one in others:
            one.end()


def release(name: str) -> None:
    """End the processes of a parcel in this worker, also those that evaluate a point; returns at once."""
    with _lock:
        children = [one for one in (*_idle, *_busy) if one.name == name]
        _idle[:] = [one for one in _idle if one not in children]
    for one in children:
        threading.Thread(target=one.end, daemon=True).start()
