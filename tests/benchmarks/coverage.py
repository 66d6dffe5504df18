"""How often intervals of parameters and of predictions hold the truth where a misfit is left that nothing explains.

    python tests/benchmarks/coverage.py run --runs 65
    python tests/benchmarks/coverage.py report

Bogies of ``rates.py`` that have something outside the library, or an effect that is taken out of it, with an expected
score of 4 or more; ``--skip`` leaves out so many at the beginning. Each line of
``results/coverage_bogie/runs.jsonl`` is a run: the verdict, and of every parameter its true value, the interval of the
fit alone, that with the unexplained misfit (`calib.missing.discrepancy`), and that of the informed fit, whose model has
what is hidden. Of every value that the study holds out it has the group, the kind, whether each of the three intervals
of its prediction holds what is measured, and the widths of the first two over that of the third. What the informed fit
does not pair has no prediction to compare with.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rates import lines
from rates_outcome import Measured
from rates_scenarios import Scenario, rounds
from rates_subject import BOGIE, ROOT
from rates_table import Rate, bound_of
from rates_world import World, digest_of

from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import EvaluationError, InputError
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.modal import ModalAdapter
from calib.inference.rules import WIDE
from calib.missing.candidate_fit import CandidateFit
from calib.missing.decision import decide
from calib.missing.discrepancy import discrepancy_of, parameter_intervals
from calib.missing.explanation import UNEXPLAINED, Explanation
from calib.missing.facts import MeasurementFacts
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit
from calib.structure.effects.variants import Variants

VISIBLE = 4.0
"""Least expected score of what is hidden."""
ANSWERING = ("verify", "modal_adapter", "one_test")
"""Modules of `calib.analyses` that predict held-out data."""
FACTS = MeasurementFacts("", "", (), pd.DataFrame(), {}, 1, 10)
DRAWS = 4000
"""Sets of bogies drawn for bounds."""
ROW = ["mode", "sensor", "kind", "part"]
KINDS = {"alone": "", "unexplained": "_unexplained"}
"""Intervals of the fit, and what their columns end in."""


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--runs", type=int, default=65)
    arguments.add_argument("--skip", type=int, default=0)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results/coverage_bogie")
    given = arguments.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "runs.jsonl"
    if given.what == "report":
        rows = list(lines(file))
        report([row for row in rows if row["code"] == rows[-1]["code"]])
        return
    code = digest_of((*BOGIE.sources, *(f"calib/analyses/{name}.py" for name in ANSWERING)))
    world = World(BOGIE, given.folder, code)
    world.settle()
    made = {(row["scenario"], row["number"]) for row in lines(file) if row["code"] == world.code}
    with file.open("a", encoding="utf-8") as out:
        for scenario, number, measured, visible in islice(visible_runs(world), given.skip, given.skip + given.runs):
            if (scenario.name, number) in made:
                continue
            try:
                row = run(world, scenario, measured)
            except (EvaluationError, InputError, np.linalg.LinAlgError) as fault:
                row = {"verdict": "failed", "error": str(fault)}
            about = {"code": world.code, "scenario": scenario.name, "number": number, "visible": visible}
            out.write(json.dumps(about | row) + "\n")
            out.flush()


def visible_runs(world: World) -> Iterator[tuple[Scenario, int, Measured, float]]:
    """Measurements whose hidden design is visible, with its expected score."""
    for scenario, number in rounds([s for s in world.kinds if s.group in ("outside", "removed")]):
        try:
            measured = world.measure(scenario, number)
            visible = max(world._truth(scenario, measured)["visible"])
        except (EvaluationError, InputError, np.linalg.LinAlgError):
            continue
        if visible >= VISIBLE:
            yield scenario, number, measured, visible


def run(world: World, scenario: Scenario, measured: Measured) -> dict[str, Any]:
    """Intervals of one measurement."""
    pair = ModalResidual(world.specimen.problem(measured.whole))
    removed = measured.hidden if scenario.removed else ()
    hypotheses = ModelHypotheses(pair, world.libraries[scenario.library], world.space, without=removed)
    found = decide(hypotheses)
    hidden = tuple(world.effects[name] for name in measured.hidden)
    names = tuple(e.name for e in hidden)
    asked = ModelHypotheses(pair, Variants(world.model, hidden, (), None), world.space)
    start = {**found.base.fit.values, **{n: measured.values[n] for e in hidden for n in e.names}}
    right = least_squares_fit(asked.fit_problem(names), names, start)
    informed = intervals(right)
    told = parameter_intervals(found.base.fit, discrepancy_of(found)).set_index("parameter")
    parameters = {
        name: {
            "true": measured.values[name], "alone": own, "informed": informed[name],
            "unexplained": told.loc[name, ["low_unexplained", "high_unexplained"]].tolist() if len(told) else None,
        }
        for name, own in intervals(found.base.fit).items()
    }  # fmt: skip
    whole = world._whole(pair.problem, measured)
    fit_of_all = CandidateFit(hidden, right, 0.0, "")
    adapters = [ModalAdapter(one, (), FACTS, whole) for one in (hypotheses, asked)]
    held_out = predicted(found, adapters[0], adapters[1], fit_of_all)
    return {"verdict": found.verdict, "parameters": parameters, "held_out": held_out}


def predicted(
    found: Explanation, adapter: ModalAdapter, asked: ModalAdapter, right: CandidateFit
) -> list[dict[str, Any]]:
    """Held-out values with the intervals of their predictions; empty where no misfit is left."""
    wide = discrepancy_of(found)
    if wide is None:
        return []
    informed = {}
    for group, own in asked.held_out_of(right, 1.0).items():
        rows = own.intervals(own.spread).to_dict("records")
        kept = [True] * len(rows) if own.lost is None else (~own.lost).tolist()
        keys = [(group, r.mode, r.sensor, r.kind, r.part) for r in own.labels]
        informed |= {key: row for key, row, known in zip(keys, rows, kept, strict=True) if known}
    out = []
    for row in adapter.predictions(found.base, wide, found.noise_scale)[0].to_dict("records"):
        best = informed.get((row["group"], *(row[name] for name in ROW)))
        if best is None:
            continue
        one = {"group": row["group"], "kind": row["kind"], "informed": bool(best["inside"])}
        for kind, end in KINDS.items():
            width = (row[f"high{end}"] - row[f"low{end}"]) / (best["high"] - best["low"])
            one |= {kind: bool(row[f"inside{end}"]), f"{kind}_width": round(width, 3)}
        out.append(one)
    return out


def intervals(fit: LinearisedFit) -> dict[str, list[float]]:
    """95 % intervals of the fitted parameters, within their limits."""
    out = {}
    for name, std in zip(fit.names, np.sqrt(np.diag(fit.covariance)).tolist(), strict=True):
        p, value = fit.fit_problem.space[name], fit.values[name]
        out[name] = [max(value - WIDE * std, p.lower), min(value + WIDE * std, p.upper)]
    return out


def report(rows: list[dict[str, Any]]) -> None:
    """Coverage and width of each kind of interval."""
    left = [row for row in rows if row["verdict"] in UNEXPLAINED]
    failed = sum(row["verdict"] == "failed" for row in rows)
    print(f"{len(rows)} runs, {failed} failed, {len(left)} with a misfit that nothing explains")
    every = [p for row in left for p in row["parameters"].values()]
    for kind in ("alone", "unexplained", "informed"):
        hit = sum(p[kind][0] <= p["true"] <= p[kind][1] for p in every)
        width = [np.diff(p[kind])[0] / np.diff(p["informed"])[0] for p in every if np.diff(p["informed"])[0] > 0]
        low, high = (bound_of(Rate("", "", 0.95, at_least, hit, len(every))) for at_least in (True, False))
        print(
            f"{kind:12s} {hit} of {len(every)} = {hit / len(every):.3f} [{low:.3f}, {high:.3f}], "
            f"{np.median(width):.2f} times as wide as informed in the median"
        )
    whole = sum(all(_held(p) for p in row["parameters"].values()) for row in left)
    print(f"with the unexplained misfit: all parameters hold in {whole} of {len(left)}; by parameter:")
    for name in left[0]["parameters"] if left else ():
        own = [row["parameters"][name] for row in left]
        print(f"  {name:20s} {sum(map(_held, own))} of {len(own)}")
    held_out = [run["held_out"] for run in left]
    for group, kind in sorted({(row["group"], end) for run in held_out for row in run for end in ("", row["kind"])}):
        own = [[row for row in run if row["group"] == group and kind in ("", row["kind"])] for run in held_out]
        told(f"{group} {kind}".strip(), own)


def told(what: str, runs: list[list[dict[str, Any]]]) -> None:
    """Coverage and width of predictions, rows by bogie.

    Bounds are those of bogies drawn with replacement, as the values of one are not independent.
    """
    runs = [run for run in runs if run]
    count = np.array([len(run) for run in runs])
    print(f"{what}: {count.sum()} values of {len(runs)} bogies")
    drawn = np.random.default_rng(1).integers(0, len(runs), (DRAWS, len(runs)))
    for kind in ("alone", "unexplained", "informed"):
        hit = np.array([sum(row[kind] for row in run) for run in runs])
        shares = hit[drawn].sum(axis=1) / count[drawn].sum(axis=1)
        low, high = np.quantile(shares, [0.05, 0.95])
        width = [row.get(f"{kind}_width", 1.0) for run in runs for row in run]
        print(
            f"  {kind:12s} {hit.sum()} of {count.sum()} = {hit.sum() / count.sum():.3f} [{low:.3f}, {high:.3f}], "
            f"{np.median(width):.2f} times as wide as informed in the median, {np.quantile(width, 0.9):.2f} in nine of "
            f"ten; least of a bogie {(hit / count).min():.2f}"
        )


def _held(parameter: dict[str, Any]) -> bool:
    low, high = parameter["unexplained"]
    return bool(low <= parameter["true"] <= high)


if __name__ == "__main__":
    main()
