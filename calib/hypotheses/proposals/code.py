"""Proposals as a library of effects: the text of a file of Python."""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Sequence

from calib import structure
from calib.hypotheses.proposals.proposal import Proposal
from calib.hypotheses.proposals.proposal import composition_words as in_words
from calib.missing.local import range_words
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.effects.composed import Builder, python_text

FUNCTION = "proposed_effects"
"""Function of the file that returns the effects."""
_WIDE = 120


def library_text(proposals: Sequence[Proposal], study: str, beside: Sequence[str] = ()) -> str:
    """Text of a file with one effect for each proposal, the best first.

    Parameters
    ----------
    proposals : sequence of Proposal
        Their effects are built by a `calib.structure.effects.composed.Builder`.
    study : str
        Title of the study.
    beside : sequence of str
        Effects of the library beside which they were fitted.
    """
    builders: list[Builder] = [p.composed.effect.build for p in proposals]  # type: ignore[attr-defined]
    head = [
        f'"""Effects that may be missing in the model of: {_plain(study)}.',
        "",
        "Composed by calib from local stiffness or mass changes of the model: nobody listed them. Names, limits,",
        "plausible sizes (prior_sd) and places are guesses from the data alone; correct what you know better. The",
        "fitted magnitudes stand in the comments.",
        '"""',
        "",
        "from calib import Effect, Parameter",
        *_imports(builders),
        "",
        "",
        f"def {FUNCTION}() -> tuple[Effect, ...]:",
        '    """The best first."""',
        "    return (",
    ]
    lines = [*head]
    for rank, proposal in enumerate(proposals, 1):
        lines += [f"        {line}" for line in _effect(rank, proposal, beside)]
    lines += ["    )"]
    for proposal, builder in zip(proposals, builders, strict=True):
        lines += ["", "", f"def {proposal.composed.effect.name}(model):"]
        lines += [f'    """{_plain(proposal.composed.effect.title)}."""', *(f"    {line}" for line in builder.code)]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Text that can stand in a docstring."""
    return " ".join(text.replace("\\", "/").replace('"', "'").split())


def _imports(builders: Sequence[Builder]) -> list[str]:
    """What the code of these builders imports."""
    body = ["pass", *(line for builder in builders for line in builder.code)]
    tree = ast.parse("def build(model):\n" + "\n".join(f"    {line}" for line in body))
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}.intersection(dir(structure))
    return [f"from calib.structure import {', '.join(sorted(used))}"] if used else []


def _effect(rank: int, proposal: Proposal, beside: Sequence[str]) -> list[str]:
    effect, composed = proposal.composed.effect, proposal.composed
    assert isinstance(effect, Effect)
    unit = effect.magnitude.unit
    fitted = f"fitted {proposal.value:.3g}{'' if unit == '-' else f' {unit}'}"
    comment = (
        f"Rank {rank}: composed from the local stiffness or mass changes ({composed.kind}) at {composed.at}; {fitted} "
        f"(95 %: {range_words(proposal.low, proposal.high, unit)}), evidence {proposal.ln_bayes:.1f} against the model"
        f"{' with ' + ' and '.join(beside) if beside else ''}, one of {proposal.choices} of its kind."
    )
    if proposal.alike:
        others = "; ".join(map(in_words, proposal.alike[:3]))
        comment += f" The data cannot discriminate it from: {others}{'; ...' if len(proposal.alike) > 3 else ''}."
    lines = [f"# {line}" for line in textwrap.wrap(comment, _WIDE - 12)]
    lines += ["Effect("]
    lines += [f"    name={python_text(effect.name)},"]
    for key in ("title", "lacks", "look_for", "phrase"):
        lines.append(f"    {key}={python_text(getattr(effect, key))},")
    lines += _parameter("magnitude=", _with_size(effect.magnitude, proposal.value), ",")
    if effect.nuisance:
        lines += ["    nuisance=("]
        lines += [f"    {line}" for p in effect.nuisance for line in _parameter("", p, ",")]
        lines += ["    ),", "    grid=("]
        lines += [
            f"        {{{', '.join(f'{python_text(n)}: {v:.5g}' for n, v in point.items())}}}," for point in effect.grid
        ]
        lines += ["    ),"]
    return [*lines, f"    build={effect.name},", "),"]


def _with_size(magnitude: Parameter, value: float) -> tuple[Parameter, float]:
    """The magnitude with its plausible size: at least the fitted one, which may be large."""
    return magnitude, max(float(magnitude.prior_sd or 0.0), abs(value))


def _parameter(lead: str, given: Parameter | tuple[Parameter, float], end: str) -> list[str]:
    p, size = given if isinstance(given, tuple) else (given, float(given.prior_sd or 0.0))
    return [
        f"    {lead}Parameter(",
        f"        {python_text(p.name)}, {p.value:.5g}, {p.lower:.5g}, {p.upper:.5g}, {python_text(p.unit)},",
        f"        prior_sd={size:.3g}, description={python_text(p.description)},",
        f"    ){end}",
    ]
