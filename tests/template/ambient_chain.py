"""Ambient records of chains: white forces that are constant between samples, whose response is exact at the samples."""

from pathlib import Path

import numpy as np
import scipy.linalg
from scipy.signal import lfilter

from calib.measurement.modal import Sensor
from calib.measurement.record import MeasuredRecord

RATE = 64.0
DAMPING = 0.01
NOISE = 0.02
"""Sensor noise over the root mean square of each sensor."""
SETTLED = 4000
"""Samples that are dropped: the chain starts at rest."""


def chain(stiffness=4000.0):
    """Stiffness of four unit masses between a wall and a free end, N/m."""
    out = stiffness * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    out[-1, -1] = stiffness
    return out


def close_pair(split=0.02, stiffness=4000.0):
    """Stiffness of two weakly coupled masses, whose modes are 2 % apart for the default, and two others, N/m."""
    k, coupling = stiffness, split * stiffness
    out = np.diag([k + coupling, k + coupling, 2.5 * k, 2.2 * k])
    out[0, 1] = out[1, 0] = -coupling
    out[1, 2] = out[2, 1] = -0.03 * k
    out[2, 3] = out[3, 2] = -0.5 * k
    return out


def modes(stiffness):
    """Natural frequencies, Hz, and shapes for unit masses."""
    squares, shapes = np.linalg.eigh(stiffness)
    return np.sqrt(squares) / (2 * np.pi), shapes


def accelerations(stiffness, n_samples, seed, noise=NOISE):
    """Accelerations (n_samples, n) of unit masses with modal damping under independent white forces."""
    n = len(stiffness)
    freq, shapes = modes(stiffness)
    damping = shapes @ np.diag(2 * DAMPING * 2 * np.pi * freq) @ shapes.T
    whole = np.zeros((3 * n, 3 * n))
    whole[:n, n : 2 * n], whole[n : 2 * n, :n], whole[n : 2 * n, n : 2 * n] = np.eye(n), -stiffness, -damping
    whole[n : 2 * n, 2 * n :] = np.eye(n)
    exact = scipy.linalg.expm(whole / RATE)
    steps, vectors = np.linalg.eig(exact[: 2 * n, : 2 * n])
    rng = np.random.default_rng(seed)
    force = rng.standard_normal((n_samples + SETTLED, n))
    driven = force @ np.linalg.solve(vectors, exact[: 2 * n, 2 * n :]).T
    states = np.stack([lfilter([0, 1], [1, -step], driven[:, k]) for k, step in enumerate(steps)], axis=1)
    motion = np.real(states @ vectors.T)
    out = (motion @ whole[n : 2 * n, : 2 * n].T + force)[SETTLED:]
    return out + noise * out.std(axis=0) * rng.standard_normal(out.shape)


def record(stiffness, n_samples, seed, noise=NOISE):
    """An ambient record of all masses."""
    sensors = tuple(Sensor(k + 1, "x", (float(k), 0.0, 0.0)) for k in range(len(stiffness)))
    values = accelerations(stiffness, n_samples, seed, noise)
    return MeasuredRecord(RATE, values, sensors, "acceleration", synthetic=True, source=f"record {seed}")


def write_csv(path: Path, values, header="# unit: m/s2\ntime,1x,2x,3x,4x"):
    """A record as a table."""
    table = np.column_stack([np.arange(len(values)) / RATE, values])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def uff_set(node, values, **others):
    """Dataset 58 with the accelerations of one node along x."""
    n = len(values)
    own = {
        "type": 58, "binary": 0, "id1": "record", "func_type": 1, "rsp_node": node, "rsp_dir": 1, "ref_node": 0,
        "ref_dir": 0, "rsp_ent_name": "NONE", "ref_ent_name": "NONE", "ver_num": 0, "load_case_id": 0,
        "ord_data_type": 4, "num_pts": n, "abscissa_spacing": 1, "abscissa_min": 0.0, "abscissa_inc": 1 / RATE,
        "abscissa_spec_data_type": 17, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0,
        "z_axis_axis_lab": "NONE", "x": np.arange(n) / RATE, "data": values,
    }  # fmt: skip
    return own | others
