"""The bogie as a blind test bench: any number of synthetic measurements whose truth is known, and one run on each.

Nothing here is tuned to answers. A measurement comes from the twin of ``studies/hidden_bogie/make_twin.py`` at full
order on the finer mesh; the question is asked on the reduced basis of the coarser model, as in a study.
"""

from __future__ import annotations

import ast
import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rates_outcome import Measured, outcome
from rates_scenarios import FIFTY, OWN, Scenario, fifty_effects

from calib.correlation.problem import ModalProblem
from calib.correlation.unused import withheld_errors
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.loading import module_of
from calib.measurement.modal import MeasuredModes
from calib.measurement.repeats import Repeat, ShapeSet, combine_repeats
from calib.missing.explain import explain
from calib.missing.findings import Findings
from calib.missing.profile import profile_interval
from calib.questions.hypotheses import ModalHypotheses
from calib.space import ParameterSpace
from calib.structure.atoms import atoms
from calib.structure.basis import Basis
from calib.structure.effect_basis import effect_basis
from calib.structure.model import StructuralModel
from calib.structure.training import train_basis
from calib.structure.variants import Variants
from calib.study import Study

ROOT = Path(__file__).resolve().parents[2]
ANSWERING = (
    "calib/missing", "calib/structure", "calib/correlation", "calib/updating", "calib/measurement", "models",
    "calib/questions/hypotheses.py", "calib/effect.py", "calib/space.py", "calib/mac.py", "calib/limits.py",
    "studies/hidden_bogie/make_twin.py", "studies/hidden_bogie/outside.py", "studies/hidden_bogie/study.toml",
    "studies/bogie/make_twin.py", "tests/benchmarks/rates_world.py", "tests/benchmarks/rates_scenarios.py",
    "tests/benchmarks/rates_outcome.py",
)  # fmt: skip


def code_digest() -> str:
    """Hash over all code that a run depends on; comments and docstrings do not count."""
    digest = hashlib.sha256()
    for place in ANSWERING:
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
    folder : Path
        Where reduced bases are kept.
    code : str
    """

    folder: Path
    code: str

    @cached_property
    def maker(self) -> Any:
        """The generator of the blind studies."""
        return module_of(ROOT / "studies/hidden_bogie/make_twin.py")

    @cached_property
    def specimen(self) -> Any:
        """What is measured."""
        return self.maker.specimen()

    @cached_property
    def study(self) -> Study:
        """One of them, for its settings; its measurement is not used."""
        return Study.load(ROOT / "studies/hidden_bogie_none")

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

    @cached_property
    def effects(self) -> dict[str, Effect]:
        """Every effect by name, those outside the library too."""
        return {e.name: e for e in (*self.study.candidates, *self.specimen.outside)}

    def settle(self) -> None:
        """Everything that takes long."""
        self.variants(OWN), self.variants(FIFTY)

    # -- libraries -----------------------------------------------------------------------------------------------------

    def variants(self, library: str, removed: tuple[str, ...] = ()) -> Variants:
        """The model with a library of effects, some of them taken out."""
        whole = self._libraries[library]
        if not removed:
            return whole
        return replace(whole, effects=tuple(e for e in whole.effects if e.name not in removed))

    @cached_property
    def _libraries(self) -> dict[str, Variants]:
        held = self.study.settings.withheld.sensors
        used = [s for s in self.specimen.layout if s.name not in held]
        local = tuple(a.effect for a in atoms(self.model, used, self.space.values, 10.0))
        own = self.study.candidates
        many = (*own, *fifty_effects(self.model, 50 - len(own)))
        return {
            OWN: Variants(self.model, own, local, self._basis("own", own, local)),
            FIFTY: Variants(self.model, many, local, self._basis("fifty", many, local)),
        }

    def _basis(self, name: str, effects: Sequence[Effect], local: Sequence[Effect]) -> Basis:
        path = self.folder / f"basis_{name}_{self.code}.npz"
        if path.exists():
            return Basis.load(path)
        pairing = self.study.settings.pairing
        assert pairing.mode_count is not None and pairing.freq_window is not None
        basis = train_basis(self.model, self.space, pairing.mode_count, seed=1, freq_max=pairing.freq_window[1])
        basis = effect_basis(self.model, basis, self.space, effects, local, 1)
        basis.save(path)
        return basis

    # -- one measurement -----------------------------------------------------------------------------------------------

    def measure(self, scenario: Scenario, number: int) -> Measured:
        """Draw a truth and measure it five times; the seed is the scenario's name and the number alone."""
        rng = np.random.default_rng([*scenario.name.encode(), number])
        values = self.specimen.draw(rng)
        hidden = tuple(self.effects[name] for name in scenario.hidden(rng, self.study.candidates))
        for effect in hidden:
            values |= self.maker.blind.draw_effect(effect, scenario.strength, rng)
        names, modes, shapes = self.specimen.solved(hidden, values, rng)
        clean = self.specimen.noiseless(names, modes, shapes)
        modes, shapes = self.maker.blind.set_up_errors(modes, shapes, scenario.noise, rng)
        repeats = [self._repeat(names, self.maker.blind.twin.scattered(modes, shapes, rng)) for _ in range(5)]
        return Measured(values, {e.name: e.names for e in hidden}, clean, self._combined(repeats))

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
        )  # fmt: skip

    # -- one run -------------------------------------------------------------------------------------------------------

    def run(self, scenario: Scenario, number: int) -> dict[str, Any]:
        """Measure, explain, and tell what came out beside the truth."""
        started = time.perf_counter()
        row: dict[str, Any] = {"code": self.code, "scenario": scenario.name, "number": number, "group": scenario.group}
        try:
            measured = self.measure(scenario, number)
            row |= self._truth(scenario, measured)
            removed = measured.hidden if scenario.removed else ()
            problem = self.specimen.problem(measured.whole)
            hypotheses = ModalHypotheses(problem, self.variants(scenario.library, removed), self.space)
            found = explain(hypotheses)
            row |= outcome(found, measured)
            if row["outcome"] == "right" and len(measured.hidden) == 1:
                row |= self._strength(found, measured) | self._withheld(found, hypotheses, measured)
        except (EvaluationError, InputError, np.linalg.LinAlgError) as fault:
            row |= {"verdict": "failed", "outcome": "failed", "error": f"{type(fault).__name__}: {fault}"}
        return row | {"seconds": round(time.perf_counter() - started, 2)}

    def _truth(self, scenario: Scenario, measured: Measured) -> dict[str, Any]:
        hidden = [self.effects[name] for name in measured.hidden]
        problem = self.specimen.problem(measured.clean)
        size = [self.maker.blind.visible(problem, self.space, [e], measured.only(e)) / scenario.noise for e in hidden]
        values = {n: round(v, 5) for n, v in measured.values.items() if n in self.space.free_names}
        strengths = {n: measured.values[n] for e in hidden for n in e.names}
        return {
            "hidden": list(measured.hidden), "strengths": strengths, "parameters": values,
            "visible": [round(v, 2) for v in size], "modes": len(measured.clean.names),
        }  # fmt: skip

    def _strength(self, found: Findings, measured: Measured) -> dict[str, Any]:
        (name,) = measured.hidden
        trial, true = found.chosen, measured.values[name]
        if trial is None or name not in trial.names:
            return {}
        low, high = profile_interval(trial.state, name)
        return {
            "phi": trial.state.values[name], "phi_over_true": trial.state.values[name] / true,
            "interval": [low, high], "covers": bool(low <= true <= high),
        }  # fmt: skip

    def _withheld(self, found: Findings, hypotheses: ModalHypotheses, measured: Measured) -> dict[str, Any]:
        trial = found.chosen
        assert trial is not None
        out: dict[str, Any] = {}
        for stage, one in (("before", found.base), ("after", trial)):
            fitted = hypotheses.question(one.names).inner.problem
            whole = self._whole(fitted, measured)
            state = one.state
            covariance = state.covariance
            table = withheld_errors(fitted, whole, state.values, state.names, covariance)
            for r in table.itertuples():
                out[f"{r.group}_{stage}"] = [round(float(r.rms), 3), round(float(r.expected), 3)]
        return out

    def _whole(self, fitted: ModalProblem, measured: Measured) -> ModalProblem:
        clusters = self.study.settings.pairing.clusters
        clusters = {mode: names for mode, names in clusters.items() if mode in measured.whole.names}
        return replace(fitted, measured=measured.whole, mode_clusters=clusters)
