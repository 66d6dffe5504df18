"""How often intervals of fitted parameters hold the truth where what is left out lies anywhere within its limits.

    python tests/benchmarks/coverage_held.py run --runs 200
    python tests/benchmarks/coverage_held.py report

Damped frames given as matrices (`rates_frame`), nothing missing, on a mesh three times finer, with sensors up to 5 mm
off and five repeats. Moduli, floors and loss factor are fitted; their true values are normal by their priors.
Stiffness and damping of the ground are left out of the selection: the study states limits and no standard deviation,
and their true values are uniform within these limits. Every fourth case is fitted once more with the two held
as exact (``fixed``), as if nothing were uncertain.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rates import lines
from rates_frame import COARSE, FINE, MODES, FrameSpecimen, blind, frame, layout
from rates_subject import FRAME, ROOT
from rates_table import Rate, bound_of
from rates_world import World, digest_of

import calib
from calib.errors.errors import InputError
from calib.structure.model import StructuralModel

HELD = ("k_ground", "c_ground")
FITTED = ("E_columns", "E_beams", "m_floors", "loss")
SOURCES = (*FRAME.sources, "tests/benchmarks/coverage_held.py", "calib/analyses", "calib/api")
MODE_COUNT = MODES + 4
EXACT = 4
"""Every so many cases are fitted with what is left out as exact too."""


@cache
def specimen() -> FrameSpecimen:
    """The damped frame and its modes at the nominal values."""
    base, names = _stated(frame(COARSE).model(damped=True)), tuple(f"F{k}" for k in range(1, MODES + 1))
    nominal = base.sensor_rows(layout()) @ base.modes(base.space.values, MODES).shapes
    fine, nothing = frame(FINE).model(damped=True), ()
    return FrameSpecimen(ROOT, base, fine, nothing, nothing, names, layout(), nominal)


def _stated(model: StructuralModel) -> StructuralModel:
    """With limits of what is left out, and no standard deviation."""
    space = model.space
    for name in HELD:
        space = space.replace(name, prior_sd=None)
    return replace(model, space=space)


def drawn(number: int) -> tuple[dict[str, float], calib.MeasuredModes] | None:
    """True values and their test; None where a mode is not identified. The seed is the number alone."""
    rng, own = np.random.default_rng([2026, 41, number]), specimen()
    values = own.base.space.values
    for name in FITTED:
        p = own.base.space[name]
        values[name] = float(np.clip(p.value + p.prior_width * rng.standard_normal(), p.lower, p.upper))
    for name in HELD:
        p = own.base.space[name]
        values[name] = float(rng.uniform(p.lower, p.upper))
    names, modes, shapes = own.solved((), values, blind.twin.moved(own.layout, rng))
    if names != own.modes:
        return None
    world = World.__new__(World)  # whose repeats need the specimen alone
    world.__dict__["specimen"] = own
    repeats = [world._repeat(names, blind.twin.noisy(modes, shapes, rng)) for _ in range(5)]
    return values, world._combined(repeats)


def run(number: int) -> dict[str, Any]:
    """Intervals of one frame, with what is left out uncertain and exact."""
    made = drawn(number)
    if made is None:
        return {"number": number, "failed": "modes"}
    values, measured = made
    out: dict[str, Any] = {"number": number, "held": {n: round(values[n], 3) for n in HELD}}
    model = specimen().base
    exact = replace(model, space=model.space.freeze({name: model.space[name].value for name in HELD}))
    for way, one in (("considered", model), ("exact", exact))[: 1 if number % EXACT else 2]:
        test = calib.ModalTest(measured, mode_count=MODE_COUNT)
        try:
            fit = calib.Problem(one, test).calibrate(list(FITTED), starts=1, progress=False)
        except InputError as fault:
            return out | {"failed": str(fault)}
        out[way] = {
            name: {"true": round(values[name], 5), "value": float(row["value"]), "std": float(row["std"]),
                   "low": float(row["low"]), "high": float(row["high"]), "on_limit": bool(row["on_limit"]),
                   "identified": bool(row["identified"])}
            for name, row in fit.parameters.iterrows()
        }  # fmt: skip
        out[f"{way}_fits"] = fit.statistics.fits
    return out


def holds(one: Mapping[str, Any]) -> bool:
    """Whether the 95 % interval holds the truth: of one side for a parameter on its search limit."""
    return bool(one["low"] <= one["true"] <= one["high"])


def report(rows: Sequence[Mapping[str, Any]]) -> None:
    """Shares of intervals that hold the truth."""
    made = [row for row in rows if "failed" not in row]
    print(f"{len(rows)} frames, {len(rows) - len(made)} failed")
    for way in ("considered", "exact"):
        own = [row for row in made if way in row]
        every = [(name, one) for row in own for name, one in row[way].items()]
        print(f"{way}: the model fits in {sum(row[f'{way}_fits'] is not False for row in own)} of {len(own)}")
        told("every parameter", (one for _, one in every))
        told("identified", (one for _, one in every if one["identified"]))
        beside = [row[way] for row in own if any(one["on_limit"] for one in row[way].values())]
        told("beside a limit", (one for row in beside for one in row.values() if not one["on_limit"]))
        told("on a limit", (one for _, one in every if one["on_limit"]))
        for name in FITTED:
            told(name, (one for which, one in every if which == name))


def told(what: str, every: Iterable[Mapping[str, Any]]) -> None:
    """One share with its bounds."""
    hit = [holds(one) for one in every]
    if hit:
        low, high = (bound_of(Rate("", "", 0.95, at_least, sum(hit), len(hit))) for at_least in (True, False))
        print(f"  {what:18s} {sum(hit)} of {len(hit)} = {np.mean(hit):.3f} [{low:.3f}, {high:.3f}]")


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--runs", type=int, default=200)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results/coverage_held")
    given = arguments.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "runs.jsonl"
    if given.what == "report":
        rows = list(lines(file))
        report([row for row in rows if row["code"] == rows[-1]["code"]])
        return
    code = digest_of(SOURCES)
    made = {row["number"] for row in lines(file) if row["code"] == code}
    with file.open("a", encoding="utf-8") as out:
        for number in range(given.runs):
            if number not in made:
                out.write(json.dumps({"code": code} | run(number)) + "\n")
                out.flush()


if __name__ == "__main__":
    main()
