"""Points that several problems are about to be asked for, solved by all processes that share tasks."""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from calib.errors.errors import EvaluationError
from calib.execution.ahead import is_collecting
from calib.execution.outcome import point_key
from calib.execution.tasks import are_shared, each
from calib.problem.problem import PairProblem

Point = tuple[PairProblem[Any], dict[str, float]]
"""A problem, and values of all parameters of its pair."""
_MODELS = 2
"""Models that are sent at once: dozens of them would take as much memory as a decision."""


def solve_shared(requests: Iterable[tuple[Any, Mapping[str, float]]]) -> None:
    """Solve points of models of matrices before they are asked for, where other processes share tasks.

    Whoever asks for such a point afterwards finds it, and counts it as if it were solved then: results do not depend on
    whether this was called. A user's function is left to the one who asks.

    Parameters
    ----------
    requests : iterable of (problem, values)
        Problems of one test, of several, or with altered rows, and named values at which their residuals will be asked.

    Raises
    ------
    InputError
        That of a model that refuses a value; a point without a solution is told to the one who asks for it.
    """
    if not are_shared() or is_collecting():
        return
    wanted = dict[tuple[int, str], Point]()
    for problem, values in requests:
        for own, complete in _points(problem, values):
            key = point_key(complete)
            if not own.is_known(key):
                wanted.setdefault((id(own), key), (own, complete))
    owners = list(dict.fromkeys(number for number, _ in wanted))
    for first in range(0, len(owners), _MODELS):
        some = owners[first : first + _MODELS]
        _solve({one: point for one, point in wanted.items() if one[0] in some})


def _solve(wanted: Mapping[tuple[int, str], Point]) -> None:
    """Solve points of a few problems; a single point is left to the one who asks."""
    if len(wanted) < 2:
        return
    pairs = {number: own.pair for (number, _), (own, _) in wanted.items()}
    found = each(_solved, pairs, [(number, complete) for (number, _), (_, complete) in wanted.items()])
    for ((_, key), (own, _)), answer in zip(wanted.items(), found, strict=True):
        own.keep_ahead(key, answer if isinstance(answer, EvaluationError) else _read(answer, own.pair))


def _points(problem: Any, values: Mapping[str, float]) -> Iterator[Point]:
    """What a problem solves at named values: `PairProblem` with models of matrices."""
    if isinstance(problem, PairProblem):
        if problem.store is None and hasattr(getattr(problem.pair.problem, "model", None), "matrices"):
            yield problem, problem.pair.space.complete(dict(values))
        return
    for part, own in getattr(problem, "inner_points", lambda values: ())(values):
        yield from _points(part, own)


def _solved(pairs: Mapping[int, Any], requested: tuple[int, Mapping[str, float]]) -> bytes | EvaluationError:
    number, values = requested
    pair = pairs[number]
    try:
        solution = pair.solve(values)
    except EvaluationError as fault:
        return fault
    content = io.BytesIO()
    _Pickler(content, _known(pair)).dump(solution)
    return content.getvalue()


def _read(content: bytes, pair: Any) -> Any:
    return _Unpickler(io.BytesIO(content), _known(pair)).load()


def _known(pair: Any) -> tuple[object, ...]:
    """What solutions of a pair hold and every process has: hundreds of megabytes of a model, and the measurement."""
    return pair.problem.model, getattr(pair.problem, "measured", None)


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
