"""The two expected failures: bad input, and a point that cannot be evaluated."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Something given by the user is wrong.

    Shown as one sentence, without a traceback, with exit code 2.

    Parameters
    ----------
    problem : str
        What is wrong: the thing, its value and the allowed range.
    place : str or Path, optional
        Where it came from, such as ``study.toml, [parameters.K_primary]`` or ``repeat_1.uff, line 12``.
    remedy : str, optional
        What to do about it.
    """

    def __init__(self, problem: str, *, place: str | Path | None = None, remedy: str | None = None):
        self.problem = problem.strip().rstrip(".")
        self.place = None if place is None else str(place)
        self.remedy = None if remedy is None else remedy.strip().rstrip(".")
        super().__init__(str(self))

    def __str__(self) -> str:
        where = f"{self.place}: " if self.place else ""
        cure = f"; {self.remedy}" if self.remedy else ""
        return f"{where}{self.problem}{cure}."

    def __reduce__(self) -> tuple[object, ...]:
        # Keyword-only arguments do not survive the default pickling between processes.
        return _rebuild_input_error, (type(self), self.problem, self.place, self.remedy)


def _rebuild_input_error(kind: type[InputError], problem: str, place: str | None, remedy: str | None) -> InputError:
    return kind(problem, place=place, remedy=remedy)


class ToleranceError(InputError):
    """A reduced basis does not reach its tolerance; the caller may continue with the full model."""


class EvaluationError(RuntimeError):
    """The model cannot be evaluated at this point (singular stiffness, no convergence); recorded as a failed row."""


def again(fault: EvaluationError, words: str | None = None) -> EvaluationError:
    """A copy of the failure with its notes, reworded if ``words`` are given, and without its traceback."""
    out = EvaluationError(*fault.args) if words is None else EvaluationError(words)
    for note in getattr(fault, "__notes__", ()):
        out.add_note(note)
    return out
