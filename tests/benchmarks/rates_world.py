"""A blind test bench: any number of synthetic measurements whose truth is known, and one run on each.

Nothing here is tuned to answers. A measurement comes from the twin of the subject's blind studies, a finer mesh at full
order or on a reduced basis of its own; the question is asked on the reduced basis of the coarser model, as in a study.
"""

from __future__ import annotations

import ast
import hashlib
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from other_methods import answers
from rates_outcome import Measured, magnitude, outcome
from rates_scenarios import FIFTY, OWN, Scenario, fifty_effects, scenarios
from rates_subject import ROOT, Subject

from calib.correlation.basis import BasisRequirements
from calib.correlation.modal.fault_library import modal_faults
from calib.correlation.modal.held_out import held_out_errors
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import EvaluationError, InputError
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.library import effects_basis
from calib.measurement.modal import MeasuredModes
from calib.measurement.repeats import Repeat, ShapeSet, combine_repeats
from calib.missing.decision import decide
from calib.missing.explanation import Explanation
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.effects.perturbations import Perturbation, perturbations
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.basis import Basis
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

ANSWERING = (
    "calib/missing", "calib/structure", "calib/correlation", "calib/inference", "calib/measurement", "models",
    "calib/problem", "calib/hypotheses", "calib/experiment", "calib/study",
    "tests/benchmarks/rates_world.py", "tests/benchmarks/rates_scenarios.py", "tests/benchmarks/rates_outcome.py",
)  # fmt: skip
_NEAR = 3.0
"""Standard deviations of a draw within which the twin's basis is trained."""


def code_digest(subject: Subject) -> str:
    """Hash over all code that a run depends on; comments and docstrings do not count."""
    return digest_of(subject.sources)


def digest_of(sources: Iterable[str]) -> str:
    """The same of the code that answers and of further files and folders, from the top of the repository."""
    digest = hashlib.sha256()
    for place in (*ANSWERING, *sources):
        path = ROOT / place
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            text = file.read_text("utf-8")
            digest.update(_plain(text).encode() if file.suffix == ".py" else text.encode())
    return digest.hexdigest()[:10]


def _plain(text: str) -> str:
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [s for s in body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
    return ast.dump(tree)


@dataclass(frozen=True, eq=False)
class World:
    """Model, twin and libraries, made once a process.

    Attributes
    ----------
    subject : Subject
    folder : Path
        Where reduced bases are kept.
    code : str
    added : tuple of Effect
        What the library has beside the study's effects.
    """

    subject: Subject
    folder: Path
    code: str
    added: tuple[Effect, ...] = ()

    @cached_property
    def maker(self) -> Any:
        """The generator of the blind studies."""
        return module_of(self.subject.maker)

    @cached_property
    def specimen(self) -> Any:
        """What is measured."""
        return self.maker.specimen(really_built=True) if self.subject.really_built else self.maker.specimen()

    @cached_property
    def study(self) -> LoadedStudy:
        """One of them, for its settings; its measurement is not used."""
        return LoadedStudy.load(ROOT / self.subject.study)

    @property
    def model(self) -> StructuralModel:
        """The base model within the search limits."""
        model = self.specimen.model
        assert isinstance(model, StructuralModel)
        return model

    @property
    def space(self) -> ParameterSpace:
        """Free are the parameters of the search."""
        return self.model.space

    @property
    def library(self) -> tuple[Effect, ...]:
        """What the model may lack."""
        return (*self.study.candidates, *self.added)

    @cached_property
    def effects(self) -> dict[str, Effect]:
        """Every effect by name, those outside the library too."""
        return {e.name: e for e in (*self.library, *self.specimen.outside)}

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """What may be hidden."""
        return scenarios(self.subject, self.study.candidates)

    def settle(self) -> None:
        """Everything that takes long."""
        _ = self.libraries, self.twin

    # -- models --------------------------------------------------------------------------------------------------------

    @cached_property
    def libraries(self) -> dict[str, Variants]:
        """The model with each library of effects."""
        held = self.study.settings.held_out.sensors
        used = [s for s in self.specimen.layout if s.name not in held]
        tested = perturbations(self.model, used, self.space.values, 10.0)
        local = tuple(a.effect for a in tested)
        own = self.library
        many = (*own, *fifty_effects(self.model, 50 - len(own)))
        basis = self._basis("own", self.model, self.space, own, tested)
        # Those that lengthen the library scale a few parts; the basis holds what each part does.
        return {OWN: Variants(self.model, own, local, basis), FIFTY: Variants(self.model, many, local, basis)}

    @cached_property
    def twin(self) -> Variants:
        """What is measured, with everything that may be hidden."""
        fine, hidden = self.specimen.fine, tuple(self.effects.values())
        basis = None
        if self.subject.reduced_twin:
            space = self.space
            for p in space.free:
                near = _NEAR * self.maker.blind.SPREAD * p.prior_width
                limits = {"lower": max(p.lower, p.value - near), "upper": min(p.upper, p.value + near)}
                space = space.replace(p.name, **limits)
            basis = self._basis("twin", fine, space, hidden, (), self._twin_modes)
        return Variants(fine, hidden, (), basis)

    @property
    def _twin_modes(self) -> int:
        """How many of its modes are solved."""
        return len(self.specimen.modes) + int(self.maker.blind.MORE)

    def _basis(
        self,
        name: str,
        model: StructuralModel,
        space: ParameterSpace,
        effects: Sequence[Effect],
        local: Sequence[Perturbation],
        count: int | None = None,
    ) -> Basis:
        settings, problem, folder = self.study.settings.reduction, self.study.problem, self.folder / name
        wanted = BasisRequirements.of(
            replace(problem, mode_count=count or problem.mode_count), settings.tolerance, settings.seed
        )
        folder.mkdir(parents=True, exist_ok=True)
        return effects_basis(model, space, effects, local, wanted, folder)

    # -- one measurement -----------------------------------------------------------------------------------------------

    def measure(self, scenario: Scenario, number: int) -> Measured:
        """Draw a truth and measure it five times; the seed is the scenario's name and the number alone."""
        rng = np.random.default_rng([*scenario.name.encode(), number])
        values = self.specimen.draw(rng)
        hidden = tuple(self.effects[name] for name in scenario.hidden(rng, self.library))
        for effect in hidden:
            values |= self.maker.blind.draw_effect(effect, scenario.magnitude, rng)
        names, modes, shapes = self._solved(hidden, values, rng)
        clean = self.specimen.noiseless(names, modes, shapes)
        modes, shapes = self.maker.blind.set_up_errors(modes, shapes, scenario.noise, rng)
        repeats = [self._repeat(names, self.maker.blind.twin.noisy(modes, shapes, rng)) for _ in range(5)]
        return Measured(values, {e.name: e.names for e in hidden}, clean, self._combined(repeats))

    def _solved(
        self, hidden: Sequence[Effect], values: dict[str, float], rng: np.random.Generator
    ) -> tuple[tuple[str, ...], Modes, np.ndarray]:
        own = tuple(e.name for e in hidden)
        if self.specimen.built is not None and own and set(own) <= {e.name for e in self.library}:
            model = self.specimen.built(own, values)
            true = {name: value for name, value in values.items() if name in model.space}
            rebuilt: tuple[tuple[str, ...], Modes, np.ndarray] = self.specimen.seen(
                model, max(model.n_dof - self.specimen.fine.n_dof, 0), true, rng
            )
            return rebuilt
        found: tuple[tuple[str, ...], Modes, np.ndarray] = self.specimen.seen(
            self.twin.with_effects(own), self.twin.added(own), values, rng
        )
        return found

    def _repeat(self, names: tuple[str, ...], test: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Repeat:
        freq, damping, shapes = test
        unknown = np.full(len(names), np.nan)
        where = tuple((s.node, s.direction) for s in self.specimen.layout)
        own = ShapeSet("", where, shapes, np.full(shapes.shape, np.nan))
        return Repeat("", names, True, freq, unknown, damping, unknown, own)

    def _combined(self, repeats: Sequence[Repeat]) -> MeasuredModes:
        c = combine_repeats(repeats)
        return MeasuredModes(
            c.names, c.natural_freq, c.natural_freq * np.sqrt(1 - np.minimum(c.damping_ratio, 0.99) ** 2), c.freq_std,
            c.damping_ratio, c.damping_std, self.specimen.layout, c.shapes, c.shape_std, len(repeats), True,
            freq_count=c.freq_count, damping_count=c.damping_count, shape_count=c.shape_count,
        )  # fmt: skip

    # -- one run -------------------------------------------------------------------------------------------------------

    def run(self, scenario: Scenario, number: int) -> dict[str, Any]:
        """Measure, explain, and tell what came out beside the truth."""
        started = time.perf_counter()
        row: dict[str, Any] = {"code": self.code, "scenario": scenario.name, "number": number, "group": scenario.group}
        try:
            measured = self.measure(scenario, number)
            row |= self._truth(scenario, measured)
            hypotheses = self.hypotheses(scenario, measured)
            found = decide(hypotheses)
            row |= outcome(found, measured) | self._told(found)
            if row["outcome"] == "right" and len(measured.hidden) == 1:
                row |= magnitude(found, measured) | self._held_out(found, hypotheses, measured)
            row["seconds"] = round(time.perf_counter() - started, 2)
            row |= self.other_answers(found, hypotheses, measured)
        except (EvaluationError, InputError, np.linalg.LinAlgError) as fault:
            row |= {"verdict": "failed", "outcome": "failed", "error": f"{type(fault).__name__}: {fault}"}
        return {"seconds": round(time.perf_counter() - started, 2)} | row

    def _told(self, found: Explanation) -> dict[str, Any]:
        """What is told of the measurement; of a world without faults nothing."""
        return {}

    def hypotheses(self, scenario: Scenario, measured: Measured) -> ModelHypotheses[Any]:
        """The question to what was measured."""
        problem = self.specimen.problem(measured.whole)
        faults = modal_faults(problem.model, problem.measured) if self.subject.suspects else ()
        removed = measured.hidden if scenario.removed else ()
        pair = ModalResidual(problem, faults=faults)
        return ModelHypotheses(pair, self.libraries[scenario.library], self.space, without=removed)

    def other_answers(self, found: Explanation, hypotheses: Any, measured: Measured) -> dict[str, Any]:
        """What other methods answer."""
        return answers(found, hypotheses, measured)

    def _truth(self, scenario: Scenario, measured: Measured) -> dict[str, Any]:
        hidden = [self.effects[name] for name in measured.hidden]
        problem = self.specimen.problem(measured.clean)
        problem = replace(problem, model=self.specimen.fine, mode_count=self._twin_modes)
        asked = ModelHypotheses(ModalResidual(problem), self.twin, self.space)
        without = asked.fit_problem(()).pair
        size = [
            self.maker.blind.change_seen(without, asked.fit_problem((e.name,)).pair, self.space, measured.only(e))
            / scenario.noise
            for e in hidden
        ]
        values = {n: round(v, 5) for n, v in measured.values.items() if n in self.space.free_names}
        magnitudes = {n: measured.values[n] for e in hidden for n in e.names}
        return {
            "hidden": list(measured.hidden), "magnitudes": magnitudes, "parameters": values,
            "visible": [round(v, 2) for v in size], "modes": len(measured.clean.names),
        }  # fmt: skip

    def _held_out(self, found: Explanation, hypotheses: ModelHypotheses, measured: Measured) -> dict[str, Any]:
        candidate_fit = found.chosen
        assert candidate_fit is not None
        out: dict[str, Any] = {}
        for stage, one in (("before", found.base), ("after", candidate_fit)):
            fitted = hypotheses.fit_problem(one.names).pair.problem
            whole = self._whole(fitted, measured)
            fit = one.fit
            covariance = fit.covariance
            table = held_out_errors(fitted, whole, fit.values, fit.names, covariance)
            for r in table.itertuples():
                out[f"{r.group}_{stage}"] = [round(float(r.rms), 3), round(float(r.expected), 3)]
        return out

    def _whole(self, fitted: ModalProblem, measured: Measured) -> ModalProblem:
        clusters = self.study.settings.pairing.clusters
        clusters = {mode: names for mode, names in clusters.items() if mode in measured.whole.names}
        return replace(fitted, measured=measured.whole, mode_clusters=clusters)
