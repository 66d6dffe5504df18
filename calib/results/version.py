"""Version of calib; that of `pyproject.toml` must be equal."""

__version__ = "0.1.0"
