"""Cables that may hang on two storeys of the four-storey rig."""

import numpy as np
import scipy.sparse as sp

from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Term, parameter
from calib.structure.effects.extend import Addition


def mass_at(storey, name):
    return lambda model: Addition(mass=(Term(name, sp.csr_array(np.diag(np.eye(4)[storey])), parameter(name)),))


def library():
    return tuple(
        Effect(
            name,
            f"cables on storey {storey + 1}",
            "Weighed without cables.",
            "Cables.",
            Parameter(name, 0.0, 0.0, 0.1, "kg", prior_sd=0.02),
            mass_at(storey, name),
        )
        for storey, name in ((1, "low_cables"), (3, "top_cables"))
    )
