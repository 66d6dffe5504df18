"""Gross errors of measured FRFs: a wrong sign, other units, a motion that is differentiated or integrated.

They leave the shape of a function: measured and model functions then differ by ``a (j omega)^n`` with a real ``a`` and
an integer ``n``. They are looked for before anything is fitted, since parameters and faults would absorb them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from calib.correlation.rules import RULES
from calib.measurement import frf_units as units
from calib.measurement.frf import QUANTITIES, MeasuredFRFs, MeasuredFunction, Quantity

Scope = Literal["test", "response", "reference"]

G, POUND, INCH = units.GRAVITY, units.FORCES["lbf"], units.LENGTHS["in"]
"""m/s2, N and m."""
MOTIONS: Mapping[float, str] = {
    1e3: "motions look like mm, read as m",
    1e-3: "motions look like m, read as mm",
    1 / INCH: "motions look like inches, read as m",
    INCH: "motions look like m, read as inches",
    1 / G: "accelerations look like g, read as m/s2",
    G: "accelerations look like m/s2, read as g",
}
"""What a factor of measured over model functions tells of their motions."""
FORCES: Mapping[float, str] = {
    1e3: "forces look like kN, read as N",
    1e-3: "forces look like N, read as kN",
    POUND: "forces look like pounds, read as N",
    1 / POUND: "forces look like N, read as pounds",
    G: "forces look like kgf, read as N",
    1 / G: "forces look like N, read as kgf",
}
"""The same of their forces."""
FACTORS = (1.0, *dict.fromkeys((*MOTIONS, *FORCES)))
"""All known factors, without their signs."""


class Factor(NamedTuple):
    """Measured functions as ``value (j omega)^order`` times those of the model.

    Attributes
    ----------
    value : float
        In SI, with its sign.
    order : int
    alike : float
        FRAC of both with a real factor: 1 where the functions then agree.
    """

    value: float
    order: int
    alike: float

    @property
    def known(self) -> float | None:
        """The known factor that is as large as its own, without the sign; None where there is none."""
        near = min(FACTORS, key=lambda one: abs(np.log(abs(self.value) / one)) if self.value else np.inf)
        return near if abs(abs(self.value) / near - 1) <= RULES.gross_near else None

    @property
    def wrong(self) -> bool:
        """Whether it is a gross error."""
        if self.alike <= RULES.gross_frac:
            return False
        return self.order != 0 or (self.known is not None and (self.value < 0 or self.known != 1.0))

    def same(self, other: Factor) -> bool:
        """Whether another one is the same to within what models are off by."""
        ratio = other.value / self.value if self.value else 0.0
        return self.order == other.order and 1 / (1 + RULES.unit_near) < ratio < 1 + RULES.unit_near


@dataclass(frozen=True)
class GrossError:
    """One gross error of a test of FRFs.

    Attributes
    ----------
    scope : {"test", "response", "reference"}
    names : tuple of str
        The responses or references; empty for the whole test.
    factor : Factor
    quantity : {"receptance", "mobility", "accelerance"}
        As the FRFs were read.
    """

    scope: Scope
    names: tuple[str, ...]
    factor: Factor
    quantity: Quantity

    @property
    def of(self) -> str:
        """Of what, such as ``response 2x``."""
        if self.scope == "test":
            return "all FRFs"
        return f"{self.scope}{'s' * (len(self.names) > 1)} {', '.join(self.names)}"

    @property
    def check(self) -> str:
        """What is to be checked, such as ``the sign of response 2x``."""
        wrong = [
            *(["quantity"] if self.factor.order else []),
            *(["units"] if self.factor.known not in (None, 1.0) else []),
            *(["sign"] if self.factor.value < 0 else []),
        ]
        return f"the {' and the '.join(wrong)} of {self.of}"

    @property
    def sentence(self) -> str:
        """What was found, and what it looks like."""
        of = "" if self.scope == "test" else f" of {self.of}"
        value, order, sure = self.factor.value, self.factor.order, f"(FRAC {self.factor.alike:.3f} with this factor)"
        words = "; ".join(self._words())
        if abs(value) < 1 and not order and self.factor.known != 1.0:
            return f"The model's FRFs{of} are {1 / value:.3g} times the measured ones {sure}: {words}."
        size = f"{value:.3g}" + (f" (j omega)^{order}" if order else "")
        return f"The measured FRFs{of} are {size} times the model's {sure}: {words}."

    def _words(self) -> Iterator[str]:
        value, order, known = self.factor.value, self.factor.order, self.factor.known
        if order:
            number = list(QUANTITIES).index(self.quantity) + order
            if 0 <= number < len(QUANTITIES):
                yield f"they look like {list(QUANTITIES)[number]}"
            else:
                what, times = "differentiated" if order > 0 else "integrated", "once" if abs(order) == 1 else "twice"
                yield f"they look {what} {times} too often"
        if known not in (None, 1.0):
            tables = {"test": (MOTIONS, FORCES), "response": (MOTIONS,), "reference": (FORCES,)}[self.scope]
            found = [table[known] for table in tables if known in table]
            yield " or ".join(found or [table[known] for table in (MOTIONS, FORCES) if known in table])
        if value < 0:
            who = {"test": "the force, or all motions,", "response": "the motion", "reference": "the force"}[self.scope]
            yield f"{who} {'have' if self.scope == 'test' else 'has'} the wrong sign"


def gross_errors(measured: MeasuredFRFs, model: np.ndarray) -> tuple[GrossError, ...]:
    """Gross errors of the whole test, then of its responses, then of its references, each beside those before.

    A group of functions has one where a factor within `RULES.gross_near` of a known one, or an order other than 0,
    makes it agree with the model to a FRAC above `RULES.gross_frac`, and none of its functions agrees by another one.

    Parameters
    ----------
    measured : MeasuredFRFs
    model : ndarray (n_freq, n_responses, n_references), complex
        In SI, of the same quantity.

    Returns
    -------
    tuple of GrossError
        Empty where there is none, and for a model whose functions have other shapes.
    """
    own, functions = np.array(model, dtype=complex), measured.functions
    sides: list[tuple[Scope, tuple[str, ...], list[list[MeasuredFunction]]]] = [("test", ("",), [list(functions)])]
    responses, references = measured.responses, measured.references
    if len(responses) > 1:
        groups = [[f for f in functions if f.i == i] for i in range(len(responses))]
        sides.append(("response", tuple(s.name for s in responses), groups))
    if len(references) > 1:
        groups = [[f for f in functions if f.j == j] for j in range(len(references))]
        sides.append(("reference", tuple(s.name for s in references), groups))
    out: list[GrossError] = []
    for scope, names, groups in sides:
        found = [(name, group, _common(measured, own, group)) for name, group in zip(names, groups, strict=True)]
        wrong = [(name, group, factor) for name, group, factor in found if factor is not None and factor.wrong]
        for _, group, factor in wrong:
            for function in group:
                scale, used = _power(measured.freq[function.lines], factor.order)
                own[function.index] *= np.where(used, factor.value * scale, 1.0)
        out += _joined(scope, [(name, factor) for name, _, factor in wrong], measured.quantity)
    return tuple(out)


def _joined(scope: Scope, found: Sequence[tuple[str, Factor]], quantity: Quantity) -> Iterator[GrossError]:
    """One error for all responses or references that have the same."""
    left = list(found)
    while left:
        first = left[0][1]
        own = [(name, f) for name, f in left if first.same(f) and first.known == f.known]
        left = [one for one in left if one not in own]
        yield GrossError(scope, tuple(name for name, _ in own if name), first, quantity)


def _common(measured: MeasuredFRFs, model: np.ndarray, group: Sequence[MeasuredFunction]) -> Factor | None:
    """The factor of some functions; None where one of them agrees with the model by another one.

    Of functions in the same units, some with the wrong sign, it has the sign of most: the others come after it.
    """
    if not group:
        return None
    pairs = [(measured.freq[f.lines], measured.values[f.index], model[f.index]) for f in group]
    found = _factor(pairs)
    if len(pairs) == 1:
        return found
    alike = [single for single in map(_factor, [[pair] for pair in pairs]) if single.alike > RULES.gross_frac]
    if all(found.same(single) for single in alike):
        return found
    negative = np.mean([single.value < 0 for single in alike])
    positive = [single._replace(value=abs(single.value)) for single in alike]
    value = float(np.median([single.value for single in positive]))
    shared = Factor(-value if negative > 0.5 else value, alike[0].order, min(single.alike for single in alike))
    other_units = shared.known != 1.0 or shared.order
    return shared if other_units and all(positive[0].same(single) for single in positive) else None


def _factor(pairs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Factor:
    """The real factor and the order that fit best; another order than 0 must fit far better than 0."""
    fits = {order: _fitted(pairs, order) for order in range(-2, 3)}
    best = max(fits.values(), key=lambda one: one.alike)
    return best if 1 - best.alike < RULES.gross_order * (1 - fits[0].alike) else fits[0]


def _fitted(pairs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], order: int) -> Factor:
    product = own = test = 0.0
    for freq, measured, model in pairs:
        scale, used = _power(freq, order)
        changed = (model * scale)[used]
        product += float(np.vdot(changed, measured[used]).real)
        own += float(np.vdot(changed, changed).real)
        test += float(np.vdot(measured[used], measured[used]).real)
    known = own > 0 and test > 0
    return Factor(product / own if known else 0.0, order, product**2 / (own * test) if known else 0.0)


def _power(freq: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """``(j omega)^order`` on the lines above 0 Hz, 1 elsewhere, and which lines these are, (n_lines,) each."""
    used = freq > 0
    return np.where(used, (2j * np.pi * np.where(used, freq, 1.0)) ** order, 1.0), used
