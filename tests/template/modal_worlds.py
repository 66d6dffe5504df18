"""FRFs of damped structures by hand, and the poles and residues of these: synthetic measurements of known modes.

Functions are inverses of dynamic stiffness matrices, poles and shapes eigenvectors of state matrices; no line of the
code that identifies modes is used.
"""

import numpy as np

from calib.measurement.frf_repeats import FRFRepeat, combine_frfs

PAIR_FREQ = np.linspace(5.0, 25.0, 201)
CENTRE = (2 * np.pi * 14) ** 2
"""1/s^2, of the pair's two masses of 1 kg."""


def roots(k, c, m):
    """Poles (n,), rad/s, ascending, and shapes (n_dof, n) of ``K + s C + s^2 M``."""
    n = len(k)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
    found, vectors = np.linalg.eig(state)
    order = np.flatnonzero(found.imag > 0)
    order = order[np.argsort(np.abs(found[order]))]
    return found[order], vectors[:n, order]


def freq_and_damping(poles):
    return np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)


def residues(k, c, m):
    """Residues of the receptances at each pole, (n, n_dof, n_dof): shapes over ``phi^T (2 s M + C) phi``."""
    poles, shapes = roots(k, c, m)
    return np.array([
        np.outer(phi, phi) / (phi @ (2 * s * m + c) @ phi) for s, phi in zip(poles, shapes.T, strict=True)
    ])  # fmt: skip


def receptances(k, c, m, freq):
    """(n_freq, n_dof, n_dof)."""
    return np.array([np.linalg.inv(k + 1j * w * c - w**2 * m) for w in 2 * np.pi * freq])


def heavy_pair(gap, ratio=0.065):
    """Two masses of nearly the same frequency, heavily damped and weakly coupled, beside a lightly damped third.

    Returns K, C, M in N/m, Ns/m and kg.
    """
    k = np.diag([CENTRE * (1 - gap), CENTRE * (1 + gap), 2 * CENTRE])
    for one, other in ((0, 1), (1, 2)):
        between = np.eye(3)[one] - np.eye(3)[other]
        k = k + 0.02 * CENTRE * np.outer(between, between)
    return k, 2 * ratio * np.sqrt(CENTRE) * np.diag([1.0, 1.1, 0.1]), np.eye(3)


def noisy(values, freq, share, seed, count, floor=1e-4, quantity="accelerance"):
    """Repeats of functions (n_freq, n_responses, n_references) with noise in proportion and a floor, along x."""
    rng = np.random.default_rng(seed)
    size = np.hypot(share * np.abs(values), floor)
    out = []
    for n in range(count):
        seen = values + size * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
        pairs = {
            ((i + 1, "x"), (j + 1, "x")): seen[:, i, j]
            for i in range(values.shape[1]) for j in range(values.shape[2])
        }  # fmt: skip
        out.append(FRFRepeat(f"repeat {n}", freq, quantity, pairs))
    return out


def with_mean(repeats):
    """Arguments of `modes_from_frfs`: the mean, and each repeat."""
    return combine_frfs(repeats, synthetic=True), [combine_frfs([one], synthetic=True) for one in repeats]


def pair_test(gap, share, seed=0, count=4):
    """Accelerances of `heavy_pair` at its three masses under forces on the two damped ones."""
    whole = receptances(*heavy_pair(gap), PAIR_FREQ)[:, :, :2] * -((2 * np.pi * PAIR_FREQ) ** 2)[:, None, None]
    return with_mean(noisy(whole, PAIR_FREQ, share, seed, count))
