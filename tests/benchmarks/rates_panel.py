"""Blind solar arrays, each explained four ways: from its modes, and from its FRFs with and without errors of the test.

The ways are modes; FRFs; FRFs with errors of channels and masses of accelerometers that the fit frees; and that it
ignores. In all FRFs the fit frees the errors of the model at resonances that the study of the FRFs states. Every array
is measured as in ``studies/hidden_panel``, whose generator builds the hidden effect into the finer mesh. Questions are
asked at full order, as the studies ask them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from other_methods import answers
from rates_outcome import magnitude, outcome
from rates_scenarios import MAGNITUDES, Scenario
from rates_subject import ROOT, Subject

from calib import read_frfs
from calib.correlation.frf.nuisance import channel_nuisances
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import EvaluationError, InputError
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.measurement.accuracy import Claim
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes
from calib.measurement.repeats import Repeat, ShapeSet, combine_repeats
from calib.missing.decision import decide
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.effects.extend import extend
from calib.structure.effects.perturbations import perturbations
from calib.structure.effects.variants import Variants
from calib.study.loading import module_of
from calib.study.settings import MeasurementSettings
from calib.study.study import LoadedStudy, with_nuisances

ERRORS = {"gain": 0.01, "phase": 0.5, "accelerometer": 0.005}
"""Standard deviations of the channels' gains (relative) and phases (degrees); kg at every sensor."""
FREED = {"gain": 1.0, "phase": 0.5, "accelerometer": 0.005}
"""The same as priors of `channel_nuisances`, in %, degrees and kg."""
BESIDE = 0.07
"""Half of the band held out around the fifth mode, over its frequency: to the outermost of its lines and beyond."""


@dataclass(frozen=True, eq=False)
class Array:
    """One blind array.

    Attributes
    ----------
    values : mapping
        True parameters, magnitudes, nuisance parameters of effects.
    effects : tuple of Effect
        As the fitted model would have them, or designs outside the library.
    structure : Spanned
    rng : Generator
        Of the noise.
    """

    values: Mapping[str, float]
    effects: tuple[Effect, ...]
    structure: Any
    rng: np.random.Generator

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the effects that it has."""
        return tuple(effect.name for effect in self.effects)


@dataclass(frozen=True, eq=False)
class PanelWorld:
    """Models and library, made once a process; see `rates_world.World`.

    Attributes
    ----------
    subject : Subject
    folder : Path
        Not used: no basis is kept.
    code : str
    """

    subject: Subject
    folder: Path
    code: str

    @cached_property
    def maker(self) -> Any:
        """The generator of the study."""
        return module_of(self.subject.maker)

    @cached_property
    def study(self) -> LoadedStudy:
        """For its library and accuracy; its measurement is not used."""
        return LoadedStudy.load(ROOT / self.subject.study)

    @cached_property
    def effects(self) -> dict[str, tuple[Effect, Effect]]:
        """By name: an effect on the fitted mesh, and as it is built into the array."""
        made = self.maker.remodelled
        own = zip(self.study.candidates, made.remodelled_effects(), strict=True)
        return {e.name: (e, built) for e, built in (*own, *((o, o) for o in made.outside_effects()))}

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """What may be hidden."""
        library = self.study.candidates
        out = [Scenario("nothing", "nothing", each=8)]
        out += [Scenario(f"{e.name}/{s}", "single", (e.name,), f) for s, f in MAGNITUDES.items() for e in library]
        out += [
            Scenario(f"outside/{n}/{s}", "outside", (n,), MAGNITUDES[s]) for s in "ML" for n in self.subject.outside
        ]
        out += [Scenario(f"without/{e.name}/M", "removed", (e.name,), 1.0, True) for e in library]
        return tuple(out)

    def settle(self) -> None:
        """Everything that is shared by the runs."""
        _ = self.variants, self.maker.fine(), self.maker.nominal(), self.effects

    @cached_property
    def variants(self) -> Variants:
        """The fitted model with the library and its local perturbations."""
        model, held = self.maker.base(), self.study.settings.held_out.sensors
        used = [sensor for sensor in self.maker.layout() if sensor.name not in held]
        lowest = float(model.modes(model.space.values, 1).natural_freq[0])
        local = tuple(p.effect for p in perturbations(model, used, model.space.values, lowest))
        return Variants(model, self.study.candidates, local)

    # -- one array -----------------------------------------------------------------------------------------------------

    def array(self, scenario: Scenario, number: int) -> Array:
        """Draw one; the seed is the scenario's name and the number alone."""
        rng = np.random.default_rng([*scenario.name.encode(), number])
        values = self.maker.draw(rng)
        known = [self.effects[name] for name in scenario.effects]
        for effect, _ in known:
            values |= self.maker.draw_effect(effect, scenario.magnitude, rng)
        structure = self.maker.built([built for _, built in known], values)
        return Array(values, tuple(effect for effect, _ in known), structure, rng)

    def run(self, scenario: Scenario, number: int) -> dict[str, Any]:
        """One array: a row with what each way tells beside the truth."""
        started = time.perf_counter()
        array = self.array(scenario, number)
        tests = self.tests(array)
        ways = {way: self._told(way, tests[way], scenario, array) for way in self.subject.ways}
        values = {name: round(value, 6) for name, value in array.values.items()}
        return {
            "code": self.code, "scenario": scenario.name, "number": number, "group": scenario.group,
            "hidden": list(array.hidden), "parameters": values, "ways": ways,
            "magnitudes": {n: array.values[n] for e in array.effects for n in e.names},
            "seconds": round(time.perf_counter() - started, 2),
        }  # fmt: skip

    def tests(self, array: Array) -> dict[str, tuple[Any, Any]]:
        """Of every way the pair as measured, and without noise."""
        names, modes, shapes = self.maker.named_modes(array.structure)
        problems = (self.maker.modal_problem(m) for m in (
            self._modes(names, [self.maker.noisy(modes, shapes, array.rng) for _ in range(self.maker.REPEATS)]),
            self.maker.noiseless(names, modes, shapes),
        ))  # fmt: skip
        measured, clean = (ModalResidual(problem) for problem in problems)
        out: dict[str, tuple[Any, Any]] = {"modes": (measured, clean)}
        fifth = modes.damped_freq[names.index("M5")] if "M5" in names else None
        exact = self._frfs(array, fifth, {})
        flawed = self._frfs(array, fifth, ERRORS)
        for way, (seen, true) in (("frfs", exact), ("freed", flawed), ("ignored", flawed)):
            out[way] = self._pair(seen, way), self._pair(true, way)
        return out

    def _modes(self, names: tuple[str, ...], repeats: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> MeasuredModes:
        unknown, layout = np.full(len(names), np.nan), self.maker.layout()
        where = tuple((s.node, s.direction) for s in layout)
        c = combine_repeats([
            Repeat("", names, True, freq, unknown, damping, unknown,
                   ShapeSet("", where, shapes, np.full(shapes.shape, np.nan)))
            for freq, damping, shapes in repeats
        ])  # fmt: skip
        return MeasuredModes(
            c.names, c.natural_freq, c.natural_freq * np.sqrt(1 - c.damping_ratio**2), c.freq_std, c.damping_ratio,
            c.damping_std, layout, c.shapes, c.shape_std, len(repeats), True,
            freq_count=c.freq_count, damping_count=c.damping_count, shape_count=c.shape_count,
        )  # fmt: skip

    def _frfs(
        self, array: Array, fifth: float | None, errors: Mapping[str, float]
    ) -> tuple[MeasuredFRFs, MeasuredFRFs]:
        """Mean of the repeats, and the noise-free functions with its standard deviations; without what is held out."""
        test = self.maker.frf_test(array.structure, **errors)
        simulated = self.maker.frf_twin.simulate(array.structure, array.values, test, array.rng)
        with TemporaryDirectory() as folder:
            self.maker.frf_twin.write(simulated, Path(folder), "solar array")
            mean = read_frfs(f"{folder}/*.uff", sensors=f"{folder}/sensors.csv", synthetic=True)
        mean = replace(mean, accuracy=self.accuracy)
        names = [sensor.name for sensor in test.responses]
        exact = simulated.noise_free[:, [names.index(sensor.name) for sensor in mean.responses]]
        held = self.study.settings.held_out.sensors
        bands = [] if fifth is None else [((1 - BESIDE) * fifth, (1 + BESIDE) * fifth)]
        true = replace(mean, values=exact)
        return mean.without(held, (), bands), true.without(held, (), bands)

    @cached_property
    def by_frfs(self) -> MeasurementSettings:
        """What the study of the FRFs claims of them and of the model."""
        return LoadedStudy.load(ROOT / f"{self.subject.study}_frf").settings.measurement

    @cached_property
    def accuracy(self) -> Claim:
        """Claimed by that study."""
        assert isinstance(self.by_frfs.accuracy, str)
        return Claim.of(self.by_frfs.accuracy)

    def _pair(self, measured: MeasuredFRFs, way: str) -> FRFResidual:
        channels = FREED if way == "freed" else {}
        nuisances = channel_nuisances(measured, **channels, resonance=self.by_frfs.nuisances.resonance)
        return FRFResidual(FRFProblem(self.maker.base(), measured, nuisances))

    def _space(self, pair: Any) -> ParameterSpace:
        space: ParameterSpace = self.maker.base().space
        return with_nuisances(space, pair.problem) if isinstance(pair, FRFResidual) else space

    def _told(self, way: str, pairs: tuple[Any, Any], scenario: Scenario, array: Array) -> dict[str, Any]:
        """What one way tells; a failure is a row as well."""
        started, (seen, true) = time.perf_counter(), pairs
        row: dict[str, Any] = {"visible": [round(self._visible(true, e, array), 2) for e in array.effects]}
        try:
            space = self._space(seen)
            hypotheses = ModelHypotheses(seen, self.variants, space, array.hidden if scenario.removed else ())
            found = decide(hypotheses)
            row |= outcome(found, array)
            if row["outcome"] == "right":
                row |= magnitude(found, array)
            row["seconds"] = round(time.perf_counter() - started, 2)
            row |= answers(found, hypotheses, array)
        except (EvaluationError, InputError, np.linalg.LinAlgError) as fault:
            row |= {"verdict": "failed", "outcome": "failed", "error": f"{way}: {type(fault).__name__}: {fault}"}
        return {"seconds": round(time.perf_counter() - started, 2)} | row

    def _visible(self, true: Any, effect: Effect, array: Array) -> float:
        """Length of the change of noise-free data by an effect that no parameter absorbs, in standard deviations."""
        base = self.maker.base()
        model = extend(base, [effect])
        more = true.with_model(model, model.n_dof - base.n_dof)
        return float(self.maker.change_seen(true, more, self._space(true), array.values))
