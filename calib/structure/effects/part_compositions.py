"""Effects composed of changed parts of a model: stiffness, mass, damping, soft mounts and supports, stiff joints."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, Protocol, TypeVar

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.measurement.places import Point
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.results.answer import names_in_words
from calib.structure.affine import Monomial, SelectedTerm
from calib.structure.effects.attach import ENDS, joined_nodes, parts_of, relative_rotation
from calib.structure.effects.composed import (
    Builder,
    MountedDampers,
    RotationalSprings,
    ScaledByFunction,
    ScaledParts,
    SoftJoint,
    SoftSupports,
)
from calib.structure.effects.composition import Composition, Names, dynamic_factor
from calib.structure.effects.perturbations import LEAST
from calib.structure.effects.rigid_joints import RigidJoint, member_ends, supports
from calib.structure.effects.terms import Terms, parts_of_terms
from calib.structure.elongations import elongations
from calib.structure.function_parts import ScaledPart
from calib.structure.model import Part, PartKind, StructuralModel
from calib.structure.places import middles
from calib.structure.rules import RULES

_FEW = 6
"""Most motions that a damper with ends damps."""
_POSITION = re.compile(
    r"front|rear|left|right|upper|lower|top|bottom|inner|outer|middle|centre|center|end|side|[xyz]|\d+"
)
"""Words of a part's name that tell its position: parts that differ in them alone may change together."""

_PARTS: Mapping[str, tuple[str, str]] = {
    "stiffness": ("is as stiff as drawn", "Cracks, wrong or worn parts and play"),
    "damping": ("dissipates as drawn", "Leaks, wear, and a part that was exchanged"),
    "mass": ("weighs as much as drawn", "Equipment, filling, or parts that were left out"),
    "section": ("has the section of the drawing", "Corrosion, holes, or a profile of another size"),
    "thickness": ("is as thick as drawn", "Corrosion, grinding, or a sheet of another thickness"),
    "dissipation": ("is elastic without loss", "Rubber, friction in joints, and whatever gets warm"),
    "damper mount": ("is mounted rigidly", "Soft or worn bushes and thin brackets at the ends of dampers"),
    "soft support": ("stands as firmly as drawn", "Soft foundations, oil columns, clearances and thin packings"),
    "soft joint": ("is joined rigidly", "Loose bolts, thin end plates and cracked welds"),
    "rotational spring": ("rotates freely where bodies are joined", "Wide seats, stiff bushes and tight joints"),
}
"""What the model assumes, and where to look, by kind."""
_TITLES: Mapping[str, tuple[str, str]] = {
    "dissipation": ("Dissipation of {}", "dissipation in {}"),
    "damper mount": ("Soft mount of {}", "a soft mount of {}"),
    "soft support": ("Flexibility in series with {}", "a flexibility in series with {}"),
    "soft joint": ("Soft joint at {}", "a soft joint at {}"),
    "rotational spring": ("Rotational spring at {}", "a rotational spring at {}"),
}


class _Named(Protocol):
    """What has a name that tells its position."""

    @property
    def name(self) -> str: ...


N = TypeVar("N", bound=_Named)


# -- parts -------------------------------------------------------------------------------------------------------------


def of_parts(model: StructuralModel, names: Names, middle: float) -> Iterator[Composition]:
    """Changes of single parts, and of parts of one kind whose names differ in their position.

    Parameters
    ----------
    model : StructuralModel
    names : Names
    middle : float
        Of the measured band, Hz.
    """
    if terms := parts_of_terms(() if model.parts else parts_of(model)):
        yield from _of_terms(terms, names, middle)
        return
    by_kind: dict[PartKind, list[Part]] = defaultdict(list)
    for part in parts_of(model):
        by_kind[part.kind].append(part)
    for kind, parts in by_kind.items():
        for group in (*((part,) for part in parts), *_alike(parts)):
            yield _changed(kind, [(kind, part) for part in group], names, middle)
            if kind == "stiffness":
                yield _changed("dissipation", [(kind, part) for part in group], names, middle)
    masses = {part.name: part for part in by_kind["mass"]}
    for part in by_kind["stiffness"]:
        if part.name in masses:
            yield _changed("section", [("stiffness", part), ("mass", masses[part.name])], names, middle)


def of_sections(model: StructuralModel, names: Names, taken: Sequence[Composition]) -> Iterator[Composition]:
    """Sections and thicknesses: stiffness and mass of what has the same nodes change together.

    Both as one (a section: the wall of a tube, a membrane), and the stiffness as the cube (a thickness in bending): of
    matrices alone nobody knows which it is.
    """
    if not model.parts and parts_of_terms(parts_of(model)):
        return  # matrices from runs have terms of thickness of their own
    known = {frozenset(c.builder.parts) for c in taken if c.kind == "section" and isinstance(c.builder, ScaledParts)}
    masses: dict[bytes, list[Part]] = defaultdict(list)
    for part in parts_of(model):
        if part.kind == "mass":
            masses[_nodes_of(model, part)].append(part)
    for part in parts_of(model):
        for mass in masses[_nodes_of(model, part)] if part.kind == "stiffness" else ():
            both: list[tuple[PartKind, Part]] = [("stiffness", part), ("mass", mass)]
            for kind in ("section", "thickness"):
                if kind != "section" or frozenset((k, p.name) for k, p in both) not in known:
                    yield replace(_changed(kind, both, names, math.nan), count=1)


def _nodes_of(model: StructuralModel, part: Part) -> bytes:
    return np.unique(model.dofs.node[np.unique(sp.csr_array(part.matrix).indices)]).tobytes()


def _of_terms(terms: Sequence[Terms], names: Names, middle: float) -> Iterator[Composition]:
    """The same of matrices from runs, whose terms are no parts by themselves."""
    for one in terms:
        kind = one.parts[0][0]
        yield _changed(kind, one.parts, names, middle, one)
        if kind == "stiffness":
            yield _changed("dissipation", one.parts, names, middle, one)
    masses = {one.at: one for one in terms if one.parts[0][0] == "mass"}
    for one in terms:
        if one.parts[0][0] == "stiffness" and one.at in masses:
            yield _changed("section", (*one.parts, *masses[one.at].parts), names, middle, one)


def _alike(parts: Sequence[N]) -> Iterator[tuple[N, ...]]:
    """Groups whose names are the same but for words of position, such as all parts of one side; smaller groups first.

    A name without any word of position stands for the middle of others: ``girder left`` and ``girder end front left``
    are the parts of one girder.
    """
    seen: set[tuple[str, ...]] = set()
    found: dict[tuple[str, ...], list[N]] = defaultdict(list)
    for part in parts:
        own = [word for word in re.split(r"[,\s_]+", part.name) if word]
        at = [k for k, word in enumerate(own) if _POSITION.fullmatch(word)]
        left = dict.fromkeys(  # in this order, whatever the seed of Python's hashes
            tuple(word for k, word in enumerate(own) if k not in gone)
            for dropped in range(min(len(at), len(own) - 1) + 1)
            for gone in combinations(at, dropped)
        )
        for words in left:
            found[words].append(part)
    for group in sorted(found.values(), key=len):
        key = tuple(sorted(part.name for part in group))
        if len(group) > 1 and key not in seen:
            seen.add(key)
            yield tuple(group)


def _changed(
    kind: str, parts: Sequence[tuple[PartKind, Part]], names: Names, middle: float, terms: Terms | None = None
) -> Composition:
    own = list(dict.fromkeys(part.name for _, part in parts))
    at = names_in_words(own) if terms is None else terms.at
    name = names.free(f"{kind} {_common(own) if terms is None else terms.name}")
    unit, lower, upper, size = "-", LEAST.get(kind, LEAST["stiffness"]), RULES.more, RULES.relative
    words = f"relative change of {at}"
    if kind == "dissipation":
        size = 1e3 * RULES.lossy / (2 * math.pi * middle)
        unit, lower, upper = "ms", 0.0, RULES.added_most * size
        words = "damping over stiffness: the loss factor is this times the angular frequency"
    magnitude = Parameter(name, 0.0, lower, upper, unit, prior_sd=size, description=words)
    build = ScaledParts(name, tuple((k, p.name) for k, p in parts), kind == "dissipation", kind == "thickness")
    effect = _part_effect(kind, at, magnitude, build)
    places = dict.fromkeys(part.place for _, part in parts if np.isfinite(part.place).all())
    return Composition(effect, kind, at, tuple(places), len(own) if terms is None else 1)


def _part_effect(kind: str, at: str, magnitude: Parameter, build: Builder, **more: Any) -> Effect:
    lacks, look_for = _PARTS[kind]
    title, phrase = _TITLES.get(kind, (f"{kind.capitalize()} of {{}}", f"another {kind} of {{}}"))
    return Effect(
        magnitude.name, title.format(at), f"It {lacks}: {at}.", f"{look_for} at {at}.", magnitude, build,
        phrase=phrase.format(at), **more,
    )  # fmt: skip


def _common(names: Sequence[str]) -> str:
    """The words that all names share; all of the first one where there are none."""
    first, *others = (name.split() for name in names)
    shared = [word for k, word in enumerate(first) if all(len(o) == len(first) and o[k] == word for o in others)]
    return " ".join(shared) or names[0]


# -- in series and across joints ---------------------------------------------------------------------------------------


def of_mounts(model: StructuralModel, names: Names, middle: float) -> Iterator[Composition]:
    """Springs in series with dampers (Maxwell elements), of single dampers and of those of one kind.

    Their magnitude is the lag of a damper on its spring, the damping constant over the stiffness. A part that damps
    more than a few motions has no ends on which it could be mounted.
    """
    dampers = [p for p in parts_of(model) if p.kind == "damping" and _has_ends(p)]
    size = 1e3 * RULES.lagging / (2 * math.pi * middle)
    for group in (*((part,) for part in dampers), *_alike(dampers)):
        own = [part.name for part in group]
        at, name = names_in_words(own), names.free(f"mount {_common(own)}")
        magnitude = Parameter(
            name, 1e-3 * size, 1e-3 * size, RULES.added_most * size, "ms", prior_sd=size,
            description="damping constant over the stiffness of the mount in series",
        )  # fmt: skip
        grid = tuple({name: float(f"{part * size:.5g}")} for part in RULES.mount_grid)
        build = MountedDampers(name, tuple(own))
        effect = _part_effect("damper mount", at, magnitude, build, grid=grid)
        yield Composition(effect, "damper mount", at, tuple(dict.fromkeys(p.place for p in group)), len(own))


def of_supports(model: StructuralModel, names: Names) -> Iterator[Composition]:
    """Flexibilities in series with supports whose position parameters select, of single ones and of all alike."""
    supports = [t for t in model.stiffness.selected if isinstance(t.coefficient, Monomial)]
    values = model.space.si(model.space.values)
    for group in (*((term,) for term in supports), *_alike(supports)):
        own = [term.name for term in group]
        at, name = names_in_words([text.replace("_", " ") for text in own]), names.free(f"soft {_common(own)}")
        size = RULES.soft * 1e9 / max(float(term.coefficient(values)) for term in group)
        magnitude = Parameter(
            name,
            0.0,
            0.0,
            RULES.added_most * size,
            "mm/MN",
            prior_sd=size,
            description=f"flexibility in series with {at}",
        )
        effect = _part_effect("soft support", at, magnitude, SoftSupports(name, tuple(own)))
        places = [place for term in group for place in _acting(model, term, values)]
        yield Composition(effect, "soft support", at, tuple(dict.fromkeys(places)), len(own))


def of_rigid_joints(
    model: StructuralModel, sensors: Sequence[Sensor], values: Mapping[str, float], names: Names, middle: float
) -> Iterator[Composition]:
    """Flexibilities in series with supports and with ends of beams that matrices hold without naming them.

    Of each in every direction that it resists; of many beams the ends nearest to `sensors`, which have places. The
    plausible size is `RULES.relative` over the dynamic stiffness of the rest against that motion at the middle of the
    measured band. A model that names its parts names these as well.
    """
    found: list[tuple[str, RigidJoint]] = []
    if not model.parts:
        found += [("soft support", one) for one in supports(model, values)]
        ends = sorted(member_ends(model, values), key=lambda one: _away(one.place, sensors))
        found += [("soft joint", one) for one in ends[: RULES.beam_ends]]
    if not found:
        return
    factor = dynamic_factor(model, values, middle)
    for kind, joint in found:
        nodes = [str(model.labels[n] if model.labels else n + 1) for n in joint.nodes]
        where, places = f"the support near node {nodes[0]}", [joint.place]
        if kind == "soft joint":
            where, (x, y, z) = f"node {nodes[0]} towards node {nodes[1]}", model.mesh.points[joint.nodes[1]].tolist()
            places.append((x, y, z))
        label, relative = " ".join(nodes[: len(places)]), list[float]()
        for direction in joint.directions:
            b, k = joint.forces[:, direction], float(joint.stiffness[direction])
            size = RULES.relative / max(k - float(b @ factor.solve(b)), 1e-9 * k)
            relative.append(size * k)
            turns, axis = direction >= 3, "xyz"[direction % 3]
            unit, size = ("rad/kNm", 1e3 * size) if turns else ("mm/MN", 1e9 * size)
            name = names.free(f"{kind} {label} {'r' * turns}{axis}")
            at = f"{where}, {'about' if turns else 'in'} {axis}"
            yield _soft_joint(kind, at, name, unit, size, SoftJoint(name, tuple(places), direction))
        if kind == "soft support" and len(relative) > 1:
            name = names.free(f"{kind} {label}")
            at = f"{where}, in all directions"
            yield _soft_joint(kind, at, name, "-", min(relative), SoftJoint(name, tuple(places), None))


def _away(place: Point, sensors: Sequence[Sensor]) -> float:
    """Distance from the nearest sensor, m."""
    return min((math.dist(place, s.point) for s in sensors if s.point is not None), default=0.0)


def _soft_joint(kind: str, at: str, name: str, unit: str, size: float, build: SoftJoint) -> Composition:
    words = f"flexibility in series with {at}" + (", over its own" if unit == "-" else "")
    magnitude = Parameter(name, 0.0, 0.0, RULES.added_most * size, unit, prior_sd=size, description=words)
    return Composition(_part_effect(kind, at, magnitude, build), kind, at, build.places[:1])


def _acting(
    model: StructuralModel, term: SelectedTerm, values: Mapping[str, float]
) -> list[tuple[float, float, float]]:
    b = sp.csr_array(term.vectors[term.choice(values)][None])
    return middles(model, model.dofs.node[np.unique(b.indices)], sp.csr_array(b.T @ b))


def of_joints(
    model: StructuralModel, values: Mapping[str, float], names: Names, middle: float
) -> Iterator[Composition]:
    """Rotational springs about each axis between bodies that a spring joins, of single joints and of those of one kind.

    Springs of the same bodies near each other are one joint. Plausible sizes as for springs at sensors, see
    `calib.structure.effects.point_compositions.of_sensors`.
    """
    if not np.all(np.isfinite(model.mesh.points)):
        return
    factor = dynamic_factor(model, values, middle)
    joints = _joints(model)
    for direction in (3, 4, 5):
        rows = {part.name: relative_rotation(model, part, direction) for part in joints}
        local = {name: RULES.local / float(row @ factor.solve(row)) for name, row in rows.items() if row is not None}
        single = [part for part in joints if part.name in local]
        for group in (*((part,) for part in single), *_alike(single)):
            own = [part.name for part in group]
            at, axis = names_in_words(own), "xyz"[direction - 3]
            name, size = names.free(f"rotation {axis} {_common(own)}"), max(local[n] for n in own)
            magnitude = Parameter(
                name,
                0.0,
                0.0,
                RULES.added_most * size,
                "Nm/rad",
                prior_sd=size,
                description=f"stiffness about {axis} of each joint",
            )
            build = RotationalSprings(name, tuple(own), direction)
            effect = _part_effect("rotational spring", f"{at}, about {axis}", magnitude, build)
            places = tuple(dict.fromkeys(part.place for part in group))
            yield Composition(effect, "rotational spring", f"{at}, about {axis}", places, len(own))


def _joints(model: StructuralModel) -> list[Part]:
    """One spring for each joint of bodies."""
    near = RULES.same_joint * float(np.ptp(model.mesh.points, axis=0).max(initial=0.0))
    out: list[tuple[tuple[int, ...], Part]] = []
    for part in parts_of(model):
        bodies = tuple(sorted(joined_nodes(model, part))) if part.kind == "stiffness" else ()
        if bodies and not any(own == bodies and math.dist(one.place, part.place) <= near for own, one in out):
            out.append((bodies, part))
    return [part for _, part in out]


def _has_ends(damper: Part) -> bool:
    """Whether a part damps few motions, of few degrees of freedom."""
    if not 0 < len(np.unique(sp.csr_array(damper.matrix).indices)) <= ENDS:
        return False
    try:
        return 0 < elongations(damper).shape[0] <= _FEW
    except InputError:  # no damper: its damping is negative
        return False


# -- functions ---------------------------------------------------------------------------------------------------------


def of_function(parts: Sequence[ScaledPart], names: Names) -> Iterator[Composition]:
    """Changes of the parts that a function scales itself."""
    for part in parts:
        name = names.free(f"{part.kind} {part.name}")
        magnitude = Parameter(
            name,
            0.0,
            LEAST[part.kind],
            RULES.more,
            "-",
            prior_sd=RULES.relative,
            description=f"relative change of {part.name}",
        )
        build = ScaledByFunction(name, part.parameter)
        yield Composition(_part_effect(part.kind, part.name, magnitude, build), part.kind, part.name)
