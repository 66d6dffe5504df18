"""Parts of a model that relax or have a constant loss factor: springs with dampers in series beside their own.

The part keeps its place, form and parameters; its dynamic stiffness K becomes ``K (1 + G(lambda))``. Matrices stay
real, and the states of the dampers are added degrees of freedom, so that modes, frequency response functions and
derivatives are those of any other effect. `calib.structure.rubber` makes effects of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.optimize import nnls

from calib.errors.arguments import numbers
from calib.errors.errors import InputError
from calib.structure.affine import Coefficient, Monomial, Term, parameter
from calib.structure.effects.attach import part_of
from calib.structure.effects.extend import Addition
from calib.structure.effects.products import OfPart
from calib.structure.elongations import elongations
from calib.structure.model import Assumption, StructuralModel

BRANCHES = 3
"""Springs with dampers in series per decade of frequency."""
_BEYOND = 2.0
"""Factor by which their corner frequencies reach beyond the band."""
_LINES = 200
"""Frequencies of the band at which the loss is fitted."""


@dataclass(frozen=True)
class Graded:
    """A spring's share of a part's stiffness, ``(factor sin(a pi/2) ratio^a)^power``; ``tan(a pi/2)`` is a loss factor.

    Attributes
    ----------
    loss_factor : str
    factor, ratio : float
    power : float
    """

    loss_factor: str
    factor: float
    ratio: float
    power: float = 1.0

    @property
    def names(self) -> frozenset[str]:
        """Parameters it depends on."""
        return frozenset((self.loss_factor,))

    @property
    def roots(self) -> frozenset[str]:
        """The loss factor, where the coefficient has no derivative at 0."""
        return self.names if self.power < 1 else frozenset()

    def __call__(self, values: Mapping[str, float]) -> float:
        """Value at parameters in SI."""
        loss = values[self.loss_factor]
        share = self.factor * loss / math.hypot(1.0, loss) * self.ratio ** (2 / math.pi * math.atan(loss))
        return float(share**self.power)

    def derivative(self, values: Mapping[str, float], name: str) -> float:
        """Derivative with respect to one parameter in SI."""
        if name != self.loss_factor:
            return 0.0
        loss = values[name]
        if loss == 0:  # of powers below 1 infinite; see `calib.structure.eigenproblem.derivatives.beside_roots`
            return self.factor if self.power == 1 else math.inf
        slope = (1 / loss + 2 / math.pi * math.log(self.ratio)) / (1 + loss**2)
        return self.power * self(values) * slope


@dataclass(frozen=True)
class ConstantLoss:
    """A real, causal material whose loss factor is constant over a band of frequencies.

    The complex stiffness ``K (1 + i eta)`` of hysteretic damping belongs to no real system: what it does in free
    vibration would begin before its cause (Crandall 1970). A causal material of constant loss factor stiffens with
    frequency, by about ``(2 eta/pi) ln(f/f_m)`` of its stiffness. Exactly constant is the loss factor of
    ``K(lambda) = K (lambda/(2 pi f_m))^a / cos(a pi/2)`` with ``a = (2/pi) arctan eta`` (Kjartansson 1979), whose
    stiffness at f_m is K. Here it is a sum of springs with dampers in series, three per decade:
    ``K (1 + sum_j s_j [lambda/(lambda + 2 pi f_j) - h_j])``, where ``h_j`` holds the stiffness at the geometric mean
    f_m of the band at K, and the strengths ``s_j = b_j sin(a pi/2) (f_j/f_m)^a`` follow that law; b makes the loss of
    small eta constant. Over the band the loss factor is within 2.5 % of eta up to 0.1 and within 8 % up to 0.3.

    Attributes
    ----------
    low, high : float
        Ends of the band, Hz.

    Raises
    ------
    InputError
        When they are not positive and in order.

    Examples
    --------
    >>> from calib.structure.relaxation import ConstantLoss
    >>> stiffness = 1 + ConstantLoss(5.0, 50.0)(0.1, 2j * 3.14159 * 15.8)
    >>> round(float(stiffness.imag / stiffness.real), 3)
    0.1
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        band_of((self.low, self.high), "constant loss")

    @property
    def middle(self) -> float:
        """f_m, Hz."""
        return math.sqrt(self.low * self.high)

    @cached_property
    def corners(self) -> np.ndarray:
        """f_j, Hz, (n_branches,)."""
        count = math.ceil(BRANCHES * math.log10(self.high / self.low * _BEYOND**2))
        return np.geomspace(self.low / _BEYOND, self.high * _BEYOND, max(count, 2))

    @cached_property
    def factors(self) -> np.ndarray:
        """b_j, (n_branches,)."""
        relative = np.geomspace(self.low, self.high, _LINES)[:, None] / self.corners
        return np.asarray(nnls(relative / (1 + relative**2), np.ones(_LINES))[0])

    @cached_property
    def held(self) -> np.ndarray:
        """h_j, (n_branches,)."""
        relative = self.middle / self.corners
        return np.asarray(relative**2 / (1 + relative**2))

    def strengths(self, loss_factor: str, power: float = 1.0) -> tuple[Graded, ...]:
        """s_j to a power, as coefficients of a named loss factor."""
        ratios = (self.corners / self.middle).tolist()
        return tuple(Graded(loss_factor, b, r, power) for b, r in zip(self.factors.tolist(), ratios, strict=True))

    def __call__(self, eta: float, eigenvalue: np.ndarray | complex) -> np.ndarray:
        """G at lambda in rad/s, of any shape; at a line of f Hz lambda is ``2 pi i f``."""
        relative = np.asarray(eigenvalue)[..., None] / (2 * np.pi * self.corners)
        strengths = np.array([s({"eta": eta}) for s in self.strengths("eta")])
        return np.asarray((strengths * (relative / (1 + relative) - self.held)).sum(axis=-1))


def lossy_parts(
    model: StructuralModel, parts: Sequence[str], loss_factor: str, band: tuple[float, float]
) -> Addition:  # fmt: skip
    """Stiffness of parts that dissipates by a loss factor, the same at all frequencies of a band.

    Parameters
    ----------
    model : StructuralModel
    parts : sequence of str
        Names of parts of stiffness, or of stiffness terms where a model has no parts.
    loss_factor : str
        Name of the parameter.
    band : (float, float)
        Hz; see `ConstantLoss` for what a part does within it. Beyond it the loss fades, and below it the
        part is softer: statically 0.82 of its stiffness with a loss factor of 0.1 and 0.54 with 0.3, over one decade.

    Raises
    ------
    InputError
        For an unknown part, or one with more than `calib.structure.elongations.MOST_MOTIONS` elastic motions.
    """
    loss = ConstantLoss(*band)
    made = zip(
        loss.strengths(loss_factor), loss.strengths(loss_factor, 0.5), loss.held.tolist(),
        (1 / (2 * np.pi * loss.corners)).tolist(), strict=True,
    )  # fmt: skip
    added = _beside(model, parts, loss_factor, [_Branch(s, root, h, Monomial(time)) for s, root, h, time in made])
    words = f"{loss.low:g} to {loss.high:g}, stiffness as in the model at {loss.middle:.3g}"
    return replace(added, assumptions=(Assumption(f"{loss_factor}: band of constant loss", words, "Hz", "as given"),))


def relaxing_parts(model: StructuralModel, parts: Sequence[str], share: str, corner_freq: str) -> Addition:
    """Parts with a spring and a damper in series beside them: the standard linear solid (Zener 1948).

    The dynamic stiffness becomes ``K (1 + x lambda/(lambda + 2 pi f))``: K slowly, ``K (1 + x)`` quickly. The loss
    factor is largest, ``x/(2 sqrt(1 + x))``, at ``f/sqrt(1 + x)``.

    Parameters
    ----------
    model : StructuralModel
    parts : sequence of str
        As in `lossy_parts`.
    share, corner_freq : str
        Names of the parameters: stiffness x of the spring in series over that of the part, corner frequency f at which
        its damper has the same dynamic stiffness.

    Raises
    ------
    InputError
        As `lossy_parts`.
    """
    time = Monomial(1 / (2 * math.pi), ((corner_freq, -1.0),))
    return _beside(model, parts, share, [_Branch(parameter(share), Monomial(1.0, ((share, 0.5),)), 0.0, time)])


class _Branch(NamedTuple):
    """A spring with a damper in series.

    Attributes
    ----------
    share, root : Coefficient
        Its share of a part's stiffness, and the root of that.
    held : float
        Fraction of the share that the part's own spring loses.
    time : Coefficient
        Time constant of its damper, s.
    """

    share: Coefficient
    root: Coefficient
    held: float
    time: Coefficient


def _beside(model: StructuralModel, parts: Sequence[str], magnitude: str, branches: Sequence[_Branch]) -> Addition:
    """Branches beside every part.

    With u an elongation of a part of stiffness k, ``s k`` the spring of a branch and ``g/sqrt(s k)`` the stroke of its
    damper, the strain energy is ``(sqrt(s k) u - g)^2/2`` and the dissipation ``g'^2 t/2``: regular at share s of 0,
    where g is decoupled.
    """
    own = [part_of(model, "stiffness", name) for name in parts]
    rows = [elongations(part) for part in own]
    n, count = model.n_dof, sum(r.shape[0] for r in rows)
    added = count * len(branches)
    stiffness, damping, first = [], [], n
    for j, branch in enumerate(branches):
        for part, row in zip(own, rows, strict=True):
            name, c = f"{magnitude}: {part.name}, branch {j + 1}", part.coefficient
            spring = sp.csr_array(sp.block_diag([part.matrix * (1 - branch.held), sp.csr_array((added, added))]))
            stiffness += [
                Term(name, spring, OfPart(part.name, c, branch.share)),
                Term(
                    f"{name}, coupling", _coupling(row, first, n + added), OfPart(part.name, c, branch.root, 0.5, -1.0)
                ),
            ]
            first += row.shape[0]
        mine = np.zeros(n + added)
        mine[first - count : first] = 1.0
        damping.append(Term(f"{magnitude}: dampers {j + 1}", _diagonal(mine), branch.time))
    whole = np.concatenate([np.zeros(n), np.ones(added)])
    return Addition((*stiffness, Term(f"{magnitude}: own", _diagonal(whole))), tuple(damping), n_added=added)


def _coupling(row: sp.csr_array, first: int, total: int) -> sp.csr_array:
    """Motions (n_motions, n_dof) beside the degrees of freedom from ``first`` on, and mirrored."""
    entries = sp.coo_array(row)
    up, down = entries.row + first, entries.col
    where = (np.concatenate([up, down]), np.concatenate([down, up]))
    return sp.csr_array(sp.coo_array((np.tile(entries.data, 2), where), shape=(total, total)))


def _diagonal(entries: np.ndarray) -> sp.csr_array:
    matrix = sp.csr_array(sp.diags_array(entries))
    matrix.eliminate_zeros()
    return matrix


def band_of(given: Sequence[float], place: str) -> tuple[float, float]:
    """Two frequencies in order; InputError for anything else."""
    ends = numbers(given, place)
    if ends.shape != (2,) or not (math.isfinite(ends[-1]) and 0 < ends[0] < ends[1]):
        raise InputError(
            f"it is {given!r:.40}", place=place, remedy="give two positive frequencies in Hz, the lower one first"
        )
    return float(ends[0]), float(ends[1])
