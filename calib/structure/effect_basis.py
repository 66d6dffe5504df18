"""A reduced basis that also holds what effects and local changes do to the modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.effect import Effect
from calib.space import ParameterSpace
from calib.structure.basis import Basis
from calib.structure.cover import covering_points
from calib.structure.derivatives import mode_derivatives
from calib.structure.extend import extend
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.training import Growth

_POINTS = 2
"""Points of the space, beside its middle, at which effects are looked at."""
_STRONG = 2.0
"""Effects are represented up to this multiple of their plausible strength."""
_ERROR = 3e-5
"""Squared projection error of every vector, over the strain energy of its mode."""
_BATCH = 20
"""Atoms taken together: the principal directions of all of them at once would cost far more and save few vectors."""
_TOGETHER = 80
"""Atoms whose derivatives are solved with the same factors: more would fill the memory."""


def effect_basis(
    model: StructuralModel,
    basis: Basis,
    space: ParameterSpace,
    effects: Sequence[Effect],
    atoms: Sequence[Effect],
    seed: int,
) -> Basis:
    """The next version of a basis, which represents modes with effects and the derivatives by atoms.

    Added are the principal directions of: shapes of the model with each effect, at its plausible and at twice its
    plausible strength or at all points of its grid, at a few points of the space; and derivatives of the shapes by
    every atom, times its plausible strength, at the middle.

    Parameters
    ----------
    model : StructuralModel
        The base model, for which ``basis`` was trained.
    basis : Basis
    space : ParameterSpace
        Where effects are looked at: its middle and a few points.
    effects, atoms : sequence of Effect
        Modes are solved for each of the first, derivatives taken for each of the second.
    seed : int
    """
    growth = Growth(model, basis)
    middle = {p.name: p.value for p in space.parameters}
    points = [middle, *covering_points(space, _POINTS, np.random.default_rng(seed))[:_POINTS]]
    vectors = basis.vectors
    for effect in effects:
        extended = extend(model, [effect])
        count = basis.count + extended.n_dof - model.n_dof
        solved = [extended.modes({**point, **own}, count) for point in points for own in _looked_at(effect)]
        vectors = growth.widened(vectors, np.hstack([_unit(growth, m, model.n_dof, basis) for m in solved]), _ERROR)
    adopted = model.modes(middle, basis.count)
    for first in range(0, len(atoms), _TOGETHER):
        some = atoms[first : first + _TOGETHER]
        slopes = _derivatives(growth, extend(model, some), middle, adopted, some, basis)
        for k in range(0, len(slopes), _BATCH):
            vectors = growth.widened(vectors, np.hstack(slopes[k : k + _BATCH]), _ERROR)
    return replace(basis, vectors=vectors, version=basis.version + 1)


def _looked_at(effect: Effect) -> Iterator[Mapping[str, float]]:
    """Strengths and nuisance values at which modes are solved."""
    if effect.grid:
        yield from effect.grid
        return
    for factor in (1.0, _STRONG) + ((-1.0,) if effect.signed else ()):
        strength = min(max(factor * effect.plausible, effect.strength.lower), effect.strength.upper)
        yield {effect.name: strength}


def _unit(growth: Growth, modes: Modes, rows: int, basis: Basis) -> np.ndarray:
    """Shapes at the model's own degrees of freedom, each of unit energy or, where it hardly moves them, of less."""
    shapes = modes.shapes[:rows, modes.natural_freq <= basis.freq_max]
    energy = np.einsum("ij,ij->j", shapes.conj(), growth.matrix @ shapes).real
    moving = energy > 1e-6 * energy.max(initial=0.0)
    kept = shapes[:, moving] / np.sqrt(energy[moving])
    return np.hstack([kept.real, kept.imag]) if modes.is_complex else kept


def _derivatives(
    growth: Growth,
    model: StructuralModel,
    point: Mapping[str, float],
    modes: Modes,
    atoms: Sequence[Effect],
    basis: Basis,
) -> list[np.ndarray]:
    """Derivatives of a model's modes by each atom, (n_dof, m) with real and imaginary parts.

    Atoms add no degrees of freedom and are of strength 0 there.
    """
    chosen = np.flatnonzero(modes.natural_freq <= basis.freq_max)
    slopes = mode_derivatives(model, point, modes, [a.name for a in atoms], chosen)
    shapes = modes.shapes[:, chosen]
    size = np.sqrt(np.einsum("ij,ij->j", shapes.conj(), growth.matrix @ shapes).real)
    usable = slopes.regular & (modes.damping_ratio[chosen] < basis.damping_max)
    columns = [a.plausible * slopes.shapes[q][:, usable] / size[usable] for q, a in enumerate(atoms)]
    return [np.hstack([c.real, c.imag]) if np.iscomplexobj(c) else c for c in columns]
