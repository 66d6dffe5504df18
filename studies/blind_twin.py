"""Synthetic measurements of the blind studies: random true values, hidden effects, and simulated tests.

A specimen holds the fitted model, a finer mesh of the same structure, the library of effects and designs outside of it.
True parameters are normal about their nominal values with half their prior standard deviations. A seed decides which
effects are hidden and their magnitude: 0.5 to 1.5 times their plausible size, of either sign where both are possible.
Noise and displaced sensors are those of ``studies/bogie``.

Seeds are tried in turn; the first one is taken for which all modes can be identified and all effects are visible. The
visibility of an effect is the length of its signature that the parameters cannot absorb: the change of the used data in
standard deviations, with all parameters projected out (the root of the expected decrease of the sum of squares, Rao
1948). It must be 8 to 20 for an effect of the library, with frequencies changed by more than 1 % and shapes by a MAC
below 0.98, and at least 8 for an effect outside the library. No result of a search enters the choice of the seed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.linalg as la
from scipy.optimize import linear_sum_assignment

from calib import Effect, MeasuredModes, Parameter, ParameterSpace, Sensor, StructuralModel
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.measurement.mac import mac
from calib.structure import ModalModel, Modes, extend
from calib.study.limits import search_space, sensitivity_space
from calib.study.loading import module_of
from calib.study.settings import StudySettings
from calib.study.study_text import read_settings

twin = module_of(Path(__file__).resolve().parent / "bogie" / "make_twin.py")

SPREAD = 0.5
MAGNITUDES = (0.5, 1.5)
INSIDE = 0.9
LEAST_MAC = 0.6
VISIBLE = (8.0, 20.0)
LEAST_FREQ_CHANGE, LARGEST_MAC = 0.01, 0.98
MEASURABLE = 0.65
"""Largest damping ratio of a mode that a test would identify."""
NEARLY = 1.2
"""Factor by which the criteria are relaxed on the fitted mesh."""
MORE = 4
"""Modes of a twin solved in addition to the named ones, since others may lie between."""


@dataclass(frozen=True)
class Kind:
    """One kind of blind study.

    Attributes
    ----------
    first_seed : int
    count : int
        Number of hidden effects.
    inside : bool
        Whether they are from the library, else from the designs outside of it.
    noise : float
        True standard deviation of the mean over that which the repeats show.
    """

    first_seed: int
    count: int = 0
    inside: bool = True
    noise: float = 1.0


@dataclass(frozen=True, eq=False)
class Specimen:
    """Structure measured by a family of blind studies.

    Attributes
    ----------
    file : Path
        A ``study.toml`` with the priors, the limits and the held-out data.
    base, fine : StructuralModel
        The fitted mesh and the twin's.
    library, outside : tuple of Effect
    modes : tuple of str
    layout : tuple of Sensor
        Nominal places.
    nominal : ndarray (n_sensors, n_modes)
        Shapes of the modes at the nominal values, by which modes are identified.
    positions : tuple of int
        Range of the true integer parameters.
    built : callable, optional
        Builds named effects with given parameters into the twin's mesh; without it the twin has the library's terms.
    """

    file: Path
    base: StructuralModel
    fine: StructuralModel
    library: tuple[Effect, ...]
    outside: tuple[Effect, ...]
    modes: tuple[str, ...]
    layout: tuple[Sensor, ...]
    nominal: np.ndarray
    positions: tuple[int, int] = (0, 0)
    built: Callable[[Sequence[str], Mapping[str, float]], StructuralModel] | None = None

    @cached_property
    def settings(self) -> StudySettings:
        """Settings of its studies."""
        return read_settings(self.file)

    @cached_property
    def model(self) -> StructuralModel:
        """The fitted mesh within the limits of the search."""
        space = sensitivity_space(self.base.space, self.settings, lambda *keys: str(self.file), {})
        return replace(self.base, space=search_space(space, self.settings, lambda *keys: str(self.file)))

    @property
    def space(self) -> ParameterSpace:
        """Parameters; those of the search are free."""
        return self.model.space

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """True values: free parameters about their nominal values, integers anywhere within `positions`."""
        truth = self.space.values
        for p in self.space.free:
            truth[p.name] = (
                float(rng.integers(self.positions[0], self.positions[1] + 1)) if p.integer else _about(p, rng)
            )
        return truth

    def identified(
        self, modes: Modes, shapes: np.ndarray, least: float = LEAST_MAC
    ) -> tuple[tuple[str, ...], Modes, np.ndarray]:
        """The modes that the nominal shapes identify: names, modes in that order, shapes at sensors."""
        similar = mac(self.nominal, shapes)
        row, column = linear_sum_assignment(-similar)
        found = [
            (self.modes[i], j) for i, j in zip(row.tolist(), column.tolist(), strict=True) if similar[i, j] >= least
        ]
        index = [j for _, j in found]
        return tuple(name for name, _ in found), modes.subset(index), shapes[:, index]

    def structure(self, effects: Sequence[Effect]) -> StructuralModel:
        """The twin's mesh with some effects."""
        return extend(self.fine, effects) if effects else self.fine

    def solved(
        self, effects: Sequence[Effect], values: Mapping[str, float], places: Sequence[Sensor] | None = None
    ) -> tuple[tuple[str, ...], Modes, np.ndarray]:
        """The twin's modes with some effects, as `identified`, at the true places of the sensors, nominal without."""
        if self.built is not None and effects:
            model = self.built([effect.name for effect in effects], values)
            values = {name: value for name, value in values.items() if name in model.space}
            return self._at(
                model, max(model.n_dof - self.fine.n_dof, 0), values, self.layout if places is None else places
            )
        model = self.structure(effects)
        return self._at(model, model.n_dof - self.fine.n_dof, values, self.layout if places is None else places)

    def seen(
        self, model: ModalModel, added: int, values: Mapping[str, float], rng: np.random.Generator | None = None
    ) -> tuple[tuple[str, ...], Modes, np.ndarray]:
        """The same for any model of the twin, with a number of degrees of freedom added; ``rng`` displaces sensors."""
        return self._at(model, added, values, self.layout if rng is None else twin.moved(self.layout, rng))

    def _at(
        self, model: ModalModel, added: int, values: Mapping[str, float], places: Sequence[Sensor]
    ) -> tuple[tuple[str, ...], Modes, np.ndarray]:
        rows = model.sensor_rows(places)
        modes = model.modes(values, len(self.modes) + MORE + added)
        return self.identified(modes, rows @ modes.shapes)

    def problem(self, whole: MeasuredModes, held_out: bool = True) -> ModalProblem:
        """Problem of the base model and the measured modes, without the held-out data where ``held_out`` is set."""
        held, pairing = self.settings.held_out, self.settings.pairing
        known = [mode for mode in held.modes if mode in whole.names]
        used = whole.without(known, held.sensors) if held_out else whole
        clusters = {mode: names for mode, names in pairing.clusters.items() if mode in used.names}
        assert pairing.mode_count is not None
        return ModalProblem(self.model, used, clusters, pairing.mode_count, freq_window=pairing.freq_window)

    def noiseless(self, names: tuple[str, ...], modes: Modes, shapes: np.ndarray) -> MeasuredModes:
        """Noise-free modes with the standard deviations of the test."""
        return MeasuredModes(
            names, modes.natural_freq, modes.damped_freq, twin.STD_FREQ * modes.natural_freq, modes.damping_ratio,
            twin.STD_DAMPING * modes.damping_ratio, self.layout, shapes / np.abs(shapes).max(axis=0),
            np.full(shapes.shape, twin.STD_SHAPE), twin.REPEATS, True,
        )  # fmt: skip


def draw_effect(effect: Effect, factor: float, rng: np.random.Generator) -> dict[str, float]:
    """Magnitude of an effect at a multiple of its plausible size, and its nuisance parameters.

    It stays off its limits, where any fit would be classified as implausible.
    """
    p = effect.magnitude
    sign = (1.0 if rng.random() < 0.5 else -1.0) if effect.signed and p.upper > 0 else 1.0 if p.upper > 0 else -1.0
    magnitude = min(max(sign * factor * effect.plausible, INSIDE * p.lower), INSIDE * p.upper)
    return {p.name: magnitude} | {q.name: _about(q, rng) for q in effect.nuisance}


def _about(p: Parameter, rng: np.random.Generator) -> float:
    return float(np.clip(p.value + SPREAD * p.prior_width * rng.standard_normal(), p.lower, p.upper))


def set_up_errors(modes: Modes, shapes: np.ndarray, noise: float, rng: np.random.Generator) -> tuple[Modes, np.ndarray]:
    """Add errors that all repeats share; nothing where ``noise`` is at most 1.

    The true standard deviation of the mean is then ``noise`` times the one that the repeats show.
    """
    if noise <= 1:
        return modes, shapes
    size = np.sqrt(noise**2 - 1)
    natural = modes.natural_freq * np.exp(size * twin.STD_FREQ * rng.standard_normal(modes.n_modes))
    damping = modes.damping_ratio * np.exp(size * twin.STD_DAMPING * rng.standard_normal(modes.n_modes))
    off = rng.standard_normal(shapes.shape) + 1j * rng.standard_normal(shapes.shape)
    scale = np.abs(shapes).max(axis=0)
    return replace(modes, natural_freq=natural, damping_ratio=damping), shapes + size * twin.STD_SHAPE * scale * off


def visible(
    problem: ModalProblem, space: ParameterSpace, effects: Sequence[Effect], values: Mapping[str, float]
) -> float:
    """Length of the joint signature of some effects with the free parameters projected out.

    Parameters
    ----------
    problem : ModalProblem
        Of the base model.
    space : ParameterSpace
    effects : sequence of Effect
    values : mapping
        True parameters, magnitudes and nuisance parameters.
    """
    base = problem.model
    assert isinstance(base, StructuralModel)
    model = extend(base, effects)
    more = replace(problem, model=model, mode_count=problem.mode_count + model.n_dof - base.n_dof)
    return change_seen(ModalResidual(problem), ModalResidual(more), space, values)


def change_seen(
    without: ModalResidual, extended: ModalResidual, space: ParameterSpace, values: Mapping[str, float]
) -> float:
    """The same from the residuals of the base model and of the one with effects."""
    own = {name: value for name, value in values.items() if name in space}
    names = [p.name for p in space.free if not p.integer]
    change = without.residual(own) - extended.residual(values)
    wide = np.vstack(
        [without.jacobian(own, names) * [space[n].prior_width for n in names], np.eye(len(names))]
    )  # the prior counts as data
    direction = np.concatenate([change, np.zeros(len(names))])
    basis = la.qr(wide, mode="economic")[0]
    return float(np.linalg.norm(direction - basis @ (basis.T @ direction)))


def turn(shapes: np.ndarray) -> np.ndarray:
    """Phase factor of the largest entry of every shape, (n_modes,): a solver returns shapes of any sign or phase."""
    largest = np.take_along_axis(shapes, np.abs(shapes).argmax(axis=0)[None], axis=0)[0]
    return largest / np.abs(largest)


def make(specimen: Specimen, kinds: Mapping[str, Kind], title: str, what: str) -> None:
    """Draw true values, measure the twin five times, write truth and repeats; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=what)
    arguments.add_argument("kind", choices=tuple(kinds))
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--into", type=Path, required=True, help="folder for the repeats")
    given = arguments.parse_args()
    kind = kinds[given.kind]
    found = drawn(specimen, kind)
    modes, shapes, rng = found.modes, found.shapes, found.rng
    if specimen.built is not None:
        shapes = shapes / turn(shapes)
    twin.write_measurement(
        given.into, specimen.modes, *set_up_errors(modes, shapes, kind.noise, rng), specimen.layout, rng, title
    )
    write_truth(given.truth, {
        **found.truth(specimen),
        "kind": given.kind,
        "noise": kind.noise,
        "natural_freq": dict(zip(specimen.modes, modes.natural_freq.tolist(), strict=True)),
        "damping_ratio": dict(zip(specimen.modes, modes.damping_ratio.tolist(), strict=True)),
    })  # fmt: skip
    print(f"seed {found.seed}")


def write_truth(path: Path, content: Mapping[str, object]) -> None:
    """Write the true values behind a measurement to a file that no analysis reads."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


@dataclass(frozen=True, eq=False)
class Drawn:
    """A twin with its true values, before it is measured.

    Attributes
    ----------
    seed : int
    effects : tuple of Effect
        That are hidden.
    values : mapping from parameter name to value
    visible : list of float
        Visibility of each effect.
    modes : Modes
    shapes : ndarray (n_sensors, n_modes)
        At the true places of the sensors.
    places : tuple of Sensor
        These places.
    rng : Generator
        Generator of the measurement noise.
    """

    seed: int
    effects: tuple[Effect, ...]
    values: Mapping[str, float]
    visible: list[float]
    modes: Modes
    shapes: np.ndarray
    places: tuple[Sensor, ...]
    rng: np.random.Generator

    def truth(self, specimen: Specimen) -> dict[str, object]:
        """What no analysis may know of the structure."""
        return {
            "seed": self.seed,
            "effects": [effect.name for effect in self.effects],
            "magnitudes": {name: self.values[name] for effect in self.effects for name in effect.names},
            "visible": self.visible,
            "parameters": {name: self.values[name] for name in specimen.space.names},
        }


def drawn(specimen: Specimen, kind: Kind) -> Drawn:
    """The twin of the first seed that meets the criteria."""
    for seed in range(kind.first_seed, kind.first_seed + 1000):
        found = _tried(specimen, kind, seed)
        if found is not None:
            return found
    raise SystemExit("no seed gave a visible effect")


def _tried(specimen: Specimen, kind: Kind, seed: int) -> Drawn | None:
    """One draw; None where a criterion is not met."""
    rng = np.random.default_rng(seed)
    designs = specimen.library if kind.inside else specimen.outside
    values = specimen.draw(rng)
    chosen: tuple[Effect, ...] = ()
    while len(chosen) < kind.count:
        one = designs[int(rng.integers(len(designs)))]
        chosen += (one,) if one not in chosen else ()
    for effect in chosen:
        values |= draw_effect(effect, float(rng.uniform(*MAGNITUDES)), rng)
    # The finer mesh decides; the fitted one screens the seeds at less cost.
    if _checked(replace(specimen, fine=specimen.base, built=None), kind, chosen, values, None, NEARLY) is None:
        return None
    places = twin.moved(specimen.layout, rng)
    found = _checked(specimen, kind, chosen, values, places, 1.0)
    return None if found is None else Drawn(seed, chosen, values, *found, places, rng)


def _checked(
    specimen: Specimen,
    kind: Kind,
    chosen: Sequence[Effect],
    values: Mapping[str, float],
    places: Sequence[Sensor] | None,
    slack: float,
) -> tuple[list[float], Modes, np.ndarray] | None:
    """Visibility of each effect, modes and shapes; None where a criterion, relaxed by ``slack``, is not met."""
    names, modes, shapes = specimen.solved(chosen, values, places)
    if names != specimen.modes or modes.damping_ratio.max() > slack * MEASURABLE:
        return None
    if not chosen:
        return [], modes, shapes
    known, without, bare = specimen.solved((), {n: values[n] for n in specimen.space.names})
    if known != specimen.modes:
        return None
    moved = slack * np.abs(modes.natural_freq / without.natural_freq - 1).max()
    similar = 1 - slack * (1 - np.diag(mac(bare, shapes)).min())
    if kind.inside and not (moved > LEAST_FREQ_CHANGE and similar < LARGEST_MAC):
        return None
    problem = specimen.problem(specimen.noiseless(names, modes, shapes))
    size: list[float] = []
    for effect in chosen:
        others = {name for other in chosen if other is not effect for name in other.names}
        alone = {name: value for name, value in values.items() if name not in others}
        size.append(visible(problem, specimen.space, [effect], alone))
        if slack * size[-1] < VISIBLE[0] or (kind.inside and size[-1] > slack * VISIBLE[1]):
            return None
    return size, modes, shapes
