"""One structure of which as much can be measured as is asked for; what was measured once stays as it was."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from next_subject import Case
from rates_scenarios import OWN
from rates_world import World

from calib.correlation.modal.residual import ModalResidual
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.measurement.modal import MeasuredModes, Sensor
from calib.problem.space import ParameterSpace

REPEATS = 5


@dataclass(frozen=True, eq=False)
class Twin:
    """The finer mesh with one of the two effects, drawn by its number.

    Attributes
    ----------
    world : World
        With a library that has both.
    case : Case
    number : int
    """

    world: World
    case: Case
    number: int

    @property
    def hidden(self) -> str:
        """The effect."""
        return self.case.competing[self.number % len(self.case.competing)]

    @cached_property
    def values(self) -> dict[str, float]:
        """The truth."""
        rng = np.random.default_rng([7, self.number])
        values: dict[str, float] = self.world.specimen.draw(rng)
        factor = float(rng.uniform(*self.case.magnitudes[self.hidden]))
        drawn: dict[str, float] = self.world.maker.blind.draw_effect(self.world.effects[self.hidden], factor, rng)
        return values | drawn

    def measured(self, extra: Sequence[Sensor] = (), repeats: int = REPEATS) -> MeasuredModes:
        """All modes that can be told apart at all sensors and at further ones."""
        spec, blind, own = self.world.specimen, self.world.maker.blind, (self.hidden,)
        known, twin, model = len(spec.layout), blind.twin, self.world.twin.with_effects(own)
        displaced = twin.moved(spec.layout, np.random.default_rng([8, self.number]))
        found = model.modes(self.values, len(spec.modes) + blind.MORE + self.world.twin.added(own))
        rows = model.sensor_rows((*displaced, *extra))
        names, modes, _ = spec.identified(found, rows[:known] @ found.shapes)
        index = [int(np.flatnonzero(found.natural_freq == f)[0]) for f in modes.natural_freq]
        shapes = rows @ found.shapes[:, index]
        shapes = shapes / np.abs(shapes[:known]).max(axis=0)
        freq, damping = modes.natural_freq, modes.damping_ratio
        std = np.full(shapes.shape, twin.STD_SHAPE)
        std[known:] *= np.maximum(
            np.abs(shapes).max(axis=0), 1.0
        )  # the standard deviation is a part of the largest motion
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

    def hypotheses(self, measured: MeasuredModes, space: ParameterSpace | None = None) -> ModelHypotheses:
        """The question of the blind studies, asked of what was measured."""
        problem = self.world.specimen.problem(measured, held_out=False)
        return ModelHypotheses(ModalResidual(problem), self.world.libraries[OWN], space or self.world.space)
