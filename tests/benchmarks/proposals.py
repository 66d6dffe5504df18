"""How often a proposal has the right kind and the right place, where the true effect is in no library.

    python tests/benchmarks/proposals.py run --cases 60
    python tests/benchmarks/proposals.py report

Cases are those of `rates_scenarios.py`: bogies whose effect is really built into a finer mesh and taken out of the
library ("without/..."), and bogies with a design outside of it ("outside/..."); only those whose effect changes the
data by at least `VISIBLE` standard deviations beyond what the parameters absorb. Proposals are composed without any
library, on the coarser mesh. `TRUTH` says what counts as right for each, from how the twin is built: the family of
kinds, and places of what is different on the twin. A place is right within `NEAR` of one of them; of several parts
that change together at least half must be.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import math
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rates_outcome import Measured
from rates_scenarios import OWN, Scenario
from rates_subject import ROOT, SUBJECTS
from rates_world import World, code_digest
from scipy.stats import beta

from calib.correlation.modal.residual import ModalResidual
from calib.execution.stage import silent
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.proposals.proposal import Composed
from calib.hypotheses.proposals.proposal_search import Search
from calib.missing.refits import Refits
from calib.missing.settings import Settings
from calib.structure.effects.compositions import compositions

VISIBLE = 6.0
NEAR = 0.7
"""Metres; the bogie is 4 m long and 2.6 m wide, and its sensors stand about a metre apart."""
ELASTIC = ("stiffness", "section", "spring to ground", "spring between", "rotational spring", "soft support")
INERTIAL = ("mass", "added mass")
DISSIPATIVE = ("damping", "dissipation", "damper to ground", "damper between")
HUNG = ("hung mass",)
MOUNTS = ("damper mount",)

Points = tuple[tuple[float, float, float], ...]


class Truth(NamedTuple):
    """What counts as right."""

    kinds: tuple[str, ...]
    places: Points


def _all(x: tuple[float, ...], y: float, z: tuple[float, ...]) -> Points:
    return tuple((a, y, c) for a, c in product(x, z))


_BLOCKS, _LEFT_BLOCK = _all((-0.28, 0.28), 1.05, (-1.17, 1.17)), _all((-0.28, 0.28), 1.05, (1.17,))
_CORNERS = _all((-1.45, 1.45), 0.43, (-1.05, 1.05))
_FRONT_LEFT: Points = ((1.45, 0.43, 1.05),)
TRUTH = {
    "actuator_flexibility": Truth(ELASTIC, _BLOCKS),  # supports of the blocks give way
    "block_tilt": Truth(ELASTIC, _BLOCKS),  # elastic blocks resist tilting
    "block_damping": Truth(DISSIPATIVE, _BLOCKS),  # dampers in parallel to the elastic blocks
    "crossbar_joint": Truth(ELASTIC, (*_all((-1.11, 1.11), 0.62, (-1.05, 1.05)), *_all((-1.11, 1.11), 0.62, (0.0,)))),
    "girder_end": Truth(ELASTIC, _all((-1.55, 1.55), 0.62, (-1.05, 1.05))),  # a thinner section there
    "crossbar_mass": Truth(INERTIAL, ((1.11, 0.62, 0.0),)),  # a point mass
    "brake_unit": Truth(HUNG, ((1.11, 0.62, 0.45),)),  # a body on bushes
    "primary_uneven": Truth(ELASTIC, _FRONT_LEFT),  # springs of that corner
    "weak_damper": Truth(DISSIPATIVE, _FRONT_LEFT),  # the damper of that corner
    "damper_mount": Truth((*DISSIPATIVE, *MOUNTS), _CORNERS),  # dampers that lose their effect with frequency
    "wheel_contact": Truth(ELASTIC, _all((1.45,), 0.43, (-0.87, 0.87))),  # contacts of the front axle
    "rolling_wheels": Truth(INERTIAL, _all((-1.45, 1.45), 0.43, (-0.87, 0.87))),  # polar inertia that acts as mass
    "gear_case_offset": Truth(INERTIAL, _all((1.45,), 0.43, (-1.05, -0.5, 0.0, 0.5, 1.05))),  # a mass elsewhere on it
    "torque_link": Truth(ELASTIC, ((1.11, 0.53, 0.0), (1.45, 0.43, 0.0))),  # a link from axle to crossbar
    "rod_damping": Truth(DISSIPATIVE, _CORNERS),  # dampers along the rods
    "stiff_bushes": Truth(ELASTIC, _CORNERS),  # rods that resist turning
    "heavy_rear": Truth(INERTIAL, (*_all((-1.55,), 0.62, (-1.05, 1.05)), (-1.11, 0.62, 0.0))),
    "stiff_rear_rods": Truth(ELASTIC, _all((-1.45,), 0.26, (-1.05, 1.05))),
    "soft_girder": Truth(ELASTIC, _all((-1.55, -1.0, -0.5, 0.0, 0.5, 1.0, 1.55), 0.62, (1.05,))),
    "skew_block": Truth(ELASTIC, _LEFT_BLOCK),  # couples vertical and lateral motion
}
"""By the hidden effect: kinds, and places of what differs on the twin, m."""


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--cases", type=int, default=60)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results/proposals")
    given = arguments.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "cases.jsonl"
    if given.what == "report":
        report([json.loads(line) for line in file.read_text("utf-8").splitlines()])
        return
    world = World(SUBJECTS["bogie"], given.folder, code_digest(SUBJECTS["bogie"]))
    world.settle()
    with file.open("w", encoding="utf-8") as out:
        for row in rows(world, given.cases):
            out.write(json.dumps(row) + "\n")
            out.flush()


def rows(world: World, count: int) -> Iterator[dict[str, Any]]:
    """The first so many visible cases of a fixed order: every kind of run once, then all of them once more."""
    kinds, made = [s for s in world.kinds if s.group in ("removed", "outside")], 0
    for number in range(1000):
        for k in np.random.default_rng([20260601, number]).permutation(len(kinds)).tolist():
            if made == count:
                return
            row = _case(world, kinds[k], number)
            if row is not None:
                made += 1
                print(made, row["scenario"], row["kind"], row["place"], row["place_in_three"], flush=True)
                yield row


def _case(world: World, scenario: Scenario, number: int) -> dict[str, Any] | None:
    """One case; None where its effect is hardly visible."""
    started = time.perf_counter()
    measured = world.measure(scenario, number)
    (score,) = world._truth(scenario, measured)["visible"]
    return row_of(world, scenario, number, score, measured, started) if score >= VISIBLE else None


def row_of(
    world: World, scenario: Scenario, number: int, score: float, measured: Measured, started: float | None = None
) -> dict[str, Any]:
    """What is proposed for one measurement, beside the truth."""
    started = time.perf_counter() if started is None else started
    problem, library = world.specimen.problem(measured.whole), world.libraries[OWN]
    base = ModelHypotheses(ModalResidual(problem), library, world.space, without=tuple(e.name for e in world.library))
    taken = [name for effect in world.effects.values() for name in effect.names]
    own = compositions(world.model, [problem.measured], world.space.values, taken)
    hypotheses = base.with_more(own.effects)
    fits = Refits(hypotheses, Settings(budget=math.inf), 1.0, silent)
    search = Search(fits, own.plain, own.mounts, own.hung, own.held, hypotheses.row_freqs)
    found = search.proposals((), base.space.values)
    truth, (hidden,) = TRUTH[measured.hidden[0]], measured.hidden
    ranked = found.ranked
    close = [] if not ranked else [c for p in found.close for c in (p.composed, *p.alike)]
    near = [_is_near(p.composed, truth) for p in ranked]
    return {
        "scenario": scenario.name, "number": number, "hidden": hidden, "score": score, "group": scenario.group,
        "magnitude": measured.values[hidden], "p_family": found.p_family, "measurement": found.measurement,
        "proposed": [[p.composed.kind, p.composed.at, round(p.evidence, 1), round(p.value, 4)] for p in ranked[:5]],
        "kind": bool(ranked) and ranked[0].composed.kind in truth.kinds,
        "kind_told": any(c.kind in truth.kinds for c in close),
        "place": bool(near) and near[0], "place_in_three": any(near[:3]),
        "both_in_three": any(n and p.composed.kind in truth.kinds for n, p in zip(near[:3], ranked[:3], strict=True)),
        "told": [[c.kind, c.at] for c in close],
        "lost": [[one.title, one.reason] for one in found.lost],
        "left": None if found.adequacy is None else found.adequacy.p_family,
        "seconds": round(time.perf_counter() - started, 1),
    }  # fmt: skip


def _is_near(composed: Composed, truth: Truth) -> bool:
    """Whether at least half of its places are near a true one."""
    near = [min(math.dist(place, true) for true in truth.places) <= NEAR for place in composed.places]
    return bool(near) and sum(near) * 2 >= len(near)


WORDS = {
    "kind": "kind of the first proposal right",
    "kind_told": "right kind among those told as equally good",
    "place": "place of the first proposal right",
    "place_in_three": "place right among the best three",
    "both_in_three": "kind and place right in one of the best three",
}


def report(found: list[dict[str, Any]]) -> None:
    """Rates with their lower bounds (one-sided, 95 %; Clopper and Pearson 1934), then by hidden effect."""
    for group in ("all", "removed", "outside"):
        own = [row for row in found if group in ("all", row["group"])]
        print(f"{group}: {len(own)} cases, {sum(not r['proposed'] for r in own)} without a proposal, "
              f"{sum(r['measurement'] for r in own)} told as a measurement error")  # fmt: skip
        for key, words in WORDS.items():
            right = sum(bool(row[key]) for row in own)
            low = float(beta.ppf(0.05, right, len(own) - right + 1)) if right else 0.0
            print(f"  {words}: {right} of {len(own)} ({100 * right / max(len(own), 1):.0f} %, bound {100 * low:.0f} %)")
    print(f"median {np.median([row['seconds'] for row in found]):.0f} s a case")
    for name in sorted({row["hidden"] for row in found}):
        own = [row for row in found if row["hidden"] == name]
        counts = ", ".join(f"{key} {sum(bool(r[key]) for r in own)}" for key in WORDS)
        firsts = "; ".join(f"{r['proposed'][0][0]} at {r['proposed'][0][1]}" for r in own if r["proposed"])
        print(f"{name} ({len(own)}): {counts}. First: {firsts}")


if __name__ == "__main__":
    main()
