"""Missing physics in a thousand blind measurements: this search and other methods on the same cases.

    python tests/benchmarks/missing_physics.py run --workers 2 --folder results/missing_physics
    python tests/benchmarks/missing_physics.py report --folder results/missing_physics

Cases follow a fixed plan with a seed each: bogies by modes, by FRFs and with faults of the test, whole vehicles, solar
arrays, tires, chains (functions) and frames (matrices). Started again, ``run`` goes on where it stopped. Each subject
has a folder with ``runs.jsonl``, as `rates.py` and `tire_rates.py` write it, so that what these have run counts too. A
solar array is counted by its modes and by FRFs whose channel errors the fit frees, a bogie measured by FRFs by these
alone.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path

import tire_rates
from rates import by_way, lines, make
from rates_subject import ROOT, SUBJECTS
from rates_table import DETECTABLE, Rate, Row, bound_of, codes, methods_file, rates, report_methods, write_rates

PLAN = {
    "bogie": 393, "bogie_fault": 39, "bogie_frf": 100, "panel": 110, "tire": 60, "chain": 250, "frame": 250,
    "frame_fault": 25, "vehicle": 60,
}  # fmt: skip
"""Cases of each subject."""
WAYS = {"bogie_frf": ("frfs",), "panel": ("modes", "freed")}
"""Ways of measuring that count, of subjects that have several."""


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results/missing_physics")
    arguments.add_argument("--only", choices=tuple(PLAN), nargs="*", help="subjects (default all)")
    arguments.add_argument("--most", type=int, help="run no more than so many cases of each subject")
    arguments.add_argument("--write", type=Path, help="report: also write the counts as CSV, docs/rates_all.csv")
    given = arguments.parse_args()
    plan = {name: min(n, given.most or n) for name, n in PLAN.items() if not given.only or name in given.only}
    if given.what == "run":
        run(plan, given.folder, given.workers)
    else:
        report(found(given.folder, plan), given.write)


def run(plan: Mapping[str, int], folder: Path, workers: int) -> None:
    """Make the cases of a plan that the folder lacks."""
    for name, count in plan.items():
        print(f"== {name} ==", flush=True)
        if name == "tire":
            tire_rates.run(argparse.Namespace(folder=folder / name, runs=count, workers=workers))
        else:
            make(SUBJECTS[name], folder / name, count, workers)


def found(folder: Path, names: Iterable[str] = PLAN) -> dict[str, list[Row]]:
    """Rows of each subject's latest code, by subject and way; those that broke are among them."""
    out: dict[str, list[Row]] = {}
    for name in names:
        rows = list(lines(folder / name / "runs.jsonl"))
        rows = [row for row in rows if row["code"] == rows[-1]["code"]]
        if name == "tire":
            rows = [tire_rates.as_row(row) for row in rows]
        ways = SUBJECTS[name].ways if name in SUBJECTS else ()
        for way in WAYS.get(name, ("",)):
            of_way = [by_way(row, ways)[way] for row in rows] if way else rows
            out[f"{name} {way}".strip()] = of_way
    return {name: rows for name, rows in out.items() if rows}


COUNTED = (
    (f"one effect, expected score {DETECTABLE:g} or more", "names it rightly"),
    ("one effect of any magnitude", "names a wrong effect"),
    ("something that is not on the list", "names something"),
    ("nothing", "says that something is missing"),
    ("one effect, named", "its 95 % interval covers the truth"),
    ("a measurement error", "names a wrong effect"),
)
"""Criteria of `rates_table.rates` that count over all subjects."""


def criteria(rows: Sequence[Row]) -> list[Rate]:
    """What is counted, with the value that is wanted."""
    by_title = {(rate.hidden, rate.verdict): rate for rate in rates(rows)}
    return [by_title[title] for title in COUNTED]


def report(found: Mapping[str, Sequence[Row]], write: Path | None = None) -> None:
    """Print counts by subject and in all, with what is wanted and one-sided 95 % bounds, and the methods' table."""
    # A tire's row has an outcome of its own words; the entry of the search in its methods has the common ones.
    told = {name: [r | r.get("methods", {}).get("this search", {}) for r in rows] for name, rows in found.items()}
    broken = {name: sum(r["verdict"].startswith("failed") for r in rows) for name, rows in told.items()}
    told = {name: [r for r in rows if not r["verdict"].startswith("failed")] for name, rows in told.items()}
    every = [r for rows in told.values() for r in rows]
    if not every:
        print("no runs yet")
        return
    print(f"{len(every)} cases; broken: {', '.join(f'{n} {k}' for n, k in broken.items() if k) or 'none'}\n")
    counted = {name: criteria(rows) for name, rows in {**told, "all": every}.items()}
    print(f"{'':24s}" + "".join(f"{f'({k})':>20s}" for k in range(1, len(counted["all"]) + 1)))
    for name, own in counted.items():
        print(f"{name:24s}" + "".join(f"{_cell(r):>20s}" for r in own))
    print()
    for k, r in enumerate(counted["all"], 1):
        sign, share = ">=" if r.at_least else "<=", f"{100 * r.count / r.n:.1f} %" if r.n else "-"
        bound = f", 95 % bound {100 * bound_of(r):.1f} %" if r.n else ""
        print(f"({k}) {r.hidden}: {r.verdict}; wanted {sign} {100 * r.required:.0f} %, counted {share}{bound}")
    made = [r for r in every if "methods" in r]
    today = date.today().isoformat()
    if write is not None:
        write_rates(counted["all"], write, codes(every), today)
    report_methods(made, methods_file(write), today)


def _cell(rate: Rate) -> str:
    return f"{rate.count}/{rate.n} ({100 * bound_of(rate):.0f} %)" if rate.n else "-"


if __name__ == "__main__":
    main()
