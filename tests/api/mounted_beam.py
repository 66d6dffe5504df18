"""A beam on two rubber mounts: the fitted model of 12 elements, and synthetic tests of another one of 30.

The beam of the tests has matrices and an eigenproblem of its own, with mounts of any complex stiffness.
"""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.linalg as la

import calib
from calib.structure.affine import parameter
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition

LENGTH, STIFFNESS, LINE = 4.0, 1.26e6, 100.0
MOUNT, DAMPER, PROPORTIONAL = 500.0, 0.9, 2e-5
"""kN/m and kNs/m of a mount; s, damping over stiffness of the beam."""
REPEATS, NOISE_FREQ, NOISE_DAMPING, NOISE_SHAPE = 5, 0.003, 0.08, 0.02
FITTED, ELEMENTS, SENSORS, MODES = 12, 30, 7, 5
TRUE = {"EI": 1.04, "line": 0.98, "k_left": 1.08, "k_right": 0.95, "c_mount": 1.1}
"""Over the nominal values."""


def beam(elements):
    """Stiffness and consistent mass of the free beam over deflection and slope of each node (Euler and Bernoulli)."""
    h, n = LENGTH / elements, 2 * elements + 2
    k = np.array([[12, 6 * h, -12, 6 * h], [0, 4 * h**2, -6 * h, 2 * h**2], [0, 0, 12, -6 * h], [0, 0, 0, 4 * h**2]])
    m = np.array(
        [[156, 22 * h, 54, -13 * h], [0, 4 * h**2, 13 * h, -3 * h**2], [0, 0, 156, -22 * h], [0, 0, 0, 4 * h**2]]
    )
    stiffness, mass = np.zeros((n, n)), np.zeros((n, n))
    for e in range(elements):
        at = slice(2 * e, 2 * e + 4)
        stiffness[at, at] += STIFFNESS / h**3 * (k + np.triu(k, 1).T)
        mass[at, at] += LINE * h / 420 * (m + np.triu(m, 1).T)
    return stiffness, mass


def ends(n):
    """Springs of 1 N/m at the left and the right end."""
    left, right = np.zeros((n, n)), np.zeros((n, n))
    left[0, 0] = right[-2, -2] = 1.0
    return left, right


def model():
    """The fitted beam, with a stiffness for each mount and one damping constant for both."""
    stiffness, mass = beam(FITTED)
    left, right = ends(len(mass))
    dofs = pd.DataFrame([(k, d) for k in range(FITTED + 1) for d in ("z", "ry")], columns=["node", "direction"])
    dofs = dofs.assign(x=dofs["node"] * LENGTH / FITTED, y=0.0, z=0.0)
    parameters = [
        calib.Parameter("EI", 1.0, 0.6, 1.6, prior_sd=0.1),
        calib.Parameter("line", 1.0, 0.7, 1.4, prior_sd=0.05),
        calib.Parameter("k_left", MOUNT, 200.0, 1200.0, "kN/m", prior_sd=75.0),
        calib.Parameter("k_right", MOUNT, 200.0, 1200.0, "kN/m", prior_sd=75.0),
        calib.Parameter("c_mount", DAMPER, 0.1, 5.0, "kNs/m", prior_sd=0.4),
    ]
    return calib.StructuralModel.from_matrices(
        {"EI": stiffness, "k_left": left, "k_right": right}, {"line": mass},
        {"c_mount": left + right, "beam": (PROPORTIONAL * stiffness, "EI")},
        dofs=dofs, parameters=parameters, name="beam on mounts",
    )  # fmt: skip


def solved(left=lambda lam: 1.0, right=None, **factors):
    """Eigenvalues and shapes at the sensors, (n_sensors, n_modes), of the other beam.

    A mount's stiffness is its true one times a function of lambda: each eigenvalue is found as that of the matrices at
    itself, mode by mode, so that complex stiffness needs no further states.
    """
    factor, right = {**TRUE, **factors}, left if right is None else right
    stiffness, mass = beam(ELEMENTS)
    stiffness, mass = factor["EI"] * stiffness, factor["line"] * mass
    one, other = (
        1e3 * MOUNT * factor[f"k_{end}"] * spring
        for end, spring in zip(("left", "right"), ends(len(mass)), strict=True)
    )
    damping = 1e3 * DAMPER * factor["c_mount"] * sum(ends(len(mass))) + PROPORTIONAL * stiffness
    squares, real = la.eigh(stiffness + one + other, mass)
    lambdas, modes = np.zeros(MODES, complex), np.zeros((len(mass), MODES), complex)
    basis = real[:, :40]  # undamped modes: the local mounts change them little
    k0, c, m = (basis.T @ a @ basis for a in (stiffness, damping, mass))
    k1, k2 = basis.T @ one @ basis, basis.T @ other @ basis
    for j, lam in enumerate(1j * np.sqrt(squares[:MODES])):
        for _ in range(100):
            k = k0 + left(lam) * k1 + right(lam) * k2
            state = np.block([[np.zeros_like(m), np.eye(len(m))], [-la.solve(m, k), -la.solve(m, c)]])
            values, vectors = la.eig(state)
            near = int(np.argmin(abs(values - lam)))
            before, lam = lam, values[near]
            if abs(lam - before) < 1e-10 * abs(lam):
                break
        lambdas[j], modes[:, j] = lam, basis @ vectors[: len(m), near]
    at = np.linspace(0, ELEMENTS, SENSORS).round().astype(int)
    seen = modes[2 * at]
    return lambdas, seen / seen[abs(seen).argmax(axis=0), range(MODES)]


def tested(folder, seed, left=lambda lam: 1.0, right=None, along=0.0, scatter=0.0, noise=NOISE_SHAPE, **factors):
    """Synthetic modes of the other beam, five repeats, written to tables of a new folder and read from there.

    Errors of the shapes that all repeats have in common: ``along`` is the share by which the amplitudes of the first
    modes grow or fall along the beam, ``scatter`` a standard deviation. ``noise`` is that of one repeat.
    """
    lambdas, shapes = solved(left, right, **factors)
    rng = np.random.default_rng(seed)
    if along:  # by another share in every mode: no gain of a channel is behind it
        signs = np.array([1, -1, 0.5, 0, 0])[:MODES]
        shapes = shapes * (1 + along * np.linspace(-1, 1, SENSORS)[:, None] * signs)
    if scatter:
        shapes = shapes + scatter * rng.standard_normal(shapes.shape)
    freq, ratio = abs(lambdas) / (2 * np.pi), -lambdas.real / abs(lambdas)
    poles, entries = ["mode,freq,freq_kind,damping,repeat"], ["mode,node,direction,re,im,repeat"]
    for r in range(REPEATS):
        f = freq * (1 + NOISE_FREQ * rng.standard_normal(MODES))
        z = ratio * (1 + NOISE_DAMPING * rng.standard_normal(MODES))
        found = shapes + noise * (rng.standard_normal(shapes.shape) + 1j * rng.standard_normal(shapes.shape))
        poles += [f"M{k + 1},{f[k]:.12g},natural,{z[k]:.12g},r{r}" for k in range(MODES)]
        entries += [
            f"M{k + 1},{j + 1},z,{found[j, k].real:.12g},{found[j, k].imag:.12g},r{r}"
            for k in range(MODES) for j in range(SENSORS)
        ]  # fmt: skip
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    places = [f"{j + 1},{LENGTH * j / (SENSORS - 1):.12g},0,0" for j in range(SENSORS)]
    for name, lines in (("modes", poles), ("shapes", entries), ("sensors", ["node,x,y,z", *places])):
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return calib.read_modes(
        folder / "modes.csv", shapes=folder / "shapes.csv", sensors=folder / "sensors.csv", synthetic=True
    )


def library():
    """Effects that the fitted beam may lack beside those of its mounts."""
    sizes = [
        ("middle_mass", "mass", "kg", 20.0, 200.0, "a mass at the middle"),
        ("prop", "stiffness", "kN/m", 50.0, 500.0, "a spring under the middle"),
        ("hose", "damping", "kNs/m", 0.3, 5.0, "a damper at the middle"),
        ("stop", "stiffness", "kN/m", 50.0, 500.0, "a spring at a third"),
    ]
    return tuple(
        calib.Effect(
            name, name, "It is not there.", "Look for it.", calib.Parameter(name, 0.0, 0.0, most, unit, prior_sd=sd),
            partial(_at, name=name, kind=kind, node=FITTED // (3 if name == "stop" else 2)), phrase=words,
        )
        for name, kind, unit, sd, most, words in sizes
    )  # fmt: skip


def _at(model, name, kind, node):
    row = np.zeros(model.n_dof)
    row[2 * node] = 1.0
    return Addition(**{kind: (outer_term(name, [row], parameter(name)),)})
