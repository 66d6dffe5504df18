"""How often generic effects name rightly what an imported frame or plate lacks.

    python tests/benchmarks/generic_rates.py run --cases 39
    python tests/benchmarks/generic_rates.py run --of plate --cases 21
    python tests/benchmarks/generic_rates.py report --write docs/rates_generic.csv

Every case is a structure of its own. A frame is plane: one or two bays, two or three storeys, spans, heights, sensors
and true parameters drawn anew. It is given as matrices without a library: in about every second case one K and one M,
else those of every member and support, which share parameters. The test comes from a mesh twice as fine, on which the
effect is made otherwise than the candidates are: a mass is spread over a length and lies anywhere on a member, a
support gives way less sideways, a thinner member loses mass too, a strut has a mass; a joint is a hinge at the end of a
beam. A section cut over half of a member, a storey with softer columns, and a thinner member where matrices name none
are in no form of the candidates.

A plate in bending stands on four to six springs, given as matrices of six panels and the supports, or as one K and one
M; the test comes from another mesh, of six elements along a panel for four. A mass is spread over some nodes, a panel
is thinner, a support gives way, a stop on some nodes touches it. A cut along a line, a layer on one half, and a thinner
panel where matrices name none are in no form of the candidates.

What is named is right if it is of the kind that was made and at its place: within a third of a member or half a panel
for masses, supports and stops, on that member or panel for sections, between those columns for struts. A place that is
free counts where it was fitted. The mass of the member or panel on which a mass lies is right too, and any change
of a panel that is thinner. Where no
candidate would be right, as without a sensor on one of the columns, what is missing is in no form of them. A set of
several that cannot be told apart is right if its best is; one that holds the truth elsewhere is no wrong name.
"Something
like it" of the right kind and place names nothing, and is counted apart.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from generic_cases import PLATES, SOLVED, Case, case
from rates_subject import ROOT
from rates_table import NAMING, Rate, bound_of, write_rates
from rates_world import digest_of

import calib
from calib.analyses.explain import decision, decision_in_detail
from calib.analyses.hypotheses_of_study import adapter_for
from calib.execution.stage import silent
from calib.missing.explanation import Explanation
from calib.missing.partial import is_far_ahead
from calib.problem.effect import Effect
from calib.structure.effects.composed import Connection, PointMass
from calib.structure.effects.compositions import generic_effects
from calib.structure.effects.free_place import FreePlace

DETECTABLE = 6.0
PRINTED = ("number", "of", "scenario", "parts", "visible", "verdict", "outcome", "best", "error", "seconds")
SOURCES = (
    "tests/benchmarks/generic_rates.py",
    "tests/benchmarks/generic_cases.py",
    "tests/benchmarks/rates_frame.py",
    "calib/hypotheses",
    "calib/analyses/explain.py",
    "calib/structure/effects",
)


def run(number: int, code: str) -> dict[str, Any]:
    """What is told of one case, beside the truth."""
    started, one = time.perf_counter(), case(number)
    library = generic_effects(one.model, [one.measured])
    problem = calib.Problem(one.model, calib.ModalTest(one.measured, mode_count=SOLVED))
    study = problem.study(effects={one.model.name: library})
    adapter = adapter_for(study, None, silent, {})
    found = decision(adapter, study.settings.explain, "case")
    adapter, found = decision_in_detail(adapter, found, study.settings.explain, "case")
    score = _score(one, found)
    group = "nothing" if not one.hidden else "single" if any(map(one.right, library)) else "outside"
    return {
        "number": number, "code": code, "group": group, "hidden": [one.hidden] if one.hidden else [],
        "of": one.model.name,
        "scenario": one.hidden or "nothing", "parts": one.parts, "magnitudes": {one.hidden: one.size},
        "n_dof": one.model.n_dof,
        "verdict": found.verdict, "credible": list(found.credible), "candidates": len(library),
        "best": [] if found.chosen is None else list(found.chosen.names), "outcome": _outcome(one, library, found),
        "visible": [round(score, 2)] * bool(one.hidden), "z": [round(score, 2)] * bool(one.hidden),
        "p_family": found.base_adequacy.p_family, "p_fit": found.base_adequacy.p_fit, "evaluations": found.evaluations,
        "blamed": [fault.name for fault, _ in found.faulty],
        "place": None if found.place is None else found.place.names[0],
        "seconds": round(time.perf_counter() - started, 1),
    }  # fmt: skip


def _outcome(one: Case, library: tuple[Effect, ...], found: Explanation) -> str:
    """See `rates_outcome.outcome`; a set is right if the best of it is, one that holds the truth is `second`."""
    of = {effect.name: effect for effect in library} | _at_fitted_places(library, found)
    if not found.names_something:
        like = found.verdict == "partial" and is_far_ahead(found) and found.chosen is not None
        return "like it" if like and all(one.right(of[n]) for n in found.chosen.names if n in of) else found.verdict
    assert found.chosen is not None
    best, credible = ([name for name in names if name in of] for names in (found.chosen.names, found.credible))
    if best and all(one.right(of[name]) for name in best):
        return "right"
    return "second" if any(one.right(of[name]) for name in credible) else "wrong"


def _at_fitted_places(library: tuple[Effect, ...], found: Explanation) -> dict[str, Effect]:
    """Effects at free places, each as one at the place where it was fitted."""
    out, fitted = {}, {t.names[0]: t.fit.values for t in found.singles}
    for effect in (e.richer for e in library if e.richer is not None):
        free = effect.build
        if isinstance(free, FreePlace) and effect.name in fitted:
            place = (None, free.moved(fitted[effect.name]))
            at = (
                PointMass(effect.name, (place,), free.directions)
                if free.matrix == "mass"
                else Connection(effect.name, "stiffness", ((place, None),), free.directions[0])
            )
            out[effect.name] = replace(effect, build=at)
    return out


def _score(one: Case, found: Explanation) -> float:
    """Change that the effect makes beyond what the parameters absorb, in standard deviations."""
    fit, tests = found.base.fit, (calib.ModalTest(clean, mode_count=SOLVED) for clean in one.clean)
    known = {name: value for name, value in fit.values.items() if name in one.model.space}
    with_it, without = (test.residual(test.problem(one.model)) for test in tests)
    change = with_it.of(with_it.solve(known)) - without.of(without.solve(known))
    if len(change) != len(fit.residual):
        return float("nan")
    return float(np.linalg.norm(fit.project_out(change[:, None])))


def counts(rows: list[dict[str, Any]]) -> list[Rate]:
    """The criteria of `rates_table.rates` that the cases are made for, with what is required of generic effects."""

    def rate(
        hidden: str, verdict: str, required: float, some: list[Any], is_so: Callable[[Any], bool], least: bool = True
    ) -> Rate:
        return Rate(hidden, verdict, required, least, sum(map(is_so, some)), len(some))

    single = [r for r in rows if r["group"] == "single"]
    strong = [r for r in single if r["visible"][0] >= DETECTABLE]
    outside, nothing = ([r for r in rows if r["group"] == name] for name in ("outside", "nothing"))
    seen = [r for r in outside if r["visible"][0] >= DETECTABLE]
    one = "an effect, generic candidates"
    return [
        rate(f"{one}, expected score 6 or more", "names it rightly", 0.9, strong, lambda r: r["outcome"] == "right"),
        rate(f"{one}, expected score 6 or more", "names it rightly, or something like it", 0.9, strong,
             lambda r: r["outcome"] in ("right", "like it")),
        rate(f"{one}, expected score 6 or more", "the truth is among the names, or nothing is named", 0.98, strong,
             lambda r: r["outcome"] != "wrong"),
        rate(f"{one} of any magnitude", "names a wrong effect", 0.0, single, lambda r: r["outcome"] == "wrong", False),
        rate("something in no form of the candidates", "names something", 0.02, outside,
             lambda r: r["verdict"] in NAMING, False),
        rate("something in no form of the candidates, expected score 6 or more", "says that something is missing",
             0.85, seen, lambda r: r["verdict"] != "nothing_detectable"),
        rate("nothing, generic candidates", "names something", 0.01, nothing, lambda r: r["verdict"] in NAMING, False),
    ]  # fmt: skip


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--of", choices=("frame", "plate"), default="frame")
    arguments.add_argument("--cases", type=int, default=39)
    arguments.add_argument("--skip", type=int, default=0)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results/generic")
    arguments.add_argument("--write", type=Path)
    given = arguments.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "cases.jsonl"
    if given.what == "report":
        report([json.loads(line) for line in file.read_text("utf-8").splitlines()], given.write, file)
        return
    code = digest_of(SOURCES)
    rows = map(json.loads, file.read_text("utf-8").splitlines() if file.exists() else ())
    done = {row["number"] for row in rows if row["code"] == code}
    with file.open("a", encoding="utf-8") as out:
        first = PLATES if given.of == "plate" else 0
        for number in range(first + given.skip, first + given.cases):
            if number in done:
                continue
            try:
                row = run(number, code)
            except Exception as fault:
                broke = {"error": repr(fault), "traceback": traceback.format_exc()}
                row = {"number": number, "code": code, "group": "failed", **broke}
            out.write(json.dumps(row) + "\n")
            out.flush()
            print({name: row.get(name) for name in PRINTED}, flush=True)


def report(rows: list[dict[str, Any]], write: Path | None, file: Path) -> None:
    """Rates with their one-sided 95 % bounds, then every case that is not right."""
    rows = [row for row in rows if row["code"] == rows[-1]["code"]]
    failed, rows = [r for r in rows if r["group"] == "failed"], [r for r in rows if r["group"] != "failed"]
    print(f"{len(rows)} cases, {len(failed)} broke; {min(r['candidates'] for r in rows)} to "
          f"{max(r['candidates'] for r in rows)} candidates")  # fmt: skip
    for rate in counts(rows):
        print(f"{rate.hidden}: {rate.verdict} in {rate.count} of {rate.n}, bound {100 * bound_of(rate):.0f} %")
    for r in rows:
        if r["outcome"] not in ("right", "nothing_detectable"):
            print(r["number"], r["scenario"], r["visible"], r["outcome"], r["verdict"], r["best"], r["credible"][:6])
    if write is not None:
        made = date.fromtimestamp(file.stat().st_mtime).isoformat()
        write_rates(counts(rows), write, rows[-1]["code"], made)


if __name__ == "__main__":
    main()
