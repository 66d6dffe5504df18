"""Models without matrices: any function from named parameters to named responses."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from calib.space import ParameterSpace
from calib.structure.model import Assumption


@dataclass(frozen=True)
class FunctionModel:
    """Anything that maps named parameters to named responses.

    Attributes
    ----------
    name : str
    space : ParameterSpace
    function : callable
        Takes ``{parameter: value}``, every value in its parameter's unit, and returns ``{response: value}``.
    assumptions : tuple of Assumption
    """

    name: str
    space: ParameterSpace
    function: Callable[[Mapping[str, float]], Mapping[str, float]]
    assumptions: tuple[Assumption, ...] = ()

    @property
    def fingerprint(self) -> str:
        """Hash over the source file that holds the function; a change anywhere in it makes old results stale."""
        digest = hashlib.sha256(self.name.encode())
        try:
            digest.update(Path(inspect.getfile(self.function)).read_bytes())
        except (TypeError, OSError):  # built-in or interactively defined: only its name is left to tell it by
            digest.update(repr(getattr(self.function, "__qualname__", self.function)).encode())
        return digest.hexdigest()[:16]
