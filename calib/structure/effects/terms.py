"""Matrices from runs as parts that an engineer knows: what a modulus scales, and what has one thickness."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from calib.structure.model import Part, PartKind

_BENDING = 3.0
"""Power of its thickness with which a plate or a rib bends."""
CONSTANT = "constant"
"""Name of the term that no parameter scales."""


class Terms(NamedTuple):
    """Terms that change together.

    Attributes
    ----------
    parts : tuple of (kind, Part)
    at : str
        What they are, in words.
    name : str
        In short, for names of effects.
    """

    parts: tuple[tuple[PartKind, Part], ...]
    at: str
    name: str


def term_name(powers: Mapping[str, float]) -> str:
    """Name of a term that is multiplied by powers of parameters, such as ``E_plates t_top^3``."""
    own = {name: power for name, power in powers.items() if power != 0}
    return " ".join(name if power == 1 else f"{name}^{power:g}" for name, power in own.items()) or CONSTANT


def parts_of_terms(parts: Sequence[Part]) -> list[Terms]:
    """What terms that matrices from runs gave may have wrong; empty for parts with names of their own.

    A power of a thickness is no part of a structure: where a parameter has one beside the first, all of its terms are
    the part, and those of the third power its bending. A term in which parameters have the power 1 is what they scale.
    """
    thick = {p for part in parts for p, power in part.coefficient.powers if power not in (0.0, 1.0)}
    of_runs = all(part.name == term_name(dict(part.coefficient.powers)) for part in parts)
    if not of_runs or not (thick or any(part.name == CONSTANT for part in parts)):
        return []
    out, of = list[Terms](), defaultdict[str, list[Part]](list)
    for part in parts:
        own = [name for name, power in part.coefficient.powers if power != 0]
        for name in own:
            if name in thick:
                of[name].append(part)
        if not thick.intersection(own):
            scale = f"{' and '.join(own)} scale{'s' if len(own) == 1 else ''}" if own else "no parameter scales"
            at = f"the parts that {scale}"
            out.append(Terms(((part.kind, part),), at, part.name))
    for name, own_parts in of.items():
        at = f"the parts of thickness {name}"
        for kind in ("stiffness", "damping", "mass"):
            alike = [part for part in own_parts if part.kind == kind]
            bent = [part for part in alike if dict(part.coefficient.powers)[name] == _BENDING]
            if alike:
                out.append(Terms(tuple((kind, part) for part in alike), at, name))
            if bent and len(bent) < len(alike) and kind == "stiffness":
                out.append(Terms(tuple((kind, part) for part in bent), f"{at} in bending", f"{name} bending"))
    return out
