"""Makes the synthetic measurements of the three blind studies: something is missing, nothing is, or no candidate is it.

    python studies/hidden_bogie/make_twin.py effect TRUTH.json --into studies/hidden_bogie/measured
    python studies/hidden_bogie/make_twin.py nothing TRUTH.json --into studies/hidden_bogie_none/measured
    python studies/hidden_bogie/make_twin.py outside TRUTH.json --into studies/hidden_bogie_outside/measured

The twin is that of ``studies/bogie`` (mesh three times finer, distributed masses, sensors off by up to 5 mm, the same
noise) with nine modes. Its parameters are drawn about their adopted values with half their prior standard deviations,
its actuators stand at any of the places 3 to 7, and a seed draws which effect it has and how strong: 0.5 to 1.5 times
its plausible size, either sign where both are possible. What it was made from is written to TRUTH.json, which nothing
that answers ever reads.

Seeds are tried in turn; the first is taken that lets all nine modes be told apart and whose effect is visible. Visible
is what the parameters cannot absorb of it: the length of the change that it makes to the used data, in units of their
scatter and projected off all parameters (the root of the decrease of the sum of squares to be expected, Rao 1948). It
has to be 8 to 20 for an effect of the library, with frequencies changed by more than 1 % and shapes by a MAC below
0.98, and 8 at least for one that is not. No seed is chosen by what any search makes of it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.linalg as la
from scipy.optimize import linear_sum_assignment

from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual
from calib.effect import Effect
from calib.limits import search_space, sensitivity_space
from calib.loading import module_of
from calib.mac import mac
from calib.measurement.modal import MeasuredModes, Sensor
from calib.settings import StudySettings, read_settings
from calib.space import Parameter, ParameterSpace
from calib.structure.extend import extend
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from models.railway import bogie_effects, bogie_on_rig

HERE = Path(__file__).resolve().parent

twin = module_of(HERE.parent / "bogie" / "make_twin.py")
outside = module_of(HERE / "outside.py")

MODES = tuple(f"{k}BT" for k in range(1, 10))
FIRST_SEED = {"effect": 1, "nothing": 1001, "outside": 2001}
SPREAD = 0.5
POSITIONS = (3, 7)
STRENGTHS = (0.5, 1.5)
INSIDE = 0.9
LEAST_MAC = 0.6
VISIBLE = (8.0, 20.0)
LEAST_FREQ_CHANGE, LARGEST_MAC = 0.01, 0.98


def twin_model() -> StructuralModel:
    """What is measured: finer and with distributed masses."""
    return bogie_on_rig(element_size=0.025, distributed=True)


def draw(space: ParameterSpace, rng: np.random.Generator) -> dict[str, float]:
    """Free parameters about their adopted values, actuators anywhere within `POSITIONS`."""
    truth = space.values
    for p in space.free:
        truth[p.name] = float(rng.integers(POSITIONS[0], POSITIONS[1] + 1)) if p.integer else _about(p, rng)
    return truth


def draw_effect(effect: Effect, factor: float, rng: np.random.Generator) -> dict[str, float]:
    """Strength of an effect at a multiple of its plausible size, and its nuisance parameters.

    It stays off its limits, where every fit of it would be called implausible.
    """
    p = effect.strength
    sign = (1.0 if rng.random() < 0.5 else -1.0) if effect.signed and p.upper > 0 else 1.0 if p.upper > 0 else -1.0
    strength = min(max(sign * factor * effect.plausible, INSIDE * p.lower), INSIDE * p.upper)
    return {p.name: strength} | {q.name: _about(q, rng) for q in effect.nuisance}


def _about(p: Parameter, rng: np.random.Generator) -> float:
    return float(np.clip(p.value + SPREAD * p.prior_width * rng.standard_normal(), p.lower, p.upper))


def identified(
    modes: Modes, nominal: np.ndarray, shapes: np.ndarray, least: float = LEAST_MAC
) -> tuple[tuple[str, ...], Modes, np.ndarray]:
    """The modes that can be told apart by the nominal shapes: names, modes in that order, their shapes at sensors."""
    similar = mac(nominal, shapes)
    row, column = linear_sum_assignment(-similar)
    found = [(MODES[i], j) for i, j in zip(row.tolist(), column.tolist(), strict=True) if similar[i, j] >= least]
    index = [j for _, j in found]
    chosen = Modes(
        modes.natural_freq[index], modes.damped_freq[index], modes.damping_ratio[index], modes.shapes[:, index]
    )
    return tuple(name for name, _ in found), chosen, shapes[:, index]


def problem_of(
    model: StructuralModel, settings: StudySettings, whole: MeasuredModes, withheld: bool = True
) -> ModalProblem:
    """The question of a blind study asked of what was measured, without what it withholds."""
    held = settings.withheld
    known = [mode for mode in held.modes if mode in whole.names]
    used = whole.without(known, held.sensors) if withheld else whole
    clusters = {mode: names for mode, names in settings.pairing.clusters.items() if mode in used.names}
    assert settings.pairing.mode_count is not None
    return ModalProblem(model, used, clusters, settings.pairing.mode_count, freq_window=settings.pairing.freq_window)


def noiseless(names: tuple[str, ...], modes: Modes, shapes: np.ndarray, layout: Sequence[Sensor]) -> MeasuredModes:
    """Modes as they are, with the scatter that a test will show."""
    return MeasuredModes(
        names, modes.natural_freq, modes.damped_freq, twin.STD_FREQ * modes.natural_freq, modes.damping_ratio,
        twin.STD_DAMPING * modes.damping_ratio, tuple(layout), shapes / np.abs(shapes).max(axis=0),
        np.full(shapes.shape, twin.STD_SHAPE), twin.REPEATS, True,
    )  # fmt: skip


def visible(
    problem: ModalProblem, space: ParameterSpace, effects: Sequence[Effect], values: Mapping[str, float]
) -> float:
    """Length of the change of the data by some effects together, projected off what the free parameters absorb.

    Parameters
    ----------
    problem : ModalProblem
        Of the base model.
    space : ParameterSpace
    effects : sequence of Effect
    values : mapping
        True parameters, strengths and nuisance parameters.
    """
    base = problem.model
    assert isinstance(base, StructuralModel)
    model = extend(base, effects)
    own = {name: value for name, value in values.items() if name in base.space}
    names = [p.name for p in space.free if not p.integer]
    without = ModalResidual(problem)
    more = replace(problem, model=model, mode_count=problem.mode_count + model.n_dof - base.n_dof)
    change = without.residual(own) - ModalResidual(more).residual(values)
    wide = np.vstack(
        [without.jacobian(own, names) * [space[n].prior_width for n in names], np.eye(len(names))]
    )  # prior knowledge is data too
    direction = np.concatenate([change, np.zeros(len(names))])
    basis = la.qr(wide, mode="economic")[0]
    return float(np.linalg.norm(direction - basis @ (basis.T @ direction)))


def _tells(kind: str, size: float, with_it: Modes, without: Modes, similar: np.ndarray) -> bool:
    """Whether the drawn effect makes a study."""
    if kind == "outside":
        return size >= VISIBLE[0]
    moved = np.abs(with_it.natural_freq / without.natural_freq - 1).max()
    shows = moved > LEAST_FREQ_CHANGE and similar.min() < LARGEST_MAC
    return VISIBLE[0] <= size <= VISIBLE[1] and bool(shows)


def main() -> None:
    """Draw a truth, measure the twin five times, write truth and repeats."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("kind", choices=tuple(FIRST_SEED))
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--into", type=Path, required=True, help="folder for the repeats")
    given = arguments.parse_args()

    settings = read_settings(HERE / "study.toml")
    model, fine, layout = bogie_on_rig(), twin_model(), twin.sensors()
    space = search_space(
        sensitivity_space(model.space, settings, lambda *keys: "study.toml", {}), settings, lambda *keys: "study.toml"
    )
    model = replace(model, space=space)
    nominal = (model.sensor_rows(layout) @ model.modes(space.values, len(MODES)).shapes)[:, : len(MODES)]
    designs = {"effect": bogie_effects(), "nothing": (), "outside": outside.outside_effects()}[given.kind]
    for seed in range(FIRST_SEED[given.kind], FIRST_SEED[given.kind] + 1000):
        rng = np.random.default_rng(seed)
        truth = draw(space, rng)
        chosen = (designs[int(rng.integers(len(designs)))],) if designs else ()
        own: dict[str, float] = {}
        for effect in chosen:
            own |= draw_effect(effect, float(rng.uniform(*STRENGTHS)), rng)
        extended = extend(fine, chosen)
        rows = extended.sensor_rows(twin.moved(layout, rng))
        solved = extended.modes({**truth, **own}, len(MODES) + 4 + extended.n_dof - fine.n_dof)
        names, modes, shapes = identified(solved, nominal, rows @ solved.shapes)
        if names != MODES:
            continue
        size = 0.0
        if chosen:
            plain = fine.modes(truth, len(MODES) + 4)
            known, without, bare = identified(plain, nominal, fine.sensor_rows(layout) @ plain.shapes)
            if known != MODES:
                continue
            problem = problem_of(model, settings, noiseless(names, modes, shapes, layout))
            size = visible(problem, space, chosen, {**truth, **own})
            if not _tells(given.kind, size, modes, without, np.diag(mac(bare, shapes))):
                continue
        break
    else:
        raise SystemExit("no seed gave a visible effect")

    twin.write_measurement(given.into, MODES, modes, shapes, layout, rng)
    given.truth.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "seed": seed,
        "kind": given.kind,
        "effects": [effect.name for effect in chosen],
        "strengths": own,
        "visible": size,
        "parameters": truth,
        "natural_freq": dict(zip(MODES, modes.natural_freq.tolist(), strict=True)),
        "damping_ratio": dict(zip(MODES, modes.damping_ratio.tolist(), strict=True)),
    }
    given.truth.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    print(f"seed {seed}")


if __name__ == "__main__":
    main()
