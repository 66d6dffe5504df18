"""Blind bogies, each explained from its modes and from its FRFs.

The bogies, their modal tests and their hidden effects are those of ``rates_world``, run by run; the same structure,
with its sensors where they truly sit, is then measured under two shakers as in ``studies/hidden_bogie_frf``.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from other_methods import answers
from rates_outcome import Measured, magnitude, outcome
from rates_scenarios import MAGNITUDES, Scenario
from rates_subject import ROOT
from rates_world import World

from calib import read_frfs
from calib.analyses.hypotheses_of_study import basis_of, perturbations_of
from calib.correlation.frf.nuisance import concerned
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.errors.errors import EvaluationError, InputError
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.missing.decision import decide
from calib.problem.effect import Effect
from calib.results.results import Results
from calib.structure.effects.extend import extend
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

STUDY = ROOT / "studies/hidden_bogie_frf"


@dataclass(frozen=True, eq=False)
class Structure:
    """One blind bogie as built.

    Attributes
    ----------
    model : StructuralModel
    values : mapping
        Of its parameters.
    places : sequence of Sensor
        Where the sensors truly sit.
    """

    model: StructuralModel
    values: dict[str, float]
    places: Sequence[Sensor]


@dataclass(frozen=True, eq=False)
class BogieWorld(World):
    """Models and libraries of both ways, made once a process."""

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """What may be hidden: nothing, one effect, one outside the library, one taken out of it."""
        library, outside = self.study.candidates, self.subject.outside
        out = [Scenario("nothing", "nothing", each=8)]
        out += [Scenario(f"{e.name}/{s}", "single", (e.name,), f) for s, f in MAGNITUDES.items() for e in library]
        out += [Scenario(f"outside/{n}/{s}", "outside", (n,), MAGNITUDES[s]) for s in "ML" for n in outside]
        out += [Scenario(f"without/{e.name}/M", "removed", (e.name,), 1.0, True) for e in library]
        return tuple(out)

    def settle(self) -> None:
        """Everything that takes long."""
        super().settle()
        _ = self.variants

    @cached_property
    def by_frfs(self) -> LoadedStudy:
        """For its model, priors, accuracy and what it holds out; its measurement is not used but to train a basis."""
        return LoadedStudy.load(STUDY)

    @cached_property
    def maker_of_frfs(self) -> Any:
        """The generator of that study."""
        return module_of(STUDY / "make_twin.py")

    @cached_property
    def finer(self) -> Any:
        """The same structures on the mesh of that generator: functions of light modes need a finer one."""
        return self.maker.specimen(self.subject.really_built, self.maker_of_frfs.ELEMENT_SIZE)

    @cached_property
    def variants(self) -> Variants:
        """Its model with the library and the local perturbations, on a reduced basis."""
        study = self.by_frfs
        (local,) = perturbations_of(study).values()
        basis = basis_of(study, Results.at(self.folder / "frf", study.name), local)
        model = study.model
        assert isinstance(model, StructuralModel)
        return Variants(model, study.candidates, tuple(p.effect for p in local), basis)

    def run(self, scenario: Scenario, number: int) -> dict[str, Any]:
        """One bogie: a row with what each way tells beside the truth."""
        started = time.perf_counter()
        by_modes = super().run(scenario, number)
        measured = self.measure(scenario, number)
        by_frfs = self._told(scenario, number, measured)
        own = ("code", "scenario", "number", "group", "hidden", "magnitudes", "parameters")
        ways = {
            "modes": {k: v for k, v in by_modes.items() if k not in own},
            "frfs": by_frfs,
        }
        return {k: by_modes[k] for k in own if k in by_modes} | {
            "ways": ways, "seconds": round(time.perf_counter() - started, 2),
        }  # fmt: skip

    # -- FRFs of the same structure ------------------------------------------------------------------------------------

    def structure(self, scenario: Scenario, number: int) -> Structure:
        """The structure that `measure` measures, drawn in the same order."""
        rng = np.random.default_rng([*scenario.name.encode(), number])
        values = self.specimen.draw(rng)
        hidden = tuple(self.effects[name] for name in scenario.hidden(rng, self.library))
        for effect in hidden:
            values |= self.maker.blind.draw_effect(effect, scenario.magnitude, rng)
        places = self.maker.blind.twin.moved(self.specimen.layout, copy.deepcopy(rng))
        own = tuple(e.name for e in hidden)
        listed = set(own) <= {e.name for e in self.library}
        finer = self.finer
        model = finer.built(own, values) if own and listed else finer.structure(hidden)
        return Structure(model, {name: values[name] for name in model.space.names if name in values}, places)

    def frfs(self, scenario: Scenario, number: int) -> tuple[MeasuredFRFs, MeasuredFRFs]:
        """Mean of the repeats, and the noise-free functions with its standard deviations; without what is held out."""
        made, there = self.maker_of_frfs, self.structure(scenario, number)
        named = {sensor.name: sensor for sensor in self.specimen.layout}
        test = made.frf_twin.FRFTest(
            made.LINES, self.specimen.layout, tuple(named[name] for name in made.SHAKERS), "accelerance",
            share=made.SHARE, floor=made.FLOOR,
        )  # fmt: skip
        rng = np.random.default_rng([*scenario.name.encode(), number, made.STREAM])
        simulated = made.frf_twin.simulate(there.model, there.values, test, rng, there.places)
        with TemporaryDirectory() as folder:
            made.frf_twin.write(simulated, Path(folder), "bogie test")
            mean = read_frfs(f"{folder}/*.uff", sensors=f"{folder}/sensors.csv", synthetic=True)
        mean = replace(mean, accuracy=self.by_frfs.frfs.accuracy)
        names = [sensor.name for sensor in test.responses]
        exact = simulated.noise_free[:, [names.index(sensor.name) for sensor in mean.responses]]
        held = self.by_frfs.settings.held_out
        bands = [(float(low), float(high)) for low, high in held.bands]
        return mean.without(held.sensors, (), bands), replace(mean, values=exact).without(held.sensors, (), bands)

    def _told(self, scenario: Scenario, number: int, measured: Measured) -> dict[str, Any]:
        """What the FRFs tell; a failure is a row as well."""
        started, row = time.perf_counter(), dict[str, Any]()
        try:
            freed = concerned(self.by_frfs.experiment.nuisances, self.by_frfs.problem.measured)
            seen, true = (
                FRFResidual(FRFProblem(self.variants.model, one, freed)) for one in self.frfs(scenario, number)
            )
            effects = [self.effects[name] for name in measured.hidden]
            row["visible"] = [round(self._visible(true, e, measured), 2) for e in effects]
            without = measured.hidden if scenario.removed else ()
            hypotheses = ModelHypotheses(seen, self.variants, self.by_frfs.search_space, without)
            found = decide(hypotheses)
            row |= outcome(found, measured)
            if row["outcome"] == "right":
                row |= magnitude(found, measured)
            row["seconds"] = round(time.perf_counter() - started, 2)
            row |= answers(found, hypotheses, measured)
        except (EvaluationError, InputError, np.linalg.LinAlgError) as fault:
            row |= {"verdict": "failed", "outcome": "failed", "error": f"frfs: {type(fault).__name__}: {fault}"}
        return {"seconds": round(time.perf_counter() - started, 2)} | row

    def _visible(self, true: FRFResidual, effect: Effect, measured: Measured) -> float:
        """Length of the change of noise-free FRFs by an effect that no parameter absorbs, in standard deviations."""
        base, space = self.variants.model, self.by_frfs.search_space
        more = true.with_model(extend(base, [effect]))
        values = {**base.space.values, **measured.only(effect)}
        own = {name: value for name, value in values.items() if name in base.space}
        given = {name: value for name, value in values.items() if name in more.space}
        names = [p.name for p in space.free if not p.integer]
        change = true.residual(own) - more.residual(given)
        slope = true.jacobian(own, names) * [space[n].prior_width for n in names]
        basis = np.linalg.qr(np.vstack([slope, np.eye(len(names))]))[0]  # the prior counts as data
        direction = np.concatenate([change, np.zeros(len(names))])
        return float(np.linalg.norm(direction - basis @ (basis.T @ direction)))
