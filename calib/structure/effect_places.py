"""Where an effect acts on a model."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from calib.problem.effect import Effect
from calib.structure.effects.extend import addition_of
from calib.structure.model import StructuralModel
from calib.structure.places import middles

_LITTLE = 1e-9
"""Entry of a matrix, over its largest, below which a degree of freedom takes no part."""


def effect_places(model: StructuralModel, effect: Effect) -> list[tuple[float, float, float]]:
    """Middle of each connected group of nodes that the terms of an effect act on, in metres.

    A hung mass acts where it is hung; between nodes, its place is known to half an element. Nodes without coordinates
    have no place.
    """
    addition, n = addition_of(model, effect), model.n_dof
    values = model.space.si(model.space.values)
    matrices = [term.matrix for term in (*addition.stiffness, *addition.damping, *addition.mass)]
    for chosen in addition.selected:
        b = sp.csr_array(chosen.vectors[chosen.choice(values)][None])
        matrices.append(sp.csr_array(b.T @ b))
    joined = sp.csr_array((n, n))
    for matrix in matrices:
        sizes = abs(sp.csr_array(matrix))
        joins = sp.csr_array((sizes > _LITTLE * sizes.max()).astype(float))
        beside = joins[:n, n:]  # what moves with a degree of freedom of the effect's own moves together
        joined = joined + joins[:n, :n] + sp.csr_array(beside @ beside.T)
    return middles(model, model.dofs.node[np.unique(joined.indices)], joined)
