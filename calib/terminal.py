"""Lines and tables on the terminal, whatever its code page, and the log of what went wrong."""

from __future__ import annotations

import codecs
import io
import sys
import traceback
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

from calib.errors import InputError
from calib.excerpt import WIDEST, excerpt
from calib.version import __version__

WIDTH = 120
"""Columns of output that does not go to a terminal."""

_out = Console(highlight=False, markup=False, soft_wrap=True, width=None if sys.stdout.isatty() else WIDTH)
ERR = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)

_PLAIN = str.maketrans({"\u2212": "-", "\u2013": "-", "\u2014": "-", "\u2192": "->", "\u00d7": "x", "\u2026": "..."})
"""For streams whose code page has no such characters."""


def _in_code_page(fault: UnicodeError) -> tuple[str, int]:
    """Replacement of characters that a stream cannot encode: an ASCII equivalent, or a question mark."""
    if not isinstance(fault, UnicodeEncodeError):
        raise fault
    text = fault.object[fault.start : fault.end].translate(_PLAIN)
    return "".join(c if c.isascii() else "?" for c in text), fault.end


def write_to_any_code_page() -> None:
    """Make output safe for a terminal or file of any code page: no character may end a command."""
    codecs.register_error("calib", _in_code_page)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.encoding.lower().replace("-", "") != "utf8":
            stream.reconfigure(errors="calib")


def say(text: str = "", style: str | None = None) -> None:
    """One line of output."""
    _out.print(text, style=style)


def warn(text: str) -> None:
    """One line that must not be missed."""
    _out.print(text, style="yellow")


def complain(text: str) -> None:
    """One line on the error stream."""
    ERR.print(f"calib: {text}")


def complain_of_input(fault: InputError, arguments: list[str]) -> None:
    """A sentence on bad input, then the line of the user's file where it is known.

    The traceback of an exception in the user's own code goes to the log.
    """
    text = fault.sentence
    log = None if fault.__cause__ is None else _log(" ".join(arguments), traceback.format_exc())
    ERR.print("Error: " + (text if log is None else f"{text.rstrip('.')}; the traceback is in {log}."))
    for line in () if fault.at is None else excerpt(fault.at, min(WIDEST, ERR.width) if ERR.is_terminal else WIDEST):
        ERR.print(line)


def complain_of_unexpected(fault: Exception, arguments: list[str]) -> None:
    """One line on an unexpected failure; its traceback goes to a log in the current directory."""
    log = _log(" ".join(arguments), traceback.format_exc())
    if log is not None:
        complain(f"unexpected {type(fault).__name__}: {fault}; the details are in {log}")


def tell_traces(asked: str, traces: Sequence[str]) -> None:
    """Log the tracebacks of a user's code that did not stop the analysis, and say where they are."""
    log = _log(asked, "\n".join(traces)) if traces else None
    if log is not None:
        say(f"The traceback is in {log}.")


def _log(asked: str, trace: str) -> Path | None:
    """Append a traceback to the log in the current directory; print it where that is impossible."""
    log = Path.cwd() / "calib-error.log"
    stamp = datetime.now(UTC).isoformat(timespec="seconds")
    text = f"{stamp} calib {__version__}: {asked}\n{trace}\n"
    try:
        with log.open("a", encoding="utf-8") as stream:
            stream.write(text)
    except OSError:
        complain(text)
        return None
    return log


def tell_kept(paths: Sequence[Path]) -> None:
    """Files that were in the way of results and that calib did not write."""
    for path in paths:
        say(f"\nKept under another name, since calib did not write it or it was changed since: {path}")


def count(number: int, thing: str) -> str:
    """A number of things, singular or plural."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def number(value: float, digits: int) -> str:
    """A number with the given number of decimals; empty for NaN."""
    return "" if pd.isna(value) else f"{value:.{digits}f}"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], left: Sequence[str] = ()) -> None:
    """Print a table; the first column and those in ``left`` are left-aligned."""
    out = Table(box=None, pad_edge=False, header_style="bold")
    for k, name in enumerate(heads):
        out.add_column(name, justify="left" if k == 0 or name in left else "right", no_wrap=False, overflow="fold")
    for row in rows:
        out.add_row(*row)
    _out.print(out)
