"""Synthetic modes and FRFs of one solar array that lacks nothing, an effect of the library, or something else.

    python studies/hidden_panel/make_twin.py effect TRUTH.json

The array is measured twice in the same state: its modes in five repeats (``measured``), and the FRFs of its twelve
sensors under a shaker at node 1 in five repeats (``../hidden_panel_frf/measured``). It is not the fitted model: its
mesh is four times finer, and the effect is built into it otherwise than in the library (``remodelled.py``). True
parameters are normal about their nominal values with half their prior standard deviations; a seed draws the effect and
its magnitude, 0.5 to 1.5 times the plausible one. Seeds are tried in turn; the first one is taken whose effect is
visible in the modes: the change that it makes to the fitted model's modes and the parameters cannot absorb is 8 to 20
standard deviations long, as in ``studies/blind_twin.py``. No result of a search enters the choice.

The standard deviation of the mean of the repeats of the modes is 0.2 % of the natural frequency, 5 % of the damping
ratio and 1.5 % of a shape's largest modulus. That of one repeat of the FRFs is 2 % of the modulus with a floor. Lines
are those of a stepped sine: seven around each resonance of the array.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.linalg as la
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from calib import Effect, MeasuredModes, Parameter, ParameterSpace, Sensor, StructuralModel
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.measurement.files.uff_write import write_uff
from calib.measurement.mac import mac
from calib.problem.problem import Pair
from calib.structure import Modes, extend
from calib.structure.eigenproblem.solve_dense import solve_dense
from calib.study.limits import search_space, sensitivity_space
from calib.study.loading import module_of
from calib.study.settings import StudySettings
from calib.study.study_text import read_settings
from models.solar_panel import MASTERS, solar_panel
from models.solar_panel_effects import solar_panel_effects

HERE = Path(__file__).resolve().parent

frf_twin = module_of(HERE.parent / "frf_twin.py")
remodelled = module_of(HERE / "remodelled.py")

FRAME, RATIO = 0.04, 0.01
FINE = 4
MODES = tuple(f"M{k}" for k in range(1, 7))
REPEATS = 5
STD_FREQ, STD_DAMPING, STD_SHAPE = 0.002, 0.05, 0.015
SHARE, FLOOR = 0.02, 5e-4
"""Of one repeat of the FRFs: relative, and in m/(N s2)."""
HIGHEST = 40.0
"""Hz: the array has no mode between 20 and 80 Hz."""
STEPS = (-3.0, -1.5, -0.6, 0.0, 0.6, 1.5, 3.0)
"""Of the sine around a resonance, over half its half-power width."""
KEPT = 60
"""Modes of the finer mesh that span its motion, together with its static deflections under a force at every sensor:
FRFs up to 40 Hz are then those of the whole mesh within 1e-5."""
SPREAD, INSIDE = 0.5, 0.9
MAGNITUDES, VISIBLE = (0.5, 1.5), (8.0, 20.0)
LEAST_MAC = 0.6
FIRST_SEED = {"nothing": 1001, "effect": 1, "outside": 2001}


@dataclass(frozen=True, eq=False)
class Spanned:
    """A structure whose motion is a sum of given ones, with the part of its interface that FRFs need.

    Attributes
    ----------
    structure : StructuralModel
    span : ndarray (n_dof, n_kept)
    values : mapping
        At which it is solved.
    """

    structure: StructuralModel
    span: np.ndarray
    values: Mapping[str, float]

    @classmethod
    def of(cls, structure: StructuralModel, values: Mapping[str, float], layout: Sequence[Sensor]) -> Spanned:
        """Spanned by its lowest modes without damping and its deflections under a force at every sensor."""
        stiffness, _, mass = structure.matrices(values)
        # A shape's sign, and with it what noise does to it, depends on the first vector of the iteration.
        first = np.random.default_rng(0).standard_normal(stiffness.shape[0])
        shapes = spla.eigsh(stiffness, KEPT, mass, sigma=0.0, v0=first)[1]
        static = spla.splu(sp.csc_matrix(stiffness)).solve(structure.sensor_rows(layout).T)
        return cls(structure, la.qr(np.hstack([shapes, static]), mode="economic")[0], values)

    def translations(self, sensor: Sensor) -> np.ndarray:
        """See `calib.structure.model.StructuralModel`."""
        return self.structure.translations(sensor) @ self.span

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """See `calib.structure.model.StructuralModel`."""
        return self.structure.sensor_rows(sensors) @ self.span

    def matrices(self, values: Mapping[str, float]) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
        """K, C and M over the span."""
        k, c, m = (sp.csc_array(self.span.T @ (a @ self.span)) for a in self.structure.matrices(values))
        return k, c, m

    def modes(self, count: int) -> Modes:
        """The lowest modes; shapes over the span."""
        k, c, m = (a.toarray() for a in self.matrices(self.values))
        return solve_dense(k, c, m, count, lambda shape: 0.0)


@cache
def base() -> StructuralModel:
    """The fitted model within the limits of its studies."""
    model, settings = solar_panel(frame=FRAME, damping_ratio=RATIO), study_settings()
    space = sensitivity_space(model.space, settings, lambda *keys: "study.toml", {})
    return replace(model, space=search_space(space, settings, lambda *keys: "study.toml"))


@cache
def fine() -> StructuralModel:
    """The finer mesh, whose damping is that of its own modes."""
    return solar_panel(FINE, frame=FRAME, damping_ratio=RATIO)


@cache
def study_settings() -> StudySettings:
    """Of the study of the modes."""
    return read_settings(HERE / "study.toml")


@cache
def layout() -> tuple[Sensor, ...]:
    """Deflections at the article's master nodes."""
    points = base().mesh.points
    return tuple(Sensor(node, "z", tuple(float(c) for c in points[node - 1])) for node in MASTERS)


@cache
def nominal() -> np.ndarray:
    """Shapes of the nominal modes at the sensors, (n_sensors, n_modes), by which modes get their names."""
    model = base()
    return model.sensor_rows(layout()) @ model.modes(model.space.values, len(MODES)).shapes


def built(effects: Sequence[Effect], values: Mapping[str, float]) -> Spanned:
    """The finer mesh with effects built into it, at true values."""
    structure = extend(fine(), effects) if effects else fine()
    return Spanned.of(structure, values, layout())


def draw(rng: np.random.Generator) -> dict[str, float]:
    """True values of the model's parameters: fitted ones are drawn, others nominal."""
    space = base().space
    return space.values | {p.name: about(p, rng) for p in space.free}


def about(p: Parameter, rng: np.random.Generator) -> float:
    """Normal about the nominal value with half the prior standard deviation, within the limits."""
    return float(np.clip(p.value + SPREAD * p.prior_width * rng.standard_normal(), p.lower, p.upper))


def draw_effect(effect: Effect, factor: float, rng: np.random.Generator) -> dict[str, float]:
    """Magnitude at a multiple of its plausible size, off its limits, and nuisance parameters."""
    p = effect.magnitude
    return {p.name: min(factor * effect.plausible, INSIDE * p.upper)} | {q.name: about(q, rng) for q in effect.nuisance}


# -- modes -------------------------------------------------------------------------------------------------------------


def named_modes(structure: Spanned) -> tuple[tuple[str, ...], Modes, np.ndarray]:
    """Modes that resemble a nominal one, in that order: names, modes, shapes at the sensors (n_sensors, n_modes)."""
    modes = structure.modes(len(MODES) + 3)
    shapes = structure.sensor_rows(layout()) @ modes.shapes
    similar, taken = mac(nominal(), shapes), list[int]()
    names = []
    for i, name in enumerate(MODES):
        best = int(np.argmax(np.where(np.isin(np.arange(similar.shape[1]), taken), 0.0, similar[i])))
        if similar[i, best] >= LEAST_MAC:
            names.append(name)
            taken.append(best)
    return tuple(names), modes.subset(taken), shapes[:, taken]


def noiseless(names: tuple[str, ...], modes: Modes, shapes: np.ndarray) -> MeasuredModes:
    """Noise-free modes with the standard deviations of the test."""
    return MeasuredModes(
        names, modes.natural_freq, modes.damped_freq, STD_FREQ * modes.natural_freq, modes.damping_ratio,
        STD_DAMPING * modes.damping_ratio, layout(), shapes / np.abs(shapes).max(axis=0),
        np.full(shapes.shape, STD_SHAPE), REPEATS, True,
    )  # fmt: skip


def noisy(modes: Modes, shapes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One repeat: frequencies, damping ratios, complex shapes (n_sensors, n_modes) of arbitrary phases."""
    grow = np.sqrt(REPEATS)
    freq = modes.natural_freq * np.exp(STD_FREQ * grow * rng.standard_normal(modes.n_modes))
    damping = modes.damping_ratio * np.exp(STD_DAMPING * grow * rng.standard_normal(modes.n_modes))
    unit = shapes / np.abs(shapes).max(axis=0)
    noise = rng.standard_normal(shapes.shape) + 1j * rng.standard_normal(shapes.shape)
    return freq, damping, (unit + STD_SHAPE * grow * noise) * np.exp(2j * np.pi * rng.random(modes.n_modes))


def modal_problem(measured: MeasuredModes) -> ModalProblem:
    """Problem of the fitted model and the modes that are not held out."""
    settings = study_settings()
    held, pairing = settings.held_out, settings.pairing
    used = measured.without([mode for mode in held.modes if mode in measured.names], held.sensors)
    assert pairing.mode_count is not None
    return ModalProblem(base(), used, {}, pairing.mode_count, freq_window=pairing.freq_window)


# -- FRFs --------------------------------------------------------------------------------------------------------------


def frf_test(structure: Spanned, **errors: float) -> Any:
    """A stepped sine around the array's resonances; ``errors`` are fields of `frf_twin.FRFTest`."""
    modes = structure.modes(len(MODES) + 3)
    inside = modes.natural_freq < HIGHEST
    found = zip(modes.damped_freq[inside], modes.damping_ratio[inside], strict=True)
    lines = {round(f * (1 + step * max(ratio, 1e-3)), 4) for f, ratio in found for step in STEPS}
    freq = np.array(sorted(line for line in lines if line > 0))
    return frf_twin.FRFTest(
        freq, layout(), layout()[:1], "accelerance", share=SHARE, floor=FLOOR, repeats=REPEATS, **errors
    )


# -- what the effect shows ---------------------------------------------------------------------------------------------


def visible(problem: ModalProblem, effects: Sequence[Effect], values: Mapping[str, float]) -> float:
    """Length of the change by effects of the library that the parameters cannot absorb, in standard deviations."""
    model = extend(base(), effects)
    more = replace(problem, model=model, mode_count=problem.mode_count + model.n_dof - base().n_dof)
    return change_seen(ModalResidual(problem), ModalResidual(more), base().space, values)


def change_seen(without: Pair, extended: Pair, space: ParameterSpace, values: Mapping[str, float]) -> float:
    """The same from the residuals of the model and of the one with the effects; priors count as data."""
    own = {name: value for name, value in values.items() if name in without.space}
    given = {name: value for name, value in values.items() if name in extended.space}
    names = list(space.free_names)
    change = without.residual(own) - extended.residual(given)
    widths = [space[n].prior_width for n in names]
    wide = np.vstack([without.jacobian(own, names) * widths, np.eye(len(names))])
    direction = np.concatenate([change, np.zeros(len(names))])
    basis = la.qr(wide, mode="economic")[0]
    return float(np.linalg.norm(direction - basis @ (basis.T @ direction)))


# -- the study's measurement -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Drawn:
    """An array before it is measured.

    Attributes
    ----------
    seed : int
    effects : tuple of Effect
        As built into it.
    values : mapping
    structure : Spanned
    size : float
        What it shows in the modes, see `visible`; 0 where nothing is hidden.
    rng : Generator
        Of the noise.
    """

    seed: int
    effects: tuple[Effect, ...]
    values: Mapping[str, float]
    structure: Spanned
    size: float
    rng: np.random.Generator


def drawn(kind: str) -> Drawn:
    """The array of the first seed that meets the criteria."""
    designs = {"nothing": (), "effect": remodelled.remodelled_effects(), "outside": remodelled.outside_effects()}[kind]
    known = {effect.name: effect for effect in (*solar_panel_effects(), *remodelled.outside_effects())}
    for seed in range(FIRST_SEED[kind], FIRST_SEED[kind] + 1000):
        rng = np.random.default_rng(seed)
        values, chosen = draw(rng), tuple[Effect, ...]()
        if designs:
            chosen = (designs[int(rng.integers(len(designs)))],)
            values |= draw_effect(chosen[0], float(rng.uniform(*MAGNITUDES)), rng)
        structure = built(chosen, values)
        names, modes, shapes = named_modes(structure)
        if names != MODES:
            continue
        if not chosen:
            return Drawn(seed, chosen, values, structure, 0.0, rng)
        size = visible(modal_problem(noiseless(names, modes, shapes)), [known[chosen[0].name]], values)
        if VISIBLE[0] <= size and (kind == "outside" or size <= VISIBLE[1]):
            return Drawn(seed, chosen, values, structure, size, rng)
    raise SystemExit("no seed gave a visible effect")


def write_modes(into: Path, names: tuple[str, ...], modes: Modes, shapes: np.ndarray, rng: np.random.Generator) -> None:
    """Write the repeats of the modes and the table of the sensors."""
    into.mkdir(parents=True, exist_ok=True)
    for k in range(1, REPEATS + 1):
        freq, damping, seen = noisy(modes, shapes, rng)
        write_uff(
            into / f"repeat_{k}.uff", names=names, natural_freq=freq, damping_ratio=damping, sensors=layout(),
            shapes=seen, title=f"SYNTHETIC twin of the solar array, repeat_{k}",
        )  # fmt: skip
    table = [{"node": s.node, **dict(zip("xyz", s.point, strict=True))} for s in layout() if s.point]
    pd.DataFrame(table).to_csv(into / "sensors.csv", index=False, float_format="%.6g")


def main() -> None:
    """Write truth and both measurements; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("kind", choices=tuple(FIRST_SEED))
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--modes", type=Path, default=HERE / "measured", help="folder for the modes")
    arguments.add_argument(
        "--frfs", type=Path, default=HERE.parent / "hidden_panel_frf/measured", help="folder for the FRFs"
    )
    given = arguments.parse_args()
    one = drawn(given.kind)
    names, modes, shapes = named_modes(one.structure)
    write_modes(given.modes, names, modes, shapes, one.rng)
    simulated = frf_twin.simulate(one.structure, one.values, frf_test(one.structure), one.rng)
    frf_twin.write(simulated, given.frfs, "solar array")
    content = {
        "seed": one.seed, "kind": given.kind, "effects": [effect.name for effect in one.effects],
        "magnitudes": {name: one.values[name] for effect in one.effects for name in effect.names},
        "visible": one.size, "parameters": {name: one.values[name] for name in base().space.names},
        "natural_freq": dict(zip(names, modes.natural_freq.tolist(), strict=True)),
        "damping_ratio": dict(zip(names, modes.damping_ratio.tolist(), strict=True)),
        "noise": {"share": SHARE, "floor": FLOOR},
    }  # fmt: skip
    given.truth.parent.mkdir(parents=True, exist_ok=True)
    given.truth.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    print(f"seed {one.seed}: seen in the modes with a length of {one.size:.1f} standard deviations")


if __name__ == "__main__":
    main()
