"""What is uncertain beside the fitted parameters: those that are not selected, and the mesh of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calib.analyses.joint_responses import own_values
from calib.errors.errors import EvaluationError, InputError
from calib.problem.problem import PairProblem
from calib.problem.shared_points import solve_shared
from calib.problem.space import Parameter, replace_parameters
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy


def with_uncertain(study: LoadedStudy) -> LoadedStudy:
    """The study with its unselected parameters free within their limits; unchanged where all are selected or exact.

    Fitted along and projected out of every score, they count like a covariance ``J S^2 J^T`` added to that of the data,
    J the derivative of the predictions and S their prior standard deviations (Kennedy and O'Hagan 2001, to first
    order), as in a calibration; see `calib.inference.considered`.
    """
    space = study.search_space
    for p in uncertain(study):
        freed = p.within(p.lower, p.upper, value=space[p.name].value, distribution="uniform")
        space = replace_parameters(space, tuple(freed if q.name == p.name else q for q in space.parameters))
    return study if space is study.search_space else replace(study, search_space=space)


def uncertain(study: LoadedStudy) -> tuple[Parameter, ...]:
    """Unselected parameters whose values are uncertain by their priors; no integers, none that is held."""
    return tuple(study.model.space[name] for name in study.unselected if name in study.held_sd)


def uncertain_note(study: LoadedStudy) -> tuple[str, ...]:
    """Which parameters that are not selected are uncertain, and which are exact, in words; empty without any."""
    names = [p.name for p in uncertain(study)]
    exact = [name for name in study.unselected if name not in names]
    if not names:
        return ()
    rest = f"; exact, as integers: {', '.join(exact)}" if exact else ""
    return (f"Parameters that are not selected are uncertain by their priors: {', '.join(names)}{rest}.",)


def mesh_changes(study: AnyStudy, values: Mapping[str, float], built: dict[str, Any] | None = None) -> np.ndarray:
    """Change of the whitened residual from the mesh of each model to its finer one, (n_rows, n_models).

    Both are solved at the named values. The tests of one model change together: their mesh is one. Rows of modes that
    only one of both meshes pairs are 0. ``built`` holds the residuals on the finer meshes, by name of the test, for
    further values.

    Raises
    ------
    InputError
        Where a finer model has other parameters, or cannot be solved.
    """
    several, of_model, blocks = len(study.studies) > 1, dict[str, int](), []
    known = {} if built is None else built
    for one in study.studies:
        pair = one.experiment.residual(one.problem)
        if one.test not in known:
            finer = one.on_finer_mesh()
            known[one.test] = None if finer is None else _on_finer(one, pair, finer)
        change, k = np.zeros(len(pair.rows)), None
        if known[one.test] is not None:
            k = of_model.setdefault(one.model_key, len(of_model))
            own = own_values(one, values) if several else {n: v for n, v in values.items() if n in pair.space}
            change = _mesh_change(one, pair, known[one.test], pair.space.complete(own))
        blocks.append((k, change))
    out = np.zeros((sum(len(change) for _, change in blocks), len(of_model)))
    begin = 0
    for k, change in blocks:
        if k is not None:
            out[begin : begin + len(change), k] = change
        begin += len(change)
    return out


def _on_finer(study: LoadedStudy, pair: Any, finer: Any) -> Any:
    """The residual on a finer mesh; InputError where that has other parameters."""
    if other := sorted(set(study.model.space.names) ^ set(finer.space.names)):
        raise InputError(
            f"only one of model and finer model has the parameter {other[0]}",
            place=study.place("explain", "finer_options"), remedy="change the size of the elements alone",
        )  # fmt: skip
    return pair.with_model(finer)


def _mesh_change(study: LoadedStudy, pair: Any, refined: Any, values: Mapping[str, float]) -> np.ndarray:
    own, finer = PairProblem(pair, pair.space), PairProblem(refined, refined.space)
    solve_shared([(own, values), (finer, values)])
    try:
        here, there = own.at(values), finer.at(values)
        change = np.asarray(refined.of(there) - pair.of(here))
    except EvaluationError as fault:
        place = study.place("explain", "finer_options")
        raise InputError(f"the finer model cannot be solved ({fault})", place=place) from None
    lost = pair.unpaired(here) ^ refined.unpaired(there)
    return np.where([row.mode in lost for row in pair.rows], 0.0, change)
