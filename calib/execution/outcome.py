"""Outcome of one evaluated point; a failure is recorded and does not end the batch."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from calib.errors.errors import EvaluationError, InputError
from calib.errors.own_code import raised_at
from calib.errors.place import Place

Function = Callable[[Mapping[str, float]], Mapping[str, float]]


class NotSent(BaseException):
    """A function that could not be sent to this process was called; never a failed point."""


class PointWanted(BaseException):
    """A computation asks for a point that is not known yet; see `calib.execution.ahead.evaluated_together`."""


WORKER_DIED = "the worker process died"
OUT_OF_MEMORY = "there was not enough memory"
TOOK_TOO_LONG = "it took longer than"


@dataclass(frozen=True)
class Outcome:
    """One evaluated point.

    Attributes
    ----------
    values : dict
        Named parameters, each in its own unit.
    status : {"ok", "failed"}
    responses : dict
        Named responses, NaN where one is not available; empty for a failed point.
    error : str
        Why it failed, one line; empty when it did not.
    seconds : float
        Time of the evaluation; ignored by comparisons.
    trace : str
        Traceback of an exception in a user's code; ignored by comparisons, and not stored.
    at : Place or None
        Line of a user's code that failed, or that defines the function whose result is wrong; likewise.
    """

    values: dict[str, float]
    status: Literal["ok", "failed"]
    responses: dict[str, float]
    error: str = ""
    seconds: float = field(default=0.0, compare=False)
    trace: str = field(default="", compare=False, repr=False)
    at: Place | None = field(default=None, compare=False, repr=False)

    @property
    def transient(self) -> bool:
        """Whether the machine may be the cause of the failure, so that another try may succeed."""
        return self.error == OUT_OF_MEMORY or self.error.startswith((WORKER_DIED, TOOK_TOO_LONG))


def attempt(function: Function, values: Mapping[str, float]) -> Outcome:
    """Evaluate one point; any failure of the function is recorded in the outcome.

    Parameters
    ----------
    function : callable
        Named values to named responses. NaN marks a response that is not available, an infinite one is a failure.
    values : mapping

    Raises
    ------
    InputError
        The set-up is wrong, not the point.
    """
    given = {str(name): float(value) for name, value in values.items()}
    responses: dict[str, float] = {}
    error = trace = ""
    at = None
    started = time.perf_counter()
    try:
        with directory_kept():
            answer = function(dict(given))
        responses = {str(name): float(value) for name, value in answer.items()}
        error = next((f"the response {n!r} is {v}" for n, v in responses.items() if math.isinf(v)), "")
    except InputError as fault:
        raise fault.with_line(raised_at(fault)) from fault.__cause__
    except (KeyboardInterrupt, PointWanted, NotSent):
        raise
    except MemoryError:
        error = OUT_OF_MEMORY
    except EvaluationError as fault:
        error = _one_line(words_of(fault).partition(": ")[2]) or "it cannot be evaluated"
        trace, at = "\n".join(getattr(fault, "__notes__", ())), fault.at or raised_at(fault)
    except BaseException as fault:  # sys.exit, or a panic in foreign code, must not end the study
        error, trace = error_line(fault), "".join(traceback.format_exception(fault))[-_TRACE:]
        at = raised_at(fault)
    seconds = time.perf_counter() - started
    if error:
        return Outcome(given, "failed", {}, error, seconds, trace, at)
    return Outcome(given, "ok", responses, "", seconds)


def point_key(values: Mapping[str, float]) -> str:
    """Key of a point: a 128-bit hash over all names, sorted, with their exact values."""
    text = "\n".join(f"{name}={float(values[name])!r}" for name in sorted(values))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def named_responses(function: Function, values: Mapping[str, float]) -> dict[str, float]:
    """Named responses of a function that may be the user's own; EvaluationError for any failure in it."""
    outcome = attempt(function, values)
    if outcome.status == "failed":
        raise failure(outcome)
    return outcome.responses


def failure(outcome: Outcome) -> EvaluationError:
    """A failed outcome as an exception, with its place and with its traceback as a note."""
    fault = EvaluationError(outcome.error, at=outcome.at)
    if outcome.trace:
        fault.add_note(outcome.trace)
    return fault


def as_cause(fault: EvaluationError) -> EvaluationError | None:
    """A failure to chain as the cause, if it carries a traceback of the user's code to log; else None."""
    return fault if getattr(fault, "__notes__", ()) else None


def words_of(fault: BaseException) -> str:
    """Type and text of an exception of any class: it may have no text, or fail to make one."""
    try:
        text = str(fault)
    except Exception:  # of the user's own `__str__`
        text = "its text cannot be made"
    return f"{type(fault).__name__}: {text}" if text.strip() else type(fault).__name__


def error_line(fault: BaseException) -> str:
    """An exception on one line, with file and line of the user's code that raised it."""
    words, at = words_of(fault), raised_at(fault)
    if at is None or isinstance(fault, SyntaxError):  # its message has the place
        return _one_line(words)
    return _one_line(words) + f" ({os.path.basename(at.file)}, line {at.line})"


_TRACE = 10_000
"""Characters of a traceback that are kept, from its end."""


@contextlib.contextmanager
def directory_kept() -> Iterator[None]:
    """Restore the working directory afterwards: a model may change it, which would break relative paths."""
    try:
        before = os.getcwd()
    except OSError:  # it was removed
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.chdir(before)


def _one_line(text: str) -> str:
    return " ".join(text.split())[:500]


@dataclass(frozen=True)
class Individual:
    """One individual of a generation of a search.

    Attributes
    ----------
    key : str
        From `point_key`.
    status : {"ok", "failed", "infeasible"}
    misfit : float
        NaN unless ``ok``.
    """

    key: str
    status: Literal["ok", "failed", "infeasible"]
    misfit: float = math.nan
