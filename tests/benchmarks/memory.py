"""Peak memory of what a study asks: one evaluation, the training of its basis, a search with two workers.

    python tests/benchmarks/memory.py [--study vehicle] [--generations 10] [--write FILE]

Each in a process of its own; the resident size holds the libraries and their shared pages. What the workers of a search
take is the larger one twice, so that the sum is an upper bound.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import tempfile
from pathlib import Path

from child import in_child, report
from page import Page
from stopwatch import short, spent
from subject import STUDIES, study_of

from calib.analyses.case import objective_of
from calib.analyses.provenance.places import open_evaluator
from calib.analyses.reduction import reduction_of
from calib.inference.cases import Case, run_case
from calib.inference.genetic import GeneticSettings
from calib.problem.sampling import sample
from calib.results.ledger import Ledger
from calib.results.results import Results

TASKS = {
    "imports": "the libraries alone",
    "evaluation": "one evaluation at full order",
    "training": "training of the basis",
    "search": "search on the basis",
}
WORKERS, POPULATION = 2, 30


def main() -> None:
    """One child a task."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--study", choices=STUDIES, default="vehicle")
    arguments.add_argument("--generations", type=int, default=10, help="of the search, populations of 30 (default 10)")
    arguments.add_argument("--write", type=Path, help="append the table to this file")
    arguments.add_argument("--task", nargs=2, metavar=("TASK", "FOLDER"), help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.task:
        took = spent(lambda: perform(given.task[0], given.study, Path(given.task[1]), given.generations))
        report(seconds=took.wall, processor=took.cpu)
        return
    page, rows = Page(given.write), []
    page.begin(f"Peak memory of the {given.study}")
    with tempfile.TemporaryDirectory() as folder:
        for task, words in TASKS.items():
            found = in_child(
                __file__, "--study", given.study, "--generations", given.generations, "--task", task, folder
            )  # fmt: skip
            workers = WORKERS if task == "search" else 0
            total = found["own_mb"] + workers * found["child_mb"]
            each = f"{found['child_mb']:.0f}" if workers else "-"
            rows.append((words, f"{found['own_mb']:.0f}", each, f"{total:.0f}", short(found["seconds"])))
    page.table(("", "process MB", f"each of {WORKERS} workers MB", "together at most MB", "wall s"), rows)


def perform(task: str, name: str, folder: Path, generations: int) -> None:
    """What a child does."""
    if task == "imports":
        return
    study = study_of(name)
    if task == "evaluation":
        study.problem.evaluate(study.model.space.values)
        return
    reduction = reduction_of(study, Results(folder))
    assert reduction is not None
    if task == "training":
        return
    space = study.search_space
    with (
        Ledger.open(folder / "ledger.sqlite") as ledger,
        open_evaluator(study, WORKERS, 1, reduction.problem, reduction.path) as evaluator,
    ):
        run_case(
            Case("X", 1), space, objective_of(study), GeneticSettings(POPULATION, generations), evaluator, ledger,
            reduction.problem.fingerprint, sample(space, POPULATION, 1).points, certify=reduction.certifier(ledger),
        )  # fmt: skip


if __name__ == "__main__":
    main()
