"""Modes of a model on its mesh and on a finer one, as partners of the same measured modes."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.rules import RULES
from calib.measurement.mac import mac


class BothMeshes(NamedTuple):
    """Comparisons of both meshes with one measurement, at the point of their `MeshError`.

    Attributes
    ----------
    here, there : Comparison
        Of the fitted mesh and of the finer one, with the same pairs.
    lost : frozenset of str
        Measured modes whose partner the finer mesh lacks.
    """

    here: Comparison
    there: Comparison
    lost: frozenset[str]


def both_meshes(problem: ModalProblem) -> BothMeshes:
    """Comparisons of both meshes of the problem's `MeshError`.

    Partners on the finer mesh are the modes that are those of the fitted mesh by MAC at the sensors; without shapes
    they are paired as those of any model.
    """
    mesh = problem.mesh
    assert mesh is not None
    exact = replace(problem, model=mesh.coarse, mesh=None, base=None)
    coarse, finer = mesh.modes(problem.mode_count)
    here = exact.compare(mesh.own(mesh.coarse), coarse)
    there = replace(exact, model=mesh.finer).compare(mesh.own(mesh.finer), finer)
    return _matched(here, there) if problem.measured.has_shapes else BothMeshes(here, there, frozenset())


def _matched(here: Comparison, there: Comparison) -> BothMeshes:
    """The same with the partners of the fitted mesh.

    Modes of nearly the same frequency are turned into each other by any small change: what counts as the finer one is
    the part of the mode that such a group of modes forms.
    """
    pairs, freq, shapes = here.pairing, there.modes.natural_freq, there.sensor_shapes
    coarse = here.sensor_shapes[:, pairs.model_index[pairs.paired]]
    similar = mac(coarse, shapes)
    whole, parts = similar.copy(), np.repeat(shapes[None], len(similar), axis=0)
    for j, f in enumerate(freq):
        group = np.flatnonzero(np.abs(freq - f) <= RULES.mesh_near * f)
        if len(group) > 1:
            part = shapes[:, group] @ np.linalg.lstsq(shapes[:, group], coarse, rcond=None)[0]
            parts[:, :, j], whole[:, j] = part.T, np.diag(mac(coarse, part))
    own, which = linear_sum_assignment(-(whole + similar))  # of equal ones the mode that is less turned
    names = [here.measured.names[i] for i in pairs.paired[own]]
    lost = frozenset(n for n, i, j in zip(names, own, which, strict=True) if whole[i, j] < RULES.mesh_mac)
    index, turned = np.full(len(pairs.model_index), -1), shapes.copy()
    index[pairs.paired[own]] = which
    turned[:, which] = parts[own, :, which].T
    there = replace(there, pairing=replace(pairs, model_index=index), sensor_shapes=turned)
    return BothMeshes(here, there, lost)
