"""The annotated example that ``calib new`` writes: a study folder with its own model and data."""

from __future__ import annotations

import shutil
import tempfile
from importlib import resources
from pathlib import Path

from calib.errors.errors import InputError

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
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("it is not an empty folder", place=folder, remedy="name a new one")
    template = resources.files("calib") / "template"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=".calib-new-", dir=folder.parent))
    except OSError as fault:
        raise InputError(f"it cannot be made ({fault.strerror})", place=folder, remedy="name another place") from None
    try:
        for name, source in FILES.items():
            (draft / name).write_bytes((template / source).read_bytes())
        draft.chmod(0o755)
        if folder.exists():
            folder.rmdir()
        draft.rename(folder)
    except OSError as fault:
        shutil.rmtree(draft, ignore_errors=True)
        raise InputError(
            f"it cannot be written ({fault.strerror})", place=folder, remedy="name another place"
        ) from None
    return [folder / name for name in FILES]
