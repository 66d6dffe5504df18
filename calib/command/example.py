"""The annotated example that ``calib new`` writes: a study folder with its own model and data."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from calib.results.written import write_new_folder

FILES = {
    "study.toml": "study.toml",
    "model.py": "model.py.txt",
    "modes.csv": "modes.csv",
    "shapes.csv": "shapes.csv",
    "sensors.csv": "sensors.csv",
}
"""Name in the new folder and name of its template."""


def write_example(folder: Path) -> list[Path]:
    """Write the example into a new or empty folder; nothing is left behind when that fails."""
    template = resources.files("calib") / "template"
    return write_new_folder(folder, {name: (template / source).read_bytes() for name, source in FILES.items()})
