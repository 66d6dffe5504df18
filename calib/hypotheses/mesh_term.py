"""The error of the mesh as a term of the covariance of an explanation's residual."""

from __future__ import annotations

from typing import Any

from calib.correlation.mesh_error import MeshError
from calib.errors.errors import InputError
from calib.hypotheses.rules import RULES
from calib.missing.linearised_fit import least_squares_fit, nearest_whole
from calib.missing.test import Adapter
from calib.structure.model import StructuralModel


def with_mesh_error(adapter: Adapter, finer: StructuralModel | None, sd: float, test: str = "") -> Adapter:
    """The adapter with an uncertain multiple of the change to a finer mesh among its parameters.

    The base model is fitted, both meshes are compared there, and again after a fit with that change. Fitted along with
    every model and projected out of every score, the multiple counts like the covariance ``sd^2 d d^T`` added to that
    of the data, ``d`` the change of the predictions (see `calib.correlation.mesh_error.MeshError`).

    Parameters
    ----------
    adapter : Adapter
    finer : StructuralModel or None
        The same parameters on a finer mesh.
    sd : float
        Standard deviation of the multiple.
    test : str
        Name of the test, where there are several; each has a multiple of its own.

    Raises
    ------
    InputError
        Without a finer mesh of a model of matrices, or where it has other parameters or modes.
    EvaluationError
        When the base model cannot be fitted.
    """
    if finer is None or not adapter.on_mesh:
        raise InputError(
            "mesh_sd states an error of the mesh, but no finer mesh is known", place="explain, mesh_sd",
            remedy="name its model options in finer_options, or leave mesh_sd out",
        )  # fmt: skip
    of_test: Any = adapter  # of one test
    fit_problem = of_test.hypotheses.fit_problem(())
    begin = nearest_whole(fit_problem, fit_problem.space.values)
    linear = of_test.hypotheses.linear_start((), begin)
    fits = [least_squares_fit(fit_problem, (), start, 1) for start in (begin, linear) if start is not None]
    values, out = min(fits, key=lambda fit: fit.misfit).values, of_test
    for k in range(RULES.mesh_fits):
        mesh = MeshError(of_test.hypotheses.variants.model, finer, fit_problem.pair.space.complete(values), sd, test)
        out = of_test.with_mesh(mesh)
        if k < RULES.mesh_fits - 1:
            again = least_squares_fit(out.hypotheses.fit_problem(()), (), values, 1)
            values = mesh.without(again.values)
    found: Adapter = out
    return found


def mesh_words(sd: float | None) -> tuple[str, ...]:
    """How uncertain the mesh is taken to be, in a sentence; none for an exact mesh."""
    if sd is None:
        return ()
    return (f"The error of the mesh counts as uncertain, by {sd:.3g} times the change to a finer mesh.",)
