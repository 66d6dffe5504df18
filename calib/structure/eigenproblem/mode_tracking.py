"""Mode tracking: which mode of a changed model is the same one, along a path and for derivatives by differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from calib.errors.errors import EvaluationError
from calib.measurement.mac import align
from calib.problem.differences import ask_ahead, difference
from calib.problem.space import ParameterSpace
from calib.structure.eigenproblem.derivatives import ModeDerivatives, eigenvalues
from calib.structure.modes import Modes
from calib.structure.rules import RULES

_SAME_PLACE = 1e-6
"""Bonus for a mode that keeps its number, so that arbitrarily rotated shapes of repeated modes are not exchanged."""


class Point(NamedTuple):
    """A complete set of values and the modes there."""

    values: Mapping[str, float]
    modes: Modes


class TrackedModel(Protocol):
    """What tracking asks of a `calib.structure.modal_model.ModalModel`."""

    @property
    def space(self) -> ParameterSpace:
        """Parameters."""
        ...

    def weighted(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray | None:
        """Shapes times the mass matrix, (n_dof, n_modes); None without one."""
        ...

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The lowest modes."""
        ...


def successors(
    start: Modes,
    end: Modes,
    columns: np.ndarray,
    weighted: Callable[[np.ndarray], np.ndarray | None] = lambda shapes: None,
) -> tuple[np.ndarray, np.ndarray]:
    """The same modes at another point, one to one, and their MAC, both (n,).

    Modes are matched so that the sum of their MAC is largest. Shapes that are known at sensors alone have no mass
    matrix in which they would be orthogonal: several modes may look alike there, and ``|ln(frequency ratio)|`` is
    subtracted, so that their frequencies tell them apart. A mode with a MAC below `RULES.successor` has no successor;
    it has left the solved modes.

    Parameters
    ----------
    start, end : Modes
        The second ones at least as many as ``columns``.
    columns : ndarray (n,), int
        Modes at the start.
    weighted : callable
        Returns shapes times the mass matrix of the start, (n_dof, n_modes), or None where there is none.
    """
    from scipy.optimize import linear_sum_assignment

    a, b = start.shapes[:, columns], end.shapes
    of_a, of_b = weighted(a), weighted(b)
    here, there = (a, b) if of_a is None or of_b is None else (of_a, of_b)
    product = np.abs(here.conj().T @ b) ** 2
    size = np.outer(np.einsum("ij,ij->j", a.conj(), here).real, np.einsum("ij,ij->j", b.conj(), there).real)
    similarity = np.divide(product, size, out=np.zeros_like(product), where=size > 0)
    gain = similarity + _SAME_PLACE * (columns[:, None] == np.arange(end.n_modes))
    if of_a is None:
        gain -= np.abs(np.log(end.natural_freq) - np.log(start.natural_freq[columns])[:, None])
    found = np.asarray(linear_sum_assignment(gain, maximize=True)[1])
    return found, similarity[np.arange(len(columns)), found]


def follow(
    model: TrackedModel, start: Point, end: Point, columns: np.ndarray, halvings: int = RULES.halvings
) -> np.ndarray:
    """Indices at the end point of modes at the start point.

    Modes are matched as in `successors`. Where all keep their numbers and similar shapes, the matching is accepted.
    Where some seem to change numbers, the straight line between the two points is halved repeatedly: two modes that
    veer exchange their shapes but not their numbers, as shorter steps show; two that cross still change numbers on the
    shortest step. A mode without a successor is no longer tracked.

    Two modes that veer with the coupling k, over a path on which they move apart by d on both sides, end with a MAC of
    ``1 - (k/d)^2``; a step resolves them while it is no longer than k. Modes that change numbers with shapes so similar
    that even the shortest step could not resolve veering cross, and no step is halved.

    Parameters
    ----------
    model : TrackedModel
    start, end : Point
        With the same number of modes.
    columns : ndarray (n,), int
        Modes at the start; -1 for none.
    halvings : int

    Returns
    -------
    ndarray (n,), int
        Modes at the end, -1 for one without a successor; where the path has fewer modes than requested, the longer step
        decides.
    """
    live = np.flatnonzero(columns >= 0)
    reached = np.full(len(columns), -1)
    found, similarity = successors(
        start.modes, end.modes, columns[live], lambda shapes: model.weighted(start.values, shapes)
    )  # fmt: skip
    reached[live] = np.where(similarity >= RULES.successor, found, -1)
    moved = found != columns[live]
    if not halvings or np.all(similarity >= np.where(moved, 1 - RULES.crossed * 4.0**-halvings, RULES.successor)):
        return reached
    integers = {p.name for p in model.space.parameters if p.integer}
    values = {n: v if n in integers else 0.5 * (start.values[n] + v) for n, v in end.values.items()}
    try:
        middle = Point(values, model.modes(values, end.modes.n_modes))
    except EvaluationError:
        return reached
    if middle.modes.n_modes < end.modes.n_modes:
        return reached
    halfway = follow(model, start, middle, columns, halvings - 1)
    return follow(model, middle, end, halfway, halvings - 1)


def followed_derivatives(
    at: Callable[[Mapping[str, float]], Modes],
    space: ParameterSpace,
    values: Mapping[str, float],
    modes: Modes,
    names: Sequence[str],
    which: Sequence[int] | np.ndarray,
    rows: np.ndarray,
    step: float,
    one_sided: bool = False,
) -> ModeDerivatives:
    """Central differences of modes, each tracked to both ends, so that modes may cross in between.

    An end is half a step away, within the limits of the parameter. Modes are matched with those of the end as in
    `successors`; the shape of a successor is scaled and phase-aligned to the mode by least squares.

    A difference is one-sided at a limit, where the model fails at one end, and for a mode without a successor there.
    A mode without successors along a parameter has zero derivatives; one whose successor is a
    different mixture of modes (`RULES.smooth`) has derivatives of frequency and damping only, and 0 for its shape.

    Parameters
    ----------
    at : callable
        Returns the modes at named values.
    space : ParameterSpace
    values : mapping
        At which ``modes`` were solved.
    modes : Modes
    names : sequence of str
    which : sequence of int
        Indices of the modes wanted.
    rows : ndarray (n_rows, n_dof)
        Output rows for the shapes.
    step : float
        Half step of a difference, over the range between the limits.
    one_sided : bool
        Whether one end of each is evaluated.

    Raises
    ------
    EvaluationError
        When the model fails on both sides of the point along one of the parameters.
    """
    chosen = np.asarray(which, dtype=int)
    complete = space.complete(dict(values))
    kind = complex if modes.is_complex else float
    eigenvalue = np.zeros((len(names), len(chosen)), dtype=complex)
    shapes = np.zeros((len(names), len(rows), len(chosen)), dtype=kind)
    if len(chosen):
        ask_ahead(at, complete, [space[name] for name in names], step, one_sided)
    for q, name in enumerate(names if len(chosen) else ()):
        path = _Path(at, modes, chosen, complete)
        slope = difference(path.vector, complete, space[name], step, one_sided).reshape(-1, 2, len(chosen))
        moved = np.nan_to_num(slope[:, 0] + 1j * slope[:, 1])
        eigenvalue[q] = moved[0]
        change = np.where(path.smooth, moved[1:], 0.0)
        shapes[q] = rows @ (change if kind is complex else change.real)
    here = eigenvalues(modes)[chosen]
    size = np.abs(here)
    grown = np.real(np.conj(here) * eigenvalue) / size
    return ModeDerivatives(
        names=tuple(names),
        eigenvalue=eigenvalue,
        shapes=shapes,
        natural_freq=grown / (2 * np.pi),
        damped_freq=eigenvalue.imag / (2 * np.pi),
        damping_ratio=-eigenvalue.real / size + here.real * grown / size**2,
        regular=np.ones(len(chosen), dtype=bool),
    )


class Moved(NamedTuple):
    """A parameter that changes another one in one kind of results only.

    Attributes
    ----------
    parameter : str
        The other one.
    kind : {"frequency", "damping", "shape"}
    unit : float
        Change of the other one by a unit.
    """

    parameter: str
    kind: str
    unit: float


def of_kinds(found: ModeDerivatives, modes: Modes, names: Sequence[str], moved: Mapping[str, Moved]) -> ModeDerivatives:
    """Derivatives by parameters that act on one kind of results only, from those by the parameters that act on all.

    Parameters
    ----------
    found : ModeDerivatives
        By the parameters that act on all kinds, (n_params, n_modes) and for shapes (n_params, n_rows, n_modes).
    modes : Modes
        The n_modes modes of ``found``, in its order.
    names : sequence of str
        Parameters of the result; each is one of ``found`` or a key of ``moved``.
    moved : mapping from str to Moved
        What each parameter of one kind moves.
    """
    row = [found.names.index(moved[name].parameter if name in moved else name) for name in names]
    kinds = [moved[name].kind if name in moved else "" for name in names]
    unit = np.array([moved[name].unit if name in moved else 1.0 for name in names])[:, None]

    def taken(rows: np.ndarray, kind: str) -> np.ndarray:
        kept = unit * [[own in ("", kind)] for own in kinds]
        return np.asarray(rows[row] * (kept[..., None] if rows.ndim == 3 else kept))

    here, ratio = eigenvalues(modes), modes.damping_ratio
    freq, damping = taken(found.natural_freq, "frequency"), taken(found.damping_ratio, "damping")
    size, root = 2 * np.pi * modes.natural_freq, np.sqrt(1 - ratio**2)
    eigenvalue = here * freq / modes.natural_freq - size * (1 + 1j * ratio / root) * damping
    whole = np.array([not own for own in kinds])[:, None]
    eigenvalue = np.where(whole, found.eigenvalue[row], eigenvalue)
    return ModeDerivatives(
        tuple(names), eigenvalue, taken(found.shapes, "shape"), freq, eigenvalue.imag / (2 * np.pi), damping,
        found.regular,
    )  # fmt: skip


class _Path:
    """Modes tracked from one point, as a real vector for differencing."""

    def __init__(
        self,
        at: Callable[[Mapping[str, float]], Modes],
        modes: Modes,
        chosen: np.ndarray,
        values: Mapping[str, float],
    ):
        self.at, self.start, self.chosen, self.values = at, modes, chosen, dict(values)
        self.smooth = np.ones(len(chosen), dtype=bool)

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Real and imaginary part of eigenvalue and shape, ((1 + n_dof) * 2 * n_modes,); NaN for a lost mode."""
        if dict(values) == self.values:
            return _parts(eigenvalues(self.start)[self.chosen], self.start.shapes[:, self.chosen])
        there = self.at(values)
        if there.n_modes < len(self.chosen):
            raise EvaluationError(f"only {there.n_modes} modes were solved to track {len(self.chosen)}")
        shapes = self.start.shapes[:, self.chosen]
        found, reached = successors(self.start, there, self.chosen)
        pairs = [(shapes[:, k], there.shapes[:, j]) for k, j in enumerate(found)]
        moved = np.column_stack([end * align(start, end) for start, end in pairs])
        self.smooth &= (reached >= RULES.smooth) | (reached < RULES.successor)
        out = _parts(eigenvalues(there)[found], moved).reshape(-1, 2, len(found))
        out[:, :, reached < RULES.successor] = np.nan
        return out.ravel()


def _parts(eigenvalue: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    both = np.vstack([eigenvalue[None], shapes]).astype(complex)
    return np.stack([both.real, both.imag], axis=1).ravel()
