"""Compositions for the tests of a model, and the search for the one that explains best."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.problem.effect import Effect
from calib.structure.affine import Monomial
from calib.structure.effects.composition import Composition, HungBy, Names
from calib.structure.effects.extend import addition_of
from calib.structure.effects.free_place import with_free_places
from calib.structure.effects.part_compositions import (
    of_function,
    of_joints,
    of_mounts,
    of_parts,
    of_rigid_joints,
    of_sections,
    of_supports,
)
from calib.structure.effects.point_compositions import (
    at_node,
    further_spots,
    heavy,
    held_at,
    hung_at,
    moving,
    of_sensors,
    springs_between,
)
from calib.structure.function_model import FunctionModel
from calib.structure.located import placed_sensors
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel

Measured = MeasuredModes | MeasuredFRFs
Model = StructuralModel | ModalFunctionModel | FunctionModel
DISSIPATING = ("dissipation", "damper to ground", "damper between")
"""Kinds of compositions that add damping."""

MODES = 10
"""Modes of the model whose frequencies stand for measured ones."""
_DIGITS = 6
"""Digits in which two changes of a matrix are the same."""
RIGID = 1e-3
"""Frequency, over the highest of these, below which a mode is one of a rigid body."""


@dataclass(frozen=True, eq=False)
class Compositions:
    """What may be proposed for a model.

    Attributes
    ----------
    plain : tuple of Composition
        Without degrees of freedom of their own.
    mounts : tuple of Composition
        Soft mounts of dampers.
    hung : tuple of HungBy
        Hung masses.
    held : tuple of Effect
        Masses held fast, from which the hung ones between the sensors follow.
    """

    plain: tuple[Composition, ...]
    mounts: tuple[Composition, ...] = ()
    hung: tuple[HungBy, ...] = ()
    held: tuple[Effect, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All that a search evaluates."""
        hung = (one.composed.effect for one in self.hung)
        composed = (*(c.effect for c in (*self.plain, *self.mounts)), *(e for e in hung if isinstance(e, Effect)))
        return (*composed, *self.held)


def compositions(
    model: Model,
    measured: Sequence[Measured],
    values: Mapping[str, float],
    taken: Collection[str] = (),
) -> Compositions:
    """Everything that may be composed for a model and the tests of it.

    Parameters
    ----------
    model : StructuralModel, ModalFunctionModel or FunctionModel
        Of a function only the parts that it scales itself are known.
    measured : sequence of MeasuredModes or MeasuredFRFs
        The fitted data of each test.
    values : mapping
        Reference values of its parameters.
    taken : collection of str
        Names that are used otherwise, such as those of the library.
    """
    names = Names({*taken, *model.space.names})
    plain = _plain(model, measured, values, names)
    if not isinstance(model, StructuralModel):
        return Compositions(plain)
    values, sensors, band = _own(model, values), _sensors(model, measured), _band(model, measured, values)
    mounts = tuple(of_mounts(model, names, _middle(band)))
    placed = {c.at for c in plain if c.kind == "added mass"}
    hung = [
        HungBy(
            hung_at(model, sensor, DIRECTIONS.index(sensor.direction), values, names, band),
            f"added mass at sensor {sensor.name}",
        )
        for sensor in sensors
        if at_node(model, sensor).at in placed and sensor.direction in DIRECTIONS[:3]
    ]
    held, mass = [], heavy(model, model.matrices(values)[2])
    for spot in further_spots(model, sensors):
        for direction in moving(model, spot.place):
            held.append(held_at(model, spot, direction, mass, names))
            hung.append(HungBy(hung_at(model, spot, direction, values, names, band), held[-1].name))
    return Compositions(plain, mounts, tuple(hung), tuple(held))


def generic_effects(model: Model, measured: Sequence[Measured], taken: Collection[str] = ()) -> tuple[Effect, ...]:
    """Effects of a model's own parts, joints, supports and points, for one of which no library lists any.

    They are the `compositions` at its nominal values but for hung masses and mounts of dampers, which only a search
    tries at all of their natural frequencies and lags. Without damping in the model there are none that dissipate:
    they would change nothing. Of those that change the same entries of one matrix in the same ratio, such as a spring
    between two masses and the part that it is, the first stands for all. Stiffness and mass of what has the same nodes
    also change together. A mass or a spring to the ground has one at a free place as its richer member. As nobody
    stated their plausible sizes, priors have heavy tails: a mass of ten times its size is not drawn down to it.

    Parameters
    ----------
    model, measured, taken
        As in `compositions`.

    Raises
    ------
    InputError
        For a model that names no parts and has no points.
    """
    names = Names({*taken, *model.space.names})
    kept = list(_plain(model, measured, model.space.values, names))
    if isinstance(model, StructuralModel):
        values, sensors = dict(model.space.values), _sensors(model, measured)
        kept += of_sections(model, names, kept)
        kept += springs_between(model, sensors, values, names, _middle(_band(model, measured, values)))
        kept = [c for c in kept if model.is_damped or c.kind not in DISSIPATING]
        kept = with_free_places(model, values, _different(model, kept), names)
    out = tuple(_guessed(c.effect) for c in kept)
    if not out:
        raise InputError(
            f"no generic effects can be composed: {model.name} names no parts, and has no matrices", place="effects",
            remedy="name a library, or give it parts that its function scales",
        )  # fmt: skip
    return out


def _guessed(effect: Effect) -> Effect:
    """A generic effect, whose plausible size is a guess."""
    richer = None if effect.richer is None else _guessed(effect.richer)
    return replace(effect, magnitude=replace(effect.magnitude, prior="heavy-tailed"), generic=True, richer=richer)


def _different(model: StructuralModel, found: Sequence[Composition]) -> list[Composition]:
    """Those that are not the same change of the model as one before, of either sign or of the same one."""
    known, out = dict[tuple[str, bytes], set[str]](), []
    for one in found:
        addition = addition_of(model, one.effect)
        terms = [(kind, t) for kind in ("stiffness", "damping", "mass") for t in getattr(addition, kind)]
        if len(terms) == 1 and not addition.selected:
            matrix = sp.csr_array(terms[0][1].matrix)
            matrix.eliminate_zeros()
            matrix.sort_indices()
            ratio = (matrix.data / np.abs(matrix.data).max(initial=1e-300)).round(_DIGITS) + 0.0
            key = (terms[0][0], b"".join(a.tobytes() for a in (matrix.indptr, matrix.indices, ratio)))
            more = "more" if isinstance(terms[0][1].coefficient, Monomial) else "less"
            before = known.setdefault(key, set())
            if before & {"both", more}:
                continue
            before.add("both" if one.effect.signed else more)
        out.append(one)
    return out


def _plain(
    model: Model, measured: Sequence[Measured], values: Mapping[str, float], names: Names
) -> tuple[Composition, ...]:
    """Compositions without degrees of freedom of their own."""
    if not isinstance(model, StructuralModel):
        return tuple(of_function(model.parts, names))
    values, sensors = _own(model, values), _sensors(model, measured)
    middle = _middle(_band(model, measured, values))
    return (
        *of_parts(model, names, middle), *of_supports(model, names),
        *of_rigid_joints(model, sensors, values, names, middle), *of_joints(model, values, names, middle),
        *of_sensors(model, sensors, values, names, middle),
    )  # fmt: skip


def _own(model: StructuralModel, values: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in values.items() if name in model.space}


def _middle(band: tuple[float, float]) -> float:
    return float(np.sqrt(band[0] * band[1]))


def _band(model: StructuralModel, measured: Sequence[Measured], values: Mapping[str, float]) -> tuple[float, float]:
    """Lowest and highest measured frequency above 0, Hz; of the model's lowest modes where no sensor measured any."""
    if measured:
        freqs = np.concatenate([one.frequencies for one in measured])
        return float(freqs[freqs > 0].min()), float(freqs.max())
    freqs = model.modes(values, min(MODES, model.n_modes)).natural_freq
    return float(freqs[freqs > RIGID * freqs.max()].min()), float(freqs.max())


def _sensors(model: StructuralModel, measured: Sequence[Measured]) -> list[Sensor]:
    return list({s.name: s for one in measured for s in placed_sensors(model, one.sensors)}.values())
