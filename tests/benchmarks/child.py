"""Tasks in a fresh process each, since the peak of a process' memory is never forgotten."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

PER_MB = 1024.0 if sys.platform != "darwin" else 1024.0**2
"""Units of the peak in a megabyte."""


def in_child(script: str, *arguments: object) -> dict[str, Any]:
    """What a script reports that is run with arguments; its other words are shown as they come."""
    command = [sys.executable, str(Path(script).resolve()), *map(str, arguments)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def report(**found: object) -> None:
    """The last line of a script for `in_child`, with the peaks of its memory."""
    print(json.dumps({**found, "own_mb": _peak(resource.RUSAGE_SELF), "child_mb": _peak(resource.RUSAGE_CHILDREN)}))


def _peak(who: int) -> float:
    """Largest resident size in MB of this process, or of the largest of its children that have ended."""
    return resource.getrusage(who).ru_maxrss / PER_MB
