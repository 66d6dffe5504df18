"""Suspension, bogies and track of the vehicle with each of their effects modelled by springs, bushes and bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from calib import StructuralModel
from models.fem.discrete import PointMass, Spring
from models.fem.member import Point
from models.railway.bogie import RX, SIDES, UX, UY
from models.railway.bolsters import FLOOR_Y, LOAD_BOLSTER_TIP, LOAD_BOLSTER_Y, PAD_Z
from models.railway.car_lines import BOGIE_X
from models.railway.vehicle import BOGIES, Assembly
from tests.models.railway.rebuilding import (
    RIGID,
    RIGID_TURN,
    Values,
    held,
    rebuilt,
    stub,
    with_bodies,
    with_matrix,
    with_springs,
)


def anti_roll_bars(v: Values, refine: int) -> StructuralModel:
    """Two levers on one axis, one on both ends of the bolster and one below it on the frame, joined by a bar."""

    def change(whole: Assembly) -> Assembly:
        springs, members = [], []
        for bogie, x in BOGIES:
            at: Point = (x, LOAD_BOLSTER_Y, 0.0)
            levers = []
            for part in ("frame", "load_bolster"):
                lever, on = f"{bogie}_lever of {part}", f"{bogie}_{part}"
                levers.append(lever)
                members.append(stub(lever, at))
                springs += held(lever, on, at, (UY, RX))
                for _, s in SIDES:
                    end: Point = (x, LOAD_BOLSTER_Y, s * LOAD_BOLSTER_TIP)
                    springs.append(Spring((lever, end), (on, end), (0, 1, 0), weight=RIGID))
            one, other = ((lever, at) for lever in levers)
            springs.append(Spring(one, other, (1, 0, 0), True, v["anti_roll_bar"] * 1e6))
        return with_bodies(with_springs(whole, springs), members)

    return rebuilt(change, refine)


def scaled(kind: str, factors: Callable[[Values], Mapping[str, float]], v: Values, refine: int) -> StructuralModel:
    """Springs or dampers, some of them stronger or weaker by name."""
    wanted = factors(v)

    def change(whole: Assembly) -> Assembly:
        own = getattr(whole, kind)
        names = {s.name for group in own.values() for s in group}
        assert set(wanted) <= names
        new = {
            group: tuple(replace(s, weight=wanted.get(s.name, 1.0) * s.weight) for s in some)
            for group, some in own.items()
        }
        return replace(whole, **{kind: new})

    return rebuilt(change, refine)


def air_springs(v: Values, refine: int) -> StructuralModel:
    """Bellows as a spring and an orifice in a row, with a piston between."""
    stiffness = v["air_spring"] * 1e3
    orifice = stiffness / (2 * np.pi * v["air_spring_freq"])

    def change(whole: Assembly) -> Assembly:
        members, springs, dampers = [], [], []
        for bogie, x in BOGIES:
            for side, s in SIDES:
                at: Point = (x, LOAD_BOLSTER_Y, s * LOAD_BOLSTER_TIP)
                body = f"{bogie}_piston_{side}"
                members.append(stub(body, at))
                springs += held(body, f"{bogie}_frame", at, (UY,))
                springs.append(Spring((f"{bogie}_load_bolster", at), (body, at), (0, 1, 0), weight=stiffness))
                dampers.append(Spring((body, at), (f"{bogie}_frame", at), (0, 1, 0), weight=orifice))
        return with_bodies(with_springs(whole, springs, dampers), members)

    return rebuilt(change, refine)


def on_bushes(
    kind: str, keys: Sequence[str], chosen: Callable[[str], bool], flexibility: str, v: Values, refine: int
) -> StructuralModel:
    """Springs or dampers whose end sits in an eye on a bush that gives along them."""
    bush, units = 1 / (v[flexibility] * 1e-9), np.eye(3).tolist()

    def change(whole: Assembly) -> Assembly:
        members, springs, own = [], [], dict(getattr(whole, kind))
        for key in keys:
            new = []
            for k, s in enumerate(own[key]):
                if chosen(s.name):
                    (part, at), body = s.end, f"front_eye {key} {k}"
                    along = np.asarray(s.direction, dtype=float) / np.linalg.norm(s.direction)
                    square = np.linalg.svd(along[None])[2][1:]
                    members.append(stub(body, at))
                    springs += [Spring((body, at), (part, at), tuple(u), weight=RIGID) for u in square.tolist()]
                    springs += [Spring((body, at), (part, at), tuple(u), True, RIGID_TURN) for u in units]
                    springs.append(Spring((body, at), (part, at), tuple(along.tolist()), weight=bush))
                    s = replace(s, end=(body, at))
                new.append(s)
            own[key] = tuple(new)
        return with_bodies(with_springs(replace(whole, **{kind: own}), springs), members)

    return rebuilt(change, refine)


def lossy_pads(v: Values, refine: int) -> StructuralModel:
    """Dampers within the floor pads."""

    def change(whole: Assembly) -> Assembly:
        pads = [s for s in whole.springs["floor_fixed"] if "floor pad" in s.name]
        return with_springs(whole, dampers=[replace(s, weight=v["pad_damping"] * 1e3) for s in pads])

    return rebuilt(change, refine)


def soft_track(v: Values, refine: int) -> StructuralModel:
    """A massless rail under every wheel, on a bush to the ground."""
    bush = 1 / (v["track_compliance"] * 1e-9)

    def change(whole: Assembly) -> Assembly:
        members, springs, contacts = [], [], []
        units = np.eye(3).tolist()
        for k, s in enumerate(whole.springs["K_rail"]):
            (_, at), body = s.end, f"front_rail {k}"
            members.append(stub(body, at))
            springs += [Spring((body, at), None, tuple(units[d]), weight=RIGID) for d in (0, 2)]
            springs += [Spring((body, at), None, tuple(u), True, RIGID_TURN) for u in units]
            springs.append(Spring((body, at), None, (0, 1, 0), weight=bush))
            contacts.append(replace(s, other=(body, at)))
        whole = replace(whole, springs=whole.springs | {"K_rail": tuple(contacts)})
        return with_bodies(with_springs(whole, springs), members)

    return rebuilt(change, refine)


def loaded_bolster(v: Values, refine: int) -> StructuralModel:
    """A mass on the middle of the front load bolster."""
    mass = PointMass(("front_load_bolster", (BOGIE_X, LOAD_BOLSTER_Y, 0.0)), v["bolster_mass"])
    return rebuilt(lambda whole: with_bodies(whole, masses=[mass]), refine)


def tight_pivots(v: Values, refine: int) -> StructuralModel:
    """Springs lengthwise between the floor's pads and the ground that resist turning and nothing else on the whole."""
    model = rebuilt(refine=refine)
    structure = model.locator.frame
    rows = []
    for bogie, x in BOGIES:
        left, right = (structure.motion((x, FLOOR_Y, s * PAD_Z), f"{bogie}_floor_{side}")[0] for side, s in SIDES)
        rows.append((left[UX] - right[UX]) / (2 * PAD_Z))
    stacked = sp.csr_array(np.array(rows))
    return with_matrix(model, "stiffness", "pivots", v["pivot_yaw"] * 1e6 * (stacked.T @ stacked))
