"""Retry: a function called again where it fails for a reason that passes, such as a licence that is taken."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from calib.errors.arguments import integer, number
from calib.errors.errors import EvaluationError, InputError
from calib.errors.own_code import raised_at
from calib.execution.outcome import error_line, words_of
from calib.execution.worker import pause


@dataclass(frozen=True, eq=False)
class Retrying:
    """A function that is called again after failures of one kind; made by `retrying`.

    Its content is that of the function alone: stored results stay valid where a retry is added or changed.

    Attributes
    ----------
    function : callable
    pattern : str
        Regular expression within the failure's text.
    times : int
        Further calls.
    wait : float
        Seconds before each of them.
    """

    function: Callable[[Mapping[str, float]], Any]
    pattern: str
    times: int
    wait: float

    is_transparent: ClassVar[bool] = True
    """See `calib.results.fingerprint.digest_of`."""

    @property
    def __wrapped__(self) -> Callable[[Mapping[str, float]], Any]:
        return self.function

    def __call__(self, values: Mapping[str, float]) -> Any:
        """What the function returns; EvaluationError where its last call fails like the first."""
        return self._result(lambda: self.function(values))

    def _result(self, call: Callable[[], Any]) -> Any:
        for further in range(self.times + 1):
            try:
                return call()
            except Exception as fault:
                if not re.search(self.pattern, _text(fault)):
                    raise
                if further == self.times:
                    calls = "once" if self.times == 1 else f"{self.times} times"
                    words = words_of(fault).partition(": ")[2] if isinstance(fault, EvaluationError) else ""
                    end = EvaluationError(f"{words or error_line(fault)} (called again {calls})", at=raised_at(fault))
                    end.add_note("".join(traceback.format_exception(fault)))
                    raise end from fault
            pause(self.wait)
        return None


@dataclass(frozen=True, eq=False)
class _RetryingDerivatives(Retrying):
    """The same for a function that tells derivatives; see `calib.structure.function_model.DerivativesOnRequest`."""

    def derivatives_by(self, values: Mapping[str, float], names: Sequence[str]) -> Mapping[str, float]:
        function: Any = self.function
        found: Mapping[str, float] = self._result(lambda: function.derivatives_by(values, names))
        return found


def retrying(
    function: Callable[[Mapping[str, float]], Any], pattern: str, times: int = 5, wait: float = 60.0
) -> Retrying:
    """The function of a model, called again where it fails for a reason that passes.

    Waiting does not count for the time limit of a study.

    Parameters
    ----------
    function : callable
        Of a `FunctionModel` or `ModalFunctionModel`.
    pattern : str
        Regular expression, such as ``"LICENSE"``, that is looked for in the exception's type, text and notes, and in
        the output of a process that failed (`subprocess.CalledProcessError`).
    times : int
        Further calls at most.
    wait : float
        Seconds before each of them.

    Raises
    ------
    InputError
        For an invalid argument.

    Examples
    --------
    >>> import calib
    >>> seats = iter([False, True])
    >>> def solve(values):
    ...     if not next(seats):
    ...         raise RuntimeError("no LICENSE is free")
    ...     return {"load": 2 * values["k"]}
    >>> calib.retrying(solve, "LICENSE", wait=0.0)({"k": 3.0})
    {'load': 6.0}
    """
    if not callable(function):
        raise InputError(f"it is {function!r:.40}", place="retrying", remedy="give a function of named values")
    try:
        re.compile(pattern)
    except (re.error, TypeError) as fault:
        raise InputError(f"the pattern {pattern!r:.40} is no regular expression ({fault})", place="retry") from None
    times, wait = integer(times, 1, "retry, times"), number(wait, "retry, wait")
    if not 0 <= wait <= 1e6:
        raise InputError(f"it is {wait:g} s", place="retry, wait", remedy="give 0 to 1e6 s")
    made = _RetryingDerivatives if hasattr(function, "derivatives_by") else Retrying
    return made(function, pattern, times, wait)


def _text(fault: Exception) -> str:
    """Everything that a failure says: its words, its notes, and the output of a process."""
    said = [words_of(fault), *getattr(fault, "__notes__", ())]
    for name in ("output", "stderr"):
        part = getattr(fault, name, None)
        said.append(part.decode(errors="replace") if isinstance(part, bytes) else part or "")
    return "\n".join(str(part) for part in said)
