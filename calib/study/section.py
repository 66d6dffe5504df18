"""A section of ``study.toml``, and the types that keys of several sections have."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
)

Pair = tuple[float, float]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
LONGEST_NAME = 255
"""Bytes in the name of a file or folder that the common file systems allow."""


def possible_path(text: str) -> str:
    """A path that file systems accept; ValueError for any other."""
    if "\0" in text:
        raise ValueError("a path cannot hold a zero character")
    longest = max((len(part.encode("utf-8", "replace")) for part in re.split(r"[/\\]", text)), default=0)
    if longest > LONGEST_NAME or len(text) > 4000:
        raise ValueError(f"a name of {longest} bytes in the path is too long: {LONGEST_NAME} are possible")
    return text


PathText = Annotated[str, AfterValidator(possible_path)]
Share = Annotated[float, Field(ge=0, le=1)]
FUNCTION = r"^[^:]+:[A-Za-z_]\w*$"
"""Names a function: ``"file.py:function"`` in the study's folder, or ``"package.module:function"``."""
FunctionText = Annotated[PathText, Field(pattern=FUNCTION)]
NAME = r"^[A-Za-z0-9_-]+$"
"""Name of a case or a test, which names files."""


class WrongBelow(ValueError):
    """A wrong value below the section or list that is checked; ``keys`` lead there."""

    def __init__(self, words: str, *keys: int | str):
        super().__init__(words)
        self.keys = keys


class Section(BaseModel):
    """A section of ``study.toml``: unknown keys are refused."""

    # Text below a field is its description in the JSON schema, in editors and in the documents.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)
