"""A figure as SVG that stands in a page: text stays text, words appear under the mouse, and nothing clashes."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from itertools import groupby
from typing import Any
from urllib.parse import quote, unquote
from xml.etree import ElementTree

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image

_HOVER = "hover:"
"""Scheme of the addresses that carry words: Matplotlib writes an artist's address into the SVG and nothing else."""
_FAMILY = "'DejaVu Sans', Verdana, Arial, sans-serif"
"""Fonts of the same widths first, so that words keep their room."""
_FONT = re.compile(r"(font(?:-family)?:[^;]*?)'DejaVu Sans'[^;]*")
_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_GROUP, _TITLE, _DEFS = (f"{{{_SVG}}}{name}" for name in ("g", "title", "defs"))
_LINK = f"{{{_XLINK}}}href"
_EVENTS = "pointer-events"
"""Attribute that the parts of a group inherit."""
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_COMMAND = re.compile(r"\s*([A-Za-z])\s*")
"""Command of a path, with the room around it."""
_FINEST = re.compile(r"(\d+\.\d{2})\d+")
_ZEROS = re.compile(r"(?:\.00|(\.\d)0)(?!\d)")
"""Zeros at the end of two decimals."""
_SPACES = re.compile(" {2,}")
_NO_TURN = re.compile(r"\s*rotate\(-?0( [^)]*)?\)")


def hover(artist: Artist, *words: str) -> None:
    """Give an artist the words that appear under the mouse.

    Parameters
    ----------
    artist : Artist
    *words : str
        One text for the artist, or one for each member of a collection.
    """
    marked = [_HOVER + quote(text) for text in words]
    if isinstance(artist, Collection):
        artist.set_urls(marked)
    elif len(marked) == 1:
        artist.set_url(marked[0])
    else:
        raise ValueError("only a collection takes several texts")


def hover_cells(ax: Axes, words: Sequence[Sequence[str]]) -> None:
    """Give every cell of a matrix its words: ``words[i][j]`` those of row i, column j."""
    squares = [
        [(j - 0.5, i - 0.5), (j + 0.5, i - 0.5), (j + 0.5, i + 0.5), (j - 0.5, i + 0.5)]
        for i, row in enumerate(words)
        for j in range(len(row))
    ]
    # Seen by the mouse alone: what is not painted would get no words.
    cells = PolyCollection(
        squares, facecolors=(1.0, 1.0, 1.0, 0.0), linewidths=0.0, zorder=5, gid="cells", clip_on=False
    )
    hover(ax.add_collection(cells, autolim=False), *(text for row in words for text in row))


def hover_points(ax: Axes, x: ArrayLike, y: ArrayLike, words: Sequence[str]) -> None:
    """Give every point of a drawn line its words; points that are not finite have none."""
    at, high = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    known = np.flatnonzero(np.isfinite(at) & np.isfinite(high)).tolist()
    look: dict[str, Any] = {
        "facecolors": (1.0, 1.0, 1.0, 0.0),
        "linewidths": 0.0,
        "zorder": 6,
        "gid": "points",
        "clip_on": False,
    }
    if len(known):
        hover(ax.scatter(at[known], high[known], s=90, **look), *(words[k] for k in known))


def without_hover(figure: Figure) -> None:
    """Remove the words under the mouse from a figure whose format would make addresses of them."""
    for artist in figure.findobj():
        if isinstance(artist, Collection):
            artist.set_urls([])
        if str(artist.get_url() or "").startswith(_HOVER):
            artist.set_url(None)


def svg_text(figure: Figure, name: str) -> str:
    """Return a figure as an ``svg`` element.

    Parameters
    ----------
    figure : Figure
    name : str
        Identifier of the figure in its page; all identifiers in the element begin with it.

    Returns
    -------
    str
        An element without XML declaration, scripts or references to anything outside, as wide as its place.
    """
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        file = io.BytesIO()
        figure.savefig(file, format="svg", facecolor="none", metadata={"Date": None, "Creator": None})
    root = ElementTree.fromstring(file.getvalue())
    for parent in root.iter():
        for child in list(parent):
            if child.tag in (f"{{{_SVG}}}metadata", f"{{{_SVG}}}style"):  # the style would hold for the whole page
                parent.remove(child)
    _say_words(root)
    _own_names(root, name)
    for element in root.iter():
        _shorten(element.attrib)
        words = element.text if (element.text or "").strip() else None
        # A browser shows several spaces as one.
        element.text = words and _SPACES.sub(lambda found: "\u00a0" * len(found[0]), words)
        if not (element.tail or "").strip():
            element.tail = None
    _share_styles(root)
    for size in ("width", "height", "version"):
        root.attrib.pop(size, None)
    root.set("style", f"stroke-linejoin: round; stroke-linecap: butt; font-family: {_FAMILY}")
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", _XLINK)
    return ElementTree.tostring(root, encoding="unicode")


def _say_words(root: ElementTree.Element) -> None:
    """Turn addresses that carry words into groups with a title."""
    for element in root.iter(f"{{{_SVG}}}a"):
        words = element.attrib.get(_LINK, "")
        element.attrib.clear()
        element.tag = _GROUP
        if words.startswith(_HOVER):
            title = ElementTree.Element(_TITLE)
            title.text = unquote(words.removeprefix(_HOVER))
            element.insert(0, title)
            element.set(_EVENTS, "all")  # an area without paint has words too
    for parent in root.iter():
        same = list(parent)
        if len(same) > 1 and all(child.attrib.get(_EVENTS) for child in same):
            parent.set(_EVENTS, "all")
            for child in same:
                del child.attrib[_EVENTS]


def _own_names(root: ElementTree.Element, name: str) -> None:
    """Keep only identifiers that something refers to, numbered behind the name of the figure."""
    wanted = {v[1:] for e in root.iter() if (v := e.attrib.get(_LINK, "")).startswith("#")}
    wanted |= {found for e in root.iter() for value in e.attrib.values() for found in _REFERENCE.findall(value)}
    identifiers = [own for element in root.iter() if (own := element.attrib.get("id")) in wanted]
    new = {own: f"{name}-{number}" for number, own in enumerate(identifiers, 1)}
    for element in root.iter():
        own = element.attrib.pop("id", None)
        if own in new:
            element.set("id", new[own])
        for key, value in element.attrib.items():
            if key == _LINK and value.startswith("#"):
                element.set(key, f"#{new.get(value[1:], value[1:])}")
            elif "url(#" in value:
                element.set(key, _REFERENCE.sub(lambda found: f"url(#{new.get(found[1], found[1])})", value))


def _shorten(attributes: dict[str, str]) -> None:
    """Remove digits finer than a hundredth and zeros, turns by no angle, the font of the whole figure, and breaks."""
    if "d" in attributes:
        attributes["d"] = shorter(attributes["d"], attributes.get("style", ""))
    for key, value in [*attributes.items()]:
        if key in ("style", "d", "transform", "x", "y", "points"):
            value = _FINEST.sub(r"\1", value)
        if key == "style":
            each = _FONT.sub(rf"\g<1>{_FAMILY}", value).split("; ")
            value = "; ".join(one for one in each if one != f"font-family: {_FAMILY}")
        elif key == "transform":
            value = _NO_TURN.sub("", value)
        elif key == "d":
            value = _ZEROS.sub(r"\1", boxed(_COMMAND.sub(r"\1", value).strip()))
        elif key == _LINK:
            value = "".join(value.split())
            value = smaller(value) if value.startswith(PNG) else value
        if value:
            attributes[key] = value
        else:
            del attributes[key]


def _share_styles(parent: ElementTree.Element) -> None:
    """Write the style of neighbours once, in the group around them, and remove groups that say nothing."""
    children: list[ElementTree.Element] = []
    for child in parent:
        if child.tag == _GROUP:
            _share_styles(child)
        children += _opened(child)
    parent[:] = []
    for style, run in groupby(children, _inherited):
        same = list(run)
        if style and len(same) > 1:
            group = ElementTree.Element(_GROUP, {"style": style})
            for member in same:
                del member.attrib["style"]
                group.extend(_opened(member))
            same = [group]
        parent.extend(same)
    content = [child for child in parent if child.tag not in (_TITLE, _DEFS)]
    single = len(content) == 1 and parent.tag == _GROUP and "style" not in parent.attrib
    if single and (style := _inherited(content[0])):
        parent.set("style", style)
        del content[0].attrib["style"]
        parent[:] = [inner for child in parent for inner in _opened(child)]


def _opened(element: ElementTree.Element) -> list[ElementTree.Element]:
    """The members of a group without attributes and words, or the element."""
    plain = element.tag == _GROUP and not element.attrib and element.find(_TITLE) is None
    return list(element) if plain else [element]


def _inherited(element: ElementTree.Element) -> str:
    """The style of an element if a group can have it instead: the opacity of a group is not that of its members."""
    style = element.attrib.get("style", "")
    return "" if style.startswith("opacity:") or "; opacity:" in style else style


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
    corners, first = [0], 0
    for end in range(2, len(points)):
        way = points[end] - points[first]
        length = float(np.hypot(*way))
        away = points[first + 1 : end] - points[first]
        along = away @ way / length if length else np.zeros(len(away))
        across = np.abs(away @ (-way[1], way[0])) / length if length else np.full(len(away), np.inf)
        ordered = np.all(np.diff([0.0, *along, length]) >= 0)
        if not ordered or across.max() > _STRAIGHT:
            first = end - 1
            corners.append(first)
    return points[[*corners, len(points) - 1]]


def _path(points: NDArray[np.float64]) -> str:
    return "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points)


def smaller(picture: str) -> str:
    """Return an embedded PNG with its colours in a palette where they are few; every pixel stays the same."""
    with Image.open(io.BytesIO(base64.b64decode(picture.removeprefix(PNG)))) as source:
        pixels = np.array(source.convert("RGBA"))
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
