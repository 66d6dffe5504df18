"""Style of all figures: colours, sizes and heading; saving leaves no half-written file."""

from __future__ import annotations

import contextlib
import io
import math
import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Literal, TypeAlias

import matplotlib
import numpy as np
from matplotlib import font_manager
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter
from PIL import Image

from calib.report.kept import FORMATS, Format
from calib.report.svg import svg_text, without_hover
from calib.results.written import replacing

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
"""Palette that colour-blind readers can tell apart (Okabe and Ito, 2008)."""

BEFORE, AFTER, WITH, MEASURED = ORANGE, BLUE, GREEN, VERMILLION
"""Colours of the model at its nominal values, calibrated, and calibrated with added effects; of the measurement."""
CASES = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, BLACK, YELLOW)
GREY, REST = "#767676", "#BDBDBD"
ATTEMPT: dict[str, Any] = {"facecolor": "#D0D0D0", "hatch": "xxxx", "edgecolor": "white"}
"""Look of an attempt that is not believed."""
WIDTH = 190.0 / 25.4
"""Width of a figure in inches: 190 mm, that of a journal's page (two columns), so that text prints at its own size."""
COLUMN = 90.0 / 25.4
"""Width in inches of one of the two columns."""
HIGHEST = 240.0 / 25.4
"""Height in inches of a page."""
Width: TypeAlias = Literal["page", "column"]
WIDTHS: dict[Width, float] = {"page": WIDTH, "column": COLUMN}
_width: ContextVar[float] = ContextVar("width", default=WIDTH)
DPI = 160
_ABREAST = 4
"""Largest number of equal panels side by side."""
DENSE = 50
"""Dots of one panel from which they are painted as pixels in SVG and PDF: as shapes they would make these large."""
SYNTHETIC = "synthetic measurement"

FALLBACKS = (
    *("Noto Sans CJK SC", "Noto Sans SC", "Source Han Sans SC", "Microsoft YaHei", "SimHei", "PingFang SC"),
    *("Hiragino Sans GB", "WenQuanYi Micro Hei", "WenQuanYi Zen Hei", "Yu Gothic", "Malgun Gothic", "Arial Unicode MS"),
)
"""Fallback fonts for characters that the first font lacks; the installed ones are used."""
NO_GLYPH = "boxes stand for characters that no font of this machine has"
_POWER = re.compile(r"\$\\mathdefault\{[^$]*\}\$")
"""Tick label that Matplotlib itself writes at a logarithmic axis."""

_TOGETHER = re.compile(
    r" (?=[=≤≥<>±−] |\([–%σ]\))|(?<= [=≤≥<>±−]) "  # signs between words, and a unit in brackets
    r"|(?<=\d) (?=[%σ]|Hz\b|[A-Za-z][A-Za-z/]{0,7}$)|(?<=\d,) (?=[+−]?\d)|(?<=\)) (?=m\b)"
)
"""Spaces within coordinates, or a number with what belongs to it, at which no line ends."""

SETTINGS: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.6,
    "axes.unicode_minus": True,
}


SMALLER: Any = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
}
"""Sizes of text in a column."""


@contextlib.contextmanager
def style(width: float = WIDTH) -> Iterator[None]:
    """Apply the settings of the figures on top of Matplotlib's defaults, not of the user's own file.

    New figures have that width, in inches.
    """
    before = _width.set(width)
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(SETTINGS if width > COLUMN else SETTINGS | SMALLER)
        known = set(font_manager.get_font_names())
        matplotlib.rcParams["font.family"] = [SETTINGS["font.family"], *(f for f in FALLBACKS if f in known)]
        try:
            yield
        finally:
            _width.reset(before)


def new_figure(height: float) -> Figure:
    """Return an empty figure without a window of that height in inches, as wide as `style` says."""
    return Figure(figsize=(_width.get(), height), dpi=DPI, layout="constrained")


def room(count: float) -> float:
    """How many of what a page has room for side by side fit into the width that `style` says."""
    return count * _width.get() / WIDTH


def new_panels(count: int, height: float, beside: float) -> tuple[Figure, np.ndarray]:
    """Return an empty figure of equal panels, at most four abreast, and the panels (n_down, n_across).

    Spare panels are hidden. ``height`` is that of a row of panels, ``beside`` that of what stands above and below them,
    in inches.
    """
    across = min(_ABREAST, max(count, 1))
    down = math.ceil(max(count, 1) / across)
    figure = new_figure(beside + height * down)
    panels = figure.subplots(down, across, squeeze=False)
    for ax in panels.flat[count:]:
        ax.set_visible(False)
    return figure, panels


def own_axes(ax: Axes | None, height: float) -> Axes:
    """Return the given Axes, or the only one of a new figure of that height in inches."""
    return new_figure(height).add_subplot() if ax is None else ax


def plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis of few decades with plain numbers, such as 0.02, not 2 × 10⁻²."""
    axis.set_major_formatter(_PlainNumbers(labelOnlyBase=True))
    axis.set_minor_formatter(_PlainNumbers(labelOnlyBase=False))


class _PlainNumbers(LogFormatter):
    """The ticks that Matplotlib would label, with plain numbers."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{x:.3g}" if super().__call__(x, pos) else ""


def fill(words: str, letters: int, **looks: Any) -> str:
    """Break words into lines of so many letters; a number keeps its sign of relation, its unit and its ``(–)``."""
    whole = _TOGETHER.sub("\xa0", words)
    if max(map(len, whole.replace("\n", " ").split(" "))) > letters:
        whole = words
    return textwrap.fill(whole, letters, **looks).replace("\xa0", " ")


def broken(label: str, letters: int = 36) -> str:
    """A label of a legend, broken where it is too long: after so many letters in a column."""
    return fill(label, letters if in_column() else 96)


def legend_above(ax: Axes, handles: list[Artist] | None = None) -> None:
    """Put the legend above the Axes, left-aligned, in as many columns as its labels allow; long ones are broken."""
    shown = ax.get_legend_handles_labels()[0] if handles is None else handles
    labels = [broken(str(h.get_label())) for h in shown]
    longest = max((len(line) for label in labels for line in label.split("\n")), default=1)
    columns = max(1, min(len(shown), int(room(105) / (longest + 9))))
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    ax.legend(shown, labels, ncols=columns, **place)


def stage_words(stage: str, effects: str = "") -> str:
    """Describe the model of a stage: ``before`` or ``after`` its calibration, or ``added``, calibrated with effects.

    Where effects were added, the words tell the calibration without them from that with them.
    """
    if not effects:
        return f"{stage} calibration"
    return {
        "before": "nominal values",
        "after": f"calibrated without {effects}",
        "added": f"calibrated with {effects}",
    }[stage]


def added(stage: str, name: str = "") -> str:
    """Describe a fit of an explanation: ``base``, or by the effects added to the model as it is, where known."""
    if stage == "base":
        return f"without {name}, calibrated" if name else "model as it is, calibrated"
    if stage == "attempt":
        return f"with {name}: best attempt, not believed" if name else "with the best attempt, not believed"
    return f"with {name or 'the missing effect'}, calibrated"


def plain(value: float) -> str:
    """Format with four significant digits, without an exponent where that stays readable."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def figure_width() -> float:
    """Width of new figures in inches."""
    return _width.get()


def in_column() -> bool:
    """Whether new figures are as narrow as a column."""
    return _width.get() <= COLUMN


def bar_beside(axes: Any, image: ScalarMappable, label: str, aspect: int = 40) -> Colorbar:
    """Add a colour bar at the right of one or several Axes; in a column, which is narrow, below them."""
    figure, place = np.ravel(axes)[0].figure, "bottom" if in_column() else "right"
    return figure.colorbar(image, ax=axes, label=label, fraction=0.04, pad=0.02, aspect=aspect, location=place)


def matrix_height(rows: int, columns: int) -> float:
    """Height in inches of a matrix with a number in each cell and upright column labels."""
    return float(np.clip(0.34 * rows, 1.2, 9.0)) + (1.4 if columns > 6 else 0.9)


def separate_cells(ax: Axes, rows: int, columns: int) -> None:
    """Draw white lines between the cells of a matrix and remove its frame."""
    ax.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    ax.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
    ax.grid(which="minor", color="white", linewidth=1.2)
    ax.tick_params(which="both", length=0)
    ax.spines[:].set_visible(False)


def add_heading(figure: Figure, title: str, synthetic: bool) -> None:
    """Write the title above the figure and, for a synthetic measurement, the label `SYNTHETIC` below the title.

    The figure grows by the height of the heading, which therefore covers nothing.
    """
    width, height = figure.get_size_inches()
    lines = textwrap.wrap(title, max(10, int(width * 10.5))) or [""]
    text, mark = 0.22 * len(lines) + 0.08, 0.3 if synthetic else 0.0
    total = height + text + mark
    figure.set_size_inches(width, total)
    top = 1.0 - (text + mark) / total
    left = 0.1 / width
    figure.text(left, 1.0 - 0.07 / total, "\n".join(lines), ha="left", va="top", fontsize=11, fontweight="bold")
    if synthetic:
        figure.text(
            left + 0.05 / width,
            1.0 - (text + 0.07) / total,
            SYNTHETIC,
            ha="left",
            va="top",
            fontsize=8.5,
            bbox={"boxstyle": "round,pad=0.2", "facecolor": "#FFF4E5", "edgecolor": VERMILLION, "linewidth": 0.8},
        )
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0.0, 0.0, 1.0, top), w_pad=0.07, h_pad=0.06)  # type: ignore[call-arg]
    else:
        figure.subplots_adjust(top=top)


def save(figure: Figure, stem: Path, formats: Sequence[Format] = ("png",)) -> list[Path]:
    """Save in each format, as ``stem`` with its suffix; see `content` and `write`."""
    return write(content(figure, stem.name, formats), stem)


def write(files: Mapping[Format, bytes], stem: Path) -> list[Path]:
    """Write pictures as ``stem`` with the suffix of each; an interruption leaves the old picture or none."""
    written = []
    for kind, picture in files.items():
        path = stem.with_name(f"{stem.name}.{kind}")
        with replacing(path) as draft:
            draft.write_bytes(picture)
        written.append(path)
    return written


def content(figure: Figure, name: str, formats: Sequence[Format], key: str = "") -> dict[Format, bytes]:
    """Content of a picture's file in each format.

    Dollar signs in names are literal. A note is added where no font has a character of a name. A PNG bears the key of
    what it shows, which `picture_key` reads.
    """
    take_dollars_literally(figure)
    files: dict[Format, bytes] = {}
    for kind in sorted(formats, key=FORMATS.index):
        if kind == "svg":
            files[kind] = svg_text(figure, name).encode()
            continue
        files[kind], lacking = _picture(figure, kind, key)
        if lacking:
            figure.text(0.995, 0.003, NO_GLYPH, ha="right", va="bottom", fontsize=6.5, color=GREY)
            files[kind], _ = _picture(figure, kind, key)
    return files


_KEY = "Source"
"""Entry of a PNG with the key of what it shows."""


def picture_key(path: Path) -> str:
    """The key that a PNG bears; empty for any other file."""
    try:
        with Image.open(path) as picture:
            return str(picture.info.get(_KEY, ""))
    except (OSError, ValueError, SyntaxError):
        return ""


def picture_width(path: Path) -> float:
    """Width in inches of a PNG that `content` made: that of a page or of a column."""
    with Image.open(path) as picture:
        return min((WIDTH, COLUMN), key=lambda width: abs(width * DPI - picture.width))


def take_dollars_literally(figure: Figure) -> None:
    """Keep the dollar signs of names from being read as formulas."""
    for text in visible_texts(figure):
        if "$" in text.get_text() and not _POWER.fullmatch(text.get_text()):
            text.set_parse_math(False)


def visible_texts(artist: Artist) -> Iterator[Text]:
    """Every text below; of axes that are switched off only what stands in their panel.

    To look for the ticks of an axis is to make them, which takes longer than to draw a three-dimensional panel.
    """
    if isinstance(artist, Text):
        yield artist
    hidden = isinstance(artist, Axes) and not artist.axison
    for child in artist.get_children():
        if not (hidden and isinstance(child, Axis)):
            yield from visible_texts(child)


def _picture(figure: Figure, kind: str, key: str) -> tuple[bytes, bool]:
    """A picture, and whether a font lacked a character."""
    if kind == "pdf":
        without_hover(figure)  # addresses would become links
    file = io.BytesIO()
    with warnings.catch_warnings(record=True) as caught, matplotlib.rc_context({"pdf.fonttype": 42}):
        warnings.simplefilter("always")
        metadata = {_KEY: key} if key and kind == "png" else None
        figure.savefig(file, format=kind, dpi=DPI, facecolor="white", metadata=metadata)
    missing = [w for w in caught if "missing from font" in str(w.message)]
    for other in caught:
        if other not in missing:
            warnings.warn_explicit(other.message, other.category, other.filename, other.lineno)
    return file.getvalue(), bool(missing)


def owner_of(ax: Axes) -> Figure:
    """Return the figure that Axes were created in."""
    figure = ax.get_figure(root=True)
    assert figure is not None  # these Axes were created in one
    return figure
