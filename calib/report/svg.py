"""A figure as SVG that stands in a page: text stays text, words appear under the mouse, and nothing clashes."""

from __future__ import annotations

import io
import re
from urllib.parse import quote, unquote
from xml.etree import ElementTree

import matplotlib
from matplotlib.artist import Artist
from matplotlib.collections import Collection
from matplotlib.figure import Figure

_HOVER = "hover:"
"""Scheme of the addresses that carry words: Matplotlib writes an artist's address into the SVG and nothing else."""
_FAMILY = "'DejaVu Sans', Verdana, Arial, sans-serif"
"""Fonts of the same widths first, so that words keep their room."""
_FONT = re.compile(r"(font(?:-family)?:[^;]*?)'DejaVu Sans'[^;]*")
_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_FINEST = re.compile(r"(\d+\.\d{2})\d+")


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
        for key in ("style", "d", "transform", "x", "y", "points"):
            if key in element.attrib:
                element.set(key, _FINEST.sub(r"\1", _FONT.sub(rf"\g<1>{_FAMILY}", element.attrib[key])))
    for size in ("width", "height", "version"):
        root.attrib.pop(size, None)
    root.set("style", "stroke-linejoin: round; stroke-linecap: butt")
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", _XLINK)
    return ElementTree.tostring(root, encoding="unicode")


def _say_words(root: ElementTree.Element) -> None:
    """Turn addresses that carry words into groups with a title."""
    address = f"{{{_XLINK}}}href"
    for element in root.iter(f"{{{_SVG}}}a"):
        words = element.attrib.get(address, "")
        element.attrib.clear()
        element.tag = f"{{{_SVG}}}g"
        if words.startswith(_HOVER):
            title = ElementTree.Element(f"{{{_SVG}}}title")
            title.text = unquote(words.removeprefix(_HOVER))
            element.insert(0, title)


def _own_names(root: ElementTree.Element, name: str) -> None:
    """Keep only identifiers that something refers to, each beginning with the name of the figure."""
    link = f"{{{_XLINK}}}href"
    wanted = {v[1:] for e in root.iter() if (v := e.attrib.get(link, "")).startswith("#")}
    wanted |= {found for e in root.iter() for value in e.attrib.values() for found in _REFERENCE.findall(value)}
    for element in root.iter():
        own = element.attrib.get("id")
        if own in wanted:
            element.set("id", f"{name}-{own}")
        elif own is not None:
            del element.attrib["id"]
        for key, value in element.attrib.items():
            if key == link and value.startswith("#"):
                element.set(key, f"#{name}-{value[1:]}")
            elif "url(#" in value:
                element.set(key, _REFERENCE.sub(rf"url(#{name}-\1)", value))
