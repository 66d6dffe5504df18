import os
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.proj3d import proj_transform

from calib.report.mesh import MeshTables
from calib.report.scene import plot_coordinates

MODES = ["1BT", "2BT", "3BT"]


def compare(errors: list[float], macs: list[float]) -> pd.DataFrame:
    measured = np.array([6.95, 10.83, 13.2])[: len(errors)]
    return pd.DataFrame(
        {
            "mode": MODES[: len(errors)],
            "natural_freq_measured": measured,
            "natural_freq_model": measured * (1.0 + np.array(errors)),
            "freq_error": errors,
            "mac": macs,
        }
    )


@pytest.fixture
def before() -> pd.DataFrame:
    """The third mode is not paired."""
    return compare([-0.12, 0.08, np.nan], [0.93, 0.55, np.nan])


@pytest.fixture
def after() -> pd.DataFrame:
    return compare([-0.004, 0.006, 0.02], [0.99, 0.96, 0.88])


@pytest.fixture
def mac() -> pd.DataFrame:
    cells = np.array([[0.93, 0.02, 0.3], [0.11, 0.55, np.nan]])
    table = pd.DataFrame(cells, columns=["1 (6.12 Hz)", "2 (11.70 Hz)", "3 (15.00 Hz)"])
    table.insert(0, "mode", MODES[:2])
    return table


@pytest.fixture
def cross() -> pd.DataFrame:
    """The second mode is not paired; 0.898 and 0.104 are read as 0.90 and 0.10, which pass."""
    table = pd.DataFrame([[0.898, 0.104], [0.3, np.nan], [0.106, 0.894]], columns=["1 (11.70 Hz)", "12 (16.20 Hz)"])
    table.insert(0, "mode", ["1BT", "2BT", "3BT"])
    table.insert(1, "model_mode", [1.0, np.nan, 12.0])
    return table


@pytest.fixture
def own() -> pd.DataFrame:
    """Orthogonality of the measured shapes; one of three pairs leaks."""
    table = pd.DataFrame([[1.0, 0.12, 0.02], [0.12, 1.0, 0.05], [0.02, 0.05, 1.0]], columns=["1BT", "2BT", "3BT"])
    table.insert(0, "mode", ["1BT", "2BT", "3BT"])
    return table


@pytest.fixture
def comac() -> pd.DataFrame:
    return pd.DataFrame({"sensor": ["1y", "2y", "2z", "3y"], "comac": [0.9, 0.4, 0.99, 0.7]})


@pytest.fixture
def sensitivity() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "parameter": ["K_primary", "c_primary", "rho"],
            "natural_freq_1BT": [0.9, -0.24, np.nan],
            "mac_1BT": [0.25, -0.7, 0.1],
            "natural_freq_2BT": [-0.3, 0.0, 0.5],
        }
    )


@pytest.fixture
def parameters() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "case": ["GB1", "GB1", "GB2", "GB2"],
            "parameter": ["K_primary", "position", "K_primary", "position"],
            "value": [1.5, -0.25, 1.6, 1.0],
            "unit": ["MN/m", "-", "MN/m", "-"],
            "lower": [1.0, -1.0, 1.0, -1.0],
            "upper": [2.0, 1.0, 2.0, 1.0],
            "ratio": [0.5, 0.375, 0.6, 1.0],
            "on_limit": [False, False, False, True],
            "spread": [0.1, 0.625, 0.1, 0.625],
            "stable": [True, False, True, False],
            "identified": [True, False, True, False],
        }
    )


@pytest.fixture
def convergence() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "case": ["GB1"] * 3 + ["GB2"] * 3,
            "generation": [0, 1, 2, 2, 1, 0],
            "best": [1.0, 0.5, 0.25, 0.3, 0.6, np.inf],
            "mean": [2.0, 1.0, 0.5, 0.6, 1.2, np.inf],
            "feasible": [30, 30, 30, 30, 4, 0],
        }
    )


@pytest.fixture
def shapes() -> pd.DataFrame:
    """Mode 1 moves up, mode 2 along z; node 2 is measured in two directions, node 9 has no coordinates."""
    rows = []
    for mode, up, across in (("1BT", 1.0, 0.0), ("2BT", 0.0, 0.5)):
        rows += [
            (mode, "1y", 1, "y", 0.0, 0.5, 1.0, up),
            (mode, "2y", 2, "y", 2.0, 0.5, 1.0, up),
            (mode, "2z", 2, "z", 2.0, 0.5, 1.0, across),
            (mode, "9y", 9, "y", np.nan, np.nan, np.nan, up),
        ]
    return pd.DataFrame(rows, columns=["mode", "sensor", "node", "direction", "x", "y", "z", "measured_re"])


@pytest.fixture
def mesh() -> MeshTables:
    """Two bars along x."""
    places = [(0.0, 0.5, 1.0), (2.0, 0.5, 1.0), (0.0, 0.0, -1.0), (2.0, 0.0, -1.0)]
    points = pd.DataFrame(places, columns=["x", "y", "z"])
    points.insert(0, "point", range(4))
    elements = pd.DataFrame({"group": ["bar"] * 2, "a": [0, 2], "b": [1, 3], "c": [np.nan] * 2, "d": [np.nan] * 2})
    return MeshTables(points, elements)


@pytest.fixture
def deflection() -> pd.DataFrame:
    """Motion of the bars; only mode 1 is paired with a model mode."""
    rows = [("1BT", 0, 0.0, 1.0, 0.0), ("1BT", 1, 0.0, 1.0, 0.0), ("1BT", 2, 0.0, 1.0, 0.0), ("1BT", 3, 0.1, 0.5, 0.2)]
    return pd.DataFrame(rows, columns=["mode", "point", "u", "v", "w"])


@pytest.fixture
def model_modes() -> pd.DataFrame:
    return pd.DataFrame({"mode": ["1BT"], "natural_freq": [6.2], "damped_freq": [6.12], "damping_ratio": [0.15]})


@pytest.fixture
def modes() -> pd.DataFrame:
    """The second mode is held out; the third is not paired before calibration."""
    measured = np.array([6.95, 10.83, 13.2])
    errors = {"before": np.array([-0.12, 0.08, np.nan]), "after": np.array([-0.004, 0.006, 0.02])}
    table = pd.DataFrame({"mode": MODES, "held_out": [False, True, False], "freq_measured": measured})
    table["freq_kind"] = "natural"
    for stage, error in errors.items():
        table[f"freq_{stage}"] = measured * (1.0 + error)
        table[f"error_{stage}"] = error
        table[f"mac_{stage}"] = np.where(np.isnan(error), np.nan, 0.9)
    return table


@pytest.fixture
def hull() -> MeshTables:
    """A box 20 m long, 2 m high and 2 m wide without ends; its top is a separate group, one side has an opening.

    A transverse bar of 1 m hangs below each end, at x = 2 and x = 18 m; a beam runs along an edge of the box.
    """
    x = np.linspace(0.0, 20.0, 11)
    ring = np.array([[2.0, -1.0], [4.0, -1.0], [4.0, 1.0], [2.0, 1.0]])
    places = [(a, y, z) for a in x for y, z in ring]
    rows = []
    for k in range(10):
        for side in range(4):
            if (k, side) == (4, 0):
                continue
            a, b = 4 * k + side, 4 * k + (side + 1) % 4
            rows.append(("top" if side == 1 else "hull", a, b, b + 4, a + 4))
    rows.append(("sill", 0, 4, np.nan, np.nan))
    for at in (2.0, 18.0):
        rows.append(("bar", len(places), len(places) + 1, np.nan, np.nan))
        places += [(at, 0.5, -0.5), (at, 0.5, 0.5)]
    points = pd.DataFrame(places, columns=["x", "y", "z"])
    points.insert(0, "point", range(len(places)))
    return MeshTables(points, pd.DataFrame(rows, columns=["group", "a", "b", "c", "d"]))


def seen(ax: Axes3D, gid: str) -> np.ndarray:
    """Corners (n, 4, 2) in pixels of the drawn pieces, from back to front."""
    (collection,) = [c for c in ax.collections if c.get_gid() == gid]
    ax.get_figure(root=True).savefig(os.devnull, format="png")
    return np.array([collection.get_transform().transform(path.vertices[:4]) for path in collection.get_paths()])


def expected(ax: Axes3D, points: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) at which points (..., 3), metres, must appear."""
    ax.get_figure(root=True).savefig(os.devnull, format="png")  # drawing fixes the view
    x, y, _ = proj_transform(*plot_coordinates(points).reshape(-1, 3).T, ax.get_proj())
    return ax.transData.transform(np.column_stack([x, y])).reshape(*points.shape[:-1], 2)


@pytest.fixture
def pixels() -> SimpleNamespace:
    """Functions that read drawn pieces back and compute where they must appear."""
    return SimpleNamespace(seen=seen, expected=expected)
