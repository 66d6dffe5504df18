"""The two expected failures: bad input, and a point that cannot be evaluated."""

from __future__ import annotations

from pathlib import Path

from calib.errors.place import Place, excerpt


class InputError(ValueError):
    """Something given by the user is wrong.

    Shown as one sentence and, where it is known, the line of the user's file; without a traceback, with exit code 2.

    Parameters
    ----------
    problem : str
        What is wrong: the thing, its value and the allowed range.
    place : str, Path or Place, optional
        Where it came from: the name of a thing, a file, or a place in a file.
    remedy : str, optional
        What to do about it.
    at : Place, optional
        The line of a file to show; default ``place``, if that is one.
    table : str
        Lines to show below the sentence, such as every offset of which it names the largest.

    Attributes
    ----------
    place : str or None
        In words, such as ``study.toml, line 14`` or ``repeat_1.uff, line 12``.
    at : Place or None
        File, line, column and length as data; the line is also shown in a note of the exception.

    Examples
    --------
    >>> import calib
    >>> calib.Parameter("t", 3.0, 5.0, 1.0, "mm")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    calib.errors.errors.InputError: parameter t: lower limit 5 is not below upper limit 1 mm; write limits as ...
    """

    def __init__(
        self,
        problem: str,
        *,
        place: str | Path | Place | None = None,
        remedy: str | None = None,
        at: Place | None = None,
        table: str = "",
    ):
        self.problem = problem.strip().rstrip(".")
        self._given = place
        self.place = None if place is None else str(place)
        self.remedy = None if remedy is None else remedy.strip().rstrip(".")
        own = place if isinstance(place, Place) and place.line is not None else None
        self.at = own if at is None or at.line is None else at
        self.table = table
        super().__init__(str(self))
        if self.at is not None and (shown := excerpt(self.at)):
            self.add_note("\n".join(shown))
        if table:
            self.add_note(table)

    def __str__(self) -> str:
        return self._sentence(self.place)

    @property
    def sentence(self) -> str:
        """The sentence without path and line of a place that is shown below it."""
        if isinstance(self._given, Place) and self._given == self.at:
            return self._sentence(self._given.short)
        return str(self)

    def _sentence(self, place: str | None) -> str:
        where = f"{place}: " if place else ""
        cure = f"; {self.remedy}" if self.remedy else ""
        said = f"{where}{self.problem}{cure}"
        return said if said.endswith("?") else f"{said}."

    def with_line(self, at: Place | None) -> InputError:
        """The same error with a line of a file to show; unchanged where it has one already or none is given."""
        if at is None or self.at is not None:
            return self
        return type(self)(self.problem, place=self._given, remedy=self.remedy, at=at, table=self.table)

    def __reduce__(self) -> tuple[object, ...]:
        # Keyword-only arguments do not survive the default pickling between processes.
        return _rebuild_input_error, (type(self), self.problem, self._given, self.remedy, self.at, self.table)


def _rebuild_input_error(
    kind: type[InputError],
    problem: str,
    place: str | Path | Place | None,
    remedy: str | None,
    at: Place | None,
    table: str,
) -> InputError:
    return kind(problem, place=place, remedy=remedy, at=at, table=table)


class ToleranceError(InputError):
    """A reduced basis does not reach its tolerance; the caller may continue with the full model."""


class EvaluationError(RuntimeError):
    """The model cannot be evaluated at this point (singular stiffness, no convergence); recorded as a failed row.

    Attributes
    ----------
    at : Place or None
        Line of the user's code that raised it, or that defines the function whose result is wrong.

    Examples
    --------
    A model states where it cannot be evaluated; a sample or search records a failed row, and `Problem.compare` raises:

    >>> import calib
    >>> def frequency(v):
    ...     if v["load"] >= 10.0:
    ...         raise calib.EvaluationError(f"the column buckles under {v['load']:g} kN")
    ...     return {"f": 5.0 * (1 - v["load"] / 10.0) ** 0.5}
    >>> space = calib.ParameterSpace((calib.Parameter("load", 1.0, 0.0, 20.0, "kN"),))
    >>> model = calib.FunctionModel("column", space, frequency)
    >>> calib.Problem(model, calib.ResponseTest({"f": 4.2})).compare({"load": 12.0})
    Traceback (most recent call last):
        ...
    calib.errors.errors.EvaluationError: the column buckles under 12 kN
    """

    def __init__(self, *words: object, at: Place | None = None):
        super().__init__(*words)
        self.at = at


def raised_anew(fault: EvaluationError, words: str | None = None) -> EvaluationError:
    """A copy of the failure with its notes and place, reworded if ``words`` are given, and without its traceback."""
    out = EvaluationError(*fault.args, at=fault.at) if words is None else EvaluationError(words, at=fault.at)
    for note in getattr(fault, "__notes__", ()):
        out.add_note(note)
    return out
