"""How often the search for a missing effect is right on blind tires.

    python tests/benchmarks/tire_rates.py run --runs 72
    python tests/benchmarks/tire_rates.py report --write docs/rates_tire.csv

A tire of ``studies/hidden_tire`` is drawn anew in every run: parameters, effect and its magnitude, noise. It is
measured at 100 and 200 kPa; its mesh has 53 x 36 cells, the fitted one 29 x 16, corrected by one of 49 x 32 at nominal
values. Kinds take turns: each effect of the library, three designs that are in no library, and nothing. A line is
appended to ``results/rates_tire/runs.jsonl`` for each; started again it goes on. An effect counts as visible from an
expected score of 6 on: the length of the change that it makes to the measured values and the parameters cannot absorb.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import multiprocessing
import time
import warnings
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import date
from functools import cache
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
from other_methods import answers, hypotheses_of
from rates_subject import ROOT
from rates_table import Rate, codes, methods_file, report_methods, write_rates
from rates_world import digest_of
from scipy.stats import beta

import calib
from calib.errors.errors import EvaluationError
from calib.measurement.responses import MeasuredResponses
from calib.study.loading import module_of
from calib.study.study_text import read_settings

FOLDER = ROOT / "studies/hidden_tire"
MESH = (53, 36)
PRESSURES = (100.0, 200.0)
VISIBLE = 6.0
SOURCES = ("models/tire", "studies/hidden_tire")
"""What a run depends on beside the code that answers."""


@cache
def twin() -> Any:
    """The generator of the study."""
    return module_of(FOLDER / "make_twin.py")


def plan():
    """(kind, design, number) without end: every effect, every other design and nothing, in turn."""
    effects = [e.name for e in twin().tire_effects()]
    outside = twin().remodelled.OUTSIDE
    for number in count():
        yield from (("effect", name, number) for name in effects)
        yield ("outside", outside[number % len(outside)], number)
        yield ("nothing", "", number)


def one(kind: str, design: str, number: int) -> dict[str, Any]:
    """Draw a tire, measure it, and ask what its model lacks."""
    make, begun = twin(), time.process_time()
    claimed = read_settings(FOLDER / "study.toml").tests[0].accuracy
    rng = np.random.default_rng([number, *kind.encode(), *design.encode()])
    truth = make.draw(rng, kind, design)
    row: dict[str, Any] = {
        "kind": kind, "design": design, "number": number, "designs": dict(truth.designs), "code": digest_of(SOURCES),
        "date": date.today().isoformat(),
    }  # fmt: skip
    try:
        exact, row["visible"] = make.exact(truth, PRESSURES, MESH), 0.0
        if truth.designs:
            plain = make.exact(make.bare(truth), PRESSURES, MESH)
            row["visible"] = make.visible(truth, exact, plain, dict.fromkeys(PRESSURES, make.MEASURED), claimed)
        tests = [
            calib.ResponseTest(
                measured(make.repeats(exact[p], rng)), name=f"{p:g}kPa", condition={"pressure": p},
                accuracy=claimed,
            )
            for p in PRESSURES
        ]  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            fit = calib.Problem(make.study.tire(), tests).calibrate(starts=1, progress=False)
            found = fit.explain(list(make.tire_effects()), progress=False)
            row["seconds"] = time.process_time() - begun
            decision = found.explanation.explanation
            row |= answers(decision, hypotheses_of(decision), Hidden(dict(truth.designs)))
    except EvaluationError as fault:
        return row | {"verdict": f"failed: {fault}"}
    naming = found.verdict in ("effect", "indistinguishable", "two_effects", "several_effects")
    return row | {
        "verdict": found.verdict, "named": list(found.explanation.explanation.equally_good) if naming else [],
    }  # fmt: skip


@dataclass(frozen=True)
class Hidden:
    """Designs of a tire by their magnitudes, as `rates_outcome.Truth`."""

    values: Mapping[str, float]

    @property
    def hidden(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(self.values)


def as_row(row: dict[str, Any]) -> dict[str, Any]:
    """A run as `rates_table` counts it."""
    group = "single" if row["kind"] == "effect" else row["kind"]
    return row | {"group": group, "visible": [row["visible"]] if row.get("visible") else []}


def measured(table: np.ndarray) -> MeasuredResponses:
    """Mean of the repeats (n_repeats, n_responses) and its standard deviation."""
    names, spread = twin().MEASURED, table.std(axis=0, ddof=1) / np.sqrt(len(table))
    return MeasuredResponses(
        {n: (float(m), float(s)) for n, m, s in zip(names, table.mean(axis=0), spread, strict=True)},
        dict.fromkeys(names, len(table)),
    )


def run(given: argparse.Namespace) -> None:
    """Make the runs that are not there yet."""
    file: Path = given.folder / "runs.jsonl"
    file.parent.mkdir(parents=True, exist_ok=True)
    done = {(r["kind"], r["design"], r["number"]) for r in lines(file)}
    wanted = [key for key in islice(plan(), given.runs) if key not in done]
    print(f"{len(wanted)} of {given.runs} runs to make", flush=True)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.workers, context) as pool, file.open("a", encoding="utf-8") as out:
        for future in as_completed([pool.submit(one, *key) for key in wanted]):
            row = future.result()
            out.write(json.dumps(row) + "\n")
            out.flush()
            print(
                row["kind"], row["design"], f"{row.get('visible', 0):.1f}", row["verdict"], row.get("named"), flush=True
            )


def lines(file: Path) -> list[dict[str, Any]]:
    """All runs made so far."""
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def report(given: argparse.Namespace) -> None:
    """Counts by design with 95 % bounds of their sums (Clopper and Pearson 1934)."""
    rows = lines(given.folder / "runs.jsonl")
    if given.write is not None:
        write_rates(rates(rows), given.write, codes(rows), rows[-1]["date"])
    report_methods([as_row(r) for r in rows], methods_file(given.write), rows[-1]["date"] if rows else "")
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        name = row["design"] or "nothing"
        if row["kind"] == "effect":
            name += ", visible" if row["visible"] >= VISIBLE else ", hardly visible"
        groups.setdefault(name, []).append(row)
    total: Counter[str] = Counter()
    print(f"{'hidden':32s}{'runs':>6s}{'right':>7s}{'among':>7s}{'wrong':>7s}{'silent':>8s}{'unnamed':>9s}")
    for name, own in sorted(groups.items()):
        counts = Counter(outcome(row) for row in own)
        total.update({f"{name.split(', ')[-1] if ', ' in name else own[0]['kind']} {k}": n for k, n in counts.items()})
        print(f"{name:32s}{len(own):6d}" + "".join(
            f"{counts[k]:{w}d}" for k, w in (("right", 7), ("among", 7), ("wrong", 7), ("silent", 8), ("unnamed", 9))
        ))  # fmt: skip
    for group in ("visible", "hardly visible", "outside", "nothing"):
        own = {k.removeprefix(f"{group} "): n for k, n in total.items() if k.startswith(f"{group} ")}
        runs = sum(own.values())
        for kind in ("right", "among", "wrong"):
            if runs:
                low, high = bounds(own.get(kind, 0), runs)
                print(f"{group}: {kind} {own.get(kind, 0)} of {runs} (95 %: {low:.0%} to {high:.0%})")


def rates(rows: list[dict[str, Any]]) -> list[Rate]:
    """Counts that the documents tell, each with the share that is required."""
    effects = [r for r in rows if r["kind"] == "effect"]
    seen = [r for r in effects if r["visible"] >= VISIBLE]
    outside = [r for r in rows if r["kind"] == "outside"]
    nothing = [r for r in rows if r["kind"] == "nothing"]

    def rate(hidden: str, verdict: str, required: float, at_least: bool, some: list, *outcomes: str) -> Rate:
        return Rate(hidden, verdict, required, at_least, sum(outcome(r) in outcomes for r in some), len(some))

    return [
        rate(f"one effect, expected score {VISIBLE:g} or more", "names it rightly", 0.90, True, seen, "right"),
        rate("one effect of any magnitude", "names a wrong effect", 0.02, False, effects, "wrong"),
        rate("something that is not on the list", "names something", 0.02, False, outside, "right", "among", "wrong"),
        rate("nothing", "says that something is missing", 0.03, False, nothing, "right", "among", "wrong", "unnamed"),
    ]


def outcome(row: dict[str, Any]) -> str:
    """Right: that effect alone; among: it and others that the data cannot tell from it; wrong: only others."""
    named = row.get("named") or []
    if row["verdict"] == "nothing_detectable":
        return "silent"
    if not named:
        return "unnamed"
    if named == [row["design"]]:
        return "right"
    return "among" if row["design"] in named else "wrong"


def bounds(hits: int, runs: int) -> tuple[float, float]:
    """95 % bounds of a rate."""
    low = beta.ppf(0.025, hits, runs - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, runs - hits) if hits < runs else 1.0
    return float(low), float(high)


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--runs", type=int, default=72, help="how many runs of the plan (default 72)")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results/rates_tire")
    arguments.add_argument("--write", type=Path, help="where the counts go as CSV, for the documents")
    given = arguments.parse_args()
    run(given) if given.what == "run" else report(given)


if __name__ == "__main__":
    main()
