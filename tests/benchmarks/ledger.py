"""Time and size of a ledger: what a search and a least-squares fit ask of it, beside the ledger of another checkout.

    python tests/benchmarks/ledger.py [--beside CHECKOUT] [--generations 250] [--write FILE]

Each checkout has a process of its own; the two take turns, generation by generation. The numbers are random.
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from page import Page
from stopwatch import HEADER, Spent, compared, short, spent

import calib
from calib.execution.outcome import Outcome, point_key
from calib.results.ledger import Individual, Ledger

POPULATION = 30
PARAMETERS, RESPONSES = 16, 48
ROWS, COLUMNS, EVERY = 496, 9, 5
"""Of a Jacobian, and the number of generations for each: the sizes of the bogie."""

TASKS = {
    "append": f"{POPULATION} evaluations added one by one",
    "lookup": f"{POPULATION} evaluations looked up",
    "record": f"a generation of {POPULATION} recorded",
    "again": "the same recorded again",
    "history": "history of the run so far",
    "count": "evaluations counted",
    "keep": f"a Jacobian of {ROWS} rows and {COLUMNS} columns stored",
    "vectors": "the same read",
}


def main() -> None:
    """Both sides in turn, then their files."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--beside", type=Path, help="another checkout of calib, with which this one is compared")
    arguments.add_argument("--generations", type=int, default=250, help=f"of {POPULATION} evaluations (default 250)")
    arguments.add_argument("--write", type=Path, help="append the tables to this file")
    arguments.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.serve:
        serve(given.serve)
        return
    page, here = Page(given.write), Path(__file__).resolve().parents[2]
    page.begin("The ledger")
    checkouts = {"beside": given.beside.resolve()} if given.beside else {}
    checkouts["here"] = here
    with tempfile.TemporaryDirectory() as folder:
        files = {side: Path(folder) / f"{side}.sqlite" for side in checkouts}
        sides = {side: Side(checkout, files[side]) for side, checkout in checkouts.items()}
        times: dict[str, dict[str, list[Spent]]] = {task: {side: [] for side in sides} for task in TASKS}
        for generation in range(given.generations):
            for task, per_side in times.items():
                for side, its in sides.items():
                    found = its.ask(task, generation)
                    if found is not None:
                        per_side[side].append(Spent(*found))
        for side in sides.values():
            side.end()
        for task, words in TASKS.items():
            page.say(words)
            page.table(HEADER, compared(times[task]))
        evaluations = POPULATION * given.generations
        for side, file in files.items():
            page.say(f"{side}: {file.stat().st_size / 1e6:.1f} MB, {evaluations} evaluations")
            page.table(("table or index", "MB", "bytes an evaluation"), parts_of(file, evaluations))


class Side:
    """The ledger of a checkout, in a process of its own."""

    def __init__(self, checkout: Path, file: Path):
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--serve", str(file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(checkout)},
        )
        used = Path(self._line()).parents[1]
        assert used == checkout, f"{checkout} is asked, and {used} answers"

    def _line(self) -> Any:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def ask(self, task: str, generation: int) -> list[float] | None:
        """Wall-clock and processor seconds of a task; None where this generation has none."""
        assert self.process.stdin is not None
        print(task, generation, file=self.process.stdin, flush=True)
        return self._line()

    def end(self) -> None:
        """Close the ledger."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        assert self.process.wait() == 0


def serve(file: Path) -> None:
    """Perform tasks named on the input until it ends."""
    print(json.dumps(calib.__file__), flush=True)
    with Ledger.open(file) as ledger:
        for line in sys.stdin:
            task, generation = line.split()
            work = prepared(ledger, task, int(generation))
            print(json.dumps(None if work is None else spent(work)), flush=True)


def prepared(ledger: Ledger, task: str, generation: int) -> Callable[[], object] | None:
    """A task with its data at hand."""
    outcomes = outcomes_of(generation)
    keys = [point_key(outcome.values) for outcome in outcomes]
    if task == "append":
        return lambda: [ledger.append("model", [outcome]) for outcome in outcomes]
    if task == "lookup":
        return lambda: ledger.lookup("model", keys)
    if task in ("record", "again"):
        misfits = [outcome.responses["response_0"] for outcome in outcomes]
        individuals = [Individual(key, "ok", misfit) for key, misfit in zip(keys, misfits, strict=True)]
        return lambda: ledger.record("run", "model", generation, individuals)
    if task == "history":
        return lambda: ledger.history("run")
    if task == "count":
        return lambda: ledger.count("model")
    if generation % EVERY:
        return None
    columns = np.random.default_rng(generation).normal(size=(COLUMNS, ROWS))
    vectors = {f"parameter_{k}": column for k, column in enumerate(columns)}
    if task == "keep":
        return lambda: ledger.keep_vectors("rows", keys[0], vectors)
    return lambda: ledger.vectors("rows", keys[0], list(vectors))


def outcomes_of(generation: int) -> list[Outcome]:
    """Evaluations of a generation, which depend on its number alone."""
    rng = np.random.default_rng([generation, 1])
    return [
        Outcome(
            {f"parameter_{k}": float(v) for k, v in enumerate(rng.uniform(1.0, 1e4, PARAMETERS))},
            "ok",
            {f"response_{k}": float(v) for k, v in enumerate(rng.uniform(0.0, 40.0, RESPONSES))},
            "",
            0.03,
        )
        for _ in range(POPULATION)
    ]


def parts_of(file: Path, evaluations: int) -> list[tuple[str, str, str]]:
    """Size of every table and index of 8 kB or more."""
    with closing(sqlite3.connect(file)) as database:
        found = database.execute("SELECT name, SUM(pgsize) FROM dbstat GROUP BY name ORDER BY 2 DESC").fetchall()
    rows = [(name, f"{size / 1e6:.2f}", short(size / evaluations)) for name, size in found if size >= 8192]
    total = sum(size for _, size in found)
    return [*rows, ("all", f"{total / 1e6:.2f}", short(total / evaluations))]


if __name__ == "__main__":
    main()
