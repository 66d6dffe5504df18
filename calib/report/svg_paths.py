"""Paths and pictures of an SVG told in fewer bytes; what is seen stays the same."""

from __future__ import annotations

import base64
import io
import re
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from PIL import Image

_SUBPATH = re.compile(r"M[^M]*")
_NUMBER = re.compile(r"-?\d+\.?\d*(?:[eE]-?\d+)?")
_CIRCLE = re.compile(r"M[^A-Z]*(?:C[^A-Z]*){8}z\s*", re.IGNORECASE)
"""Eight cubic curves, of which Matplotlib makes a circle."""
_SEGMENTS = re.compile(r"M[^A-Za-z]*(?:L[^A-Za-z]*)+")
_X, _Y = r"-?[\d.]+", r" -?[\d.]+"
_FLAT_BOX = re.compile(rf"M({_X})({_Y})L({_X})\2L\3({_Y})L\1\4(?:L\1\2)?z")
_HIGH_BOX = re.compile(rf"M({_X})({_Y})L\1({_Y})L({_X})\3L\4\2(?:L\1\2)?z")
"""Closed boxes along the axes, whose first side is level or upright."""
_STRAIGHT = 0.005
"""Distance in points from a straight line below which a vertex on it is not seen: half of the last digit written."""
_COLOURS = 256
"""Colours that a PNG holds by their number."""
PNG = "data:image/png;base64,"


def shorter(path: str, style: str) -> str:
    """Return the data of a path with circles as arcs, and chained lines joined where nothing is filled or dashed.

    Parameters
    ----------
    path : str
        Attribute ``d``, with absolute coordinates as Matplotlib writes them.
    style : str
        Attribute ``style`` of the same element.
    """
    parts = [_arcs(part) if _CIRCLE.fullmatch(part) else part for part in _SUBPATH.findall(path)]
    if "fill: none" not in style or "dasharray" in style:
        return "".join(parts) or path
    out: list[str] = []
    for lines, run in groupby(parts, lambda part: _SEGMENTS.fullmatch(part) is not None):
        same = list(run)
        out += _joined([_points(part) for part in same]) if lines else same
    return "".join(out) or path


def boxed(path: str) -> str:
    """Return the data of a path with boxes along the axes told by their sides."""
    path = _FLAT_BOX.sub(lambda m: f"M{m[1]}{m[2]}H{m[3]}V{m[4].strip()}H{m[1]}z", path)
    return _HIGH_BOX.sub(lambda m: f"M{m[1]}{m[2]}V{m[3].strip()}H{m[4]}V{m[2].strip()}z", path)


def _points(part: str) -> NDArray[np.float64]:
    """Points of a subpath, ``(n, 2)``."""
    return np.array([float(number) for number in _NUMBER.findall(part)]).reshape(-1, 2)


def _arcs(part: str) -> str:
    """A circle as two arcs, or the subpath if its curves are none."""
    ends = _points(part)[::3]
    if len(ends) != 9:
        return part
    centre = ends[:8].mean(axis=0)
    radii = np.hypot(*(ends - centre).T)
    radius = radii.mean()
    if not np.allclose(radii, radius, rtol=1e-3, atol=1e-5):
        return part
    (x, y), r = centre - (radius, 0.0), f"{radius:.2f}"
    return f"M{x:.2f} {y:.2f}a{r} {r} 0 1 0 {2 * radius:.2f} 0a{r} {r} 0 1 0 {-2 * radius:.2f} 0z"


def _joined(lines: list[NDArray[np.float64]]) -> list[str]:
    """Lines each of which goes on where the last one ended, as one; vertices on a straight line are left out."""
    chains = [[lines[0]]]
    for line in lines[1:]:
        if np.array_equal(chains[-1][-1][-1], line[0]):
            chains[-1].append(line[1:])
        else:
            chains.append([line])
    return [_path(_straightened(np.concatenate(chain))) for chain in chains]


def _straightened(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points without those that lie, in order, on the straight line between their neighbours that are kept."""
    kept, first = [0], 0
    for end in range(2, len(points)):
        way = points[end] - points[first]
        length = float(np.hypot(*way))
        away = points[first + 1 : end] - points[first]
        along = away @ way / length if length else np.zeros(len(away))
        across = np.abs(away @ (-way[1], way[0])) / length if length else np.full(len(away), np.inf)
        ordered = np.all(np.diff([0.0, *along, length]) >= 0)
        if not ordered or across.max() > _STRAIGHT:
            first = end - 1
            kept.append(first)
    return points[[*kept, len(points) - 1]]


def _path(points: NDArray[np.float64]) -> str:
    return "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points)


def smaller(picture: str) -> str:
    """Return an embedded PNG with its colours in a palette where they are few; every pixel stays the same."""
    with Image.open(io.BytesIO(base64.b64decode(picture.removeprefix(PNG)))) as given:
        pixels = np.array(given.convert("RGBA"))
    # As one number a pixel: rows are compared far more slowly.
    found, numbers = np.unique(pixels.view(np.uint32).ravel(), return_inverse=True)
    if len(found) > _COLOURS:
        return picture
    colours = found.view(np.uint8).reshape(-1, 4)
    image = Image.fromarray(numbers.reshape(pixels.shape[:2]).astype(np.uint8), "P")
    image.putpalette(colours[:, :3].tobytes())
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True, transparency=colours[:, 3].tobytes())
    made = PNG + base64.b64encode(file.getvalue()).decode("ascii")
    return min(made, picture, key=len)
