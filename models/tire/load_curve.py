"""Load curves: a tire pressed step by step to deflections, or to a load."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from calib import EvaluationError, InputError
from models.tire.contact import Ground, Pressed, equilibrium

WARNED_ROTATION = 0.35
REFUSED_ROTATION = 0.6
"""Of moderate-rotation theory, rad. Half the square stands for one minus the cosine: 1 % too much at the first, 3 % at
the second, and the sine for the angle: 2 % and 6 %."""
SMALLEST_PART = 1 / 16
"""Of a step, before a curve ends."""


class RotationWarning(UserWarning):
    """Rotations come near the limit of moderate-rotation theory."""


@dataclass(frozen=True)
class LoadCurve:
    """Equilibria in the order they were found.

    Attributes
    ----------
    steps : tuple of Pressed
        Every converged step asked for.
    failure : str or None
        Why the curve ends before its last step; None where it is complete.
    """

    steps: tuple[Pressed, ...]
    failure: str | None = None

    @property
    def deflections(self) -> np.ndarray:
        """(n_steps,), m."""
        return np.array([step.deflection for step in self.steps])

    @property
    def loads(self) -> np.ndarray:
        """(n_steps,), N."""
        return np.array([step.load for step in self.steps])

    @property
    def last(self) -> Pressed:
        """The last equilibrium found.

        Raises
        ------
        EvaluationError
            Where no step converged.
        """
        if not self.steps:
            raise EvaluationError(self.failure or "the load curve has no step")
        return self.steps[-1]

    def complete(self) -> LoadCurve:
        """Return the curve itself.

        Raises
        ------
        EvaluationError
            Where it ended early.
        """
        if self.failure is not None:
            raise EvaluationError(self.failure)
        return self


def load_curve(ground: Ground, deflections: np.ndarray) -> LoadCurve:
    """Press the tire to each deflection in turn, each step starting from the last ones.

    Parameters
    ----------
    ground : Ground
    deflections : (n_steps,) array
        m, positive and ascending. What is found at a deflection does not depend on the ones before it.

    Returns
    -------
    LoadCurve
        Ends with the last good step, and says why, where Newton's method fails or rotations exceed the theory.

    Raises
    ------
    InputError
        For deflections that do not ascend from above zero or exceed the section.
    """
    wanted = np.atleast_1d(np.asarray(deflections, float))
    if wanted.size == 0 or not np.isfinite(wanted).all() or wanted[0] <= 0.0 or (np.diff(wanted) <= 0.0).any():
        raise InputError("the deflections must ascend from above 0 m")
    _check_section(ground, float(wanted[-1]))
    found: list[Pressed] = []
    trail = [_untouched(ground)]
    failure = None
    for deflection in wanted:
        try:
            trail = _follow(ground, trail, float(deflection))
        except EvaluationError as fault:
            failure = str(fault)
            break
        found.append(trail[-1])
    rotation = found[-1].largest_rotation if found else 0.0
    if rotation > WARNED_ROTATION:
        warnings.warn(
            f"the wall turns by {rotation:.2f} rad at {found[-1].deflection:g} m; the theory holds for moderate "
            f"rotations, up to about {WARNED_ROTATION} rad",
            RotationWarning,
            stacklevel=2,
        )
    return LoadCurve(tuple(found), failure)


def press_to_load(ground: Ground, load: float, start: Pressed | None = None, tolerance: float = 1e-8) -> Pressed:
    """Equilibrium at a wanted load, by Newton's method on the deflection.

    Parameters
    ----------
    ground : Ground
    load : float
        N.
    start : Pressed, optional
        An equilibrium to start from.
    tolerance : float
        Of the load, relative.

    Raises
    ------
    InputError
        For a load that is not positive.
    EvaluationError
        Where the load is not reached.
    """
    if not np.isfinite(load) or load <= 0.0:
        raise InputError(f"the wanted load is {load:g} N, allowed is above 0")
    grid = ground.inflated.wall.grid
    section = float(np.ptp(grid.profile.r(grid.s_node)))
    trail = [_untouched(ground)] if start is None else [start]
    step = 0.02 * section
    for _ in range(60):
        here = trail[-1]
        if here.force.any():
            if abs(here.load - load) <= tolerance * load:
                return here
            # A tire stiffens with its patch: long steps from small deflections would overshoot.
            step = float(np.clip((load - here.load) / here.stiffness, -0.5 * here.deflection, 0.1 * section))
        target = here.deflection + step
        _check_section(ground, target)
        trail = _follow(ground, trail, target)
    raise EvaluationError(f"the load of {load:g} N is not reached; the last deflection is {trail[-1].deflection:g} m")


def _check_section(ground: Ground, deflection: float) -> None:
    grid = ground.inflated.wall.grid
    section = float(np.ptp(grid.profile.r(grid.s_node)))
    if deflection > 0.5 * section:
        raise InputError(
            f"a deflection of {deflection:g} m is more than half the section height of {section:g} m",
            remedy="moderate-rotation theory holds up to about a quarter",
        )


def _untouched(ground: Ground) -> Pressed:
    return Pressed(ground, 0.0, ground.inflated.displacement, np.zeros(ground.nodes.size), 0.0, 0)


def _follow(ground: Ground, trail: list[Pressed], deflection: float) -> list[Pressed]:
    """Reach a deflection from the last two equilibria, in smaller parts where one step fails; the last two again."""
    part = 1.0
    while True:
        here = trail[-1]
        target = here.deflection + part * (deflection - here.deflection)
        if part == 1.0 or abs(target - deflection) < 1e-12:
            target = deflection
        start = here.displacement
        if len(trail) > 1:
            ahead = (target - here.deflection) / (here.deflection - trail[0].deflection)
            start = start + min(ahead, 2.0) * (start - trail[0].displacement)
        try:
            reached = equilibrium(ground, start, here.force > 0.0, target)
        except EvaluationError as fault:
            part /= 2
            if part < SMALLEST_PART:
                raise EvaluationError(
                    f"no equilibrium found beyond a deflection of {here.deflection:g} m ({fault})"
                ) from fault
            continue
        rotation = reached.largest_rotation
        if rotation > REFUSED_ROTATION:
            raise EvaluationError(
                f"the wall turns by {rotation:.2f} rad at a deflection of {target:g} m, beyond moderate rotations "
                f"({REFUSED_ROTATION} rad); the last good deflection is {here.deflection:g} m"
            )
        trail = [here, reached] if here.force.any() else [reached]
        if target == deflection:
            return trail
        part = 1.0 if part == 1.0 else min(1.0, 2 * part)
