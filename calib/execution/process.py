"""A command in a process group of its own: it never outlives whoever waits for it, and its output is kept."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from calib.errors.errors import InputError

OUTPUT = "calib_output.txt"
"""File with everything that the command wrote on its output and error streams."""
_GUARDED = (
    'exec 3<&0; "$@" </dev/null 3<&- & run=$!; { read none <&3; kill -9 0; } & guard=$!; '
    "wait $run; code=$?; kill -9 $guard; exit $code"
)
"""Shell: runs a command, and ends its whole process group when the pipe at its input closes, however that happens.

A worker process may be killed at any time, which nothing in it can answer; what it has started would run on.
"""


def is_beside(program: str) -> bool:
    """Whether a program is named by a relative path, such as ``./run.sh``, and so belongs to the study."""
    return bool(os.path.dirname(program)) and not os.path.isabs(program)


def program_of(command: Sequence[str], folder: Path, place: str) -> list[str]:
    """The command with the path of its program, a relative one being that from ``folder``; InputError without it."""
    name = command[0]
    if is_beside(name) and os.access(own := (folder / name).resolve(), os.X_OK) and own.is_file():
        return [str(own), *command[1:]]
    found = shutil.which(name)
    if found is None:
        remedy = "install it, or name its whole path"
        raise InputError(f"there is no program {name!r} on this machine", place=place, remedy=remedy)
    return [found, *command[1:]]


def run_command(command: Sequence[str], folder: Path, time_limit: float | None = None) -> int:
    """Run a command in a folder, its output in the file `OUTPUT` there; nothing that it started is left afterwards.

    Parameters
    ----------
    command : sequence of str
        Program with its path, and arguments; no shell reads them.
    folder : Path
        Its working directory.
    time_limit : float, optional
        Seconds.

    Returns
    -------
    int
        Exit code; negative the signal that ended it.

    Raises
    ------
    TimeoutError
        Beyond the time limit.
    """
    guarded = sys.platform != "win32"
    whole = ["sh", "-c", _GUARDED, "sh", *command] if guarded else list(command)
    with (folder / OUTPUT).open("wb") as output:
        process = subprocess.Popen(
            whole, cwd=folder, stdin=subprocess.PIPE, stdout=output, stderr=subprocess.STDOUT,
            start_new_session=guarded,
        )  # fmt: skip
        try:
            code = process.wait(time_limit)
        except subprocess.TimeoutExpired:
            raise TimeoutError from None
        finally:
            _end(process)
    return 128 - code if guarded and code > 128 and code - 128 in signal.valid_signals() else code


def last_lines(text: str, count: int) -> list[str]:
    """The last lines of a text that say anything."""
    lines = [" ".join(line.split()) for line in text.splitlines()]
    return [line for line in lines if line.strip("-=*_. ")][-count:]


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process with all of its group."""
    with contextlib.suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()
    process.wait()
