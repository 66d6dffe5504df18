"""An effect whose parameters a model's function reads itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calib import Effect, FunctionModel, ModalFunctionModel, Parameter


def function_effect(
    name: str,
    title: str,
    phrase: str,
    lacks: str,
    look_for: str,
    upper: float,
    unit: str,
    plausible: float,
    nuisance: tuple[Parameter, ...] = (),
    grid: Sequence[Mapping[str, float]] = (),
) -> Effect:
    """An effect of positive magnitude; the function reads its parameters where they are given, and takes 0 else.

    Parameters
    ----------
    name, title, phrase, lacks, look_for
        See `calib.problem.effect.Effect`.
    upper, plausible : float
        Limit, and a large but plausible magnitude, in ``unit``.
    unit : str
    nuisance, grid
        See `calib.problem.effect.Effect`.
    """
    magnitude = Parameter(name, 0.0, 0.0, upper, unit, prior_sd=plausible)
    return Effect(name, title, lacks, look_for, magnitude, _known, nuisance, tuple(grid), phrase=phrase)


def _known(model: FunctionModel | ModalFunctionModel) -> None:
    """Nothing to build."""
