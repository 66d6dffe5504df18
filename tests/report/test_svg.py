"""Figures as SVG in a page."""

import io
import re
from xml.etree import ElementTree

import matplotlib
import pytest
from matplotlib.patches import Rectangle

from calib.report.style import new_figure, save, style
from calib.report.svg import hover, hover_cells, hover_points, svg_text

ODD = "</svg><script>x</script> & \u0022'\u00b5' % 100:/?#"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def figure():
    """A bar, a line with a clip path, markers and text, all with words under the mouse."""
    with style():
        drawn = new_figure(2.0)
        ax = drawn.add_subplot()
        (bar,) = ax.bar([0], [1], label="bar")
        hover(bar, ODD)
        ax.plot([0, 1, 2], [0.5, float("nan"), 5.0], "o-")
        hover_points(ax, [0, 1, 2], [0.5, float("nan"), 5.0], ["first", "gap", "last"])
        hover_cells(ax, [["a1", "a2"], ["b1", "b2"]])
        ax.set_ylim(0, 2)
        ax.set_title(ODD)
        yield drawn


def titles(text):
    return [element.text for element in ElementTree.fromstring(text).iter(f"{SVG}title")]


def test_words_appear_under_the_mouse_as_they_are_given(figure):
    found = titles(svg_text(figure, "one"))
    assert found.count(ODD) == 1 and {"a1", "a2", "b1", "b2", "first"} <= set(found) and "gap" not in found
    assert "hover:" not in svg_text(figure, "one")


def test_text_stays_text_and_nothing_points_outside(figure):
    text = svg_text(figure, "one")
    root = ElementTree.fromstring(text)
    assert ODD in [element.text for element in root.iter(f"{SVG}text")]
    assert "<script" not in text and not re.search(r"(?<!xmlns)(?<!xmlns:xlink)=.https?:", text)
    assert (
        not list(root.iter(f"{SVG}style")) and not list(root.iter(f"{SVG}a")) and not list(root.iter(f"{SVG}metadata"))
    )
    assert "viewBox" in root.attrib and "width" not in root.attrib


def test_spaces_keep_words_apart(figure):
    figure.axes[0].set_title("1BT   10.82 Hz, one space here")
    shown = [element.text for element in ElementTree.fromstring(svg_text(figure, "one")).iter(f"{SVG}text")]
    assert "1BT\u00a0\u00a0\u00a010.82 Hz, one space here" in shown


def looks(element, around):
    """Tag and resolved style of everything that is drawn, without the font that all texts have."""
    own = {**around, **dict(part.split(": ") for part in element.get("style", "").split("; ") if part)}
    own.pop("font-family", None)
    if element.tag.removeprefix(SVG) in ("path", "use", "text", "tspan", "image"):
        yield element.tag, own
    for child in element:
        if child.tag != f"{SVG}defs":
            yield from looks(child, {name: value for name, value in own.items() if name != "opacity"})


@pytest.mark.medium
def test_everything_has_the_style_that_matplotlib_gives_it(figure):
    (ax,) = figure.axes
    ax.set_yscale("log")  # powers of ten are formulas
    ax.bar([1, 2], [1, 1], alpha=0.5)
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure.savefig(file, format="svg", facecolor="none")
    given, written = ElementTree.fromstring(file.getvalue()), ElementTree.fromstring(svg_text(figure, "one"))
    written.attrib.pop("style")  # that of Matplotlib's style sheet
    wanted = list(looks(given, {}))
    assert list(looks(written, {})) == wanted
    formulas = [{part.tag for part in text} for text in written.iter(f"{SVG}text") if len(text)]
    assert formulas and all(tags == {f"{SVG}tspan"} for tags in formulas)
    assert any("opacity" in style for _, style in wanted)
    assert len(list(written.iter(f"{SVG}g"))) < len(list(given.iter(f"{SVG}g"))) / 2
    assert all(group.attrib or group.find(f"{SVG}title") is not None for group in written.iter(f"{SVG}g"))


def test_parts_without_paint_have_their_words_too(figure):
    """The property is inherited, so that a group of such parts has it once; every part keeps its own words."""
    (ax,) = figure.axes
    ax.set(xlim=(-1, 2), ylim=(-1, 2))
    hover_cells(ax, [["a", "b"], ["c", "d"]])
    root = ElementTree.fromstring(svg_text(figure, "one"))
    above = {child: parent for parent in root.iter() for child in parent}
    parts = [above[title] for title in root.iter(f"{SVG}title") if title.text in ("a", "b", "c", "d")]
    assert [part[0].text for part in parts] == ["a", "b", "c", "d"] and len(set(map(id, parts))) == 4
    assert all(len(part.findall(f"{SVG}title")) == 1 and part.find(f"{SVG}path") is not None for part in parts)
    assert len({id(above[part]) for part in parts}) == 1 and above[parts[0]].get("pointer-events") == "all"
    assert all("pointer-events" not in part.attrib for part in parts)


def test_identifiers_of_two_figures_in_a_page_never_clash(figure):
    first, second = (svg_text(figure, name) for name in ("one", "two"))
    names = [set(re.findall(r' id="([^"]*)"', text)) for text in (first, second)]
    assert names[0] and not names[0] & names[1]
    for text, own in zip((first, second), names, strict=True):
        assert set(re.findall(r'(?:href="|url\()#([^")]*)', text)) == own


@pytest.mark.medium
def test_the_same_figure_gives_the_same_text(figure):
    assert svg_text(figure, "one") == svg_text(figure, "one")


def test_only_a_collection_takes_several_words():
    with pytest.raises(ValueError, match="collection"):
        hover(Rectangle((0, 0), 1, 1), "one", "two")


@pytest.mark.medium
def test_every_format_is_written_and_a_pdf_has_no_links(figure, tmp_path):
    with matplotlib.rc_context({"pdf.compression": 0}):
        written = save(figure, tmp_path / "drawn", ("pdf", "png", "svg"))
    assert [path.name for path in written] == ["drawn.svg", "drawn.png", "drawn.pdf"]
    assert written[1].read_bytes().startswith(b"\x89PNG") and ElementTree.parse(written[0]).getroot().tag == f"{SVG}svg"
    assert ODD in titles(written[0].read_text(encoding="utf-8"))
    assert written[2].read_bytes().startswith(b"%PDF") and b"/URI" not in written[2].read_bytes()
