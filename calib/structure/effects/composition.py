"""A composed effect: what it is, where it acts, and how it is named."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from calib.measurement.places import Point
from calib.problem.effect import Effect
from calib.structure.effects.composed import Builder
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor, symmetric_factor
from calib.structure.model import StructuralModel


@dataclass(frozen=True)
class Composition:
    """An effect composed of local perturbations.

    Attributes
    ----------
    effect : Effect
        Built by a `calib.structure.effects.composed.Builder`.
    kind : str
        Of parts: ``stiffness``, ``damping``, ``mass``, ``section`` (stiffness and mass together), ``thickness`` (mass,
        and stiffness as its cube), ``dissipation`` (dampers in parallel to them), ``damper mount`` (springs in series
        with dampers), ``soft support`` (springs in series with supports), ``soft joint`` (with ends of beams),
        ``rotational spring`` (between the bodies that a spring joins). At points: ``added mass``, ``hung mass``,
        ``spring to ground``, ``damper to ground``, ``spring between``, ``damper between``.
    at : str
        Parts, sensors or points, in words.
    places : tuple of (3,) float
        Of everything that changes together, m; empty where none is known.
    count : int
        Parts or points that change together, or 1.
    """

    effect: Effect
    kind: str
    at: str
    places: tuple[Point, ...] = ()
    count: int = 1

    @property
    def place(self) -> Point:
        """Middle of its places, m; NaN where none is known."""
        if not self.places:
            return (math.nan, math.nan, math.nan)
        x, y, z = np.mean(self.places, axis=0).tolist()
        return (x, y, z)

    @property
    def builder(self) -> Builder:
        """What builds the effect."""
        builder: Builder = self.effect.build  # type: ignore[assignment]
        return builder

    @property
    def family(self) -> tuple[str, bool]:
        """Compositions among which it was chosen: of its kind, and of single places or of several together."""
        return self.kind, self.count > 1


@dataclass(frozen=True, eq=False)
class HungBy:
    """A hung mass, and the candidate that is the same mass held fast.

    Attributes
    ----------
    composed : Composition
    fixed : str
        Name of that local perturbation or effect.
    """

    composed: Composition
    fixed: str


def dynamic_factor(model: StructuralModel, values: Mapping[str, float], freq: float) -> SymmetricFactor:
    """Factor of ``K + omega^2 M`` at a frequency in Hz: flexibilities at places, those of a free body finite too."""
    stiffness, _, mass = model.matrices(values)
    return symmetric_factor(sp.csc_array(stiffness + (2 * np.pi * freq) ** 2 * mass))


def slug(text: str) -> str:
    """A name for Python and for files."""
    return re.sub(r"\W+", "_", text).strip("_").lower()


class Names:
    """Names that are not taken yet."""

    def __init__(self, taken: Collection[str]) -> None:
        self._taken = set(taken)

    def free(self, text: str, *ends: str) -> str:
        """A free name; with every end appended it is free too."""
        first, number = slug(text), 1
        first = first if first.isidentifier() else f"at_{first}"
        name = first
        while self._taken & {name + end for end in ("", *ends)}:
            number += 1
            name = f"{first}_{number}"
        self._taken |= {name + end for end in ("", *ends)}
        return name
