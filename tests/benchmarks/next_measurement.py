"""Whether what is advised to be measured next tells two effects apart as often, and as clearly, as promised.

    python tests/benchmarks/next_measurement.py --runs 20

The bogie of ``studies/hidden_bogie`` carries a mass on its left girder that the model lacks: in turn at the middle or
ahead of it. The first test has no sensors on the frame and can hardly tell where. Each run measures the twin (another
mesh, displaced sensors, the mean of five repeats with its scatter as stated), explains, and, where the answer is one of
the two or both, measures what the advice puts first, keeps the old data, and explains again. Every line is appended to
``results/next/runs.jsonl``; started again it goes on. The table compares the log odds promised for the true place with
those that came out.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.loading import module_of
from calib.measurement.modal import MeasuredModes, Sensor
from calib.missing.advice import advise
from calib.missing.explain import explain
from calib.missing.findings import Findings, Trial
from calib.missing.option import Option
from calib.missing.refits import DEFAULT, Refits
from calib.missing.rivals import sharpness
from calib.questions.hypotheses import ModalHypotheses
from calib.questions.library import kept_basis
from calib.questions.prospects import modal_prospects
from calib.questions.reduction import Wanted
from calib.space import Parameter, ParameterSpace
from calib.structure.affine import parameter
from calib.structure.atoms import atoms
from calib.structure.extend import Addition, extend
from calib.structure.model import StructuralModel
from calib.structure.variants import Variants
from calib.study import Study
from models.railway.effects_frame import GIRDER_Y, GIRDER_Z, UX, UY, UZ, motion, outer_term

ROOT = Path(__file__).resolve().parents[2]
PLACES = {"mass_middle": 0.0, "mass_ahead": 0.45}
MASSES = (150.0, 250.0)
"""Between these the hidden mass is drawn, kg."""
FRAME = tuple(f"{node}y" for node in range(101, 115))
"""All sensors of the frame: the first test has only those of wheelsets, boxes and blocks."""
REPEATS = 5


def masses() -> tuple[Effect, ...]:
    """A mass on the left girder at either place."""
    return tuple(
        Effect(
            name, f"Mass on the left girder at x = {x:g} m", "It is left out.", "Look there.",
            Parameter(name, 0.0, 0.0, 600.0, "kg", prior_sd=150.0), _Mass(name, x),
        )
        for name, x in PLACES.items()
    )  # fmt: skip


@dataclass(frozen=True)
class _Mass:
    name: str
    x: float

    def __call__(self, model: StructuralModel) -> Addition:
        rows = [motion(model, ("frame", (self.x, GIRDER_Y, GIRDER_Z)), d) for d in (UX, UY, UZ)]
        return Addition(mass=(outer_term(self.name, rows, parameter(self.name)),))


@dataclass(frozen=True, eq=False)
class Bench:
    """Model, twin and library, made once."""

    folder: Path

    @cached_property
    def maker(self) -> Any:
        """The generator of the blind studies."""
        return module_of(ROOT / "studies/hidden_bogie/make_twin.py")

    @cached_property
    def specimen(self) -> Any:
        """What is measured."""
        return self.maker.specimen()

    @cached_property
    def variants(self) -> Variants:
        """The model with the library of the study and the two masses."""
        study, model = Study.load(ROOT / "studies/hidden_bogie_none"), self.specimen.model
        held, pairing, own = study.settings.withheld.sensors, study.settings.pairing, study.settings.reduction
        used = [s for s in self.specimen.layout if s.name not in held]
        local = tuple(a.effect for a in atoms(model, used, self.space.values, 10.0))
        library = (*study.candidates, *masses())
        assert pairing.mode_count is not None and pairing.freq_window is not None
        wanted = Wanted(pairing.mode_count, pairing.freq_window[1], own.tolerance, own.seed)
        return Variants(model, library, local, kept_basis(model, self.space, library, local, wanted, self.folder))

    @property
    def space(self) -> ParameterSpace:
        """Free are the parameters of the search."""
        space = self.specimen.model.space
        assert isinstance(space, ParameterSpace)
        return space

    def hypotheses(self, measured: MeasuredModes, space: ParameterSpace | None = None) -> ModalHypotheses:
        """The question of the blind studies, asked of what was measured."""
        problem = self.specimen.problem(measured, withheld=False)
        return ModalHypotheses(problem, self.variants, space or self.space)


@dataclass(frozen=True, eq=False)
class Twin:
    """One structure, of which as much can be measured as is asked for; what was measured once stays as it was."""

    bench: Bench
    number: int

    @property
    def hidden(self) -> str:
        """Where the mass is."""
        return tuple(PLACES)[self.number % len(PLACES)]

    @cached_property
    def values(self) -> dict[str, float]:
        """The truth."""
        rng = np.random.default_rng([7, self.number])
        values: dict[str, float] = self.bench.specimen.draw(rng)
        return values | {self.hidden: float(rng.uniform(*MASSES))}

    def measured(self, extra: Sequence[Sensor] = (), repeats: int = REPEATS) -> MeasuredModes:
        """All modes that can be told apart at all sensors and at further ones."""
        spec, known, twin = self.bench.specimen, len(self.bench.specimen.layout), self.bench.maker.blind.twin
        hidden = [e for e in masses() if e.name == self.hidden]
        model = extend(spec.fine, hidden)
        displaced = twin.moved(spec.layout, np.random.default_rng([8, self.number]))
        found = model.modes(self.values, len(spec.modes) + 4)
        rows = model.sensor_rows((*displaced, *extra))
        names, modes, _ = spec.identified(found, rows[:known] @ found.shapes)
        index = [int(np.flatnonzero(found.natural_freq == f)[0]) for f in modes.natural_freq]
        shapes = rows @ found.shapes[:, index]
        shapes = shapes / np.abs(shapes[:known]).max(axis=0)
        freq, damping = modes.natural_freq, modes.damping_ratio
        std = np.full(shapes.shape, twin.STD_SHAPE)
        std[known:] *= np.maximum(np.abs(shapes).max(axis=0), 1.0)  # the scatter is a part of the largest motion
        size, noise = math.sqrt(REPEATS / repeats), self._noise(len(names), known, len(extra), repeats)
        freq = freq * np.exp(twin.STD_FREQ * size * noise[0])
        damping = damping * np.exp(twin.STD_DAMPING * size * noise[1])
        return MeasuredModes(
            names, freq, freq * np.sqrt(1 - np.minimum(damping, 0.99) ** 2), twin.STD_FREQ * size * freq, damping,
            twin.STD_DAMPING * size * damping, (*spec.layout, *extra), shapes + size * std * noise[2], size * std, 1,
            True,
        )  # fmt: skip

    def _noise(self, n: int, known: int, more: int, repeats: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the mean over the repeats in units of its standard deviation; that of each repeat is always the same."""
        parts = []
        for k in range(repeats):
            rng, other = (np.random.default_rng([seed, self.number, k]) for seed in (9, 10))
            first = rng.standard_normal((2, n)), rng.standard_normal((known, n, 2)), other.standard_normal((more, n, 2))
            parts.append(first)
        both = [sum(part[i] for part in parts) / math.sqrt(repeats) for i in range(3)]
        return both[0][0], both[0][1], np.concatenate(both[1:]) @ np.array([1.0, 1.0j])


def run(bench: Bench, number: int, modes: Sequence[str], sensors: Sequence[str]) -> dict[str, Any]:
    """Measure, explain, follow the advice, explain again."""
    twin = Twin(bench, number)
    row: dict[str, Any] = {"number": number, "hidden": twin.hidden}
    whole = twin.measured()
    first = bench.hypotheses(whole.without([m for m in modes if m in whole.names], sensors))
    found = explain(first)
    row |= {"verdict": found.verdict, "credible": list(found.credible)}
    rivals = believed(found, first)
    if rivals is None:
        return row
    withheld = {m: float(f) for m, f in zip(whole.names, whole.natural_freq, strict=True) if m in modes}
    now = rivals[0].ln_evidence - rivals[1].ln_evidence
    candidates = [g.effect for g in found.groups]
    prospects = modal_prospects(
        first, rivals, candidates, found.base_check.named, found.noise_scale, withheld, seed=number
    )
    table = advise(prospects)
    table = table[table["effect"] == rivals[0].names[0]]
    # A computed mode that the twin's test has no name for cannot be measured here.
    possible = table[(table["kind"] != "mode") | table["option"].str.startswith("mode ")]
    best = possible.iloc[0]
    option = next(o for o in prospects.options if o.name == best["option"])
    after = measured_next(twin, first, rivals[0], option, modes, sensors)
    again = explain(after)
    sign = 1.0 if rivals[0].names[0] == twin.hidden else -1.0
    second = believed(again, after, [t.names[0] for t in rivals])
    realised = math.nan if second is None else second[0].ln_evidence - second[1].ln_evidence
    return row | {
        "option": option.name, "kind": option.kind, "now": sign * now, "promised": float(best["ln_bayes"]),
        "low": float(best["ln_bayes_low"]), "high": float(best["ln_bayes_high"]), "chance": float(best["chance"]),
        "realised": sign * realised, "verdict_after": again.verdict, "credible_after": list(again.credible),
        "evaluations": found.evaluations, "scale": again.noise_scale, "p_fit": again.base_check.p_fit,
    }  # fmt: skip


def believed(found: Findings, hypotheses: ModalHypotheses, names: Sequence[str] = ()) -> tuple[Trial, Trial] | None:
    """Fits with each of the two masses, the best first or in the order of the names; None when neither is believed."""
    if not names and not (found.names_something and set(found.credible) & set(PLACES)):
        return None
    fits = Refits(hypotheses, replace(DEFAULT, budget=math.inf), found.noise_scale, lambda words: None)
    known = {t.names[0]: t for t in found.singles}
    trials = []
    for name in names or PLACES:
        start = known[name].state.values if name in known else {**found.base.state.values, name: 50.0}
        trials.append(fits.trial((name,), start, whole=1))
    if not names:
        trials.sort(key=lambda t: -t.ln_evidence)
    return trials[0], trials[1]


def measured_next(
    twin: Twin, first: ModalHypotheses, trial: Trial, option: Option, modes: Sequence[str], sensors: Sequence[str]
) -> ModalHypotheses:
    """What was measured together with what the option adds."""
    bench, space, extra, repeats, held = twin.bench, first.space, [], REPEATS, list(modes)
    if option.kind == "repeats":
        repeats = round(REPEATS / option.scale**2)
    if option.kind == "mode":
        held = [m for m in modes if f"mode {m}," not in option.name]
    if option.kind == "sensor":
        places = re.findall(r"\(([-\d.]+), ([-\d.]+), ([-\d.]+)\) (\w+)", option.name)
        extra = [Sensor(900 + k, d, (float(x), float(y), float(z))) for k, (x, y, z, d) in enumerate(places)]
    for name, sd in option.prior_sd.items():
        told = 1 / sharpness(trial.state, name, sd)
        result = twin.values[name] + told * np.random.default_rng([11, twin.number]).standard_normal()
        p = space[name]
        weights = np.array([1 / p.prior_width**2, 1 / told**2])
        mean = float(weights @ [p.value, result] / weights.sum())
        space = space.replace(name, value=mean, prior_sd=float(weights.sum() ** -0.5))
    whole = twin.measured(extra, repeats)
    return bench.hypotheses(whole.without([m for m in held if m in whole.names], sensors), space)


def report(rows: Sequence[Mapping[str, Any]]) -> None:
    """Promised against realised."""
    print(f"{'run':>4} {'hidden':12} {'before':18} {'now':>6} {'promised (8 of 10)':>22} {'realised':>9}  after")
    for r in rows:
        text = f"{r['number']:4d} {r['hidden']:12} {r['verdict']:18}"
        if "option" in r:
            spread = f"{r['promised']:.1f} ({r['low']:.1f} to {r['high']:.1f})"
            after = f"{r['verdict_after']} {' '.join(r['credible_after'])}"
            text += f" {r['now']:6.1f} {spread:>22} {r['realised']:9.1f}  {after} [{r['option'][:48]}]"
        print(text)
    for title, kept in (
        ("all that were followed", [r for r in rows if "option" in r]),
        ("of these not told apart before", [r for r in rows if "option" in r and r["verdict"] == "indistinguishable"]),
    ):
        if not kept:
            continue
        get = {k: np.array([r[k] for r in kept]) for k in ("now", "promised", "realised", "low", "high", "chance")}
        inside = (get["realised"] >= get["low"]) & (get["realised"] <= get["high"])
        right = [r["credible_after"] == [r["hidden"]] for r in kept]
        wrong = [r["verdict_after"] == "effect" and r["credible_after"] != [r["hidden"]] for r in kept]
        error = np.std(get["realised"], ddof=1) / math.sqrt(len(kept)) if len(kept) > 1 else math.nan
        print(
            f"\n{title}: {len(kept)} of {len(rows)} runs\n"
            f"  ln odds for the true one: before {get['now'].mean():.1f}, promised {get['promised'].mean():.1f}, "
            f"realised {get['realised'].mean():.1f} +- {error:.1f}\n"
            f"  within the promised range of 8 in 10: {inside.sum()} of {len(kept)}\n"
            f"  beyond 20:1: promised {get['chance'].mean():.2f}, realised {np.mean(get['realised'] > 3):.2f}; "
            f"right one named alone {sum(right)}, a wrong one {sum(wrong)}"
        )


def main() -> None:
    """Run what is not there yet, and tell."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--runs", type=int, default=20)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results" / "next")
    arguments.add_argument("--modes", nargs="*", default=["4BT", "9BT"], help="modes left out of the first test")
    arguments.add_argument("--sensors", nargs="*", default=list(FRAME), help="sensors left out")
    given = arguments.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file, bench = given.folder / "runs.jsonl", Bench(given.folder)
    rows = [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []
    done = {r["number"] for r in rows}
    with file.open("a", encoding="utf-8") as out:
        for number in (n for n in range(given.runs) if n not in done):
            try:
                row = run(bench, number, given.modes, given.sensors)
            except (EvaluationError, InputError, np.linalg.LinAlgError) as fault:
                row = {"number": number, "hidden": Twin(bench, number).hidden, "verdict": f"failed: {fault}"}
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
            print(number, row["verdict"], file=sys.stderr, flush=True)
    report(sorted((r for r in rows if r["number"] < given.runs), key=lambda r: r["number"]))


if __name__ == "__main__":
    main()
