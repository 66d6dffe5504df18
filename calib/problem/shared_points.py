"""What problems are about to be asked for, evaluated by all processes that share tasks."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from calib.execution.ahead import in_advance, is_collecting
from calib.execution.outcome import NotSent, point_key
from calib.execution.tasks import Told, are_shared, each, processes, unreported
from calib.problem.problem import PairProblem

_MODELS = 2
"""Models that are sent at once: dozens of them would take as much memory as a decision."""


def solve_shared(requests: Iterable[tuple[Any, Mapping[str, float]]]) -> None:
    """Solve points of models of matrices before they are asked for, where other processes share tasks.

    Whoever asks for such a point afterwards finds it, and counts it as if it were solved then: results do not depend on
    whether this was called. A user's function is left to the one who asks, and so is what a model refuses.

    Parameters
    ----------
    requests : iterable of (problem, values)
        Problems of one test, of several, or with altered rows, and named values at which their residuals will be asked.
    """
    if not are_shared() or is_collecting():
        return
    wanted = dict[tuple[int, str], tuple[PairProblem[Any], dict[str, float]]]()
    for problem, values in requests:
        for own, its in _parts(problem, values):
            if not _of_matrices(own):
                continue
            complete = own.pair.space.complete(dict(its))
            key = point_key(complete)
            if not own.is_known(key):
                wanted.setdefault((id(own), key), (own, complete))
    _run(_solved, PairProblem.at, list(wanted.values()), _MODELS)


def run_shared(function: Callable[..., object], requests: Iterable[tuple[Any, ...]], told: Told = unreported) -> None:
    """Run computations on problems, such as fits, before they are asked for, where other processes share tasks.

    Whoever runs one of them afterwards finds the points and slopes that it asks for, as many as a problem keeps, and
    counts them as if they were evaluated then: results do not depend on whether this was called. Computations on a
    user's function, and what fails, are left to the one who asks.

    Parameters
    ----------
    function : callable
        Defined in a module, with a problem and further arguments; what it returns is not used.
    requests : iterable of (problem, ...)
        Problems of one test, of several, or with altered rows, each with these arguments.
    told : callable
        See `calib.execution.tasks.each`.
    """
    if processes() < 2 or is_collecting():
        return
    able = [one for one in requests if all(_of_matrices(own) for own, _ in _parts(one[0], {}))]
    _run(_computed, function, able, 2 * processes(), told)


def _run(
    task: Callable[[_Computations, int], bytes],
    function: Callable[..., object],
    requests: Sequence[tuple[Any, ...]],
    most: int,
    told: Told = unreported,
) -> None:
    """Run computations on so many models at once; a single one is left to the one who asks."""
    by_model = dict[tuple[int, ...], list[tuple[Any, ...]]]()
    for one in requests:
        by_model.setdefault(tuple(id(own) for own in _owners(one[0])), []).append(one)
    groups = list(by_model.values())
    for first in range(0, len(groups), most):
        some = [one for group in groups[first : first + most] for one in group]
        if len(some) < 2:
            continue
        contents = each(task, _Computations(function, some, task is _computed), range(len(some)), told)
        for (problem, *_), content in zip(some, contents, strict=True):
            owners = _owners(problem)
            for own, found in zip(owners, _read(content, owners), strict=True):
                for key, one in found.items():
                    own.keep_ahead(key, one)


@dataclass(frozen=True, eq=False)
class _Computations:
    """A function and what it is called with."""

    function: Callable[..., object]
    requests: Sequence[tuple[Any, ...]]
    stays_here: bool
    """Whether the models would travel longer than they take; see `calib.execution.cluster_tasks`."""


def _solved(shared: _Computations, number: int) -> bytes:
    """A point, as `_added`."""
    return _added(shared, number)


def _computed(shared: _Computations, number: int) -> bytes:
    """A longer computation, as `_added`: a team expects how long a function takes by the last time."""
    return _added(shared, number)


def _added(shared: _Computations, number: int) -> bytes:
    """What one computation has added to what its problems keep for requests that follow."""
    request = shared.requests[number]
    owners = _owners(request[0])
    before = [own.ahead.keys() for own in owners]
    with in_advance():
        try:
            shared.function(*request)
        except NotSent:
            raise
        except Exception:  # whoever asks for it fails in the same way
            pass
    added = [{k: v for k, v in own.ahead.items() if k not in b} for own, b in zip(owners, before, strict=True)]
    content = io.BytesIO()
    _Pickler(content, _known(owners)).dump(added)
    return content.getvalue()


def _read(content: bytes, owners: Sequence[PairProblem[Any]]) -> list[dict[Hashable, Any]]:
    found: list[dict[Hashable, Any]] = _Unpickler(io.BytesIO(content), _known(owners)).load()
    return found


def _owners(problem: Any) -> list[PairProblem[Any]]:
    """The problems of single tests that a problem consists of, each once."""
    return list({id(own): own for own, _ in _parts(problem, {})}.values())


def _parts(problem: Any, values: Mapping[str, float]) -> Iterator[tuple[Any, Mapping[str, float]]]:
    """What a problem asks at named values: problems of single tests, each with its own values."""
    inner = getattr(problem, "inner_points", None)
    if inner is None:
        yield problem, values
        return
    for part, own in inner(values):
        yield from _parts(part, own)


def _of_matrices(problem: Any) -> bool:
    """Whether a problem solves a model of matrices, and stores nothing between runs."""
    if not isinstance(problem, PairProblem) or problem.store is not None:
        return False
    return hasattr(getattr(problem.pair.problem, "model", None), "matrices")


def _known(owners: Sequence[PairProblem[Any]]) -> tuple[object, ...]:
    """What solutions hold and every process has: hundreds of megabytes of models, and the measurements."""
    problems = [own.pair.problem for own in owners]
    return tuple(thing for one in problems for thing in (one.model, getattr(one, "measured", None)))


class _Pickler(pickle.Pickler):
    """Pickles a solution without what every process has."""

    def __init__(self, file: io.BytesIO, known: tuple[object, ...]):
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._known = {id(thing): k for k, thing in enumerate(known) if thing is not None}

    def persistent_id(self, obj: object) -> int | None:
        return self._known.get(id(obj))


class _Unpickler(pickle.Unpickler):
    """Reads what `_Pickler` wrote, with what this process has."""

    def __init__(self, file: io.BytesIO, known: tuple[object, ...]):
        super().__init__(file)
        self._known = known

    def persistent_load(self, pid: int) -> object:
        return self._known[pid]
