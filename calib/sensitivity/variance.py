"""Elementary effects (Morris) and variance shares (Sobol) for a space without constraints, through SALib."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd

from calib.errors.errors import InputError
from calib.problem.space import ParameterSpace


@dataclass(frozen=True, eq=False)
class Design:
    """Points to evaluate, in the order the analysis expects.

    Attributes
    ----------
    method : {"morris", "sobol"}
    names : tuple of str
        The free parameters.
    points : ndarray (n_points, n_free)
        Over the free parameters, each in its own unit; integers for integer parameters.
    unit : ndarray (n_points, n_free)
        The same points as parts of the range, 0 to 1, as they are evaluated (integers rounded).
    note : str
        What the points ignore, in one sentence; empty when nothing.
    """

    method: Literal["morris", "sobol"]
    names: tuple[str, ...]
    points: np.ndarray
    unit: np.ndarray
    note: str = ""


def morris_design(
    space: ParameterSpace, trajectories: int, seed: int, levels: int = 4, ignore_constraints: bool = False
) -> Design:
    """Trajectories that change one parameter at a time (Morris 1991): ``trajectories * (n_free + 1)`` points.

    Parameters
    ----------
    space : ParameterSpace
    trajectories : int
    seed : int
    levels : int
        Even number of grid levels; a step is ``levels/(2(levels - 1))`` of the range, for integer parameters
        rounded to the nearest value.
    ignore_constraints : bool
        Elementary effects need inputs that vary one by one over the whole box. Constraints are refused, unless this is
        set: then points that break them are evaluated as well, and `Design.note` says so.

    Raises
    ------
    InputError
        When a constraint binds free parameters and is not ignored, nothing is free, or a number is out of range.
    """
    note = _independent(space, "elementary effects (Morris)", ignore_constraints)
    if trajectories < 2 or levels < 2 or levels % 2:
        raise InputError(
            f"{trajectories} trajectories on {levels} levels are requested",
            place="Morris",
            remedy="ask for at least 2 trajectories and an even number of levels",
        )
    from SALib.sample import morris as morris_sampling  # slow to import, and few commands need it

    unit = morris_sampling.sample(_problem(space), trajectories, num_levels=levels, seed=seed)
    span = np.where(space.integer, space.upper - space.lower, 1.0)
    unit = np.where(space.integer, np.round(unit * span) / span, unit)
    return Design("morris", space.free_names, space.between(unit), unit, note)


def morris_effects(design: Design, responses: pd.DataFrame) -> pd.DataFrame:
    """Mean size and standard deviation of the elementary effects (Morris 1991; Campolongo, Cariboni and Saltelli 2007).

    An effect is the change of the response over the part of its range that the parameter actually moved (after
    rounding of integers), so that for a linear response ``mu`` is the coefficient times the range.

    Parameters
    ----------
    design : Design
        Of `morris_design`.
    responses : DataFrame (n_points, n_responses)
        Row for row with ``design.points``; NaN where an evaluation failed or the response is unknown.

    Returns
    -------
    DataFrame
        ``parameter, response, mu, mu_star, sigma, trajectories, dropped``: effects in the response's unit over the
        whole range; a trajectory with an unknown value of a response is dropped for that response, and counted. NaN
        where fewer than 2 trajectories remain.

    Raises
    ------
    InputError
        When the rows do not belong to the design.
    """
    y = _rows(design, "morris", responses)
    p = len(design.names)
    runs, points = y.reshape(-1, p + 1, y.shape[1]), design.unit.reshape(-1, p + 1, p)
    steps = np.diff(points, axis=1)
    changed = np.abs(steps).argmax(axis=2)
    length = np.take_along_axis(steps, changed[:, :, None], axis=2)
    effects = np.empty((len(runs), p, y.shape[1]))
    np.put_along_axis(effects, changed[:, :, None], np.diff(runs, axis=1) / length, axis=1)
    whole = np.isfinite(runs).all(axis=1)
    out = []
    for j, response in enumerate(responses.columns):
        kept = effects[whole[:, j], :, j]
        figures = np.full((3, p), np.nan)
        if len(kept) >= 2:
            figures = np.stack([kept.mean(axis=0), np.abs(kept).mean(axis=0), kept.std(axis=0, ddof=1)])
        for i, name in enumerate(design.names):
            out.append((name, response, *figures[:, i].tolist(), len(kept), len(runs) - len(kept)))
    columns = ["parameter", "response", "mu", "mu_star", "sigma", "trajectories", "dropped"]
    return pd.DataFrame(out, columns=columns)


def sobol_design(space: ParameterSpace, base: int, seed: int, ignore_constraints: bool = False) -> Design:
    """Points for first-order and total variance shares (Saltelli et al. 2010): ``base * (n_free + 2)`` of them.

    Parameters
    ----------
    space : ParameterSpace
    base : int
        A power of 2, as Sobol's sequence requires.
    seed : int
        Of the scrambling (Owen).
    ignore_constraints : bool
        Variance shares are defined for independent inputs. Constraints are refused, unless this is set: then points
        that break them are evaluated as well, and `Design.note` says so.

    Raises
    ------
    InputError
        When a constraint binds free parameters and is not ignored, nothing is free, or ``base`` is no power of 2.
    """
    note = _independent(space, "variance shares (Sobol)", ignore_constraints)
    if base < 2 or base & (base - 1):
        raise InputError(f"{base} base points are requested", place="Sobol", remedy="ask for a power of 2, such as 512")
    from SALib.sample import sobol as sobol_sampling  # slow to import, and few commands need it

    unit = sobol_sampling.sample(_problem(space), base, calc_second_order=False, seed=seed)
    points = space.from_unit(unit)
    return Design("sobol", space.free_names, points, space.position(points), note)


def sobol_shares(design: Design, responses: pd.DataFrame, seed: int = 0) -> pd.DataFrame:
    """First-order and total share of each response's variance (Sobol 2001; Saltelli et al. 2010).

    Parameters
    ----------
    design : Design
        Of `sobol_design`.
    responses : DataFrame (n_points, n_responses)
        Row for row with ``design.points``, all known.
    seed : int
        Of the resampling behind the confidence intervals.

    Returns
    -------
    DataFrame
        ``parameter, response, S1, S1_conf, ST, ST_conf``: shares, and half widths of their 95 % intervals from 100
        resamplings; NaN for a response that never changes.

    Raises
    ------
    InputError
        When any value is unknown: the estimators need every point of the design, and missing values are not imputed.
    """
    y = _rows(design, "sobol", responses)
    unknown = ~np.isfinite(y)
    if unknown.any():
        worst = int(unknown.sum(axis=0).argmax())
        raise InputError(
            f"response {responses.columns[worst]!r} is unknown at {int(unknown[:, worst].sum())} of {len(y)} points",
            place="Sobol",
            remedy="narrow the limits to where the model can be evaluated, leave that response out, or use Morris",
        )
    from SALib.analyze import sobol as sobol_analysis  # slow to import, and few commands need it

    problem = {"num_vars": len(design.names), "names": list(design.names), "bounds": [[0.0, 1.0]] * len(design.names)}
    out = []
    for j, response in enumerate(responses.columns):
        if np.ptp(y[:, j]) > 0:
            # SALib takes a seed of 0 for none and then uses NumPy's global generator.
            found: Any = sobol_analysis.analyze(problem, y[:, j], calc_second_order=False, seed=seed + 1)
        else:
            found = dict.fromkeys(("S1", "S1_conf", "ST", "ST_conf"), np.full(len(design.names), np.nan))
        for i, name in enumerate(design.names):
            out.append((name, response, *(float(found[key][i]) for key in ("S1", "S1_conf", "ST", "ST_conf"))))
    return pd.DataFrame(out, columns=["parameter", "response", "S1", "S1_conf", "ST", "ST_conf"])


def _independent(space: ParameterSpace, what: str, ignore: bool) -> str:
    """Refuse the constraints that bind free parameters, or return a sentence that they are ignored."""
    if not space.free:
        raise InputError("no parameter is free", place=what, remedy="select at least one parameter")
    free = set(space.free_names)
    binding = [c.name for c in space.constraints if any(name in free and value for name, value in c.coefficients)]
    if not binding:
        return ""
    names = ", ".join(repr(name) for name in binding)
    if not ignore:
        raise InputError(
            f"{what} need independent parameters, but these are bound by {names}",
            place="sensitivity",
            remedy="use the partial rank correlation and the variance share, or have the constraints ignored",
        )
    return f"Constraints are ignored ({names}): the points fill the whole box, infeasible parts included."


def _problem(space: ParameterSpace) -> dict[str, Any]:
    names = list(space.free_names)
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


def _rows(design: Design, method: str, responses: pd.DataFrame) -> np.ndarray:
    if design.method != method:
        raise InputError(f"the points were made for {design.method}, not for {method}", place="sensitivity")
    if len(responses) != len(design.points):
        raise InputError(
            f"{len(responses)} rows of responses do not belong to {len(design.points)} points", place="sensitivity"
        )
    return responses.to_numpy(dtype=float)
