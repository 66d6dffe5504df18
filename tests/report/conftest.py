import numpy as np
import pandas as pd
import pytest

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
            "on_bound": [False, False, False, True],
            "spread": [0.1, 0.625, 0.1, 0.625],
            "stable": [True, False, True, False],
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
    """Mode 1 moves up, mode 2 along z; node 2 is measured in two directions, node 9 has no place."""
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
def deflection() -> pd.DataFrame:
    """Two bars along x, of which only mode 1 has a model mode."""
    rows = [
        ("1BT", 0, "bar", 0.0, 0.5, 1.0, 2.0, 0.5, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0),
        ("1BT", 1, "bar", 0.0, 0.0, -1.0, 2.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.1, 0.5, 0.2),
    ]
    names = "mode line group x1 y1 z1 x2 y2 z2 u1 v1 w1 u2 v2 w2".split()
    return pd.DataFrame(rows, columns=names)
