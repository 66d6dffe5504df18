"""Version of calib, as `pyproject.toml` tells it too."""

__version__ = "0.1.0"
