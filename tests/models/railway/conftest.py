"""The vehicle, built once, identification of its modes, and the check of printed parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from calib import Parameter, Sensor, StructuralModel
from calib.measurement.modal import DIRECTIONS
from calib.structure.eigenproblem.solve import solve_modes
from calib.study.loading import module_of
from models.railway import vehicle

STATIONS = (-12.95, -9.5, -5.0, 0.2, 5.0, 9.5, 12.95)
FEWER = (-12.95, -5.0, 0.2, 5.0, 12.95)


def places() -> list[Sensor]:
    """36 directions: sole bars, left cantrail, ends of the girders and of the load bolsters."""
    chosen = [(x, 1.15, z, "y", "car") for z in (1.40, -1.40) for x in STATIONS]
    chosen += [(x, y, z, "z", "car") for y, z in ((1.15, 1.40), (3.05, 1.27)) for x in FEWER]
    for name, centre in (("front", 9.5), ("rear", -9.5)):
        ends = [(centre + dx, 0.62, z) for z in (1.05, -1.05) for dx in (2.005, -2.005)]
        chosen += [(*p, "y", f"{name}_frame") for p in ends]
        chosen += [(centre, 0.86, z, "y", f"{name}_load_bolster") for z in (1.17, -1.17)]
    return [Sensor(i, d, (x, y, z), on) for i, (x, y, z, d, on) in enumerate(chosen, start=1)]


def templates(sensors: list[Sensor]) -> dict[str, np.ndarray]:
    """Approximate shape of each named mode at the sensors."""
    x, y, z = np.array([s.point for s in sensors]).T
    up = np.array([DIRECTIONS.index(s.direction) == 1 for s in sensors])
    on = np.array([str(s.on) for s in sensors])
    car, front, rear = on == "car", on == "front_frame", on == "rear_frame"
    rising, aside = 1.0 * (car & up), 1.0 * (car & ~up)
    bow = 2 * (x / 12.95) ** 2 - 0.6
    bell = np.cos(np.pi * x / 21)
    near = np.where(front, x - 9.5, x + 9.5)
    out = {
        "1C": rising * z - aside * (y - 1.0),
        "2C": rising * 1.0,
        "3C": rising * x,
        "4C": -rising * 0.55 * z * bell - aside * 0.9 * (y - 2.1) * bell,
        "5C": rising * bow,
        "6C": -rising * x * z + aside * x * (y - 0.8),
    }
    for name, shape in (("1B", np.ones(len(x))), ("2B", z), ("3B", near)):
        out[f"{name} in"], out[f"{name} anti"] = shape * front + shape * rear, shape * front - shape * rear
    return out


@dataclass(frozen=True)
class Named:
    """Indices of the named modes."""

    index: dict[str, int]
    alike: dict[str, float]
    motion: np.ndarray


def named(model: StructuralModel, shapes: np.ndarray) -> Named:
    """Index and MAC of every named mode, one to one, and all motions at the sensors; for modes below 16 Hz."""
    sensors = places()
    motion = model.sensor_rows(sensors) @ shapes
    wanted = templates(sensors)
    size = np.sum(np.abs(motion) ** 2, axis=0)
    alike = np.array([np.abs(t @ motion) ** 2 / (t @ t) / size for t in wanted.values()])
    rows, columns = linear_sum_assignment(-alike)
    index = {name: int(k) for name, k in zip(wanted, columns, strict=True)}
    return Named(index, {name: float(alike[r, index[name]]) for r, name in zip(rows, wanted, strict=True)}, motion)


@pytest.fixture(scope="session")
def name_modes() -> Callable[[StructuralModel, np.ndarray], Named]:
    return named


@pytest.fixture(scope="session")
def vehicle_sensors() -> list[Sensor]:
    return places()


@pytest.fixture(scope="session")
def assert_published() -> Callable[[Parameter, tuple, bool], None]:
    """Fails when a parameter is not as printed: name, nominal value, limits, unit; None for what is lost."""

    def check(p: Parameter, printed: tuple, deterministic: bool) -> None:
        name, nominal, lower, upper, unit = printed
        assert (p.name, p.unit) == (name, unit)
        for own, other in ((p.value, nominal), (p.lower, lower), (p.upper, upper)):
            assert other is None or own == other
        assert p.lower <= p.value <= p.upper
        assert (p.distribution == "fixed") == deterministic

    return check


@pytest.fixture(scope="session")
def car() -> StructuralModel:
    return vehicle()


@pytest.fixture(scope="session")
def rigid_car() -> StructuralModel:
    return vehicle(seats="rigid")


@pytest.fixture(scope="session")
def undamped(car):
    k, _, m = car.matrices({})
    return solve_modes(k, None, m, 15, car.dofs.direction >= 3)


@pytest.fixture(scope="session")
def damped(car):
    return car.modes({}, 15)


@pytest.fixture(scope="session")
def effect_checks() -> ModuleType:
    """See `effect_checks.py` beside this file."""
    return module_of(Path(__file__).with_name("effect_checks.py"))
