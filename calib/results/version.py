"""Version of calib."""

from __future__ import annotations

from pathlib import Path

FALLBACK = "0.2.0"
"""That of a clone from which nothing was installed; equal to ``fallback_version`` in `pyproject.toml`."""


def _version() -> str:
    """What setuptools-scm wrote beside this file, from the latest tag, when the package was built or installed.

    It belongs to these files, unlike the metadata of whatever calib is installed.
    """
    try:
        return Path(__file__).with_name("version.txt").read_text("ascii").strip() or FALLBACK
    except (OSError, UnicodeError):
        return FALLBACK


__version__ = _version()
