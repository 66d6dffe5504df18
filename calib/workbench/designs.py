"""The designs of a study for the page: the table of `calib designs` as columns, read by a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors.errors import InputError

_PATIENCE = 120.0
"""Seconds in which the table must have been read."""
_SHARES = ("mean_error",)
"""Columns that are told in percent, beside the errors of responses."""


def designs_view(file: Path, root: Path, part: str) -> bytes:
    """The designs of a study as JSON; InputError where it cannot be read, or nothing was evaluated.

    Keys: ``count`` of designs, ranked, the best first; ``design``, ``case`` of each (a number of ``cases``), ``status``
    (1 for one that failed), and ``columns``: of each ``name, unit, input, log``, and its ``numbers``. Numbers are those
    of 32 bits, little-endian in base64, NaN where unknown. ``words`` tells how many there are.
    """
    command = [sys.executable, "-m", "calib.workbench.designs", str(file), str(root), part]
    try:
        found = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=_PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        raise InputError(f"they were not read in {_PATIENCE:.0f} s", place="designs") from None
    _, _, told = found.stdout.rpartition(b"\x00")  # a user's code may have printed before
    if found.returncode or not told:
        last = (found.stderr or found.stdout).decode("utf-8", "replace").strip().splitlines()[-1:]
        raise InputError(" ".join(last) or "they cannot be read", place="designs")
    return told


def columns(found: Any) -> dict[str, Any]:
    """The content of `designs_view` from a `calib.analyses.designs.Designs`."""
    table, space = found.table, found.space
    outputs = [name if f"error {name}" not in table else f"error {name}" for name in found.outputs]
    names = [
        *space.free_names,
        "objective",
        *(n for n in ("mean_error", "mean_mac") if table[n].notna().any()),
        *outputs,
    ]
    cases = list(dict.fromkeys(table["case"].astype(str)))
    return {
        "count": len(table), "words": " ".join(found.sentences), "cases": cases,
        "design": _packed(table["design"]), "case": _packed(table["case"].astype(str).map(cases.index)),
        "status": _packed(table["status"] != "ok"),
        "columns": [_column(table, space, name) for name in dict.fromkeys(names)],
    }  # fmt: skip


def _column(table: Any, space: Any, name: str) -> dict[str, Any]:
    numbers, unit, own = table[name], "", space[name] if name in space.free_names else None
    if own is not None:
        unit = "" if own.unit == "-" else own.unit
    elif name in _SHARES or name.startswith("error "):
        numbers, unit = 100 * numbers, "%"
    return {
        "name": name, "unit": unit, "input": own is not None, "log": own is not None and own.is_log,
        "numbers": _packed(numbers),
    }  # fmt: skip


def _packed(numbers: Any) -> str:
    return b64encode(np.asarray(numbers, dtype="<f4").tobytes()).decode("ascii")


def main(arguments: Sequence[str]) -> None:
    """Print the designs, or end with a sentence."""
    from calib.api import steps
    from calib.api.listener import Listener
    from calib.api.study import Study
    from calib.workbench.what_if import loaded

    file, root, part = arguments
    try:
        whole = loaded(Path(file), Path(root), part)
        study = Study(Path(file), Path(root), quick=part.startswith("quick"), listener=Listener(), read=whole)
        told = json.dumps(columns(steps.designs_step(study)), separators=(",", ":"))
    except InputError as fault:
        sys.exit(fault.sentence)
    sys.stdout.flush()
    sys.stdout.buffer.write(b"\x00" + told.encode())


if __name__ == "__main__":
    main(sys.argv[1:])
