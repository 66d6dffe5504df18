"""Faults of pairs that any modal test may have: exchanged channels and axes, far cross-talk, modes that are mixed.

A test of n channels has n (n - 1)/2 pairs to exchange and n (n - 1) ways for one to read another, so that these faults
are a family of their own among the candidates: the limits of all others do not rise with them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from calib.correlation.fault_rules import RULES
from calib.correlation.modal.faults import Contribution, ModalFault
from calib.measurement.mac import is_real
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.problem.candidate import NOWHERE
from calib.problem.space import Parameter

EXCHANGED = "Every channel has the name of its own sensor."
"""What is assumed without an exchange of channels."""
CHECK_ORDER = "Check the order of the channels and the table of the sensors."
"""What to check of an exchange."""
QUADRATURE = ", in quadrature"
"""End of the name of a share of another mode that is turned by a right angle."""
_WHOLE = 0.1
"""Part of an exchange that may be missing where it is told as one."""


def exchanges(sensors: Sequence[Sensor]) -> Iterator[ModalFault]:
    """Exchanges of any two channels: each reads, at magnitude 1, the motion of the other in the place of its own."""
    for (i, a), (j, b) in itertools.combinations(enumerate(sensors), 2):
        name = f"exchange of sensors {a.name} and {b.name}"
        shares = (
            Contribution(i, a, factor=-1.0), Contribution(i, b), Contribution(j, b, factor=-1.0), Contribution(j, a)
        )  # fmt: skip
        yield ModalFault(
            Parameter(name, 0.0, 0.0, RULES.exchange_most, "-", prior_sd=1.0), name, EXCHANGED, CHECK_ORDER,
            partial(exchange_words, a.name, b.name), "exchange", f"{a.name} {b.name}", a.point or NOWHERE,
            of_pair=True, whole=True, shares=shares,
        )  # fmt: skip


def exchange_words(first: str, second: str, by: float) -> str:
    """A part of an exchange in words, such as ``sensors 11z and 12z are exchanged``."""
    if abs(by - 1) < _WHOLE:
        return f"sensors {first} and {second} are exchanged"
    return f"sensors {first} and {second} each read {100 * by:.2g} % of the other in the place of their own motion"


def exchanged_axes(sensors: Sequence[Sensor]) -> Iterator[ModalFault]:
    """Exchanges of two axes of one node with one sign reversed: a quarter turn of a sensor of several axes, either way.

    With both signs kept it is one of `exchanges`.
    """
    axes = {(s.node, s.direction): k for k, s in enumerate(sensors) if s.direction in DIRECTIONS[:3]}
    for (node, first), (other, second) in itertools.combinations(sorted(axes), 2):
        if node != other:
            continue
        i, j = axes[node, first], axes[node, second]
        a, b = sensors[i], sensors[j]
        for reverses in (b, a):
            name = f"exchange of axes of sensors {a.name} and {b.name}, {reverses.name} reversed"
            shares = (
                Contribution(i, a, factor=-1.0), Contribution(i, b, factor=1.0 if reverses is b else -1.0),
                Contribution(j, b, factor=-1.0), Contribution(j, a, factor=-1.0 if reverses is b else 1.0),
            )  # fmt: skip
            yield ModalFault(
                Parameter(name, 0.0, 0.0, RULES.exchange_most, "-", prior_sd=1.0), name,
                f"The sensors of node {node} measure along {first} and {second}.", "Check how they are mounted.",
                partial(axes_words, a, b, reverses), "axes", f"{a.name} {b.name}", a.point or NOWHERE,
                of_pair=True, whole=True, shares=shares,
            )  # fmt: skip


def axes_words(first: Sensor, second: Sensor, reverses: Sensor, by: float) -> str:
    """A part of an exchange of axes in words, such as ``sensor 3x measures along y and 3y along -x``."""
    along = [
        f"{'-' if s is reverses else ''}{axis}" for s, axis in ((first, second.direction), (second, first.direction))
    ]
    if abs(by - 1) < _WHOLE:
        return f"sensor {first.name} measures along {along[0]} and {second.name} along {along[1]}"
    return (
        f"sensors {first.name} and {second.name} each have {100 * by:.2g} % of the motion along {along[0]} and "
        f"{along[1]} in the place of their own"
    )


def mixed_modes(measured: MeasuredModes) -> Iterator[ModalFault]:
    """Shapes that hold a share of the mode before or after them, where its frequency is near enough to be mixed.

    What the analysis mixed is taken off the measured shape: the measured one of the other mode, times the magnitude.
    Only a shape of which the other mode has all sensors is taken to be mixed; a complex one also in quadrature, as the
    response of another mode beside its resonance is.
    """
    complex_shapes = ~is_real(measured.shapes)
    order, seen = np.argsort(measured.natural_freq, kind="stable"), np.isfinite(measured.shapes)
    for below, above in itertools.pairwise(order.tolist()):
        low, high = measured.natural_freq[[below, above]].tolist()
        if high - low > RULES.mixed_apart * 0.5 * (low + high):
            continue
        for i, j in ((below, above), (above, below)):
            if not seen[:, i].any() or (seen[:, i] & ~seen[:, j]).any():
                continue
            for way in ("", QUADRATURE) if complex_shapes[i] else ("",):
                mode, other = measured.names[i], measured.names[j]
                name, most = f"share of mode {other} in mode {mode}{way}", RULES.mixed_most
                yield ModalFault(
                    Parameter(name, 0.0, -most, most, "-", prior_sd=RULES.mixed), name,
                    "Every measured shape is that of one mode.",
                    "Check whether the analysis separates the two modes: its resolution, its order and its references.",
                    partial(mixed_words, mode, other), "mixed", of_pair=True, mixed=(mode, other, way),
                )  # fmt: skip


def mixed_words(mode: str, other: str, by: float) -> str:
    """A share of another mode in words, such as ``the shape of mode 2T is mixed: 20 % of it are of mode 3B``."""
    return f"the shape of mode {mode} is mixed with that of mode {other}, by {100 * abs(by):.2g} % of its size"
