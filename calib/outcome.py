"""What comes of one evaluated point; a failure is told and ends nothing."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from calib.errors import EvaluationError, InputError

Function = Callable[[Mapping[str, float]], Mapping[str, float]]

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
    """

    values: dict[str, float]
    status: Literal["ok", "failed"]
    responses: dict[str, float]
    error: str = ""
    seconds: float = field(default=0.0, compare=False)

    @property
    def transient(self) -> bool:
        """Whether the failure is one of the machine, so that another try may succeed."""
        return self.error in (WORKER_DIED, OUT_OF_MEMORY) or self.error.startswith(TOOK_TOO_LONG)


def attempt(function: Function, values: Mapping[str, float]) -> Outcome:
    """Evaluate one point; whatever goes wrong there is told in the outcome.

    Parameters
    ----------
    function : callable
        Named values to named responses. NaN is a response that is not available, an infinite one is a failure.
    values : mapping

    Raises
    ------
    InputError
        The set-up is wrong, not the point.
    """
    given = {str(name): float(value) for name, value in values.items()}
    responses: dict[str, float] = {}
    error = ""
    started = time.perf_counter()
    try:
        with _directory_kept():
            answer = function(dict(given))
        responses = {str(name): float(value) for name, value in answer.items()}
        error = next((f"the response {n!r} is {v}" for n, v in responses.items() if math.isinf(v)), "")
    except (InputError, KeyboardInterrupt):
        raise
    except MemoryError:
        error = OUT_OF_MEMORY
    except EvaluationError as fault:
        error = _one_line(str(fault)) or "it cannot be evaluated"
    except BaseException as fault:  # sys.exit, or a panic in foreign code, must not end the study
        error = _one_line(f"{type(fault).__name__}: {fault}")
    seconds = time.perf_counter() - started
    if error:
        return Outcome(given, "failed", {}, error, seconds)
    return Outcome(given, "ok", responses, "", seconds)


@contextlib.contextmanager
def _directory_kept() -> Iterator[None]:
    """A model may leave for another directory, where nothing relative would be found."""
    try:
        before = os.getcwd()
    except OSError:  # somebody removed it
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.chdir(before)


def _one_line(text: str) -> str:
    return " ".join(text.split())[:500]
