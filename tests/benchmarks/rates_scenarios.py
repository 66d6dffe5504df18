"""What is hidden in each run, in which order runs are made, and a library of fifty effects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from rates_subject import Subject

from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial, Term
from calib.structure.effects.extend import Addition
from calib.structure.model import Part, StructuralModel

OWN, FIFTY = "own", "fifty"
MAGNITUDES = {"S": 0.5, "M": 1.0, "L": 2.0}
ANY = ("any",)
"""Any effect of the library, drawn for each run."""
_SEED = 20260501


@dataclass(frozen=True)
class Scenario:
    """One kind of run.

    Attributes
    ----------
    name : str
        With the number of a run its seed.
    group : str
        Which rates it counts for.
    effects : tuple of str
        What the twin has and the base model lacks.
    magnitude : float
        Over the plausible size.
    removed : bool
        Whether those effects are taken out of the library.
    noise : float
        Standard deviation of the mean over what the repeats show.
    library : str
    each : int
        Runs a round.
    """

    name: str
    group: str
    effects: tuple[str, ...] = ()
    magnitude: float = 1.0
    removed: bool = False
    noise: float = 1.0
    library: str = OWN
    each: int = 1

    def hidden(self, rng: np.random.Generator, library: Sequence[Effect]) -> tuple[str, ...]:
        """Names of the effects of one run."""
        return (library[int(rng.integers(len(library)))].name,) if self.effects == ANY else self.effects


def scenarios(subject: Subject, library: Sequence[Effect]) -> tuple[Scenario, ...]:
    """All kinds of runs for a subject and its library."""
    out = [
        Scenario("nothing", "nothing", each=6),
        Scenario("fifty", "fifty", library=FIFTY, each=3),
        Scenario("noise", "noise", noise=2.0, each=3),
        Scenario("noise/any/L", "noise_effect", ANY, 2.0, noise=2.0, each=3),
    ]
    out += [Scenario(f"{e.name}/{s}", "single", (e.name,), f) for s, f in MAGNITUDES.items() for e in library]
    out += [Scenario(f"outside/{n}/{s}", "outside", (n,), f) for s, f in MAGNITUDES.items() for n in subject.outside]
    out += [Scenario(f"without/{e.name}/{s}", "removed", (e.name,), MAGNITUDES[s], True) for s in "ML" for e in library]
    out += [Scenario(f"{a}+{b}/{s}", "pair", (a, b), MAGNITUDES[s]) for s in "ML" for a, b in subject.pairs]
    out += [Scenario(f"{'+'.join(t)}/{s}", "triple", t, MAGNITUDES[s]) for s in "ML" for t in subject.triples]
    return tuple(out)


def plan(subject: Subject, library: Sequence[Effect]) -> Iterator[tuple[Scenario, int]]:
    """`rounds` of all kinds of runs for a subject and its library."""
    return rounds(scenarios(subject, library))


def rounds(kinds: Sequence[Scenario]) -> Iterator[tuple[Scenario, int]]:
    """Runs without end, every round once through all scenarios in an order of its own."""
    for turn in range(1_000_000):
        runs = [(s, turn * s.each + k) for s in kinds for k in range(s.each)]
        for i in np.random.default_rng([_SEED, turn]).permutation(len(runs)):
            yield runs[int(i)]


def fifty_effects(model: StructuralModel, count: int) -> tuple[Effect, ...]:
    """Plausible local effects that lengthen a library: one to three parts of one kind, scaled together."""
    rng = np.random.default_rng(_SEED)
    out: list[Effect] = []
    taken: set[tuple[str, ...]] = set()
    while len(out) < count:
        first = model.parts[int(rng.integers(len(model.parts)))]
        alike = [p for p in model.parts if p.kind == first.kind and p is not first]
        alike.sort(key=lambda p: float(np.linalg.norm(np.subtract(p.place, first.place))))
        near = [alike[int(i)] for i in rng.permutation(min(6, len(alike)))[: int(rng.integers(3))]]
        chosen = (first, *near)
        key = tuple(sorted(f"{p.kind} {p.name}" for p in chosen))
        if key in taken:
            continue
        taken.add(key)
        name = f"local_{len(out) + 1}"
        lower = -0.9 if rng.random() < 0.5 else 0.0
        magnitude = Parameter(name, 0.0, lower, 3.0, "-", prior_sd=float(rng.uniform(0.15, 0.5)))
        out.append(Effect(name, ", ".join(key), "nothing", "nothing", magnitude, _Scaled(name, chosen)))
    return tuple(out)


@dataclass(frozen=True)
class _Scaled:
    """Some parts of a model times a magnitude."""

    name: str
    parts: tuple[Part, ...]

    def __call__(self, model: StructuralModel) -> Addition:
        def term(p: Part) -> Term:
            powers = (*p.coefficient.powers, (self.name, 1.0))
            return Term(f"{self.name}: {p.name}", p.matrix, Monomial(p.coefficient.factor, powers))

        terms = tuple(term(p) for p in self.parts)
        kind = self.parts[0].kind
        if kind == "stiffness":
            return Addition(stiffness=terms)
        return Addition(damping=terms) if kind == "damping" else Addition(mass=terms)
