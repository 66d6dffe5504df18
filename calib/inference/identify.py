"""Identifiability: posterior covariance, confounded parameters, and directions that the data do not see."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from calib.errors.errors import InputError
from calib.inference.constraints import ConstraintRows
from calib.inference.rules import RULES
from calib.problem.prior import Prior
from calib.problem.space import Parameter, ParameterSpace

if TYPE_CHECKING:
    import pandas as pd

_ZERO = 1e-13


@dataclass(frozen=True, eq=False)
class Posterior:
    """Gaussian posterior of the parameters, linearised at one point.

    Attributes
    ----------
    names : tuple of str
    covariance : ndarray (n_params, n_params)
        In the parameters' own units; infinite on the diagonal where neither data nor prior say anything.
    std : ndarray (n_params,)
    correlation : ndarray (n_params, n_params)
        Of a parameter with infinite variance: its correlation within the unseen directions.
    data_share : ndarray (n_params,)
        ``1 - V_kk/s_k^2``: 1 when the data decide, 0 when the prior does; 1 for a finite std without a prior. Of the
        information on a parameter, ``1/V_kk``, the prior gives ``1/s_k^2`` and the data the rest: this is their share.
        The variance added by held parameters is not counted here.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    std: np.ndarray
    correlation: np.ndarray
    data_share: np.ndarray


def posterior(
    names: Sequence[str],
    jacobian: np.ndarray,
    prior_sd: np.ndarray,
    held: np.ndarray | None = None,
    alone: np.ndarray | None = None,
) -> Posterior:
    """``V = (G^T G + diag(1/s^2))^-1`` (Laplace approximation about the optimum).

    Held parameters of known standard deviation shift the estimates by ``B = -V G^T H`` per standard deviation each;
    that adds ``B B^T`` to the covariance (consider parameters, Bierman 1977, section 8.2).

    Parameters
    ----------
    names : sequence of str
    jacobian : ndarray (n_rows, n_params)
        G: of the whitened residual, per unit of each parameter.
    prior_sd : ndarray (n_params,)
        In the same units; infinite without a prior.
    held : ndarray (n_rows, n_held), optional
        H: change of the whitened residual by one standard deviation of each held parameter.
    alone : ndarray (n_params,), optional
        Standard deviation of each prior by itself, of which the data's share is told, where priors are correlated.

    Raises
    ------
    InputError
        When shapes differ, or numbers are not finite or not positive.
    """
    g, s = np.atleast_2d(np.asarray(jacobian, dtype=float)), np.asarray(prior_sd, dtype=float)
    n = len(names)
    if g.shape[1] != n or s.shape != (n,):
        raise InputError(f"{n} parameters, but a Jacobian {g.shape} and {len(s)} priors", place="identifiability")
    if not np.all(np.isfinite(g)) or not np.all(s > 0):
        raise InputError("the Jacobian or a prior is not a usable number", place="identifiability")
    # With columns scaled to length one the inverse does not depend on units.
    whole = np.vstack([g, np.diag(1.0 / s)])
    size = np.linalg.norm(whole, axis=0)
    size = np.where(size > 0, size, 1.0)
    _, singular, vt = np.linalg.svd(whole / size, full_matrices=False)
    lost = singular <= _ZERO * max(len(whole), 1) * singular.max(initial=1.0)
    # A direction of infinite variance gets a very large one, so that correlations keep their meaning.
    weight = 1.0 / np.where(lost, _ZERO * singular.max(initial=1.0), singular)
    scaled = (vt.T * weight**2) @ vt
    own = np.sqrt(np.diag(scaled)) / size
    if held is not None and held.shape[1]:
        shift = scaled @ ((g / size).T @ held)
        scaled = scaled + shift @ shift.T
    spread = np.sqrt(np.diag(scaled))
    correlation = np.clip(scaled / np.outer(spread, spread), -1.0, 1.0)
    unbounded = np.sum(vt[lost] ** 2, axis=0) > 1e-16
    covariance = scaled / np.outer(size, size)
    std = np.where(unbounded, np.inf, spread / size)
    covariance[np.diag_indices(n)] = std**2
    s = s if alone is None else alone
    with np.errstate(invalid="ignore"):
        share = np.where(np.isfinite(s), 1.0 - (own / s) ** 2, 1.0)
    share = np.where(unbounded, 0.0, share)
    return Posterior(tuple(names), covariance, std, correlation, np.clip(share, 0.0, 1.0))


def with_held(known: Posterior, jacobian: np.ndarray, held: np.ndarray | None) -> np.ndarray:
    """Joint covariance of the estimates and the held parameters of known standard deviation.

    Predictions of other data err by both, and they are correlated: ``[[V + B B^T, B], [B^T, I]]`` with the shift B of
    `posterior`.

    Parameters
    ----------
    known : Posterior
        Of the same residual, without held parameters.
    jacobian : ndarray (n_rows, n_params)
    held : ndarray (n_rows, n_held) or None
        Change of the whitened residual by one standard deviation of each held parameter.

    Returns
    -------
    ndarray (n_params + n_held, n_params + n_held)
        In the parameters' own units; held ones in their standard deviations.
    """
    if held is None or not held.shape[1]:
        return known.covariance
    shift = -known.covariance @ (jacobian.T @ held)
    return np.block([[known.covariance + shift @ shift.T, shift], [shift.T, np.eye(held.shape[1])]])


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiability of the parameters.

    Attributes
    ----------
    posterior : Posterior
    parameters : DataFrame
        ``parameter, std, needed, identified, prior_sd, data_share``; own units, ``needed`` by `needed_std`,
        ``identified`` by `faults`.
    confounded : DataFrame
        ``parameter_a, parameter_b, correlation, words``; pairs with a correlation beyond the threshold, strongest
        first; harmless where both are identified.
    directions : DataFrame
        ``direction, signal, data_share, seen, parameters, words``; orthogonal combinations of parameters in units of
        their prior standard deviations, least visible first. ``signal`` is the change of the whitened residual by one
        such unit, for the measurement uncertainty as stated (not scaled where the model does not fit); ``seen`` where
        it is at least `Rules.seen`. What the data see is not identified by that alone: see `faults`.
    common_scale : float
        Change of the whitened residual when all parameters change by 10 % together, for the measurement uncertainty as
        stated; NaN without values or with fewer than two parameters. Near 0, the data see ratios only, such as those of
        stiffnesses to masses.
    searched : bool
        Whether the values are the end of a genetic search, or given, and no least-squares fit ended there.
    """

    posterior: Posterior
    parameters: pd.DataFrame
    confounded: pd.DataFrame
    directions: pd.DataFrame
    common_scale: float
    searched: bool = False

    @property
    def correlation(self) -> pd.DataFrame:
        """Posterior correlation, rows and columns parameters."""
        import pandas as pd

        names = list(self.posterior.names)
        return pd.DataFrame(self.posterior.correlation, index=names, columns=names)

    @property
    def ratios_only(self) -> bool:
        """Whether the data do not see all parameters change together."""
        return self.common_scale < RULES.seen  # False for NaN: fewer than two parameters

    def trades_with(self, name: str) -> tuple[str, float] | None:
        """The parameter that correlates most with one, and their posterior correlation; None below `Rules.trades`."""
        own = self.posterior.correlation[self.posterior.names.index(name)].copy()
        own[self.posterior.names.index(name)] = 0.0
        if not len(own) or not np.nanmax(np.abs(own), initial=0.0) >= RULES.trades:
            return None
        k = int(np.nanargmax(np.abs(own)))
        return self.posterior.names[k], float(own[k])

    def confounded_with(self, name: str) -> list[str]:
        """The parameters that are confounded with one, strongest first."""
        pairs = zip(self.confounded["parameter_a"], self.confounded["parameter_b"], strict=True)
        return [b if a == name else a for a, b in pairs if name in (a, b)]

    def sentences(self) -> tuple[str, ...]:
        """Sentences on confounded parameters and on directions that the data do not see."""
        out = self.confounded["words"].tolist()
        out += self.directions.loc[~self.directions["seen"], "words"].tolist()
        if self.ratios_only:
            out.append(
                f"{', '.join(self.parameters['parameter'])} can all grow by the same factor without the data noticing: "
                "they see ratios only. A known mass or stiffness would settle it."
            )
        return tuple(out)


_COORDINATES = ("m", "mm", "rad", "deg")
"""Units of positions and angles."""


def needed_std(p: Parameter, value: float | None = None) -> float:
    """Largest standard deviation with which a parameter counts as identified, in its unit.

    It is what the study needs (``needed``), by default `Rules.needed` of the nominal value, on a logarithmic scale of
    the fitted ``value``. That says nothing where it
    is 0 (or all but 0 beside a stated prior, as the magnitude of an effect that cannot begin at 0), nor of an integer,
    nor of a coordinate, which is a length or an angle of either sign: there it is the prior standard deviation, of an
    integer `Rules.whole` at most. The range between the limits has no part in it: limits say nothing of the data.
    """
    if p.needed is not None:
        return p.needed
    if p.integer:
        return min(p.prior_width, RULES.whole)
    if p.is_log:
        return RULES.needed * (p.value if value is None else value)
    coordinate = p.unit in _COORDINATES and p.lower < 0 < p.upper
    none = abs(p.value) <= RULES.none * (p.prior_sd or 0.0)
    return p.prior_width if none or coordinate else RULES.needed * abs(p.value)


def faults(
    p: Parameter, std: float, data_share: float, value: float | None = None, searched: bool = False
) -> tuple[str, ...]:
    """Reasons why a parameter is not identified; empty when it is.

    The data must give at least half of the information on it (else ``prior``), its standard deviation must be at most
    what is needed (else ``wide``; see `needed_std`), and its value must be off its limits (else ``limit``): a fit
    against a limit has not found the optimum of the data.

    Parameters
    ----------
    p : Parameter
    std : float
        Posterior standard deviation in its unit, scaled by the misfit where the model does not fit.
    data_share : float
        See `Posterior`.
    value : float, optional
        At the optimum; without it limits are not checked.
    searched : bool
        See `Identifiability`.
    """
    found = {
        "wide": not std <= needed_std(p, value),
        "prior": not data_share >= RULES.by_data,
        "limit": value is not None and p.limit_at(value, None if p.integer else std, searched) is not None,
    }
    return tuple(name for name, wrong in found.items() if wrong)


def identify(
    space: ParameterSpace,
    names: Sequence[str],
    jacobian: np.ndarray,
    prior_sd: np.ndarray | None = None,
    values: Mapping[str, float] | None = None,
    threshold: float = RULES.confounded,
    held: np.ndarray | None = None,
    birge: float = 1.0,
    searched: bool = False,
    constraints: ConstraintRows | None = None,
) -> Identifiability:
    """Find which parameters the data determine, and which are confounded.

    Parameters
    ----------
    space : ParameterSpace
        For ranges, prior widths and what is needed.
    names : sequence of str
        Parameters of the columns, without integers, for which derivatives mean nothing (see `integer_std`).
    jacobian : ndarray (n_rows, n_params)
        Of the whitened residual at the optimum, per unit of each parameter, for the measurement uncertainty as stated.
    prior_sd : ndarray (n_params,), optional
        Default the prior widths of the space; infinite without a prior.
    values : mapping, optional
        Values at the optimum; with them limits and the common scale of all parameters are checked.
    threshold : float
        Absolute correlation from which a pair is confounded.
    held : ndarray (n_rows, n_held), optional
        Change of the whitened residual by one standard deviation of each held parameter; see `posterior`.
    birge : float
        Factor by which the posterior scales the measurement uncertainty, above 1 where the model does not fit (Birge
        1932). Directions and common scale are for the uncertainty as stated.
    searched : bool
        See `Identifiability`.
    constraints : ConstraintRows, optional
        Rows beside the data, whatever the misfit; those of correlated priors must be among them.
    """
    import pandas as pd

    chosen = tuple(names)
    at = dict(values or {})
    own = [space[n].prior_width_at(at.get(n, space[n].value)) for n in chosen]
    s = np.array(own if prior_sd is None else prior_sd, dtype=float)
    independent = Prior({n: space[n] for n in chosen}).widths({**space.values, **at}, chosen)
    g = np.atleast_2d(np.asarray(jacobian, dtype=float))
    beside = constraints or ConstraintRows.none(len(chosen), 0 if held is None else held.shape[1])
    moved = None if held is None else np.vstack([held / birge, beside.held])
    rows = np.vstack([g / birge, beside.slope])
    found = posterior(chosen, rows, independent if prior_sd is None else s, moved, s)
    g = np.vstack([g, beside.slope])
    span = np.array([space[n].span_at(at.get(n, space[n].value)) for n in chosen])
    known = zip(chosen, found.std.tolist(), found.data_share.tolist(), strict=True)
    bad = [faults(space[n], std, share, at.get(n), searched) for n, std, share in known]
    identified = np.array([not why for why in bad], dtype=bool)
    columns = {
        "parameter": chosen,
        "std": found.std,
        "needed": [needed_std(space[n], at.get(n)) for n in chosen],
        "identified": identified,
        "prior_sd": s,
        "data_share": found.data_share,
    }
    reach = np.where(np.isfinite(s), s, span / math.sqrt(12.0))
    directions = _directions(chosen, g * reach)
    scale = math.nan
    if values is not None and len(chosen) > 1:
        scale = float(np.linalg.norm(g @ (0.1 * np.array([values[n] for n in chosen]))))
    confounded = _confounded(found, identified, threshold)
    return Identifiability(found, pd.DataFrame(columns), confounded, directions, scale, searched)


def _confounded(found: Posterior, identified: np.ndarray, threshold: float) -> pd.DataFrame:
    import pandas as pd

    rows = []
    for (a, one), (b, other) in combinations(enumerate(found.names), 2):
        r = float(found.correlation[a, b])
        if abs(r) < threshold:
            continue
        way = "raising both" if r > 0 else "raising one and lowering the other"
        words = f"{one} and {other} are confounded: {way} hardly changes the data."
        if identified[a] and identified[b]:
            words = f"{one} and {other} are strongly correlated ({r:.2f}), yet both have small standard deviations."
        rows.append((one, other, r, words))
    rows.sort(key=lambda row: -abs(row[2]))
    return pd.DataFrame(rows, columns=["parameter_a", "parameter_b", "correlation", "words"])


def _directions(names: tuple[str, ...], scaled: np.ndarray) -> pd.DataFrame:
    import pandas as pd

    n = len(names)
    _, singular, vt = np.linalg.svd(np.vstack([scaled, np.zeros((n, n))]), full_matrices=False)
    rows: list[tuple[int, float, float, bool, str, str]] = []
    for k in reversed(range(n)):
        part = vt[k] * np.sign(vt[k][np.argmax(np.abs(vt[k]))])
        order = np.argsort(-np.abs(part), kind="stable")
        named = [(names[j], part[j]) for n_th, j in enumerate(order) if n_th == 0 or abs(part[j]) >= RULES.takes_part]
        ways = ", ".join(f"{name} {'up' if p > 0 else 'down'}" for name, p in named)
        signal, text = float(singular[k]), named[0][0] if len(named) == 1 else ways
        seen = signal >= RULES.seen
        words = f"The data {'see' if seen else 'hardly see'} {text}"
        words += f": one prior standard deviation changes them by {signal:.2g} measurement standard deviations."
        share = signal**2 / (1 + signal**2)
        rows.append((len(rows) + 1, signal, share, seen, ", ".join(name for name, _ in named), words))
    return pd.DataFrame(rows, columns=["direction", "signal", "data_share", "seen", "parameters", "words"])


def prediction_interval(
    labels: Sequence[str], freq: np.ndarray, jacobian: np.ndarray, covariance: np.ndarray, level: float = 0.95
) -> pd.DataFrame:
    """Prediction interval of computed frequencies from the posterior covariance of the parameters alone.

    It includes neither measurement uncertainty nor model error.

    Parameters
    ----------
    labels : sequence of str
    freq : ndarray (n_modes,)
        Computed, Hz.
    jacobian : ndarray (n_modes, n_params)
        Of ``ln freq``, per unit of each parameter.
    covariance : ndarray (n_params, n_params)
    level : float

    Returns
    -------
    DataFrame
        ``mode, natural_freq, std, lower, upper``; Hz. Limits are symmetric in the logarithm.
    """
    import pandas as pd

    with np.errstate(invalid="ignore", over="ignore"):
        relative = np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))
        relative = np.where(np.isnan(relative), np.inf, relative)
        reach = float(special.ndtri(0.5 + level / 2)) * relative
        table = {"std": freq * relative, "lower": freq * np.exp(-reach), "upper": freq * np.exp(reach)}
    return pd.DataFrame({"mode": list(labels), "natural_freq": freq, **table})
