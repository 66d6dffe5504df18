"""Side-by-side timing: tasks take turns, so that a busy machine slows all of them alike, and ratios are of one turn."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

Point = Mapping[str, float]
Task = Callable[[Point], object]


class Spent(NamedTuple):
    """Wall-clock and processor seconds; the latter of this process and of children that have ended."""

    wall: float
    cpu: float


def spent(task: Callable[[], object]) -> Spent:
    """What one call takes."""
    wall, cpu = time.perf_counter(), _processor()
    task()
    return Spent(time.perf_counter() - wall, _processor() - cpu)


def median(some: Sequence[Spent]) -> Spent:
    """Of wall and processor time apart."""
    wall, cpu = np.median(np.array(some), axis=0)
    return Spent(float(wall), float(cpu))


def exponent(sizes: Sequence[float], taken: Sequence[Spent]) -> Spent:
    """Of the growth ``taken ~ sizes**exponent`` from the first to the last, of wall and processor time apart."""
    wide = np.log(sizes[-1] / sizes[0])
    return Spent(*(float(np.log(last / first) / wide) for first, last in zip(taken[0], taken[-1], strict=True)))


def in_turn(tasks: Mapping[str, Task], points: Sequence[Point]) -> dict[str, list[Spent]]:
    """What every task takes at every point; at each point all of them, one after the other."""
    times: dict[str, list[Spent]] = {name: [] for name in tasks}
    for values in points:
        for name, task in tasks.items():
            times[name].append(spent(lambda task=task, values=values: task(values)))
    return times


HEADER = ("", "wall ms", "processor ms", "over the first, wall", "over the first, processor")
"""Of `compared`."""


def compared(times: Mapping[str, Sequence[Spent]]) -> list[tuple[str, ...]]:
    """A row a task: minimum / median / maximum of its milliseconds and of its ratios to the first task."""
    walls, cpus = ({name: np.array([s[k] for s in some]) for name, some in times.items()} for k in (0, 1))
    first = next(iter(times))
    rows = []
    for name in times:
        rows.append(
            (
                name, spread(1e3 * walls[name]), spread(1e3 * cpus[name]), spread(walls[name] / walls[first]),
                spread(cpus[name] / cpus[first]),
            )
        )  # fmt: skip
    return rows


def spread(numbers: np.ndarray) -> str:
    """Minimum / median / maximum."""
    return " / ".join(short(v) for v in (numbers.min(), np.median(numbers), numbers.max()))


def short(value: float) -> str:
    """Three digits."""
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def _processor() -> float:
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime
