"""A bogie with its bolsters at its place under the car."""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.fem.discrete import End, PointMass, Spring
from models.fem.member import Member, Point, Suppression, Tie
from models.fem.rbe3 import Rbe3
from models.railway.bogie import bogie
from models.railway.bolsters import bolsters


@dataclass(frozen=True)
class RunningGear:
    """Parts of one bogie with bolsters; names of bodies, groups and RBE3s have the bogie's name as prefix.

    Attributes
    ----------
    members, ties, suppressions, masses, rbe3s
        As of a structure.
    springs : mapping from str to tuple of Spring
        ``primary``, ``rod_upper``, ``rod_lower``, ``rail``, ``secondary``, ``rod_tilting`` carry parameters;
        ``suspension_fixed`` and ``floor_fixed`` hold constant ones.
    dampers : mapping from str to tuple of Spring
        ``primary``, ``secondary`` and ``yaw``.
    """

    members: tuple[Member, ...]
    ties: tuple[Tie, ...]
    suppressions: tuple[Suppression, ...]
    masses: tuple[PointMass, ...]
    springs: dict[str, tuple[Spring, ...]]
    dampers: dict[str, tuple[Spring, ...]]
    rbe3s: tuple[Rbe3, ...]


def running_gear(name: str, x: float, size: float, distributed: bool = False) -> RunningGear:
    """One bogie of the vehicle.

    Parameters
    ----------
    name : str
        Such as ``front``: its frame is the body ``front_frame``.
    x : float
        Its centre, m; the yaw dampers' brackets stand towards the near end of the car.
    size : float
        Largest element length, m.
    distributed : bool
        As of `models.railway.bogie.bogie`.
    """
    own, above = bogie(size, distributed), bolsters(size, 1.0 if x >= 0 else -1.0)
    put = _Place(name, x)
    springs, dampers = own.springs | above.springs, {"primary": own.dampers} | above.dampers
    return RunningGear(
        tuple(put.member(m) for m in (*own.members, *above.members)),
        tuple(put.tie(t) for t in own.ties),
        tuple(put.suppression(s) for s in (*own.suppressions, *above.suppressions)),
        tuple(put.mass(m) for m in (*own.masses, *above.masses)),
        {key: tuple(put.spring(s) for s in some) for key, some in springs.items()},
        {key: tuple(put.spring(s) for s in some) for key, some in dampers.items()},
        tuple(put.rbe3(s) for s in above.rbe3s),
    )


@dataclass(frozen=True)
class _Place:
    name: str
    x: float

    def point(self, p: Point) -> Point:
        return (p[0] + self.x, p[1], p[2])

    def part(self, name: str) -> str:
        return f"{self.name}_{name}"

    def label(self, name: str) -> str:
        return f"{self.name} bogie, {name}" if name else ""

    def end(self, end: End) -> End:
        return self.part(end[0]), self.point(end[1])

    def member(self, m: Member) -> Member:
        return replace(
            m, body=self.part(m.body), group=self.part(m.group), start=self.point(m.start), end=self.point(m.end),
            through=tuple(self.point(p) for p in m.through), part=self.label(m.part),
        )  # fmt: skip

    def tie(self, t: Tie) -> Tie:
        return replace(t, body=self.part(t.body), other=self.part(t.other), point=self.point(t.point))

    def suppression(self, s: Suppression) -> Suppression:
        return replace(
            s, groups=tuple(self.part(g) for g in s.groups), body=self.part(s.body) if s.body else "",
            point=None if s.point is None else self.point(s.point),
        )  # fmt: skip

    def mass(self, m: PointMass) -> PointMass:
        return replace(m, at=self.end(m.at), name=self.label(m.name))

    def spring(self, s: Spring) -> Spring:
        other = None if s.other is None else self.end(s.other)
        return replace(s, end=self.end(s.end), other=other, name=self.label(s.name))

    def rbe3(self, s: Rbe3) -> Rbe3:
        return replace(s, name=self.part(s.name), feet=tuple(self.point(f) for f in s.feet))
