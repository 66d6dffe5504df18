"""What a benchmark prints: sentences and Markdown tables, which may be written to a file as well."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Page:
    """Prints everything as it comes, and appends it to a file where one is given."""

    file: Path | None = None

    def begin(self, title: str) -> None:
        """A title with the day and the load of the machine."""
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
        machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, load {load:.1f} at the start"
        self.say(f"## {title}\n\n{time.strftime('%Y-%m-%d')}, {machine}, one BLAS thread")

    def say(self, text: str) -> None:
        """A paragraph."""
        print(f"{text}\n", flush=True)
        if self.file is not None:
            with self.file.open("a", encoding="utf-8") as out:
                out.write(f"{text}\n\n")

    def table(self, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """A Markdown table."""
        lines = [header, ["---"] * len(header), *rows]
        self.say("\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines))
