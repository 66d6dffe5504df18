"""How often the search for a missing effect is right, with everything that should fool it.

    python tests/benchmarks/rates.py run --of bogie --runs 300 --workers 2
    python tests/benchmarks/rates.py report --of bogie --write docs/rates_bogie.csv
    python tests/benchmarks/rates.py report --of panel --write docs/rates_panel.csv

``run`` makes the first so many runs of a plan that never changes and appends a line for each to
``results/rates_bogie/runs.jsonl``; started again it goes on where it stopped. Seeds belong to the runs, whatever the
number of workers. Lines made with other code are kept and not counted (``report --code all`` counts them). Effects that
leave no trace are run like all others: nobody knows beforehand. Each solar array (``--of panel``) is one run, explained
in four ways, and each bogie of ``--of bogie_frf`` one in two; their report is one table for each way, and writes one
file for each: ``docs/rates_panel_modes.csv`` and so on. ``--executor dask`` or ``dask://HOST:PORT`` has a cluster make
the runs, whose workers find these scripts and the folder at the same paths; a run that loses its worker is made again.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import contextlib
import functools
import importlib
import json
import multiprocessing
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import date
from itertools import islice
from pathlib import Path
from typing import Any

from chain_rates import ChainWorld
from rates_beside import report_alike, report_widths
from rates_bogie_frf import BogieWorld
from rates_faults import FaultyFrameWorld, FaultyWorld
from rates_frame import FrameWorld
from rates_frame_frf import FRFFrameWorld
from rates_panel import PanelWorld
from rates_scenarios import Scenario, rounds
from rates_subject import ROOT, SUBJECTS, Subject
from rates_table import report
from rates_world import World, code_digest

from calib.execution.executor import Injected

AnyWorld = World | PanelWorld | ChainWorld


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--of", choices=tuple(SUBJECTS), default="bogie", help="what is measured (default bogie)")
    arguments.add_argument("--runs", type=int, default=300, help="how many runs of the plan (default 300)")
    arguments.add_argument("--skip", type=int, default=0, help="leave out so many runs at the beginning of the plan")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--executor", metavar="NAME", help="dask, with so many workers here, or dask://HOST:PORT")
    arguments.add_argument("--only", help="run only scenarios whose name begins so")
    arguments.add_argument("--folder", type=Path, help="where runs and bases are kept (default results/rates_...)")
    arguments.add_argument("--code", help="report only lines of this code, or 'all' (default: the latest)")
    arguments.add_argument("--write", type=Path, help="report: also write the counts as CSV, docs/rates_bogie.csv")
    arguments.add_argument("--beside", type=Path, help="report: the runs.jsonl of another count of the same structures")
    given = arguments.parse_args()
    subject = SUBJECTS[given.of]
    folder = given.folder or ROOT / "results" / f"rates_{subject.name}"
    if given.what == "report":
        file = folder / "runs.jsonl"
        made = date.fromtimestamp(file.stat().st_mtime).isoformat() if file.exists() else ""
        report_of(subject, list(lines(file)), given.code, given.write, made)
        if given.beside:
            report_alike(lines(file), lines(given.beside))
        return
    make(subject, folder, given.runs, given.workers, given.skip, given.only or "", given.executor)


def make(
    subject: Subject, folder: Path, runs: int, workers: int, skip: int = 0, only: str = "", executor: str | None = None
) -> None:
    """Make those of the first so many runs of a subject's plan that the folder lacks."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "runs.jsonl"
    world = world_of(subject, folder, code_digest(subject))
    world.settle()
    done = {(row["scenario"], row["number"]) for row in lines(file) if row["code"] == world.code}
    chosen = ((s, k) for s, k in rounds(world.kinds) if not only or s.name.startswith(only))
    wanted = [(s, k) for s, k in islice(chosen, skip, skip + runs) if (s.name, k) not in done]
    print(f"code {world.code}: {len(wanted)} of {runs} runs to make", flush=True)
    started = time.perf_counter()
    with file.open("a", encoding="utf-8") as out:
        if out.tell() and not file.read_bytes().endswith(b"\n"):
            out.write("\n")  # the last line was cut off: it stands alone and is not read
        for k, row in enumerate(rows(world, wanted, workers, executor), 1):
            out.write(json.dumps(row) + "\n")
            out.flush()
            if k % 10 == 0:
                print(f"{k} runs, {(time.perf_counter() - started) / k:.1f} s each", flush=True)


def world_of(subject: Subject, folder: Path, code: str) -> AnyWorld:
    """The bench of a subject."""
    kinds: dict[str, type[AnyWorld]] = {
        "panel": PanelWorld, "bogie_frf": BogieWorld, "bogie_fault": FaultyWorld, "frame": FrameWorld,
        "frame_fault": FaultyFrameWorld, "frame_frf": FRFFrameWorld, "chain": ChainWorld,
    }  # fmt: skip
    return kinds.get(subject.name, World)(subject, folder, code)


def report_of(subject: Subject, found: list[dict[str, Any]], code: str | None, counts: Path | None, made: str) -> None:
    """The report of a subject, or one for each way with a file of its own."""
    if not subject.ways:
        report(found, code, counts, made)
        return
    apart = [by_way(row, subject.ways) for row in found]
    for way in subject.ways:
        print(f"\n== {way} ==")
        file = counts and counts.with_name(f"{counts.stem}_{way}{counts.suffix}")
        report([row[way] for row in apart], code, file, made)
    if len(subject.ways) == 2:
        report_widths({way: [row[way] for row in apart] for way in subject.ways})


def by_way(row: dict[str, Any], ways: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """The rows of one structure, as those of other subjects are; a run that broke is one of every way."""
    own = {k: v for k, v in row.items() if k not in ("ways", "seconds")}
    return {way: own | row["ways"][way] if "ways" in row else dict(row) for way in ways}


def lines(file: Path) -> Iterator[dict[str, Any]]:
    """What was run so far."""
    if file.exists():
        for line in file.read_text("utf-8").splitlines():
            try:
                yield json.loads(line)
            except json.JSONDecodeError:
                continue


def rows(
    world: AnyWorld, wanted: list[tuple[Scenario, int]], workers: int, executor: str | None = None
) -> Iterator[dict[str, Any]]:
    """Answers as they come."""
    asked = world.subject, world.folder, world.code
    if executor:
        yield from _by_cluster(Injected.of(executor, workers if executor == "dask" else None, print), asked, wanted)
    elif workers == 1:
        yield from (_made(world, s, k) for s, k in wanted)
    else:
        with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
            for future in as_completed([pool.submit(run_of, *asked, s, k) for s, k in wanted]):
                yield future.result()


def _by_cluster(
    chosen: Injected, asked: tuple[Subject, Path, str], wanted: list[tuple[Scenario, int]]
) -> Iterator[dict[str, Any]]:
    """Answers of a cluster. A run whose workers die again and again has failed; Dask tries four."""
    import distributed

    there = importlib.import_module("rates")  # workers import it, with the world that they keep
    with contextlib.closing(chosen):
        assert chosen.cluster is not None
        client = chosen.cluster.client()
        asking = {client.submit(there.run_of, *asked, s, k, pure=False): (s, k) for s, k in wanted}
        for future in distributed.as_completed(asking, loop=client.loop):
            try:
                yield future.result()
            except distributed.KilledWorker as fault:
                yield _failed(asked[2], *asking[future], fault)
            except (OSError, distributed.CancelledError):
                raise chosen.cluster.lost() from None


@functools.lru_cache(maxsize=1)
def _settled(subject: Subject, folder: Path, code: str) -> AnyWorld:
    """The bench of a worker process."""
    if code_digest(subject) != code:
        raise RuntimeError("the code changed meanwhile: start again")
    world = world_of(subject, folder, code)
    world.settle()
    return world


def run_of(subject: Subject, folder: Path, code: str, scenario: Scenario, number: int) -> dict[str, Any]:
    """One run, in a worker process."""
    return _made(_settled(subject, folder, code), scenario, number)


def _made(world: AnyWorld, scenario: Scenario, number: int) -> dict[str, Any]:
    """One run; whatever breaks in it is a row with its traceback, and no reason to lose the others."""
    try:
        return world.run(scenario, number)
    except Exception as fault:
        return _failed(world.code, scenario, number, fault)


def _failed(code: str, scenario: Scenario, number: int, fault: Exception) -> dict[str, Any]:
    """The row of a run that broke, while its exception is handled."""
    row = {"code": code, "scenario": scenario.name, "number": number, "group": scenario.group}
    told = {"error": f"{type(fault).__name__}: {fault}", "traceback": traceback.format_exc()}
    return row | {"verdict": "failed", "outcome": "failed"} | told


if __name__ == "__main__":
    main()
