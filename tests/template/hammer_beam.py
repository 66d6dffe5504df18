"""Impact tests of a cantilever by finite differences: pulses of a hammer, accelerations in time, what spoils them.

The beam is differenced in space, its modes are stepped in time with a force that is linear between samples of a rate
eight times as high, and both channels pass one filter. No line of the code that makes FRFs is used.
"""

from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, decimate, lfilter

RATE = 512.0
FINER = 8
SAMPLES = 1024
N = 40
"""Points along the beam of 1 m."""
FIRST = 11.0
"""Hz, of the lowest mode."""
RATIOS = np.array([0.012, 0.008, 0.006, 0.006, 0.006])
"""Damping ratios of the modes; the fifth lies above the lines."""
PLACES = (10, 20, 30, 40)
HIT_AT = 30


def modes():
    """Natural frequencies (Hz) and shapes (n_points, n_modes) of the five lowest modes."""
    ghost = np.zeros((N + 4, N))  # points -1 to N + 2: clamped at 0, no moment and no shear at N
    ghost[2 : N + 2] = np.eye(N)
    ghost[0] = ghost[2]
    ghost[N + 2] = 2 * ghost[N + 1] - ghost[N]
    ghost[N + 3] = 4 * ghost[N + 1] - 4 * ghost[N] + ghost[N - 1]
    bent = np.array([ghost[k] - 4 * ghost[k + 1] + 6 * ghost[k + 2] - 4 * ghost[k + 3] + ghost[k + 4]
                     for k in range(N)])  # fmt: skip
    bent[-1] /= 2  # half a mass at the end makes the operator symmetric
    mass = np.ones(N)
    mass[-1] = 0.5
    root = np.sqrt(mass)
    squares, vectors = np.linalg.eigh(bent / np.outer(root, root))
    omega = np.sqrt(squares[:5] / squares[0]) * FIRST
    return omega, vectors[:, :5] / root[:, None]


FREQ, SHAPES = modes()


def pulse(times, at, strength, width=2.5e-3):
    """A half-sine of a hammer, N."""
    phase = (times - at) / width
    return np.where((phase > 0) & (phase < 1), strength * np.sin(np.pi * np.clip(phase, 0, 1)), 0.0)


def responses(force, hit_at=HIT_AT, places=PLACES):
    """Accelerations (n_fine, n_places) under a force at a point, both at the finer rate."""
    out = np.zeros((len(force), len(places)))
    for freq, ratio, shape in zip(FREQ, RATIOS, SHAPES.T, strict=True):
        omega = 2 * np.pi * freq
        system = [1.0, 0.0, 0.0], [1.0, 2 * ratio * omega, omega**2]
        b, a, _ = cont2discrete(system, 1 / (RATE * FINER), method="foh")
        out += np.outer(lfilter(np.ravel(b), a, shape[hit_at - 1] * force), shape[np.array(places) - 1])
    return out


def record(hits, seed=0, *, samples=SAMPLES, noise=1e-3, hit_at=HIT_AT, places=PLACES, window=None, limit=None):
    """A record (n_samples, 2 + n_places) of time, force and accelerations.

    ``hits`` are instants (s) and strengths (N). ``noise`` is that of every channel over its largest value; ``window``
    the time constant of an exponential one, s, ``limit`` the range of the accelerometers over the largest acceleration.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(samples * FINER) / (RATE * FINER)
    force = sum(pulse(times, at, strength) for at, strength in hits)
    every = np.column_stack([force, responses(force, hit_at, places)])
    every = decimate(every, FINER, ftype="fir", axis=0)[:samples]
    if limit is not None:
        range_of = limit * np.abs(every[:, 1:]).max()
        every[:, 1:] = np.clip(every[:, 1:], -range_of, range_of)
    else:
        every = every + noise * np.abs(every).max(axis=0) * rng.standard_normal(every.shape)
    times = np.arange(samples) / RATE
    if window is not None:
        every *= np.exp(-times / window)[:, None]
    return np.column_stack([times, every])


def write(path: Path, table, unit="(m/s2)/N", hit_at=HIT_AT, places=PLACES):
    """A record as a table."""
    names = ",".join(["time", f"force {hit_at}z", *(f"{place}z" for place in places)])
    head = f"# unit: {unit}\n{names}" if unit else names
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def session(folder: Path, count=5, seed=0, **others):
    """Records of single hits of different strength, one file each."""
    rng = np.random.default_rng(1000 + seed)
    hits = [(0.05 + 0.02 * rng.random(), rng.uniform(60, 140)) for _ in range(count)]
    each = (record([hit], seed * 50 + k, **others) for k, hit in enumerate(hits))
    return [write(folder / f"hit_{k}.csv", table) for k, table in enumerate(each)]
