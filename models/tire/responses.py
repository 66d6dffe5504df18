"""Responses of a tire, free and on the ground, with their derivatives."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib import InputError
from models.tire.contact import Ground, Pressed
from models.tire.derivatives import STEP, Change, StripTangent, Tangent, along, frequency_slopes
from models.tire.harmonics import HoopModes, hoop_modes
from models.tire.inflated import Inflated, inflate
from models.tire.load_curve import RotationWarning, load_curve, press_to_load
from models.tire.patch import bulge, patch_length, patch_width, shoulder
from models.tire.tire import Tire

KPA, MM = 1e3, 1e-3


@dataclass(frozen=True)
class State:
    """Equilibria and modes of a tire at one pressure.

    Attributes
    ----------
    ground : Ground
        With the inflated state.
    steps : mapping from str to Pressed
        By deflection, mm.
    loaded : mapping from str to Pressed
        By load, N.
    even : Inflated or None
        On equal hoop cells, for the modes.
    modes : HoopModes or None
    """

    ground: Ground
    steps: Mapping[str, Pressed]
    loaded: Mapping[str, Pressed]
    even: Inflated | None = None
    modes: HoopModes | None = None


@dataclass(frozen=True)
class Rig:
    """What is done to a tire, and on which mesh it is computed.

    Attributes
    ----------
    n_meridian, n_hoop : int
        Cells.
    deflections : sequence of float
        mm, ascending.
    loads : sequence of float
        N, ascending.
    orders : sequence of int
        Hoop orders whose lowest mode is wanted.
    """

    n_meridian: int = 29
    n_hoop: int = 16
    deflections: Sequence[float] = ()
    loads: Sequence[float] = ()
    orders: Sequence[int] = ()

    def __post_init__(self) -> None:
        for name in ("deflections", "loads", "orders"):
            given = getattr(self, name)
            if list(given) != sorted(set(given)):
                raise InputError(f"the {name} of a tire must ascend, each once: {', '.join(f'{x:g}' for x in given)}")

    def solve(self, tire: Tire, pressure: float) -> State:
        """Equilibria and modes at a pressure, Pa.

        Raises
        ------
        EvaluationError
            Where one is not found.
        """
        ground = tire.on_ground(pressure, self.n_meridian, self.n_hoop)
        steps: tuple[Pressed, ...] = ()
        if len(self.deflections):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RotationWarning)  # a search would repeat it at every point
                steps = load_curve(ground, np.asarray(self.deflections) * MM).complete().steps
        last, loaded = (steps[0] if steps else None), {}
        for load in self.loads:
            last = loaded[f"{load:g}"] = press_to_load(ground, load, last)
        even = modes = None
        if len(self.orders):
            even = inflate(tire.wall(self.n_meridian, self._hoop_cells, 0.0), tire.wall(self.n_meridian, 1), pressure)
            modes = hoop_modes(even, np.asarray(self.orders))
        return State(ground, {f"{d:g}": s for d, s in zip(self.deflections, steps, strict=True)}, loaded, even, modes)

    @property
    def _hoop_cells(self) -> int:
        """Equal cells around the hoop, 12 to a wave of the highest order."""
        return max(12 * max(self.orders), 24)

    def responses(self, state: State) -> dict[str, float]:
        """All responses; see `models.tire.model.tire_on_ground`."""
        out = self._static(state)
        if state.modes is not None:
            out |= dict(zip(self._frequencies, state.modes.frequencies[:, 0].tolist(), strict=True))
        return out

    @property
    def _frequencies(self) -> list[str]:
        return [f"freq_{order}" for order in self.orders]

    def slopes(self, state: State, changes: Mapping[str, Change], ranges: Mapping[str, float]) -> dict[str, dict]:
        """Derivatives of the responses by each parameter.

        Parameters
        ----------
        state : State
        changes : mapping from parameter to Change
            Per unit of the parameter.
        ranges : mapping from parameter to float
            Between its limits; the scale of differences.
        """
        tangents = {k: Tangent(step) for k, step in state.steps.items()}
        at_load = {k: Tangent(step) for k, step in state.loaded.items()}
        out, strip = {}, StripTangent(state.ground.inflated)
        for name, by in changes.items():
            h = STEP * ranges[name]
            inflated = state.ground.inflated
            slope = strip.slope(by)
            there, back = (along(inflated, slope, by, x) for x in (h, -h))
            radius = (there.radius - back.radius) / (2 * h)
            pressed = {k: tangent.slope(by, radius) for k, tangent in tangents.items()}
            moved = [
                State(
                    replace(state.ground, inflated=end),
                    {k: tangents[k].along(end, pressed[k], x) for k in tangents},
                    {},
                )
                for x, end in ((h, there), (-h, back))
            ]
            high, low = (self._static(one) for one in moved)
            out[name] = {key: (high[key] - low[key]) / (2 * h) for key in high}
            for k, tangent in at_load.items():
                load = float(tangent.slope(by, radius)[1].sum())
                out[name][f"radius_at_{k}"] = (radius + load / tangent.pressed.stiffness) / MM
            if state.even is not None and state.modes is not None:
                found = frequency_slopes(state.even, state.modes, slope, by, h)[:, 0]
                out[name] |= dict(zip(self._frequencies, found.tolist(), strict=True))
        return out

    def _static(self, state: State) -> dict[str, float]:
        """Responses that follow from displacements and contact forces."""
        inflated = state.ground.inflated
        centre = int(np.argmax(state.ground.rest))
        out = {
            "radius_inflated": inflated.radius / MM, "growth_crown": inflated.growth / MM,
            "growth_width": inflated.widening / MM,
        }  # fmt: skip
        last = (0.0, 0.0)
        for d, step in state.steps.items():
            # The tangent jumps whenever a node comes to touch; the slope between deflections does not.
            here = (step.deflection / MM, step.load)
            out |= {
                f"load_{d}": step.load, f"stiffness_{d}": (here[1] - last[1]) / (here[0] - last[0]),
                f"patch_length_{d}": patch_length(step) / MM,
                f"patch_width_{d}": patch_width(step) / MM, f"bulge_{d}": bulge(step) / MM,
                f"shoulder_{d}": shoulder(step) / MM, f"centre_{d}": float(step.pressure[centre]) / KPA,
            }  # fmt: skip
            last = here
            if step.largest_pressure_converges:
                out[f"peak_{d}"] = step.largest_pressure / KPA
        return out | {f"radius_at_{k}": step.loaded_radius / MM for k, step in state.loaded.items()}
