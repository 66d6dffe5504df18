"""Four kinds of blind tests in turn: nothing wrong, a fault of the test alone, an effect alone, both.

    python tests/benchmarks/rates_four.py run --of frame --cases 400
    python tests/benchmarks/rates_four.py report --of frame

Frames given as matrices (`rates_frame`) or bogies. An effect is built into the finer mesh at 0.5 to 2 times its
plausible size. Both have an expected score of at least 6 **after the other is freed**: the change of the noise-free
readings, in standard deviations, that all parameters and the change pattern of the other cannot explain. Draws below
are drawn again, by the truth alone. Faults of the test are candidates in every case, as in a study.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg as la
from rates import lines, rows
from rates_faults import OFF, _most_real, misread
from rates_frame import FrameWorld
from rates_outcome import Measured
from rates_scenarios import Scenario, rounds
from rates_subject import BOGIE_FAULT, FRAME_FAULT, ROOT, Subject
from rates_table import Rate, bound_of
from rates_world import World, code_digest

from calib.correlation.modal.residual import ModalResidual
from calib.measurement.modal import MeasuredModes, Sensor
from calib.missing.explanation import Explanation
from calib.problem.effect import Effect
from calib.structure.modes import Modes

FAULTS = ("gain", "sign", "place", "rotation", "cross-talk", "exchange", "axes", "far cross-talk", "mixed modes")
"""Of one sensor, of a pair of sensors, of two modes."""
LEAST = 6.0
"""Expected score of effects and faults, after the other is freed."""
SIZES = (0.5, 2.0)
"""Range of an effect's magnitude over its plausible size."""
DRAWS = 200
"""Draws until one has that score."""
KINDS = (Scenario("four/nothing", "nothing"), Scenario("four/fault", "fault"), Scenario("four/effect", "single"),
         Scenario("four/both", "both"))  # fmt: skip
_SUBJECTS = {"frame": FRAME_FAULT, "bogie": BOGIE_FAULT}


@dataclass(frozen=True, eq=False)
class TestedOfFour(Measured):
    """As `Measured`, of one of the four kinds.

    Attributes
    ----------
    fault : str
        Kind of the fault, or empty.
    right : str
        The candidate that is right, or the sensor that every right one bears.
    scores : mapping from str to float
        Expected scores of ``effect`` and ``fault``, after the other is freed.
    """

    fault: str = ""
    right: str = ""
    scores: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class FourWorld(World):
    """A world with the four kinds; nothing but the truth decides which draws are made."""

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """The four."""
        return KINDS

    def measure(self, scenario: Scenario, number: int) -> Measured:
        """The first draw of a truth whose effect and fault are visible, measured five times."""
        for draw in range(DRAWS):
            found = self._drawn(scenario, np.random.default_rng([*scenario.name.encode(), number, draw]))
            if found is not None:
                return found
        raise RuntimeError(f"no draw of {scenario.name} {number} is visible")

    def _drawn(self, scenario: Scenario, rng: np.random.Generator) -> TestedOfFour | None:
        values, layout = self.specimen.draw(rng), self.specimen.layout
        hidden: tuple[Effect, ...] = ()
        if scenario.group in ("single", "both"):
            hidden = (self.library[int(rng.integers(len(self.library)))],)
            values |= self.maker.blind.draw_effect(hidden[0], float(rng.uniform(*SIZES)), rng)
        fault = FAULTS[int(rng.integers(len(FAULTS)))] if scenario.group in ("fault", "both") else ""
        own = int(rng.integers(2**31))
        places = self.maker.blind.twin.moved(layout, rng)
        wrong, moved = self._off(places, np.random.default_rng(own)) if fault == "place" else (places, "")
        names, modes, shapes = self._with(hidden, values, wrong)
        read, right = self._read(fault, shapes, own, names, modes)
        right = moved or right
        clean = {(True, True): self.specimen.noiseless(names, modes, read)}
        for effect, faulty in ((False, True), (True, False), (False, False)):
            if (hidden or effect) and (fault or faulty):  # else it is one of the others
                bare = self._with(hidden if effect else (), values, wrong if faulty else places)
                if bare[0] != names:
                    return None
                shapes = self._read(fault if faulty else "", bare[2], own, names, modes)[0]
                clean[effect, faulty] = self.specimen.noiseless(names, bare[1], shapes)
        scores = self._scores(clean, values, bool(hidden), bool(fault))
        if min(scores.values(), default=LEAST) < LEAST:
            return None
        repeats = [self._repeat(names, self.maker.blind.twin.noisy(modes, read, rng)) for _ in range(5)]
        whole = self._combined(repeats)
        return TestedOfFour(values, {e.name: e.names for e in hidden}, clean[True, True], whole, fault, right, scores)

    def _with(
        self, hidden: Sequence[Effect], values: Mapping[str, float], places: Sequence[Sensor]
    ) -> tuple[tuple[str, ...], Modes, np.ndarray]:
        known = {n for e in hidden for n in e.names} | set(self.specimen.space.names)
        names, modes, shapes = self.specimen.solved(hidden, {n: v for n, v in values.items() if n in known}, places)
        return names, modes, _most_real(shapes)

    def _off(self, places: tuple[Sensor, ...], rng: np.random.Generator) -> tuple[tuple[Sensor, ...], str]:
        """The places with one sensor elsewhere on its part, and its name."""
        while True:
            k, axis = int(rng.integers(len(places))), int(rng.integers(3))
            sensor, step = places[k], np.zeros(3)
            step[axis] = rng.uniform(*OFF) * (1 if rng.random() < 0.5 else -1)
            x, y, z = np.add(sensor.point, step)
            there = replace(sensor, point=(float(x), float(y), float(z)))
            _, distance = self.specimen.fine.locator.row(there.point, "xyz".index(sensor.direction), sensor.on)
            if distance < 0.1:
                return (*places[:k], there, *places[k + 1 :]), sensor.name

    def _read(
        self, fault: str, shapes: np.ndarray, seed: int, names: tuple[str, ...], modes: Modes
    ) -> tuple[np.ndarray, str]:
        """Shapes as a test with that fault reads them, and the candidate or the sensor that is right."""
        layout, rng = self.specimen.layout, np.random.default_rng(seed)
        if fault in ("", "place"):
            return shapes, ""
        if fault == "sign":
            k, out = int(rng.integers(len(layout))), shapes.copy()
            out[k] *= -1
            return out, layout[k].name
        freq = dict(zip(names, modes.natural_freq.tolist(), strict=True))
        read, right = misread(fault, shapes, layout, rng, freq)
        first = int(np.random.default_rng(seed).integers(len(layout)))  # which `misread` draws first
        return read, right or layout[first].name

    def _scores(
        self, clean: Mapping[tuple[bool, bool], MeasuredModes], values: Mapping[str, float], effect: bool, fault: bool
    ) -> dict[str, float]:
        """Expected scores of what is hidden, each after the other is freed."""
        of = {key: ModalResidual(self.specimen.problem(one)) for key, one in clean.items()}
        own = {name: value for name, value in values.items() if name in self.space}
        free = [p.name for p in self.space.free if not p.integer]
        at = {key: one.residual(own) for key, one in of.items()}
        if len({len(rows) for rows in at.values()}) > 1:
            return {"effect": 0.0}
        slope = of[True, True].jacobian(own, free) * [self.space[n].prior_width for n in free]
        change = {"effect": at[True, True] - at[False, True]} if effect else {}
        change |= {"fault": at[True, True] - at[True, False]} if fault else {}
        out = {}
        for name, by in change.items():
            others = [pattern[:, None] for other, pattern in change.items() if other != name]
            wide = np.hstack(
                [np.vstack([slope, np.eye(len(free))]), *[np.pad(o, ((0, len(free)), (0, 0))) for o in others]]
            )
            basis, whole = la.qr(wide, mode="economic")[0], np.concatenate([by, np.zeros(len(free))])
            out[name] = round(float(np.linalg.norm(whole - basis @ (basis.T @ whole))), 2)
        return out

    def _truth(self, scenario: Scenario, measured: Measured) -> dict[str, Any]:
        assert isinstance(measured, TestedOfFour)
        magnitudes = {n: measured.values[n] for own in measured.parameters_of.values() for n in own}
        return {"hidden": list(measured.hidden), "magnitudes": magnitudes, "fault": measured.fault,
                "fault_right": measured.right, "scores": dict(measured.scores or {})}  # fmt: skip

    def _told(self, found: Explanation) -> dict[str, Any]:
        told = [fault.name for fault, _ in found.faulty]
        beside = found.datum is not None or any(fault.name not in told for fault in self._faults_beside(found))
        alike = [other for _, other in found.mistakable]
        return {"faults_told": told, "faults_alike": alike, "measurement_too": beside,
                "equally_good": list(found.equally_good)}  # fmt: skip

    def _faults_beside(self, found: Explanation) -> Sequence[Any]:
        """Faults that the verdict tells as what may be in the place of an effect."""
        return () if found.fault is None else found.fault.effects

    def other_answers(self, found: Explanation, hypotheses: Any, measured: Measured) -> dict[str, Any]:
        """None: other methods answer elsewhere."""
        return {}

    def _held_out(self, found: Explanation, hypotheses: Any, measured: Measured) -> dict[str, Any]:
        return {}


@dataclass(frozen=True, eq=False)
class FourFrameWorld(FourWorld, FrameWorld):
    """Frames."""


def fault_told(row: Mapping[str, Any]) -> bool:
    """Whether the fault is told: of a pair the candidate itself, or as one that explains about as well; else a fault of
    that sensor."""
    right = row["fault_right"]
    if " " in right:
        return right in (*row["faults_told"], *row.get("faults_alike", ()))
    return any(_sensor_of(name) == right for name in row["faults_told"])


def _sensor_of(fault: str) -> str:
    """The sensor that reads wrong by a candidate's name."""
    if " into " in fault:
        return fault.split(" into ")[1]
    return fault.split(" sensor ")[1].split()[0] if " sensor " in fault else ""


def is_right(row: Mapping[str, Any]) -> bool:
    """Whether an answer tells what is there and nothing else."""
    named = row["credible"] == row["hidden"] and (not row["hidden"] or row["outcome"] == "right")
    if row["group"] == "nothing":
        return bool(row["verdict"] == "nothing_detectable")
    return bool(named and (fault_told(row) if row["fault"] else not row["faults_told"]))


def is_hedged(row: Mapping[str, Any]) -> bool:
    """Whether what is there is told beside something that cannot be told from it."""
    return not is_right(row) and bool({*row["hidden"], row["fault_right"]} & {*row["equally_good"]})


def is_alarm(row: Mapping[str, Any]) -> bool:
    """Whether "something is missing" is said of a complete model, and no measurement error in its place."""
    quiet = row["verdict"] in ("nothing_detectable", "measurement", "noise_underestimated")
    return not row["hidden"] and not quiet and not row["measurement_too"]


def is_wrong(row: Mapping[str, Any]) -> bool:
    """Whether an effect is named that is not there, without the true one beside it."""
    return bool(row["credible"]) and not {*row["credible"]} & {*row["hidden"]}


_CRITERIA: tuple[tuple[str, str, float, bool, tuple[str, ...], Callable[[Mapping[str, Any]], bool]], ...] = (
    ("an effect alone", "names it rightly", 0.95, True, ("single",), is_right),
    ("an effect and a fault", "tells both", 0.70, True, ("both",), is_right),
    ("a fault alone", "tells it", 0.90, True, ("fault",), is_right),
    ("nothing, or a fault alone", "says that something is missing, unhedged", 0.03, False, ("nothing", "fault"),
     is_alarm),
    ("any", "names a wrong effect", 0.01, False, ("nothing", "fault", "single", "both"), is_wrong),
)  # fmt: skip


def rates(found: Sequence[Mapping[str, Any]]) -> list[Rate]:
    """Every criterion with its count."""
    out = []
    for hidden, verdict, required, at_least, groups, holds in _CRITERIA:
        own = [row for row in found if row["group"] in groups]
        out.append(Rate(hidden, verdict, required, at_least, sum(map(holds, own)), len(own)))
    return out


def report(found: Sequence[Mapping[str, Any]]) -> None:
    """Counts with bounds, and every case that is not right."""
    made = [row for row in found if row["outcome"] != "failed"]
    print(f"{len(found)} cases, {len(found) - len(made)} failed")
    for rate in rates(made):
        if rate.n:
            way, bound = (">=", "<=")[not rate.at_least], 100 * bound_of(rate)
            share = f"{rate.count} of {rate.n} ({100 * rate.count / rate.n:.1f} %, {way} {bound:.1f} %)"
            print(f"{rate.hidden}: {rate.verdict} {share}; wanted {way} {100 * rate.required:g} %")
    if made:
        print(f"evaluations of a decision in the median: {np.median([row['evaluations'] for row in made]):.0f}")
        print(f"seconds of a case in the median: {np.median([row['seconds'] for row in made]):.1f}")
    for row in made:
        if not is_right(row):
            print(f"  {row['scenario']} {row['number']}: {row['verdict']}{' (hedged)' * is_hedged(row)}; hidden",
                  *row["hidden"], row["fault"], row["fault_right"], row["scores"], "; told", *row["credible"],
                  row["faults_told"], row["measurement_too"])  # fmt: skip
    for row in found:
        if row["outcome"] == "failed":
            print(f"  {row['scenario']} {row['number']}: {row.get('error')}")


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--of", choices=tuple(_SUBJECTS), default="frame")
    arguments.add_argument("--cases", type=int, default=400)
    arguments.add_argument("--skip", type=int, default=0, help="leave out so many cases at the beginning of the plan")
    arguments.add_argument("--workers", type=int, default=1)
    arguments.add_argument(
        "--folder", type=Path, help="where cases and bases are kept (default results/rates_four_...)"
    )
    given = arguments.parse_args()
    folder = given.folder or ROOT / f"results/rates_four_{given.of}"
    folder.mkdir(parents=True, exist_ok=True)
    file, kind = folder / "runs.jsonl", FourFrameWorld if given.of == "frame" else FourWorld
    if given.what == "report":
        report(list(lines(file)))
        return
    subject: Subject = _SUBJECTS[given.of]
    world = kind(subject, folder, code_digest(subject))
    _ = world.libraries
    done = {(row["scenario"], row["number"]) for row in lines(file) if row["code"] == world.code}
    plan = islice(rounds(KINDS), given.skip, given.skip + given.cases)
    with file.open("a", encoding="utf-8") as out:
        for row in rows(world, [(s, k) for s, k in plan if (s.name, k) not in done], given.workers):
            out.write(json.dumps(row) + "\n")
            out.flush()


if __name__ == "__main__":
    main()
