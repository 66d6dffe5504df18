"""Models to update by cross-model equations, and what is measured of structures that differ from them.

The solar array with other Young's moduli, and a chain of five masses of which stiffness, mass or damping changes.
"""

from functools import partial

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.inference.cmcf_equations import Change, CmcfSettings, InitialModel, MeasuredReceptance
from calib.structure.reduction.static_reduction import static_reduction
from models.solar_panel import GROUPS, MASTERS, solar_panel

SYMMETRIC = np.array([0.2, 0.2, 0.3, 0.3, 0.5, 0.5])
"""Relative changes of the Young's moduli, as in the article: the array stays symmetric."""
ASYMMETRIC = np.array([0.2, 0.1, 0.3, 0.05, 0.5, 0.25])
LEVEL = 4
ALL_STEPS = CmcfSettings(tolerance=0.0)


def transformation(masters, level, stiffness, mass):
    return static_reduction(stiffness, mass, masters, level).transformation


class Array:
    """The solar array as an initial model, and the structure with other Young's moduli that is measured."""

    def __init__(self):
        model = solar_panel()
        self.k, _, self.m = model.matrices({})
        nodes = zip(model.dofs.node, model.dofs.direction, strict=True)
        self.masters = np.array([k for k, (node, d) in enumerate(nodes) if node + 1 in MASTERS and d == 2])
        own = [model.matrix_derivatives({}, g)[0] * model.space[g].value for g in GROUPS]
        self.changes = tuple(Change(g, "stiffness", sp.csc_array(k)) for g, k in zip(GROUPS, own, strict=True))
        self.reduce = partial(transformation, self.masters, LEVEL)
        self.initial = InitialModel(self.k, self.m, self.changes, self.masters, self.reduce)
        self.whole = InitialModel(self.k, self.m, self.changes, np.arange(self.k.shape[0]))

    def stiffness(self, alpha):
        return sp.csc_array(self.k + sum(a * c.matrix for a, c in zip(alpha, self.changes, strict=True)))

    def freq(self, alpha, count=4):
        eigenvalues = la.eigh(self.stiffness(alpha).toarray(), self.m.toarray(), eigvals_only=True)
        return np.sqrt(eigenvalues[:count]) / (2 * np.pi)

    def receptance(self, alpha, freq):
        k, m = self.stiffness(alpha).toarray(), self.m.toarray()
        return np.array([la.inv(k - (2 * np.pi * f) ** 2 * m) for f in freq])

    def measured(self, alpha, offset):
        """What a test measures: the masters' partition of the whole receptance."""
        freq = self.freq(alpha) * (1 + offset)
        here = np.ix_(range(len(freq)), self.masters, self.masters)
        return MeasuredReceptance(freq, self.receptance(alpha, freq)[here], np.arange(12))

    def consistent(self, alpha, offset):
        """The receptance of the measured structure reduced to the masters, which has no modes beyond them."""
        freq = self.freq(alpha) * (1 + offset)
        k, t = self.stiffness(alpha), self.reduce(self.stiffness(alpha), self.m)
        found = [la.inv(t.T @ (k - (2 * np.pi * f) ** 2 * self.m) @ t) for f in freq]
        return MeasuredReceptance(freq, np.array(found), np.arange(12))

    def noisy(self, alpha, seed, offset=0.02):
        """5 % noise of the receptance, and frequencies tagged 3 % wrong; both uniform."""
        rng, true = np.random.default_rng(seed), self.measured(alpha, offset)
        receptance = true.receptance * (1 + 0.05 * rng.uniform(-1, 1, true.receptance.shape))
        return MeasuredReceptance(true.freq * (1 + 0.03 * rng.uniform(-1, 1, 4)), receptance, true.references)


def damped(kind):
    """A chain of five masses whose stiffness, mass or damping changes, and its receptance at its own resonances."""
    n = 5
    links = [np.zeros((n, n)) for _ in range(n)]
    for i, link in enumerate(links):
        b = np.eye(n)[i] - (np.eye(n)[i - 1] if i else 0)
        link += 1e4 * np.outer(b, b)
    masses = [np.diag(np.eye(n)[i]) for i in range(n)]
    k, m = sum(links), sum(masses)
    changes = [Change(f"k{i}", "stiffness", sp.csc_array(link)) for i, link in enumerate(links)]
    truth = [0.1, -0.1, 0.2, 0.0, 0.3]
    z = {
        "stiffness": k + sum(a * link for a, link in zip(truth, links, strict=True)),
        "mass": m,
        "loss": 0 * k,
        "c": 0 * k,
    }
    if kind == "mass":
        changes += [Change("m3", "mass", sp.csc_array(masses[3]))]
        truth += [0.25]
        z["mass"] = m + 0.25 * masses[3]
    if kind == "structural":
        changes += [Change(f"d{i}", "structural", sp.csc_array(links[i])) for i in (0, 2)]
        truth += [0.01, 0.03]
        z["loss"] = 0.01 * links[0] + 0.03 * links[2]
    if kind == "viscous":
        changes += [Change("c2", "viscous", sp.csc_array(links[2]))]
        truth += [1e-4]
        z["c"] = 1e-4 * links[2]
    omega = np.sqrt(la.eigh(z["stiffness"], z["mass"], eigvals_only=True)[:4])
    omega = omega * (1.01 if kind == "mass" else 1.0)
    dynamic = [z["stiffness"] + 1j * w * z["c"] + 1j * z["loss"] - w**2 * z["mass"] for w in omega]
    receptance = np.array([la.inv(d) for d in dynamic])
    model = InitialModel(sp.csc_array(k), sp.csc_array(m), tuple(changes), np.arange(n))
    real = receptance.real if kind == "mass" else receptance
    return model, MeasuredReceptance(omega / (2 * np.pi), real, np.arange(n)), np.array(truth)
