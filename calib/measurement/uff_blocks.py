"""Datasets of a universal file as checked text, and their contents through pyuff."""

from __future__ import annotations

import contextlib
import io
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyuff

from calib.errors import InputError

_MARKER = b"    -1"
USED_KINDS = (15, 55, 164, 2411)
"""Dataset numbers whose text is kept."""


@dataclass(frozen=True)
class Block:
    """One dataset as text: its type, the line it starts on (from 1), and the lines after the type line."""

    kind: int
    line: int
    lines: tuple[str, ...]


def read_blocks(path: Path) -> list[Block]:
    """Split a universal file into its datasets.

    Raises InputError when it is empty, is no universal file, or a dataset is not closed (a truncated file).
    """
    try:
        data = path.read_bytes()
    except OSError as err:
        raise InputError(f"it cannot be read ({err.strerror})", place=path, remedy="check the path") from None
    if not data.strip():
        raise InputError("it is empty", place=path, remedy="export it again")
    blocks: list[Block] = []
    begun: list[bytes] | None = None
    start = 0
    for number, raw in enumerate(data.rstrip(b"\x1a").splitlines(), start=1):
        line = raw.rstrip()
        if line == _MARKER:
            if begun is not None:
                blocks.append(_block(path, start, begun))
            begun, start = ([], number) if begun is None else (None, start)
        elif begun is not None:
            begun.append(line)
        elif line:
            raise InputError(
                "text outside the datasets: this is no universal file, or a '-1' line was lost",
                place=f"{path}, line {number}",
                remedy="export it again",
            )
    if begun is not None:
        raise InputError(
            "the dataset that starts here is not closed by a '-1' line: the file is truncated",
            place=f"{path}, line {start}",
            remedy="export it again",
        )
    return blocks


def _block(path: Path, start: int, lines: Sequence[bytes]) -> Block:
    head = lines[0][:6].strip() if lines else b""
    if not head.isdigit() or int(head) == 0:
        raise InputError(
            "no dataset number follows the '-1' line", place=f"{path}, line {start + 1}", remedy="export it again"
        )
    kind = int(head)
    # the other datasets are not read, and may be binary
    return Block(kind, start, tuple(map(_text, lines[1:])) if kind in USED_KINDS else ())


def _text(raw: bytes) -> str:
    """Printable text of one line; exotic line breaks would otherwise split it for some readers and not for others."""
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return "".join(c if c.isprintable() else "?" for c in text)


def halves_of_six(path: Path, block: Block) -> list[Block]:
    """The block itself, or two (x, y, z and rx, ry, rz) for complex data of six components a node.

    pyuff cannot read the six. The second half is told by its kind being -55 until the halves are put together.
    """
    if block.kind != 55 or len(block.lines) < 8:
        return [block]
    if block.lines[5][40:60].split() != ["5", "6"]:
        return [block]
    head, body = block.lines[:8], block.lines[8:]
    if len(body) % 3:
        raise InputError(
            "the dataset 55 that starts here has not three lines a node",
            place=f"{path}, line {block.line}",
            remedy="export it again",
        )
    head = (*head[:5], head[5][:50] + f"{3:10d}", *head[6:])
    halves = []
    for kind, offset in ((55, 1), (-55, 2)):
        lines = [line for k in range(0, len(body), 3) for line in (body[k], body[k + offset])]
        halves.append(Block(kind, block.line, (*head, *lines)))
    return halves


def extract_sets(path: Path, blocks: Sequence[Block]) -> list[dict[str, Any]]:
    """Contents of the blocks, through pyuff.

    pyuff sees a cleaned copy: it silently drops an unclosed dataset, trips over lines padded to 80 columns, and takes
    any line that ends in -1 for the end of a dataset.
    """
    text = "".join(
        f"{-1:6d}\n{abs(b.kind):6d}\n" + "".join(line + "\n" for line in b.lines) + f"{-1:6d}\n" for b in blocks
    )
    sets: list[dict[str, Any]] = []
    at = 0
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        copy = Path(folder) / "copy.uff"
        copy.write_text(text, encoding="utf-8", newline="\n")
        quiet = io.StringIO()
        # pyuff signals damage by exceptions of any kind (Exception, IndexError, TypeError, OverflowError, ...), so
        # nothing narrower can be caught here
        try:
            with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
                reader = pyuff.UFF(str(copy))
                kinds = [int(kind) for kind in reader.get_set_types()]
                if kinds != [abs(block.kind) for block in blocks]:
                    raise ValueError("a line inside ends in -1")
                for at in range(len(blocks)):
                    sets.append(dict(reader.read_sets(at)))
        except Exception as err:
            raise InputError(
                f"the dataset {abs(blocks[at].kind)} that starts here cannot be read ({first_line(err)})",
                place=f"{path}, line {blocks[at].line}",
                remedy="export it again",
            ) from None
    return sets


def first_line(err: Exception) -> str:
    """First line of a message without its full stop, or the kind of the exception."""
    lines = str(err).strip().splitlines()
    return lines[0].rstrip(".") if lines else type(err).__name__
