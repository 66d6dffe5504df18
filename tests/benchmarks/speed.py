"""The table of speeds: how long everything takes that an engineer waits for, before and after a change.

    python tests/benchmarks/speed.py [--before COMMIT] [--rows NAME ...] [--long] [--table FILE]

``--before`` is another commit of this repository, checked out into a temporary folder; it takes turns with this
checkout, group by group, so that a busy machine slows both. `waits.py` measures both sides; other rows that commit
measures of itself, by its own scripts and studies, since names of modules change. Wall clock and processor time, the
latter of all processes together, which are as many as by default; on a busy machine believe the processor time.
``--table`` names the CSV file; the Markdown table stands beside it. What takes long is measured on request.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
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
COLUMNS = (
    "measure", "wanted, wall clock", "before", "before, processor", "after", "after, processor", "ratio",
    "ratio, processor",
)  # fmt: skip
NAN = float("nan")


class Row(NamedTuple):
    """A row: its measure in words, unit, what is wanted, group of measures and name in it."""

    words: str
    unit: str
    wanted: str
    group: str
    name: str


class Group(NamedTuple):
    """Measures that one process takes, with the arguments of a script."""

    arguments: tuple[str, ...]
    long: bool = False
    script: str = "measures.py"


GROUPS = {
    **{name: Group((name,), script="waits.py") for name in ("imports", "compare", "explain", "spearman")},
    **{name: Group((name,), long=True, script="waits.py") for name in ("plate", "wide", "parts")},
    "modes": Group(("modes",), script="waits.py"),
    "opensees": Group(("opensees",)),
    "calculix": Group(("calculix",)),
    "vehicle": Group(("vehicle",)),
    "matrices": Group(("matrices",)),
    "sensors": Group(("sensors",), long=True),
    "effects": Group(("effects",)),
    "auto": Group(("auto",), long=True),
    "explain_vehicle": Group(("commands", "explain studies/hidden_effect"), long=True),
    "genetic": Group(
        ("commands", "calibrate studies/bogie --workers 2", "calibrate studies/vehicle --workers 2"), long=True
    ),
    "fine": Group(("--sizes", "1", "4", "--samples", "8"), long=True, script="growth.py"),
    "fine_explain": Group(("finer", "studies/hidden_effect", "refine=1", "refine=4"), long=True),
}
ROWS = (
    Row("import calib; calib.Problem", "s", "0.4x", "imports", "seconds"),
    Row("calib compare studies/bogie, first: answer printed", "s", "0.4x", "compare", "answer"),
    Row("figures drawn, end", "s", "", "compare", "first"),
    Row("again, unchanged: answer printed", "s", "0.15x", "compare", "answer_again"),
    Row("end", "s", "", "compare", "again"),
    Row("calib explain studies/hidden_bogie, nothing kept: answer printed", "s", "0.4x", "explain", "answer"),
    Row("figures drawn, end", "s", "", "explain", "first"),
    Row("the same, bases kept: answer printed", "s", "0.3x", "explain", "answer_kept"),
    Row("figures drawn, end", "s", "", "explain", "kept"),
    Row("Spearman, 100 inputs, 300 responses, 500 samples", "s", "0.02", "spearman", "seconds"),
    Row(
        "plate of 4,800 degrees of freedom, 14 parts, one damped: calibrate and explain, over one solution by eigsh",
        "",
        "100",
        "plate",
        "solutions",
    ),
    Row("peak memory of that", "MB", "300", "plate", "own_mb"),
    Row("explain without a list, 10k degrees of freedom, 10 parts", "s", "0.3x", "wide", "explain"),
    Row("explain without a list, 1.9k degrees of freedom, 100 parts", "s", "0.2x", "parts", "explain"),
    Row("peak memory of that", "MB", "400", "parts", "own_mb"),
    Row("one reduced evaluation of the vehicle", "ms", "10 to 12", "vehicle", "evaluation"),
    Row("full-order modes of the vehicle, refined", "s", "0.26", "vehicle", "refined"),
    Row("full-order modes of the vehicle, solved directly", "s", "", "vehicle", "direct"),
    Row("basis of the vehicle's search at the study's tolerance", "s", "20", "vehicle", "basis"),
    Row("basis of all effects of the vehicle", "s", "120", "effects", "effects"),
    Row("calib explain studies/hidden_effect, nothing kept", "s", "120", "explain_vehicle", "seconds"),
    Row("both phases by method auto, one case each, nothing kept", "s", "60", "auto", "one"),
    Row("both phases by method auto, four cases each, nothing kept", "s", "", "auto", "four"),
    Row("both phases as in the article, 60,000 individuals, 2 workers", "s", "240", "genetic", "seconds"),
    Row("20 real modes of a matrix model, 10k degrees of freedom", "s", "", "matrices", "one"),
    Row("its derivatives of 10 modes by 8 parameters", "s", "", "matrices", "slopes"),
    Row("its calibration, 8 parameters, nothing kept", "s", "", "matrices", "calibrate"),
    Row("the same over one solution", "", "6", "matrices", "solutions"),
    Row("static vectors with a damped strip of 885 degrees of freedom", "", "60", "matrices", "strip_vectors"),
    Row("what they take", "s", "", "matrices", "strip"),
    Row("500 sensors, 100 modes, 2k degrees of freedom: compare", "s", "10", "sensors", "compare"),
    Row("the same: calibrate 10 parameters", "s", "120", "sensors", "calibrate"),
    Row("peak memory of that", "MB", "2048", "sensors", "own_mb"),
    Row("40 real modes at full order, matrices at hand", "s", "", "modes", "own"),
    Row("the same by scipy eigsh", "s", "", "modes", "eigsh"),
    Row("eigsh over ours", "", "2.8", "modes", "faster"),
    Row("20 damped modes at full order, assembled anew", "s", "0.7x", "modes", "damped"),
    Row("the same by OpenSees, model built before", "s", "", "opensees", "solved"),
    Row("40 real modes at full order, assembled anew", "s", "", "modes", "own_anew"),
    Row("the same by scipy eigsh", "s", "", "modes", "eigsh_anew"),
    Row("the same by OpenSees, model built anew", "s", "", "opensees", "anew"),
    Row("the same by CalculiX, which always reads and assembles", "s", "", "calculix", "anew"),
    Row("of which CalculiX takes for a single mode", "s", "", "calculix", "one"),
    Row("124k degrees of freedom: training at 8 points", "s", "told", "fine", "training"),
    Row("124k degrees of freedom: peak memory of that", "MB", "told", "fine", "own_mb"),
    Row("exponent of its growth from 10k degrees of freedom", "", "1.3", "fine", "growth_training"),
    Row("exponent of the growth of a damped solution at full order", "", "1.3", "fine", "growth_solve"),
    Row("exponent of the growth of an answer on the basis", "", "1.3", "fine", "growth_answer"),
    Row("124k degrees of freedom: calib explain, nothing kept", "s", "told", "fine_explain", "seconds"),
    Row("124k degrees of freedom: peak memory of its largest process", "MB", "6000", "fine_explain", "child_mb"),
    Row("exponent of its growth from 10k degrees of freedom", "", "1.3", "fine_explain", "growth"),
)
FACTOR = {"ms": 1e3, "s": 1.0, "MB": 1.0, "": 1.0}

Cell = tuple[float, float] | str
"""Wall clock and processor time, or something else and NaN; or words where nothing can be measured."""


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
    page, found = Page(), dict[tuple[str, str], dict[str, Cell]]()
    page.begin("Speeds, before and after")
    with checked_out(given.before) as before:
        for name in chosen:
            for _ in range(given.repeats):
                for side, checkout in (("before", before), ("after", ROOT)):
                    if checkout is not None:
                        taken = measured(GROUPS[name], checkout)
                        known = found.setdefault((side, name), taken)
                        known.update({key: least(value, known[key]) for key, value in taken.items()})
            page.table(COLUMNS, rows_of(found, [name]))
            if given.table:
                write(given.table, rows_of(found, list(GROUPS)))
    page.table(COLUMNS, rows_of(found, list(GROUPS)))
    page.say("Smallest of the turns. A ratio is before over after. More on other codes: full_order.py.")


def least(one: Cell, other: Cell) -> Cell:
    """The smaller one, of wall clock and of processor time apart."""
    if isinstance(one, str) or isinstance(other, str):
        return one
    return min(one[0], other[0]), min(one[1], other[1])


def rows_of(found: dict[tuple[str, str], dict[str, Cell]], groups: list[str]) -> list[tuple[str, ...]]:
    """Rows of the groups that were measured."""
    out = []
    for row in ROWS:
        before, after = (found.get((side, row.group), {}).get(row.name) for side in ("before", "after"))
        if row.group not in groups or after is None:
            continue
        words = f"{row.words} ({row.unit})" if row.unit else row.words
        cells = [told(side, k, FACTOR[row.unit]) for side in (before, after) for k in (0, 1)]
        both = not (before is None or isinstance(before, str) or isinstance(after, str))
        ratios = [told((before[k] / after[k], NAN), 0, 1.0) if both else "" for k in (0, 1)]
        out.append((words, row.wanted, *cells, *ratios))
    return out


def told(cell: Cell | None, which: int, factor: float) -> str:
    """Wall clock (0) or processor time (1) of a cell in words; empty where there is none."""
    if cell is None or isinstance(cell, str):
        return (cell or "") if which == 0 else ""
    return "" if math.isnan(cell[which]) else short(factor * cell[which])


def write(file: Path, rows: list[tuple[str, ...]]) -> None:
    """The table as CSV, and as Markdown beside it."""
    with file.open("w", encoding="utf-8", newline="") as out:
        csv.writer(out, lineterminator="\n").writerows([COLUMNS, *rows])
    beside = file.with_suffix(".md")
    beside.unlink(missing_ok=True)
    Page(beside).table(COLUMNS, rows)


def measured(group: Group, checkout: Path) -> dict[str, Cell]:
    """What a group takes with the code of a checkout; nothing where that code lacks the measure."""
    scripts = HERE if group.script == "waits.py" else checkout / HERE.relative_to(ROOT)
    paths = os.pathsep.join([str(checkout), str(scripts)])
    done = subprocess.run(
        [sys.executable, str(scripts / group.script), *group.arguments],
        cwd=ROOT, stdout=subprocess.PIPE, text=True, check=checkout == ROOT,
        env={**os.environ, "PYTHONPATH": paths, "PYTHONSAFEPATH": "1"},
    )  # fmt: skip
    if done.returncode:
        return {}
    taken = json.loads(done.stdout.splitlines()[-1])
    return {key: cell_of(value) for key, value in taken.items()}


def cell_of(value: list[float] | float | str) -> Cell:
    """What a script told of one measure."""
    if isinstance(value, list):
        return float(value[0]), float(value[1])
    return value if isinstance(value, str) else (float(value), NAN)


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
