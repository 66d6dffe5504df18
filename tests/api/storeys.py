"""A chain of masses, storeys of a building, with what its model lacks; measurements are synthetic, with noise."""

import numpy as np
import pandas as pd
from scipy.linalg import eig

import calib
from calib.measurement.frf import MeasuredFRFs

FLOORS, MASS, STIFF, DAMPING = 6, 2000.0, 4e6, 4e3
HELD = ("M5",)
"""Mode that is left out of every fit."""


def spring(k, n=FLOORS):
    """Square of the drift below floor k, from 1."""
    row = np.zeros(n)
    row[k - 1] = 1.0
    if k > 1:
        row[k - 2] = -1.0
    return np.outer(row, row)


def chain(mass=MASS):
    """One stiffness and one damping constant for all storeys; masses are known."""
    named = range(1, FLOORS + 1)
    return calib.StructuralModel.from_matrices(
        stiffness={f"storey {k}": (STIFF * spring(k), "k") for k in named},
        damping={f"damper {k}": (DAMPING * spring(k), "c") for k in named},
        mass={f"floor {k}": mass * np.diag(np.eye(FLOORS)[k - 1]) for k in named},
        dofs=pd.DataFrame(
            [(k, "x", 0.0, 0.0, 3.0 * k) for k in named], columns=["node", "direction", "x", "y", "z"]
        ),
        parameters=[
            calib.Parameter("k", 1.0, 0.7, 1.4, "-", prior_sd=0.15),
            calib.Parameter("c", 1.0, 0.3, 2.0, "-", prior_sd=0.4),
        ],
        name="chain",
    )  # fmt: skip


def truth(mass=(), stiffness=(), damping=(), hung=None, lag=0.0):
    """K, C, M, all stiffnesses 4 % higher; changes of floors in kg, of storeys and dampers as shares.

    With a lag in s, the second damper stands on a spring in series, with a small mass in between.
    """
    k = sum(1.04 * STIFF * (1 + dict(stiffness).get(n, 0.0)) * spring(n) for n in range(1, FLOORS + 1))
    c = sum(1.1 * DAMPING * (1 + dict(damping).get(n, 0.0)) * spring(n) for n in range(1, FLOORS + 1))
    m = np.diag([MASS + dict(mass).get(n, 0.0) for n in range(1, FLOORS + 1)])
    for n in (2,) if lag else ():
        k, c, m = (np.pad(a, (0, 1)) for a in (k, c, m))
        row, c0 = np.zeros(len(k)), 1.1 * DAMPING
        row[n - 1] = 1.0
        row[n - 2] = -1.0 if n > 1 else 0.0
        c -= c0 * np.outer(row, row)
        eye = row.copy()
        eye[n - 1], eye[-1] = 0.0, 1.0  # the node between spring and damper, from the floor below
        spring_row = np.zeros(len(k))
        spring_row[n - 1], spring_row[-1] = 1.0, -1.0
        c, k = c + c0 * np.outer(eye, eye), k + c0 / lag * np.outer(spring_row, spring_row)
        m[-1, -1] = 1e-2
    if hung is not None:
        floor, weight, freq = hung
        row = np.zeros(FLOORS + 1)
        row[floor - 1], row[-1] = 1.0, -1.0
        omega = 2 * np.pi * freq
        k, c, m = (np.pad(a, (0, 1)) for a in (k, c, m))
        k, c = k + weight * omega**2 * np.outer(row, row), c + 0.06 * weight * omega * np.outer(row, row)
        m[-1, -1] = weight
    return k, c, m


def measured(seed=5, count=FLOORS, **changed):
    """The lowest modes of the truth in the order of their frequencies, with noise."""
    k, c, m = truth(**changed)
    n, rng = len(k), np.random.default_rng(seed)
    zero, one = np.zeros((n, n)), np.eye(n)
    values, vectors = eig(np.block([[zero, one], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]]))
    order = [i for i in np.argsort(np.abs(values)) if values[i].imag > 0][:count]
    values, shapes = values[order], vectors[:FLOORS, order]
    freq, ratio = np.abs(values) / (2 * np.pi), -values.real / np.abs(values)
    shapes = shapes / shapes[np.argmax(np.abs(shapes), axis=0), range(len(order))]
    noise, std = rng.standard_normal((2, *shapes.shape)), 0.005
    return calib.MeasuredModes(
        names=tuple(f"M{j + 1}" for j in range(len(order))),
        natural_freq=freq * (1 + 1e-3 * rng.standard_normal(len(order))),
        damped_freq=freq * np.sqrt(1 - ratio**2), freq_std=1e-3 * freq,
        damping_ratio=ratio * (1 + 0.03 * rng.standard_normal(len(order))), damping_std=0.03 * ratio,
        sensors=tuple(calib.Sensor(k + 1, "x", (0.0, 0.0, 3.0 * (k + 1))) for k in range(FLOORS)),
        shapes=shapes + std * (noise[0] + 1j * noise[1]), shape_std=np.full(shapes.shape, std),
        n_repeats=5, synthetic=True, source="synthetic chain",
    )  # fmt: skip


def posed(**changed):
    held = () if "hung" in changed else HELD
    return calib.Problem(chain(), calib.ModalTest(measured(**changed), held_out=held))


def frfs(freq, driven=(1, 4), seed=8, std=2e-7, **changed):
    """Accelerances of all floors by forces at some of them, with noise of 1 % and a floor."""
    k, c, m = truth(**changed)
    floors = np.arange(FLOORS)
    whole = np.array([-(w**2) * np.linalg.inv(k + 1j * w * c - w**2 * m) for w in 2 * np.pi * freq])
    true = whole[np.ix_(range(len(freq)), floors, np.array(driven) - 1)]
    size, rng = 0.01 * np.abs(true) + std, np.random.default_rng(seed)
    noise = rng.standard_normal((2, *true.shape))
    sensors = tuple(calib.Sensor(n + 1, "x", (0.0, 0.0, 3.0 * (n + 1))) for n in floors)
    return MeasuredFRFs(
        freq, sensors, tuple(sensors[n - 1] for n in driven), "accelerance", true + size * (noise[0] + 1j * noise[1]),
        size, 5, True,
    )  # fmt: skip
