"""Composed effects: what a local perturbation may be in engineering terms, each with the code that builds it.

Every builder adds to a model what its code, run as the body of ``def build(model)``, would add.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from calib.measurement.places import Point
from calib.structure.affine import Term, parameter
from calib.structure.effects.attach import (
    Place,
    between,
    hung_masses,
    motion,
    mounted_dampers,
    outer_term,
    part_of,
    relative_rotation,
    scaled_part,
    softened_supports,
    thicker_part,
)
from calib.structure.effects.extend import Addition
from calib.structure.effects.rigid_joints import softened_joint
from calib.structure.model import PartKind, StructuralModel
from calib.structure.rules import RULES


class Builder(Protocol):
    """What builds an effect, and its code."""

    def __call__(self, model: Any) -> Any:
        """What the effect adds to a model."""
        ...

    @property
    def code(self) -> tuple[str, ...]:
        """Lines of the body of a function of ``model``, without indentation."""
        ...


def _literal(place: Place) -> str:
    part, point = place
    return f"({None if part is None else python_text(part)}, ({', '.join(repr(float(c)) for c in point)}))"


@dataclass(frozen=True)
class ScaledParts:
    """Parts of a model scaled together by one plus the magnitude, or damping in proportion to their stiffness.

    Attributes
    ----------
    name : str
        Of the magnitude.
    parts : tuple of (kind, name)
    dissipating : bool
        Whether dampers in parallel are added: C is the magnitude, in s, times the stiffness of the parts.
    thickness : bool
        Whether the magnitude is that of a thickness: stiffness, of bending, grows with its cube.
    """

    name: str
    parts: tuple[tuple[PartKind, str], ...]
    dissipating: bool = False
    thickness: bool = False

    def __call__(self, model: StructuralModel) -> Addition:
        """Terms of every matrix."""
        terms: dict[str, list[Term]] = {}
        for kind, part in self.parts:
            cubed = self.thickness and kind == "stiffness"
            changed = thicker_part(model, part, self.name) if cubed else (scaled_part(model, kind, part, self.name),)
            terms.setdefault("damping" if self.dissipating else kind, []).extend(changed)
        own = {kind: tuple(terms.get(kind, ())) for kind in ("stiffness", "damping", "mass")}
        return Addition(own["stiffness"], own["damping"], own["mass"])

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        lines, kinds = ["return Addition("], tuple(dict.fromkeys(kind for kind, _ in self.parts))
        for kind in kinds:
            lines.append(f"    {'damping' if self.dissipating else kind}=(")
            cubed = self.thickness and kind == "stiffness"
            lines += [
                f'        *thicker_part(model, {python_text(part)}, "{self.name}"),'
                if cubed
                else f'        scaled_part(model, "{kind}", {python_text(part)}, "{self.name}"),'
                for own, part in self.parts
                if own == kind
            ]
            lines.append("    ),")
        return (*lines, ")")


@dataclass(frozen=True)
class MountedDampers:
    """Springs in series with dampers of a model.

    Attributes
    ----------
    name : str
        Of their lag.
    parts : tuple of str
        Parts of damping.
    """

    name: str
    parts: tuple[str, ...]

    def __call__(self, model: StructuralModel) -> Addition:
        """See `calib.structure.effects.attach.mounted_dampers`."""
        return mounted_dampers(model, self.parts, self.name)

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        return (f'return mounted_dampers(model, {_names(self.parts)}, "{self.name}")',)


@dataclass(frozen=True)
class SoftSupports:
    """Flexibilities in series with supports whose position parameters select.

    Attributes
    ----------
    name : str
        Of the flexibility.
    supports : tuple of str
    """

    name: str
    supports: tuple[str, ...]

    def __call__(self, model: StructuralModel) -> Addition:
        """See `calib.structure.effects.attach.softened_supports`."""
        return softened_supports(model, self.supports, self.name)

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        return (f'return softened_supports(model, {_names(self.supports)}, "{self.name}")',)


@dataclass(frozen=True)
class SoftJoint:
    """A flexibility in series with a support, or with a beam's end, that matrices hold without naming it.

    Attributes
    ----------
    name : str
        Of the flexibility.
    places : tuple of (3,) float
        M; see `calib.structure.effects.rigid_joints.softened_joint`.
    direction : int or None
        0..5 for x, y, z and rotations about them; None for all.
    """

    name: str
    places: tuple[Point, ...]
    direction: int | None

    def __call__(self, model: StructuralModel) -> Addition:
        """See `calib.structure.effects.rigid_joints.softened_joint`."""
        return softened_joint(model, self.places, self.direction, self.name)

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        points = [f"({', '.join(repr(float(c)) for c in point)})" for point in self.places]
        places = f"({', '.join(points)}{',' * (len(points) == 1)})"
        axes = "0, 1, 2: x, y, z; 3, 4, 5: rx, ry, rz; None: all"
        return (
            f"places = {places}",
            f'return softened_joint(model, places, {self.direction}, "{self.name}")  # {axes}',
        )


@dataclass(frozen=True)
class RotationalSprings:
    """Rotational springs about one axis between the bodies that springs of a model join.

    Attributes
    ----------
    name : str
        Of their stiffness.
    parts : tuple of str
        Springs of the model.
    direction : int
        3, 4, 5 for rx, ry, rz.
    """

    name: str
    parts: tuple[str, ...]
    direction: int

    def __call__(self, model: StructuralModel) -> Addition:
        """One term."""
        rows = [relative_rotation(model, part_of(model, "stiffness", part), self.direction) for part in self.parts]
        kept = [row for row in rows if row is not None]
        return Addition(stiffness=(outer_term(self.name, kept, parameter(self.name)),))

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        return (
            f'joints = [part_of(model, "stiffness", name) for name in {_names(self.parts)}]',
            f"rows = [relative_rotation(model, joint, {self.direction}) for joint in joints]  # 3, 4, 5: rx, ry, rz",
            f'return Addition(stiffness=(outer_term("{self.name}", rows, parameter("{self.name}")),))',
        )


@dataclass(frozen=True)
class PointMass:
    """Masses at points, in all directions in which the points move.

    Attributes
    ----------
    name : str
    places : tuple of Place
        Each has one mass.
    directions : tuple of int
    """

    name: str
    places: tuple[Place, ...]
    directions: tuple[int, ...]

    def __call__(self, model: StructuralModel) -> Addition:
        """One mass term."""
        rows = [motion(model, place, d) for place in self.places for d in self.directions]
        return Addition(mass=(outer_term(self.name, rows, parameter(self.name)),))

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        over = f"for place in places for direction in {_tuple(self.directions)}"
        return (
            f"places = {_literals(self.places)}",
            f"rows = [motion(model, place, direction) {over}]  # 0, 1, 2: x, y, z",
            f'return Addition(mass=(outer_term("{self.name}", rows, parameter("{self.name}")),))',
        )


@dataclass(frozen=True)
class HungMass:
    """A mass on a spring that gives in one direction; in the others it moves with its point.

    Attributes
    ----------
    name : str
    freq : str
        Name of its natural frequency on a fixed base.
    place : Place
    direction : int
        In which the spring gives.
    others : tuple of int
        Directions in which the mass is held.
    """

    name: str
    freq: str
    place: Place
    direction: int
    others: tuple[int, ...]

    def __call__(self, model: StructuralModel) -> Addition:
        """An oscillator, and a mass in the other directions."""
        hung = hung_masses([motion(model, self.place, self.direction)], self.name, self.freq, RULES.hung_ratio)
        rows = [motion(model, self.place, d) for d in self.others]
        held = (outer_term(f"{self.name}: held", rows, parameter(self.name), hung.n_added),) if rows else ()
        return Addition(hung.stiffness, hung.damping, (*hung.mass, *held), n_added=hung.n_added)

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        named, ratio = f'"{self.name}", "{self.freq}"', RULES.hung_ratio
        hung = f"hung_masses([motion(model, place, {self.direction})], {named}, {ratio})"
        lines = (f"place = {_literal(self.place)}", f"hung = {hung}  # damping ratio on its mounts: rubber (assumed)")
        if not self.others:
            return (*lines, "return hung")
        return (
            *lines,
            f"rows = [motion(model, place, direction) for direction in {_tuple(self.others)}]  # held in these",
            f'held = outer_term("{self.name}: held", rows, parameter("{self.name}"), hung.n_added)',
            "return Addition(hung.stiffness, hung.damping, (*hung.mass, held), n_added=hung.n_added)",
        )


@dataclass(frozen=True)
class Connection:
    """Springs or dampers in one direction, between two points each or from one to the ground.

    Attributes
    ----------
    name : str
    matrix : {"stiffness", "damping"}
    ends : tuple of (Place, Place or None)
        Of each; None for the ground.
    direction : int
    """

    name: str
    matrix: str
    ends: tuple[tuple[Place, Place | None], ...]
    direction: int

    def __call__(self, model: StructuralModel) -> Addition:
        """One term."""
        rows = [
            motion(model, one, self.direction) if other is None else between(model, one, other, self.direction)
            for one, other in self.ends
        ]
        term = (outer_term(self.name, rows, parameter(self.name)),)
        return Addition(stiffness=term) if self.matrix == "stiffness" else Addition(damping=term)

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        if self._grounded:
            lines = [f"places = {_literals([one for one, _ in self.ends])}"]
            lines += [f"rows = [motion(model, place, {self.direction}) for place in places]"]
        else:
            lines = ["ends = ("]
            for one, other in self.ends:
                assert other is not None
                lines += ["    (", f"        {_literal(one)},", f"        {_literal(other)},", "    ),"]
            lines += [")", f"rows = [between(model, one, other, {self.direction}) for one, other in ends]"]
        term = f'outer_term("{self.name}", rows, parameter("{self.name}"))'
        return (*lines, f"return Addition({self.matrix}=({term},))")

    @property
    def _grounded(self) -> bool:
        return all(other is None for _, other in self.ends)


@dataclass(frozen=True)
class ScaledByFunction:
    """A part of a function model that the function itself scales.

    Attributes
    ----------
    name : str
    part : str
        The value by which the function scales it, see `calib.structure.function_parts.ScaledPart`.
    """

    name: str
    part: str

    def __call__(self, model: Any) -> Callable[[Mapping[str, float]], Any]:
        """A function of all values."""
        function, name, part = model.function, self.name, self.part
        return lambda values: function({**values, part: values.get(part, 0.0) + values[name]})

    @property
    def code(self) -> tuple[str, ...]:
        """See `Builder`."""
        return (
            f"part = {python_text(self.part)}",
            f'return lambda values: model.function({{**values, part: values.get(part, 0.0) + values["{self.name}"]}})',
        )


OF_MATRICES = (
    ScaledParts,
    MountedDampers,
    SoftSupports,
    SoftJoint,
    RotationalSprings,
    PointMass,
    HungMass,
    Connection,
)
"""What builds a composed effect of a model of matrices."""


def python_text(text: str) -> str:
    """A Python string in double quotes where that needs no escapes."""
    return f'"{text}"' if text.isprintable() and not set(text) & set('"\\') else repr(text)


def _tuple(numbers: tuple[int, ...]) -> str:
    return f"({', '.join(map(str, numbers))}{',' * (len(numbers) == 1)})"


def _literals(places: Sequence[Place]) -> str:
    return f"({', '.join(map(_literal, places))}{',' * (len(places) == 1)})"


def _names(names: Sequence[str]) -> str:
    return f"({', '.join(map(python_text, names))}{',' * (len(names) == 1)})"
