"""The table of speeds: how long everything takes that an engineer waits for, before and after a change.

    python tests/benchmarks/speed.py [--before COMMIT] [--rows NAME ...] [--long] [--table FILE]

``--before`` is another commit of this repository, checked out into a temporary folder; it takes turns with this
checkout, group by group, so that a busy machine slows both. Studies are those of this checkout on both sides. Wall
clock, worker processes as by default. ``--table`` names the CSV file; the Markdown table stands beside it. What takes
long is measured on request.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from page import Page
from stopwatch import short
from subject import ROOT

HERE = Path(__file__).resolve().parent
COLUMNS = ("measure", "wanted", "before", "after", "ratio")


class Row(NamedTuple):
    """A row: its measure in words, unit, what is wanted, group of measures and name in it."""

    words: str
    unit: str
    wanted: str
    group: str
    name: str


class Group(NamedTuple):
    """Measures that one process takes, with the arguments of `measures.py`."""

    arguments: tuple[str, ...]
    long: bool = False


GROUPS = {
    "modes": Group(("modes",)),
    "explain_bogie": Group(("explain", "explain studies/hidden_bogie")),
    "vehicle": Group(("vehicle",)),
    "effects": Group(("effects",)),
    "auto": Group(
        ("phases", "calibrate studies/bogie --method auto", "calibrate studies/vehicle --method auto"), long=True
    ),
    "explain_vehicle": Group(("explain", "explain studies/hidden_effect"), long=True),
    "genetic": Group(
        ("phases", "calibrate studies/bogie --workers 2", "calibrate studies/vehicle --workers 2"), long=True
    ),
    "fine": Group(("--size", "4", "--samples", "8"), long=True),
}
ROWS = (
    Row("one reduced evaluation of the vehicle", "ms", "10 to 12", "vehicle", "evaluation"),
    Row("full-order modes of the vehicle, refined", "s", "0.26", "vehicle", "refined"),
    Row("full-order modes of the vehicle, solved directly", "s", "", "vehicle", "direct"),
    Row("basis of the vehicle's search at the study's tolerance", "s", "34", "vehicle", "basis"),
    Row("basis of all effects of the vehicle", "s", "", "effects", "effects"),
    Row("calib explain studies/hidden_bogie, nothing kept", "s", "", "explain_bogie", "seconds"),
    Row("calib explain studies/hidden_effect, nothing kept", "s", "", "explain_vehicle", "seconds"),
    Row("both phases by method auto, nothing kept", "s", "", "auto", "seconds"),
    Row("both phases as in the article, 60,000 individuals, 2 workers", "s", "", "genetic", "seconds"),
    Row("40 real modes at full order, matrices at hand", "s", "", "modes", "own"),
    Row("the same by scipy eigsh", "s", "", "modes", "eigsh"),
    Row("40 real modes at full order, assembled anew", "s", "", "modes", "own_anew"),
    Row("the same by scipy eigsh", "s", "", "modes", "eigsh_anew"),
    Row("124k degrees of freedom: training at 8 points", "s", "", "fine", "training"),
    Row("124k degrees of freedom: peak memory of that", "MB", "", "fine", "own_mb"),
)
FACTOR = {"ms": 1e3, "s": 1.0, "MB": 1.0}


def main() -> None:
    """Measure group by group, and write the table after each."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--before", metavar="COMMIT", help="a commit that takes turns with this checkout")
    arguments.add_argument("--rows", nargs="+", choices=GROUPS, metavar="NAME", help=f"of {', '.join(GROUPS)}")
    arguments.add_argument("--long", action="store_true", help="also what takes long")
    arguments.add_argument("--repeats", type=int, default=1, help="turns of each group; the fastest counts")
    arguments.add_argument("--table", type=Path, help="write this CSV file, and a Markdown file beside it")
    given = arguments.parse_args()
    chosen = given.rows or [name for name, group in GROUPS.items() if given.long or not group.long]
    page, found = Page(), dict[tuple[str, str], dict[str, float]]()
    page.begin("Speeds, before and after")
    with checked_out(given.before) as before:
        for name in chosen:
            for _ in range(given.repeats):
                for side, checkout in (("before", before), ("after", ROOT)):
                    if checkout is not None:
                        taken = measured(GROUPS[name], checkout)
                        known = found.setdefault((side, name), taken)
                        known.update({key: min(value, known[key]) for key, value in taken.items()})
            page.table(COLUMNS, rows_of(found, [name]))
            if given.table:
                write(given.table, rows_of(found, list(GROUPS)))
    page.table(COLUMNS, rows_of(found, list(GROUPS)))
    page.say(
        "Smallest of the turns, wall clock. The ratio is before over after. CalculiX and OpenSees: see full_order.py."
    )


def rows_of(found: dict[tuple[str, str], dict[str, float]], groups: list[str]) -> list[tuple[str, ...]]:
    """Rows of the groups that were measured."""
    out = []
    for row in ROWS:
        pair = [found.get((side, row.group), {}).get(row.name) for side in ("before", "after")]
        if row.group in groups and pair[1] is not None:
            cells = ["" if v is None else short(FACTOR[row.unit] * v) for v in pair]
            ratio = "" if pair[0] is None else short(pair[0] / pair[1])
            out.append((f"{row.words} ({row.unit})", row.wanted, *cells, ratio))
    return out


def write(file: Path, rows: list[tuple[str, ...]]) -> None:
    """The table as CSV, and as Markdown beside it."""
    with file.open("w", encoding="utf-8", newline="") as out:
        csv.writer(out, lineterminator="\n").writerows([COLUMNS, *rows])
    beside = file.with_suffix(".md")
    beside.unlink(missing_ok=True)
    Page(beside).table(COLUMNS, rows)


def measured(group: Group, checkout: Path) -> dict[str, float]:
    """What a group takes with the code of a checkout; those of `growth.py` as processor and wall times."""
    script = HERE / ("growth.py" if group.arguments[0] == "--size" else "measures.py")
    paths = os.pathsep.join([str(checkout), str(HERE)])
    done = subprocess.run(
        [sys.executable, str(script), *group.arguments], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True,
        env={**os.environ, "PYTHONPATH": paths, "PYTHONSAFEPATH": "1"},
    )  # fmt: skip
    taken = json.loads(done.stdout.splitlines()[-1])
    return {key: float(value[0] if isinstance(value, list) else value) for key, value in taken.items()}


@contextmanager
def checked_out(commit: str | None) -> Iterator[Path | None]:
    """A commit in a temporary folder, as a worktree of this repository; None without one."""
    if commit is None:
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "before"
        subprocess.run(["git", "worktree", "add", "--detach", "--quiet", str(place), commit], cwd=ROOT, check=True)
        try:
            yield place
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(place)], cwd=ROOT, check=True)


if __name__ == "__main__":
    main()
