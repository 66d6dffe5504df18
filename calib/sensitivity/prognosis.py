"""Metamodel of optimal prognosis: the model and the inputs that predict each response best, and how well."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from scipy import special

from calib.errors.errors import InputError
from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace
from calib.sensitivity.gaussian_process import GaussianProcess, fitted_process, is_installed
from calib.sensitivity.partial import table_arrays
from calib.sensitivity.polynomials import KINDS, Kind, Polynomial, PolynomialTerms, fitted_polynomial, of_inputs
from calib.sensitivity.rules import PROGNOSIS
from calib.sensitivity.spearman import same_rows

Model = Polynomial | GaussianProcess
CONSTANT, NONE = "constant", "none"
"""Kinds of responses that never change, and of those known too rarely."""
PROCESS_REMEDY = "install scikit-learn (extra 'metamodel' of calib)"


@dataclass(frozen=True, eq=False)
class Metamodel:
    """The metamodel of a response.

    Attributes
    ----------
    response : str
    kind : str
        One of `KINDS`, ``"Gaussian process"``, `CONSTANT` or `NONE`.
    inputs : tuple of str
        Those that it has, the largest share first.
    cop, lower, upper : float
        Total coefficient of prognosis and its 95 % interval; NaN without a metamodel.
    shares : DataFrame (n_inputs, 3)
        The same columns for every input of the designs.
    rows : ndarray of int (n_known,)
        Designs in which the response is known.
    true, predicted : ndarray (n_known,)
        Its values, and those that are predicted without the design's own fold.
    error : float
        Root mean square of the differences, in the unit of the response.
    model : callable, optional
        Of inputs between -1 and 1.
    space : ParameterSpace
    """

    response: str
    kind: str
    inputs: tuple[str, ...]
    cop: float
    lower: float
    upper: float
    shares: pd.DataFrame
    rows: np.ndarray
    true: np.ndarray
    predicted: np.ndarray
    error: float
    model: Callable[[np.ndarray], np.ndarray] | None
    space: ParameterSpace = field(repr=False)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Predicted values (n,) at points (n, n_free), each input in its own unit; the mean of a constant response."""
        if self.model is None:
            return np.full(len(points), self.true.mean() if len(self.true) else np.nan)
        return self.model(_scaled(self.space, points))


@dataclass(frozen=True, eq=False)
class Prognosis:
    """Metamodels of all responses.

    Attributes
    ----------
    models : tuple of Metamodel
    untried : tuple of str
        Responses for which a Gaussian process might predict better and was not tried.
    """

    models: tuple[Metamodel, ...]
    untried: tuple[str, ...] = ()

    def __getitem__(self, response: str) -> Metamodel:
        found = next((one for one in self.models if one.response == response), None)
        if found is None:
            known = ", ".join(one.response for one in self.models[:12]) + ", ..." * (len(self.models) > 12)
            raise InputError(f"there is no response {response!r}", place="metamodel", remedy=f"they are {known}")
        return found

    @property
    def table(self) -> pd.DataFrame:
        """``prognosis.csv``: response, model, inputs (joined by ", "), cop, lower, upper, error, designs."""
        rows = [
            (m.response, m.kind, ", ".join(m.inputs), m.cop, m.lower, m.upper, m.error, len(m.rows))
            for m in self.models
        ]
        return pd.DataFrame(rows, columns=["response", "model", "inputs", "cop", "lower", "upper", "error", "designs"])

    @property
    def inputs(self) -> pd.DataFrame:
        """``prognosis_inputs.csv``: response, parameter, cop, lower, upper."""
        parts = [m.shares.reset_index().assign(response=m.response) for m in self.models]
        table = pd.concat(parts, ignore_index=True)
        return table[["response", "parameter", "cop", "lower", "upper"]]

    @property
    def sentences(self) -> tuple[str, ...]:
        """How well the responses are predicted, which of them are not, and what was not tried."""
        known = sorted((m for m in self.models if m.model is not None), key=lambda m: m.cop)
        out = list[str]()
        if known:
            ends = " to ".join(f"{m.cop:.2f} ({m.response})" for m in dict.fromkeys((known[0], known[-1])))
            out.append(f"Metamodels predict {_count(len(known))} with a coefficient of prognosis (CoP) of {ends}.")
        for kind, why in (
            (CONSTANT, "it never changes"),
            (NONE, f"known in fewer than {PROGNOSIS.rows_least} designs"),
        ):
            if names := [m.response for m in self.models if m.kind == kind]:
                out.append(f"No metamodel of {_some(names)}: {why}.")
        if self.untried:
            remedy = f"it takes up to {PROGNOSIS.process_rows} designs" if is_installed() else PROCESS_REMEDY
            out.append(f"No Gaussian process was tried for {_count(len(self.untried))}: {remedy}.")
        return tuple(out)


def _count(number: int) -> str:
    return f"{number} response{'s' * (number != 1)}"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def prognosis(space: ParameterSpace, points: pd.DataFrame, responses: pd.DataFrame, seed: int = 0) -> Prognosis:
    """Metamodel of optimal prognosis of every response (Most and Will 2008, 2011).

    Candidates are sparse polynomials (linear, quadratic with products, polynomial chaos) in the inputs that certainly
    matter, and a Gaussian process in the same inputs where polynomials predict less than 0.99 and scikit-learn is
    installed. Each predicts every design from the other folds, with terms and inputs chosen anew in every fold, and

        CoP = 1 - PRESS / SS_total.

    The model with the smallest PRESS is taken, unless a simpler one comes close. The CoP of an input is the total CoP
    times the input's total share in the variance of the metamodel (Sobol), with the other inputs given; shares of
    coupled inputs overlap and may add up to more than the total.

    The interval of the total comes from resampled designs. That of an input has the spread of its share among the
    models of the folds (jackknife) as well, and the part of the variance that the metamodel does not predict, which
    may be this input's as a whole or not at all.

    Parameters
    ----------
    space : ParameterSpace
        Its free parameters are the columns of ``points``, uniform between their limits.
    points : DataFrame (n, n_free)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown, dropped response by response.
    seed : int
        Of folds and resampling.

    Returns
    -------
    Prognosis

    Raises
    ------
    InputError
        When the rows of the two tables do not belong together, or a parameter is unknown somewhere.
    """
    x, y = table_arrays(points, responses)
    z, names = _scaled(space, x), [str(name) for name in points.columns]
    pairs = None if _is_exact(space) else _Pairs.of(space, seed)
    found: dict[int, Metamodel] = {}
    for known, columns in same_rows(y):
        rows = np.flatnonzero(known)
        designs = _Designs.of(z[rows], seed) if len(rows) >= PROGNOSIS.rows_least else None
        for column in columns:
            own, response = y[rows, column], str(responses.columns[column])
            if designs is None or np.ptp(own) <= 1e-12 * np.abs(own).max():
                kind = NONE if designs is None else CONSTANT
                found[column] = _without(response, kind, names, rows, own, space)
            else:
                found[column] = _metamodel(response, names, designs, rows, own, space, pairs)
    models = tuple(found[column] for column in sorted(found))
    poor = (m for m in models if isinstance(m.model, Polynomial) and _is_poor(1.0 - m.cop, m.model))
    return Prognosis(models, tuple(m.response for m in poor if not _is_possible(len(m.rows))))


def _scaled(space: ParameterSpace, points: np.ndarray) -> np.ndarray:
    lower, upper = space.coordinates(space.lower), space.coordinates(space.upper)
    return 2.0 * (space.coordinates(points) - lower) / np.where(upper > lower, upper - lower, 1.0) - 1.0


def _is_exact(space: ParameterSpace) -> bool:
    """Whether inputs are independent and continuous, so that shares of polynomials follow from their weights."""
    return not space.constraints and not space.integer.any()


@dataclass(frozen=True, eq=False)
class _Designs:
    """Designs of responses that are known in the same rows: folds, resampling, and terms of all inputs."""

    z: np.ndarray
    folds: list[np.ndarray]
    resampled: np.ndarray
    values: dict[Kind, np.ndarray]

    @classmethod
    def of(cls, z: np.ndarray, seed: int) -> _Designs:
        random, n = np.random.default_rng(seed), len(z)
        folds = np.array_split(random.permutation(n), PROGNOSIS.folds)
        counts = random.multinomial(n, np.full(n, 1.0 / n), PROGNOSIS.resamplings).astype(float)
        values: dict[Kind, np.ndarray] = {kind: PolynomialTerms.of(kind, range(z.shape[1])).values(z) for kind in KINDS}
        return cls(z, folds, counts, values)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A candidate with its cross-validation."""

    model: Model
    parts: Sequence[Model]
    predicted: np.ndarray

    def press(self, y: np.ndarray) -> float:
        return float(((y - self.predicted) ** 2).sum())


def _best(designs: _Designs, y: np.ndarray) -> _Tried:
    """The candidate that predicts best, or a simpler one that comes close."""
    z, folds, total = designs.z, designs.folds, float(((y - y.mean()) ** 2).sum())
    best: _Tried | None = None
    for kind in KINDS:
        values, predicted, parts = designs.values[kind], np.empty(len(y)), list[Model]()
        for rows in folds:
            kept = np.setdiff1d(np.arange(len(y)), rows)
            part = fitted_polynomial(kind, z[kept], y[kept], values[kept])
            predicted[rows] = part(z[rows])
            parts.append(part)
        tried = _Tried(fitted_polynomial(kind, z, y, values), parts, predicted)
        if best is None or tried.press(y) < (1.0 - PROGNOSIS.better) * best.press(y):
            best = tried
        if best.press(y) < 1e-12 * total:
            break
    assert best is not None
    best = _stable(best, z, y)
    if _is_poor(best.press(y) / total, best.model) and _is_possible(len(y)):
        tried = _Tried(*fitted_process(z, y, best.model.inputs, folds))
        if tried.press(y) < (1.0 - PROGNOSIS.better) * best.press(y):
            best = tried
    return best


def _stable(best: _Tried, z: np.ndarray, y: np.ndarray) -> _Tried:
    """The candidate in the inputs that most folds have too (Meinshausen and Buehlmann 2010).

    The rest that a polynomial leaves is smaller than its error, since its terms were chosen among many, so that a test
    against that rest takes inputs which do nothing. Other folds seldom take the same ones.
    """
    model = best.model
    if not isinstance(model, Polynomial):
        return best
    least = PROGNOSIS.stable * len(best.parts) - 1e-9
    stable = [i for i in model.inputs if sum(i in part.inputs for part in best.parts) >= least]
    return best if len(stable) == len(model.inputs) else replace(best, model=of_inputs(model.kind, z, y, stable))


def _is_poor(missed: float, model: Model) -> bool:
    """Whether a Gaussian process may predict better than a polynomial."""
    return missed > 1.0 - PROGNOSIS.process_below and bool(model.inputs)


def _is_possible(count: int) -> bool:
    return count <= PROGNOSIS.process_rows and is_installed()


def _metamodel(
    response: str,
    names: Sequence[str],
    designs: _Designs,
    rows: np.ndarray,
    y: np.ndarray,
    space: ParameterSpace,
    pairs: _Pairs | None,
) -> Metamodel:
    """The metamodel of a response that changes."""
    best, w, n = _best(designs, y), designs.resampled, len(y)
    squares, centred = (y - best.predicted) ** 2, y - y.mean()
    cop = max(0.0, 1.0 - float(squares.sum() / (centred**2).sum()))
    total = w @ centred**2 - (w @ centred) ** 2 / n
    resampled = 1.0 - (w @ squares) / np.where(total > 0, total, np.inf)
    lower, upper = (float(np.clip(q, 0.0, 1.0)) for q in np.quantile(resampled, [0.025, 0.975]))
    lower, upper = min(lower, cop), max(upper, cop)
    exact = pairs is None and isinstance(best.model, Polynomial)
    if not exact and pairs is None:
        pairs = _Pairs.of(space, 0)
    every, blur = _shares([best.model, *best.parts], len(names), None if exact else pairs)
    share, each = every[0], every[1:]
    k = len(each)
    spread = np.sqrt((k - 1) / k * ((each - each.mean(axis=0)) ** 2).sum(axis=0))
    half = cop * np.hypot(float(special.stdtrit(k - 1, 0.975)) * spread, 2.0 * blur)
    unknown = cop * (1.0 - cop)
    shares = pd.DataFrame(
        {
            "cop": cop * share,
            "lower": np.clip(cop * share - np.hypot(half, share * (cop - lower)) - unknown * share, 0.0, 1.0),
            "upper": np.clip(cop * share + np.hypot(half, share * (upper - cop)) + unknown * (1.0 - share), 0.0, 1.0),
        },
        index=pd.Index(names, name="parameter"),
    )
    inputs = tuple(names[i] for i in sorted(best.model.inputs, key=lambda i: -share[i]))
    error = float(np.sqrt(squares.mean()))
    return Metamodel(
        response, best.model.kind, inputs, cop, lower, upper, shares, rows, y, best.predicted, error, best.model, space
    )


def _without(
    response: str, kind: str, names: Sequence[str], rows: np.ndarray, y: np.ndarray, space: ParameterSpace
) -> Metamodel:
    """A response that has no metamodel."""
    nan = float("nan")
    shares = pd.DataFrame(nan, index=pd.Index(names, name="parameter"), columns=["cop", "lower", "upper"])
    error = 0.0 if kind == CONSTANT else nan
    return Metamodel(response, kind, (), nan, nan, nan, shares, rows, y, y.copy(), error, None, space)


# -- shares of inputs --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Points of a space, and for every input another value of it with all other inputs given, (n, n_inputs) both."""

    base: np.ndarray
    other: np.ndarray

    @classmethod
    def of(cls, space: ParameterSpace, seed: int) -> _Pairs:
        """Points over the admissible region, and values uniform over what limits and constraints then leave."""
        from scipy.stats import qmc  # slow to import, and few metamodels need it

        p = len(space.free)
        unit = qmc.Sobol(2 * p, rng=np.random.default_rng(seed)).random(PROGNOSIS.pairs)
        base = sample(space, PROGNOSIS.pairs, seed).points if space.constraints else space.from_unit(unit[:, :p])
        weights, least, most = space.constraint_rows()
        rest = (base @ weights.T)[:, :, None] - base[:, None, :] * weights  # of the sums, without the input
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(least[:, None] - rest) / weights, (most[:, None] - rest) / weights])
        low = np.where(weights != 0, ends.min(axis=0), -np.inf).max(axis=1, initial=-np.inf)
        high = np.where(weights != 0, ends.max(axis=0), np.inf).min(axis=1, initial=np.inf)
        low, high = np.maximum(low, space.lower), np.minimum(high, space.upper)
        share = unit[:, p:]
        steps = np.ceil(low - 1e-9) + np.floor(share * (np.floor(high + 1e-9) - np.ceil(low - 1e-9) + 1.0))
        other = np.where(space.integer, np.minimum(steps, np.floor(high + 1e-9)), low + share * (high - low))
        other = np.where(space.log, space.between(share), other)  # no constraint narrows them
        return cls(_scaled(space, base), _scaled(space, other))


def _shares(models: Sequence[Model], count: int, pairs: _Pairs | None) -> tuple[np.ndarray, np.ndarray]:
    """Total share of every input in the variance of models of one kind (Jansen 1999), (n_models, count).

    The second is the standard error of the first model's, (count,).
    """
    share, blur = np.zeros((len(models), count)), np.zeros(count)
    if pairs is None:
        return np.array([one.total_shares(count) for one in models if isinstance(one, Polynomial)]), blur
    base = _together(models, pairs.base)
    variance = base.var(axis=0)
    for i in sorted({i for one in models for i in one.inputs}):
        moved = pairs.base.copy()
        moved[:, i] = pairs.other[:, i]
        halves = 0.5 * (_together(models, moved) - base) ** 2 / np.where(variance > 0, variance, np.inf)
        share[:, i], blur[i] = halves.mean(axis=0), halves[:, 0].std() / np.sqrt(len(halves))
    return share, blur


def _together(models: Sequence[Model], z: np.ndarray) -> np.ndarray:
    """Values (n, n_models); processes of one covariance evaluate it once."""
    processes = [one for one in models if isinstance(one, GaussianProcess)]
    if processes:
        return replace(processes[0], weights=np.stack([one.weights for one in processes], axis=1))(z)
    return np.stack([one(z) for one in models], axis=1)
