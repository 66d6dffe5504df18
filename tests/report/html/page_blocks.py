"""Parts of a page as a reader finds them: paragraphs, definitions, tables and figures, read from its sections."""

from dataclasses import dataclass, field
from html.parser import HTMLParser

from calib.report.html.write import sections


@dataclass(frozen=True)
class Words:
    """A paragraph; its kind is ``plain``, ``reported``, ``warning`` or ``verdict``."""

    text: str
    kind: str = "plain"


@dataclass(frozen=True)
class Terms:
    """Definitions: (term, meaning)."""

    pairs: tuple[tuple[str, str], ...]


@dataclass
class Table:
    """A table with its headings, rows, and the numbers of the rows in grey."""

    folded: bool
    caption: str = ""
    heads: list[str] = field(default_factory=list)
    rows: list[tuple[str, ...]] = field(default_factory=list)
    grey: list[int] = field(default_factory=list)


@dataclass
class Figure:
    """Any figure; ``folded`` is what is shown before it is unfolded."""

    name: str
    folded: str
    alt: str = ""
    caption: str = ""
    tables: list[str] = field(default_factory=list)


class Picture(Figure):
    """A figure that is drawn."""


class Viewer(Figure):
    """A figure that a script draws: one that can be turned, or whose axes can be brushed."""


class _Parser(HTMLParser):
    """Collects the blocks of one section."""

    def __init__(self, body):
        super().__init__()
        self.blocks, self._summary, self._text, self._figure, self._captioned = [], "", [], False, False
        self.feed(str(body))

    def handle_starttag(self, tag, attributes):
        found, self._text = dict(attributes), []
        if tag == "details":
            self._summary = "folded"
        elif tag == "figure":
            kind = Viewer if found.get("class") in ("viewer", "parallel") else Picture
            self.blocks.append(kind(found["id"], self._summary))
            self._figure = True
        elif tag == "table":
            self.blocks.append(Table(bool(self._summary)))
        elif tag == "dl":
            self.blocks.append(Terms(()))
        elif tag == "p":
            self._kind = found.get("class", "")
        elif tag == "tr":
            self._row = []
            if found.get("class") == "unseen":
                self.blocks[-1].grey.append(len(self.blocks[-1].rows))
        elif tag == "figcaption":
            self._captioned = True
        elif tag == "span":  # the files behind the caption
            self._captioned = False
        elif found.get("role") == "img":
            self.blocks[-1].alt = found["aria-label"]
        elif tag == "a" and "download" in found:
            self.blocks[-1].tables.append(found["download"].removesuffix(".csv"))

    def handle_data(self, words):
        self._text.append(words)
        if self._captioned:
            self.blocks[-1].caption += words

    def handle_endtag(self, tag):
        text, block = " ".join("".join(self._text).split()), self.blocks[-1] if self.blocks else None
        if tag == "details":
            self._summary = ""
        elif tag == "summary":
            self._summary = text
        elif tag == "p" and not self._figure:
            self.blocks.append(Words(text, self._kind))
        elif tag == "dt":
            self._term = text
        elif tag == "dd":
            self.blocks[-1] = Terms((*block.pairs, (self._term, text)))
        elif tag == "caption":
            block.caption = text
        elif tag in ("td", "th"):
            self._row.append(text)
        elif tag == "tr":
            if block.heads:
                block.rows.append(tuple(self._row))
            else:
                block.heads = self._row
        elif tag == "figure":
            self._figure = False
        elif tag == "figcaption":
            self._captioned = False
            block.caption = " ".join(block.caption.split()).split(". ", 1)[1]


def section_blocks(section):
    """The blocks of one section."""
    return _Parser(section.body).blocks


def page_blocks(results):
    """All blocks of the page of these results, in their order."""
    return [block for section in sections(results) for block in section_blocks(section)]
