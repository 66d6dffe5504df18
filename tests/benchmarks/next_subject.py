"""Two effects that a first test can hardly tell apart, on a bogie and on a vehicle, and what that test leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rates_subject import BOGIE, VEHICLE, Subject

from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import parameter
from calib.structure.effects.extend import Addition
from calib.structure.model import StructuralModel
from models.railway.effects_frame import GIRDER_Y, GIRDER_Z, UX, UY, UZ, motion, outer_term


@dataclass(frozen=True)
class Case:
    """Which of two effects is hidden has to be found.

    Attributes
    ----------
    subject : Subject
        What is measured.
    magnitudes : mapping from str to (float, float)
        The two effects, which are hidden in turn, and between which multiples of its plausible size each is drawn.
    modes, sensors : tuple of str
        What the first test leaves out.
    added : tuple of Effect
        Those of the two that are not in the subject's own library.
    """

    subject: Subject
    magnitudes: Mapping[str, tuple[float, float]]
    modes: tuple[str, ...]
    sensors: tuple[str, ...]
    added: tuple[Effect, ...] = field(default=())

    @property
    def competing(self) -> tuple[str, ...]:
        """Names of the two effects."""
        return tuple(self.magnitudes)


@dataclass(frozen=True)
class _Mass:
    name: str
    x: float

    def __call__(self, model: StructuralModel) -> Addition:
        rows = [motion(model, ("frame", (self.x, GIRDER_Y, GIRDER_Z)), d) for d in (UX, UY, UZ)]
        return Addition(mass=(outer_term(self.name, rows, parameter(self.name)),))


def _mass(name: str, x: float) -> Effect:
    """A mass on the left girder of the bogie."""
    magnitude = Parameter(name, 0.0, 0.0, 600.0, "kg", prior_sd=150.0)
    title = f"Mass on the left girder at x = {x:g} m"
    return Effect(name, title, "It is left out.", "Look there.", magnitude, _Mass(name, x))


CASES = {
    "bogie": Case(
        BOGIE,
        {"mass_middle": (1.0, 5 / 3), "mass_ahead": (1.0, 5 / 3)},
        ("4BT", "9BT"),
        # All of the frame: those of wheelsets, boxes and blocks are left.
        tuple(f"{node}y" for node in range(101, 115)),
        (_mass("mass_middle", 0.0), _mass("mass_ahead", 0.45)),
    ),
    "vehicle": Case(
        VEHICLE,
        {"body_damping": (0.15, 0.3), "soft_seats": (0.65, 1.0)},
        ("6C", "2B_anti"),
        # All that look sideways: the car is measured upright only.
        tuple(f"{node}z" for node in range(215, 225)),
    ),
}
