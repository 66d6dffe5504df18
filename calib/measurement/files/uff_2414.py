"""Mode shapes in datasets 2414 (analysis data), converted to equivalent datasets 55."""

from __future__ import annotations

import math
from pathlib import Path

from calib.measurement.files.uff_blocks import MODAL, Dataset

_AT_NODES = 1
_MOTIONS = (0, 8, 11, 12, 93, 95, 96)
"""Result types that may be shapes: displacement, velocity, acceleration, or not stated."""
_COMPONENTS = {3: 2, 6: 3}
"""Values a node, and the data characteristic of dataset 55 that goes with them."""
_COMPLEX = {2: False, 4: False, 5: True, 6: True}
"""Data types that can be read: single and double precision, real and complex."""
_UNREADABLE = "the dataset 2414 that starts here cannot be read"


def as_dataset_55(path: Path, block: Dataset) -> Dataset | None:
    """The dataset 55 equivalent to a dataset 2414, or None for one that holds no mode shape.

    Modes are analysis types 2 (frequency in Hz, modal mass, viscous and hysteretic damping ratio), 3 and 7 (eigenvalue
    in rad/s), with three or six components of motion a node. Values keep six digits, as dataset 55 does.

    Raises
    ------
    InputError
        When such a dataset is damaged.
    """
    try:
        head = _whole(block.lines[8], 6)
        location = _whole(block.lines[2], 1)[0]
    except (ValueError, IndexError):
        raise block.error(path, _UNREADABLE, "export it again") from None
    analysis, result, data, width = head[1], head[3], head[4], head[5]
    if analysis not in MODAL or location != _AT_NODES or result not in _MOTIONS:
        return None
    if width not in _COMPONENTS or data not in _COMPLEX:
        raise block.error(
            path,
            f"the dataset 2414 that starts here has {width} values a node of data type {data}",
            "export 3 or 6 components of motion, real or complex",
        )
    try:
        integers = _whole(block.lines[9], 8)
        reals = _reals(block.lines[11])
        eigenvalues = _reals(block.lines[12])
        numbers = [*reals[1:2], *reals[3:6]] if analysis == 2 else eigenvalues[:6]
        # dataset 55 counts what follows; the load set and the number of the mode are in other columns
        second = [2, 4 if analysis == 2 else 6, integers[4], integers[5]]
        size = width * (2 if _COMPLEX[data] else 1)
        body = _body(block.lines[13:], size)
    except (ValueError, IndexError):
        raise block.error(path, _UNREADABLE, "export it again") from None
    lines = [
        *block.lines[3:8],
        "".join(f"{n:10d}" for n in (head[0], analysis, _COMPONENTS[width], 8, 5 if _COMPLEX[data] else 2, width)),
        "".join(f"{n:10d}" for n in second),
        "".join(f"{x:13.5e}" for x in numbers),
    ]
    for node, values in body:
        lines.append(f"{node:10d}")
        lines += ["".join(f"{x:13.5e}" for x in values[k : k + 6]) for k in range(0, size, 6)]
    return Dataset(55, block.line, tuple(lines), block)


def _whole(line: str, count: int) -> list[int]:
    """Integers in columns of ten; blank ones are 0."""
    cells = [line[10 * k : 10 * (k + 1)].strip() for k in range(count)]
    return [int(cell or 0) for cell in cells]


def _reals(line: str) -> list[float]:
    """Six numbers in columns of 13, or separated by blanks where the columns are wider; blank ones are 0."""
    if len(line.rstrip()) > 78:
        return [float(cell) for cell in line.split()]
    return [float(line[13 * k : 13 * (k + 1)].strip() or 0) for k in range(6)]


def _body(lines: tuple[str, ...], size: int) -> list[tuple[int, list[float]]]:
    """Node labels with their values, however many lines these take."""
    out: list[tuple[int, list[float]]] = []
    rest = [line for line in lines if line.strip()]
    at = 0
    while at < len(rest):
        node = int(rest[at][:10])
        at += 1
        values: list[float] = []
        while len(values) < size:
            values += _numbers(rest[at])
            at += 1
        if len(values) != size or not all(map(math.isfinite, values)):
            raise ValueError("not the number of values that was announced")
        out.append((node, values))
    return out


def _numbers(line: str) -> list[float]:
    """Numbers of one line: separated by blanks, or in columns of 13 where a minus sign fills the gap."""
    try:
        return [float(cell) for cell in line.split()]
    except ValueError:
        text = line.rstrip()
        return [float(text[k : k + 13]) for k in range(0, len(text), 13)]
