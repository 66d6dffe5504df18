"""Parts whose stiffness or damping depends on the level of excitation, for tests of one structure at several levels.

Rubber softens with amplitude (Payne 1962), and joints slip: a modal test at one level sees an equivalent linear part.
Of two tests at different levels the part differs, everything else is shared. The level is a condition of each test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import get_args

from calib.errors.arguments import parts_once
from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import Monomial, Term
from calib.structure.effects.attach import part_of
from calib.structure.effects.extend import Addition
from calib.structure.model import PartKind, StructuralModel

_LEFT = 0.05
"""Least stiffness or damping over that at level 0, at the largest magnitude and level."""


def level(largest: float, name: str = "level") -> Parameter:
    """Level of excitation as a parameter that tests set: 0 where parts are as in the model, and in no unit.

    Parameters
    ----------
    largest : float
        Largest level of any test. With levels relative to the lower of two tests, less 1, tests of 1 mm and 4 mm have
        levels 0 and 3; on a logarithmic scale to base 2, 0 and 2.
    name : str

    Raises
    ------
    InputError
        When the largest level is not positive.

    Examples
    --------
    >>> from calib.structure.amplitude import level
    >>> level(2.0).distribution
    'fixed'
    """
    if not 0 < largest < math.inf:
        raise InputError(f"the largest level is {largest:g}", place=f"level {name!r}", remedy="give a positive number")
    words = "level of excitation of a test; 0 where parts are as in the model"
    return Parameter(name, 0.0, 0.0, largest, "-", "fixed", description=words)


def with_level(model: StructuralModel, at: Parameter) -> StructuralModel:
    """A model with a parameter on which nothing depends, until it has an effect of `amplitude_dependence`.

    A test sets it: ``condition={"level": 1.0}`` of `calib.ModalTest`, ``set = { level = 1.0 }`` in a study.

    Parameters
    ----------
    model : StructuralModel
    at : Parameter
        Of `level`.

    Raises
    ------
    InputError
        When the model has a parameter of that name.
    """
    if at.name in model.space:
        raise InputError(
            f"the model {model.name} has {at.name!r} already", place="level", remedy="give the level another name"
        )
    return replace(model, space=ParameterSpace((*model.space.parameters, at), model.space.constraints))


def amplitude_terms(
    model: StructuralModel, parts: Sequence[str], kind: PartKind, magnitude: Parameter, at: str
) -> Addition:  # fmt: skip
    """Parts times ``1 - x s`` with the level s of a test.

    Parameters
    ----------
    model : StructuralModel
        With the level, see `with_level`.
    parts : sequence of str
        Names of parts of that kind, or of terms where a model has no parts.
    kind : {"stiffness", "damping"}
    magnitude : Parameter
        Of x.
    at : str
        Name of the parameter s.

    Raises
    ------
    InputError
        For an unknown part, a model without the level, or one whose largest level leaves nothing of the parts.
    """
    if at not in model.space:
        raise InputError(
            f"the model {model.name} has no parameter {at!r}, the level of a test",
            remedy="add the level to the model, see calib.structure.amplitude",
        )
    if magnitude.upper * model.space[at].upper >= 1:
        raise InputError(
            f"at the largest level of {model.name}, {model.space[at].upper:g}, nothing would be left of its parts",
            remedy="give the effect the level that the model has",
        )  # fmt: skip
    terms = []
    for part in (part_of(model, kind, name) for name in parts):
        powers = (*part.coefficient.powers, (magnitude.name, 1.0), (at, 1.0))
        lost = Monomial(-part.coefficient.factor, powers)
        terms.append(Term(f"{magnitude.name}: {part.name}", part.matrix, lost, part.name))
    return Addition(stiffness=tuple(terms)) if kind == "stiffness" else Addition(damping=tuple(terms))


def amplitude_dependence(
    name: str, of: str, parts: Sequence[str], at: Parameter, kind: PartKind = "stiffness", plausible: float = 0.1
) -> Effect:  # fmt: skip
    """The effect that parts soften, or lose damping, with the level of the test.

    Its magnitude is the share of the stiffness or damping that they lose per unit of the level; negative where they
    gain, as a damper does of dry friction or a gap that closes. A single test, or several at one level, cannot show it:
    the change is then that of the parts' own parameters.

    Parameters
    ----------
    name : str
        Of the effect and its magnitude.
    of : str
        The parts in words, such as ``the primary springs``.
    parts : sequence of str
        Their names in the model.
    at : Parameter
        The level, of `level`, which the model must have; see `with_level`.
    kind : {"stiffness", "damping"}
    plausible : float
        Large but plausible magnitude: with levels 0 and 1, a share of the stiffness.

    Raises
    ------
    InputError
        When the level is not one of `level`, or the plausible size leaves nothing of the parts at the largest level.

    Examples
    --------
    >>> from calib.structure.amplitude import amplitude_dependence, level
    >>> at = level(2.0)
    >>> effect = amplitude_dependence("softening", "the rubber blocks", ["blocks"], at)
    >>> effect.in_words, effect.magnitude.upper
    ('a stiffness of the rubber blocks that depends on the level of the test', 0.475)
    """
    place = f"effect {name}"
    if kind not in get_args(PartKind)[:2]:
        raise InputError(f"its kind is {kind!r}", place=place, remedy="give 'stiffness' or 'damping'")
    if at.unit != "-" or at.upper <= 0 or at.lower < 0:
        raise InputError(
            f"its level {at.name!r} reaches from {at.lower:g} to {at.upper:g} {at.unit}", place=place,
            remedy="make it by calib.structure.amplitude.level",
        )  # fmt: skip
    listed = parts_once(parts, name, kind)
    most = (1 - _LEFT) / at.upper
    if not 0 < plausible <= most:
        raise InputError(
            f"its plausible size is {plausible:g} at levels up to {at.upper:g}", place=place,
            remedy=f"give a positive number up to {most:.3g}, of which something is left at the largest level",
        )  # fmt: skip
    magnitude = Parameter(
        name, 0.0, -10 * plausible, most, "-", prior_sd=plausible,
        description=f"share of the {kind} that {of} lose from level 0 to level 1",
    )  # fmt: skip
    return Effect(
        name=name,
        title=f"{kind.capitalize()} of {of} by level of excitation",
        phrase=f"a {kind} of {of} that depends on the level of the test",
        lacks=f"The {kind} of {of} is the same at all levels of excitation.",
        look_for=f"Rubber, gaps, friction or bolted joints in {of}; frequencies that shift with the exciting force.",
        magnitude=magnitude,
        build=partial(amplitude_terms, parts=listed, kind=kind, magnitude=magnitude, at=at.name),
    )
