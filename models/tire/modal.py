"""The inflated tire as a model of modes at sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib import InputError, ModalFunctionModel, ParameterSpace
from models.tire.harmonics import HoopModes, hoop_modes, rings
from models.tire.inflated import Inflated, inflate
from models.tire.model import KPA, assumptions, parameters, tire_of
from models.tire.parts import PARTS

STATIONS = 12
"""Places around the hoop, the first at the exciter, below the axle."""
SHOULDER, SIDE = 0.35, 0.2
"""Where the other sensors stand, over the meridian from one bead."""
N_MODES = 8


class Station(NamedTuple):
    """A sensor: node, direction, hoop angle from the exciter, rad, and part of the meridian from one bead."""

    node: int
    direction: str
    angle: float
    part: float


_ROWS = ((0, 0.5, STATIONS, "xz"), (20, SHOULDER, STATIONS // 2, "xyz"), (40, SIDE, STATIONS // 2, "xyz"))
LAYOUT = tuple(
    Station(first + k + 1, direction, 2 * np.pi * k / STATIONS, part)
    for first, part, count, directions in _ROWS for k in range(count) for direction in directions
)  # fmt: skip
"""Sensors of `tire_modes`."""


def tire_modes(
    n_meridian: int = 29, orders: tuple[int, ...] = (0, 1, 2, 3, 4), n_each: int = 2, n_modes: int = N_MODES
) -> ModalFunctionModel:
    """Modes of the inflated tire, free of the ground, excited radially at a point of its crown.

    Modes of a hoop order above 0 come in pairs of one frequency; the exciter moves the one whose crown moves radially
    there, and not the other. Sensors stand at twelve stations around the crown (nodes 1 to 12, directions x forward and
    z up), and at the first six on the shoulder (21 to 26) and the sidewall (41 to 46) of one side, axially (y) too.
    The tire has no damping.

    Parameters
    ----------
    n_meridian : int
        Cells from bead to bead.
    orders : tuple of int
        Hoop orders to solve.
    n_each : int
        Modes of each.
    n_modes : int
        Lowest modes returned.

    Raises
    ------
    InputError
        For more modes than are solved.
    """
    if n_modes > len(orders) * n_each:
        raise InputError(
            f"{n_modes} modes are wanted, but {n_each} of {len(orders)} hoop orders are solved",
            remedy="solve more orders",
        )
    function = ModesFunction(n_meridian, orders, n_each, n_modes)
    return ModalFunctionModel(
        "inflated tire", ParameterSpace(parameters()), function, [f"{s.node}{s.direction}" for s in LAYOUT], n_modes,
        damped=False,
        assumptions=assumptions(n_meridian, 12 * max(orders)), parts=PARTS,
    )  # fmt: skip


@dataclass(frozen=True)
class ModesFunction:
    """The function of `tire_modes`.

    Attributes
    ----------
    n_meridian : int
    orders : tuple of int
    n_each, n_modes : int
    """

    n_meridian: int
    orders: tuple[int, ...]
    n_each: int
    n_modes: int

    def __call__(self, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Frequencies, Hz, and shapes at the sensors of the modes that the exciter moves."""
        tire = tire_of(values)
        wall = tire.wall(self.n_meridian, 12 * max(self.orders), 0.0)
        inflated = inflate(wall, tire.wall(self.n_meridian, 1), values["pressure"] * KPA)
        modes = hoop_modes(inflated, np.asarray(self.orders), self.n_each)
        every = [
            (modes.frequencies[k, j], self._at_sensors(inflated, modes, k, j))
            for k in range(len(self.orders)) for j in range(self.n_each)
        ]  # fmt: skip
        lowest = sorted(every, key=lambda mode: mode[0])[: self.n_modes]
        return {
            "natural_freq": np.array([freq for freq, _ in lowest]),
            "shapes": np.stack([shape for _, shape in lowest], axis=1),
        }

    def _at_sensors(self, inflated: Inflated, modes: HoopModes, k: int, j: int) -> np.ndarray:
        """Real shape (n_sensors,), turned so that the crown's radial motion at the exciter is largest."""
        grid, order = inflated.wall.grid, int(modes.orders[k])
        q = np.zeros(grid.n_dof, complex)
        q[rings(grid)[:, 0]] = modes.shapes[k, :, j]
        u, v, w = (np.where(number[:, 0] >= 0, q[number[:, 0]], 0.0) for number in grid.numbers)
        u_node = (np.append(0.0, u) + np.append(u, 0.0)) / 2
        # v stands half a hoop cell further on than u and w.
        v_node = v * np.exp(-1j * np.pi * order / grid.n_hoop)
        p, s = grid.profile, grid.s_node
        radial, axial = p.dz(s) * w + p.dr(s) * u_node, p.dz(s) * u_node - p.dr(s) * w
        crown = _between(grid.profile.length / 2, s, radial)
        turn = np.conj(crown) / abs(crown) if abs(crown) > 1e-9 * np.abs(radial).max() else 1.0
        out = np.empty(len(LAYOUT))
        for row, sensor in enumerate(LAYOUT):
            place, angle = grid.profile.length * sensor.part, sensor.angle
            wave = turn * np.exp(1j * order * angle)
            out_r, out_a, out_v = ((_between(place, s, one) * wave).real for one in (radial, axial, v_node))
            out[row] = {
                "x": out_r * np.sin(angle) + out_v * np.cos(angle), "y": out_a,
                "z": -out_r * np.cos(angle) + out_v * np.sin(angle),
            }[sensor.direction]  # fmt: skip
        return out


def _between(place: float, s: np.ndarray, values: np.ndarray) -> complex:
    """Complex values interpolated at an arc length."""
    return complex(np.interp(place, s, values.real), np.interp(place, s, values.imag))
