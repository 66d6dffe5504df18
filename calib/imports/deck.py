"""Decks: input files of a code with values of parameters written where ``{{ name }}`` stands."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from calib.errors.errors import EvaluationError, InputError
from calib.errors.place import Place
from calib.problem.parameter import Parameter

if TYPE_CHECKING:
    from jinja2 import Environment

SUFFIX = ".j2"
"""Of a template; the deck has the same name without it."""
MATRICES = "matrices"
"""Name in a template that is true where the run shall write matrices, and false where it shall compute modes."""


def fortran(value: object) -> str:
    """A value as codes read it: a number that is no integer always has a decimal point.

    ``1e6`` is an integer to some of them, or a number of a degree of freedom (*SPRING of CalculiX); ``1.0e6`` is none.
    """
    if not isinstance(value, float):
        return str(value)
    mantissa, exponent, power = repr(float(value)).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + exponent + power


def in_columns(value: float, columns: int) -> str:
    """The number with most digits in so many columns, such as the 8 of a field of Nastran.

    Raises
    ------
    EvaluationError
        Where it does not fit.
    """
    for digits in range(17, 0, -1):
        for text in (f"{value:#.{digits}g}", f"{value:.{digits - 1}e}"):
            mantissa, exponent, power = text.partition("e")
            whole = mantissa + ("" if "." in mantissa else ".")
            for end in (f"{exponent}{power}", f"{int(power):+d}" if power else ""):
                if len(whole + end) <= columns:
                    return whole + end
    raise EvaluationError(f"{value!r} does not fit into {columns} columns")


def deck_name(template: str | Path) -> str:
    """Name of the deck of a template."""
    return Path(template).name.removesuffix(SUFFIX)


def read_template(file: Path, known: Iterable[str]) -> tuple[str, set[str]]:
    """Text of a template and the parameters that it uses, all of them among the known ones.

    Raises
    ------
    InputError
        For a file that is not there or no UTF-8 text; with the line for wrong syntax or an unknown name.
    """
    import jinja2
    from jinja2 import meta

    try:
        text = file.read_bytes().decode("utf-8")
    except OSError as fault:
        raise InputError(f"it cannot be read ({fault.strerror})", place=file) from None
    except UnicodeDecodeError as fault:
        raise InputError(f"it is not UTF-8 text (byte {fault.start})", place=file, remedy="save it so") from None
    lines = text.split("\n")
    try:
        tree = _environment().parse(text)
    except jinja2.TemplateSyntaxError as fault:
        raise InputError(
            f"it is no template ({fault.message})", place=Place.in_lines(str(file), lines, fault.lineno),
            remedy="write {{ name }} where the value of a parameter belongs",
        ) from None  # fmt: skip
    used = meta.find_undeclared_variables(tree) - set(_environment().globals)
    listed = sorted(known)
    for name in sorted(used - {*listed, MATRICES}):
        number = next((k for k, line in enumerate(lines, start=1) if name in line), 1)
        raise InputError(
            f"{name!r} is no parameter", place=Place.in_lines(str(file), lines, number),
            remedy=f"the parameters are {', '.join(listed) or 'none'}",
        )  # fmt: skip
    return text, used


def deck_of(text: str, parameters: Iterable[Parameter], values: Mapping[str, float], matrices: bool = False) -> str:
    """A template with the values of parameters in it, those of integers without a decimal point.

    Raises
    ------
    EvaluationError
        Where an expression in it fails at these values.
    """
    plain = {p.name: round(values[p.name]) if p.integer else float(values[p.name]) for p in parameters}
    try:
        return _environment().from_string(text).render({**plain, MATRICES: matrices})
    except EvaluationError:
        raise
    except Exception as fault:  # whatever an expression of the user's may raise
        frames = traceback.walk_tb(fault.__traceback__)
        number = max((line for frame, line in frames if frame.f_code.co_filename == _TEMPLATE), default=0)
        first = isinstance(fault, TypeError) and number and "|" in text.splitlines()[number - 1]
        hint = ". A filter acts before * and +: write {{ (2 * t) | columns(8) }}" if first else ""
        what = f"the template{f', line {number},' if number else ''} cannot be written"
        raise EvaluationError(f"{what} ({type(fault).__name__}: {fault}){hint}") from None


_TEMPLATE = "<template>"
"""File of the code of a template in a traceback."""


@cache
def _environment() -> Environment:
    import jinja2

    filters: dict[str, Callable[..., str]] = {"columns": in_columns}
    made = jinja2.Environment(undefined=jinja2.StrictUndefined, finalize=fortran, keep_trailing_newline=True)
    made.filters |= filters
    return made
