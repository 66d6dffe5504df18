"""Effects of a study's libraries, looked at before any solve: each can be built, and its name stands for one effect."""

from __future__ import annotations

from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.study.loading import with_effects
from calib.study.several import AnyStudy


def require_usable(study: AnyStudy, composed: bool = True) -> None:
    """InputError where an effect that a model may lack cannot be built, or two models have different ones of a name.

    Those that are ``composed`` of the models' own parts, which can be hundreds, are left out on request.
    """
    known, place = dict[str, Effect](), str(study.file)
    for one in study.studies:
        model, effects = one.model, [effect for effect in one.candidates if composed or not effect.generic]
        every = [member for simplest in effects for member in simplest.family]
        try:
            with_effects(model, effects, place)  # hundreds at once
            of_family = (member for simplest in effects for member in simplest.family if member is not simplest)
            alone = [member for member in of_family if not member.generic]  # these are made to fit
        except InputError:
            alone = every  # to tell which one does not fit
        for effect in alone:
            with_effects(model, [effect], place)
        for effect in every:
            other = known.setdefault(effect.name, effect)
            if other.parameters != effect.parameters:
                raise InputError(
                    f"two models have different effects {effect.name!r}", place=place,
                    remedy="give one of them another name, or both the same parameters",
                )  # fmt: skip
