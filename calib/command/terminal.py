"""Lines and tables on the terminal, whatever its code page, and the log of what went wrong."""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys
import traceback
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from calib.api.entries.entry import NARROWEST, WIDTH, Entry, lines_of, wrapped_lines
from calib.api.progress import error_stream
from calib.errors.errors import InputError
from calib.errors.place import WIDEST, excerpt
from calib.execution.outcome import words_of
from calib.results.answer import LABEL, Answer
from calib.results.version import __version__

_FREE = sys.stdout.isatty() or "COLUMNS" in os.environ


class _Output(Console):
    """Standard output; what cannot be written any more is left out, and noted."""

    lost = ""

    def print(self, *given: Any, **more: Any) -> None:
        """As `rich.console.Console.print`."""
        if self.lost:
            return
        try:
            super().print(*given, **more)
        except OSError as fault:
            self.lost = fault.strerror or type(fault).__name__
            with contextlib.suppress(OSError, ValueError):  # so that nothing complains again at the end
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    def on_broken_pipe(self) -> None:
        """Called while the fault is handled; Rich would end the command."""
        raise


_out = _Output(highlight=False, markup=False, emoji=False, soft_wrap=True, width=None if _FREE else WIDTH)

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
    """One paragraph of output, wrapped between words on a terminal; elsewhere it stays one line."""
    _out.print("\n".join(_wrapped(line) for line in text.split("\n")), style=style)


def labelled(label: str, text: str) -> None:
    """One paragraph behind a label, indented on a terminal."""
    head = f"{label}:".ljust(LABEL)
    _out.print(f"[bold]{head}[/bold]", end="", markup=True)
    _out.print(_wrapped(text, LABEL))


def warn(text: str) -> None:
    """One paragraph that must not be missed."""
    say(text, style="yellow")


def _wrapped(text: str, indent: int = 0) -> str:
    """Text in lines that fit the terminal; the first begins after ``indent`` columns, the others are indented so."""
    if not _out.is_terminal or indent + len(text) <= _out.width:
        return text
    lines = wrapped_lines(text, max(_out.width - indent, NARROWEST))
    return f"\n{' ' * indent}".join(lines)


def complain(text: str) -> None:
    """One line on the error stream."""
    error_stream().print(f"calib: {text}")


def output_lost() -> bool:
    """Whether a part of what the command had to say could not be written, which is told."""
    if _out.lost:
        complain(f"standard output cannot be written ({_out.lost}): what the command had to say is incomplete")
    return bool(_out.lost)


def complain_of_input(fault: InputError, arguments: list[str]) -> None:
    """A sentence on bad input, then the line of the user's file where it is known, and the table of the error.

    The traceback of an exception in the user's own code goes to the log.
    """
    text = fault.sentence
    log = None if fault.__cause__ is None else _log(" ".join(arguments), traceback.format_exc())
    stream = error_stream()
    stream.print("Error: " + (text if log is None else f"{text.rstrip('.')}; the traceback is in {log}."))
    widest = min(WIDEST, stream.width) if stream.is_terminal else WIDEST
    for line in () if fault.at is None else excerpt(fault.at, widest):
        stream.print(line)
    for line in fault.table.splitlines():
        stream.print(line)


def complain_of_unexpected(fault: Exception, arguments: list[str]) -> None:
    """One line on an unexpected failure; its traceback goes to a log in the current directory."""
    log = _log(" ".join(arguments), traceback.format_exc())
    if log is not None:
        complain(f"unexpected {words_of(fault)}; the details are in {log}")


def tell_traces(command: str, traces: Sequence[str]) -> None:
    """Log the tracebacks of a user's code that did not stop the analysis, and say where they are."""
    log = _log(command, "\n".join(traces)) if traces else None
    if log is not None:
        say(f"The traceback is in {log}.")


def _log(command: str, trace: str) -> Path | None:
    """Append a traceback to the log in the current directory; print it where that is impossible."""
    log = Path.cwd() / "calib-error.log"
    stamp = datetime.now(UTC).isoformat(timespec="seconds")
    text = f"{stamp} calib {__version__}: {command}\n{trace}\n"
    try:
        with log.open("a", encoding="utf-8") as stream:
            stream.write(text)
    except OSError:
        complain(text)
        return None
    return log


def tell_set_aside(paths: Sequence[Path]) -> None:
    """Files that were in the way of results and that calib did not write."""
    for path in paths:
        say(f"\nKept under another name, since calib did not write it or it was changed since: {path}")


def tell_answer(answer: Answer, place: Path | None) -> None:
    """Print an answer in four lines."""
    for label, text in answer.labelled.items():
        labelled(label, text)
    if place is not None:
        labelled("Report" if place.suffix == ".html" else "Results", str(place))


def tell_entries(entries: Sequence[Entry], verbose: bool) -> None:
    """Print warnings first, then the other entries; on request all of them."""
    for text, style in lines_of(entries, verbose, "-v shows all", _out.width):
        say(text, style)
