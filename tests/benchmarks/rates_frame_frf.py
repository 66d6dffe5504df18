"""Blind frames measured by FRFs: nothing hidden, a channel that reads wrong, an effect, or what is in no library.

The frame of `rates_frame`, with losses in its members and in the ground, under two shakers. Its twin has the finer
mesh, into which effects are built otherwise than the library lists them. A fault is the gain or the phase of one
channel, of a sensor or a force; faults of the test are candidates, and errors of the model at its resonances are
fitted, as in ``studies/hidden_panel_frf``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rates_frame import COARSE, FINE, FrameSpecimen, FrameWorld, built, frame, frame_effects, layout, outside_effects
from rates_outcome import Measured
from rates_scenarios import MAGNITUDES, OWN, Scenario
from rates_subject import ROOT

from calib import read_frfs
from calib.correlation.frf.nuisance import channel_nuisances
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.library import local_perturbations
from calib.measurement.accuracy import frf_claim
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.structure.effects.extend import extend
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from calib.study.loading import module_of
from calib.study.study import with_nuisances

frf_twin = module_of(ROOT / "studies/frf_twin.py")
LINES = 0.75 + 0.25 * np.arange(64)
"""Hz; nine modes of 0.1 to 1 % of critical damping."""
SHAKERS = (("column 33", 1.0, "x"), ("beam 21", 0.25, "z"))
"""At the top of the last column, and upright on the second floor."""
SHARE, FLOOR, REPEATS = 0.01, 1e-7, 3
"""Noise of one repeat: over the modulus, and in m/(N s2)."""
ACCURACY, RESONANCE = {"share": "1 %", "floor": 1e-7}, 1.0
"""What a user would claim of this mesh: at every line, and % at the peaks of the resonances."""
GAIN, PHASE = (0.10, 0.30), (4.0, 12.0)
"""Ranges of a wrong channel's gain less 1, either sign, and of its phase, degrees."""
LEAST = 4.0
"""Expected score below which an effect may stay unseen."""


def forces() -> tuple[Sensor, ...]:
    """Where the shakers act."""
    mesh = frame(COARSE)
    nodes = [(mesh.node(member, along), direction) for member, along, direction in SHAKERS]
    return tuple(Sensor(node + 1, direction, mesh.points[node]) for node, direction in nodes)


def sensors() -> tuple[Sensor, ...]:
    """Every third place of the modal test, and the drive points, without which a fit has no linear start."""
    some, driven = layout()[::3], {f.name for f in forces()}
    return (*some, *(s for s in layout() if s.name in driven - {own.name for own in some}))


@dataclass(frozen=True)
class Fault:
    """A channel that reads wrong in all repeats.

    Attributes
    ----------
    kind : {"gain", "phase"}
    side : {"response", "reference"}
    channel : Sensor
    size : float
        Of the gain relative, of the phase in degrees.
    """

    kind: str
    side: str
    channel: Sensor
    size: float

    @classmethod
    def drawn(cls, kind: str, test: Any, rng: np.random.Generator) -> Fault:
        """Of any channel, of either sign."""
        channels = [("response", s) for s in test.responses] + [("reference", s) for s in test.references]
        side, channel = channels[int(rng.integers(len(channels)))]
        low, high = GAIN if kind == "gain" else PHASE
        return cls(kind, side, channel, float(rng.uniform(low, high)) * (1 if rng.random() < 0.5 else -1))

    @property
    def name(self) -> str:
        """Of the candidate."""
        return f"{self.kind}_{'force_' if self.side == 'reference' else ''}{self.channel.name}"

    def factors(self, test: Any) -> np.ndarray:
        """What the functions (n_responses, n_references) are multiplied by; those of a force are divided."""
        out = np.ones((len(test.responses), len(test.references)), dtype=complex)
        own = 1 + self.size if self.kind == "gain" else np.exp(1j * np.radians(self.size))
        if self.side == "response":
            out[test.responses.index(self.channel)] = own
        else:
            out[:, test.references.index(self.channel)] = 1 / own
        return out


@dataclass(frozen=True, eq=False)
class TestedFRFs(Measured):
    """As `Measured`, of functions.

    Attributes
    ----------
    fault : Fault or None
    """

    fault: Fault | None = None


def told_rightly(row: Mapping[str, Any]) -> bool:
    """Whether an answer is right.

    Of a complete frame: nothing is missing. Of a wrong channel: it is told, and no effect. Of an effect: it is named
    alone, or something like it is told; one that no test would see may stay unseen. Of a design outside the library: no
    effect is named, and where it is visible something is missing.
    """
    unseen = min(row.get("visible", ()), default=0.0) < LEAST
    quiet = row["verdict"] == "nothing_detectable"
    if row["group"] == "nothing":
        return quiet
    if row["group"] == "fault":
        return row.get("blamed") == [row["fault"]] and not row["credible"]
    if row["group"] == "single":
        like = bool((row.get("nearly") or {}).get("right"))
        return row["outcome"] == "right" or like or (unseen and quiet)
    return row["outcome"] != "failed" and not row["credible"] and (unseen or not quiet)


@dataclass(frozen=True, eq=False)
class FRFFrameWorld(FrameWorld):
    """Damped frames under two shakers; nothing is held out."""

    @cached_property
    def specimen(self) -> Any:
        """The damped frame, of which no modes are measured."""
        nothing: tuple[str, ...] = ()
        return FrameSpecimen(
            file=ROOT, base=frame(COARSE).model(damped=True), fine=frame(FINE).model(damped=True),
            library=frame_effects(), outside=outside_effects(), modes=nothing, layout=sensors(),
            nominal=np.zeros((0, 0)),
        )  # fmt: skip

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """Thirty a round: six complete frames, six wrong channels, fourteen effects, four designs outside."""
        sizes = {s: MAGNITUDES[s] for s in "ML"}
        out = [Scenario("nothing", "nothing", each=6)]
        out += [Scenario(f"fault/{kind}", "fault", each=3) for kind in ("gain", "phase")]
        out += [Scenario(f"{e.name}/{s}", "single", (e.name,), f) for s, f in sizes.items() for e in self.library]
        out += [
            Scenario(f"outside/{n}/{s}", "outside", (n,), f) for s, f in sizes.items() for n in self.subject.outside
        ]
        return tuple(out)

    def settle(self) -> None:
        """Everything that takes long."""
        _ = self.libraries

    @cached_property
    def libraries(self) -> dict[str, Any]:
        """The model with its library, at full order: each effect of a few elements takes a basis nearly as large."""
        values = self.specimen.base.space.values
        seen = self._functions(self.specimen.base, values, np.random.default_rng(1))[1]
        tested = local_perturbations(self.model, [seen], values)
        return {OWN: Variants(self.model, self.library, tuple(p.effect for p in tested))}

    def measure(self, scenario: Scenario, number: int) -> Measured:
        """Draw a truth and measure it three times; the seed is the scenario's name and the number alone."""
        rng = np.random.default_rng([*scenario.name.encode(), number])
        values = self.specimen.draw(rng)
        hidden = tuple(self.effects[name] for name in scenario.hidden(rng, self.library))
        for effect in hidden:
            values |= self.maker.blind.draw_effect(effect, scenario.magnitude, rng)
        names = tuple(effect.name for effect in hidden)
        listed = set(names) <= {effect.name for effect in self.library}
        model = built(names, values, damped=True) if names and listed else self.specimen.structure(hidden)
        own = {name: value for name, value in values.items() if name in model.space}
        fault = Fault.drawn(scenario.name.split("/")[1], self._test, rng) if scenario.group == "fault" else None
        seen, clean = self._functions(model, own, rng, fault)
        return TestedFRFs(values, {e.name: e.names for e in hidden}, clean, seen, fault)

    @cached_property
    def _test(self) -> Any:
        """How a frame is measured."""
        return frf_twin.FRFTest(
            LINES, self.specimen.layout, forces(), "accelerance", share=SHARE, floor=FLOOR, repeats=REPEATS
        )

    def _functions(
        self, model: StructuralModel, values: Mapping[str, float], rng: np.random.Generator, fault: Fault | None = None
    ) -> tuple[MeasuredFRFs, MeasuredFRFs]:
        """Mean of the repeats, with a fault, and the functions without noise and fault with its standard deviations."""
        simulated = frf_twin.simulate(model, values, self._test, rng)
        exact = simulated.noise_free
        if fault is not None:
            read = [replace(one, values=one.values * fault.factors(self._test)) for one in simulated.repeats]
            simulated = replace(simulated, repeats=tuple(read))
        with TemporaryDirectory() as folder:
            frf_twin.write(simulated, Path(folder), "frame")
            mean = read_frfs(f"{folder}/*.uff", sensors=f"{folder}/sensors.csv", synthetic=True)
        mean = replace(mean, accuracy=frf_claim(ACCURACY))
        names = [[s.name for s in side] for side in (self._test.responses, self._test.references)]
        rows, columns = (
            [own.index(s.name) for s in side]
            for own, side in zip(names, (mean.responses, mean.references), strict=True)
        )
        return mean, replace(mean, values=exact[:, rows][:, :, columns])

    def _problem(self, model: StructuralModel, measured: MeasuredFRFs) -> FRFProblem:
        return FRFProblem(model, measured, channel_nuisances(measured, resonance=RESONANCE))

    def hypotheses(self, scenario: Scenario, measured: Measured) -> ModelHypotheses[Any]:
        """The question to the measured functions."""
        problem = self._problem(self.model, measured.whole)
        space = with_nuisances(self.space, problem)  # without the faults, which are candidates
        return ModelHypotheses(FRFResidual(problem).suspected(), self.libraries[scenario.library], space)

    def _truth(self, scenario: Scenario, measured: Measured) -> dict[str, Any]:
        pair = FRFResidual(self._problem(self.model, measured.clean))
        space = with_nuisances(self.space, pair.problem)
        size = [
            self.maker.blind.change_seen(pair, pair.with_model(extend(self.model, [e])), space, measured.only(e))
            for e in (self.effects[name] for name in measured.hidden)
        ]
        values = {n: round(v, 5) for n, v in measured.values.items() if n in self.space.free_names}
        magnitudes = {n: measured.values[n] for own in measured.parameters_of.values() for n in own}
        return {
            "hidden": list(measured.hidden), "magnitudes": magnitudes, "parameters": values,
            "visible": [round(v, 2) for v in size], "fault": measured.fault.name if measured.fault else "",
            "fault_size": measured.fault.size if measured.fault else 0.0,
        }  # fmt: skip

    def other_answers(self, found: Any, hypotheses: Any, measured: Measured) -> dict[str, Any]:
        """None: other methods answer on the modal tests of the frame."""
        return {}

    def run(self, scenario: Scenario, number: int) -> dict[str, Any]:
        """As any world's, with whether what is told is right."""
        row = super().run(scenario, number)
        return row | {"told_rightly": told_rightly(row)}
