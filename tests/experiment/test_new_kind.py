"""A kind of test that calib does not have, added as ARCHITECTURE.md says: deflections under a static load."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from scipy.sparse.linalg import spsolve

import calib
from calib.errors.errors import InputError
from calib.experiment import Test
from calib.experiment.test import UNNAMED, require_named
from calib.problem.differences import central_jacobian
from calib.results.fingerprint import digest_of

# -- what would stand in calib/correlation/static -------------------------------------------------------------------


class DeflectionRow(NamedTuple):
    mode: str
    kind: str
    sensor: str


@dataclass(frozen=True, eq=False)
class DeflectionProblem:
    """A model's deflections under a load (node: N) against measured ones (sensor: mm and its standard deviation)."""

    model: calib.StructuralModel
    targets: Mapping[str, tuple[float, float]]
    load: Mapping[str, float]

    reducible = user_function = numbers_function = None
    assumed_std = ()

    @property
    def space(self):
        return self.model.space

    @property
    def fingerprint(self):
        return digest_of("deflections", self.model.fingerprint, sorted(self.load.items()))[:16]

    @property
    def search_targets(self):
        return {name: value for name, (value, _) in self.targets.items()}

    @property
    def sensitivity_responses(self):
        return list(self.targets)

    @property
    def relative_std(self):
        return np.array([std / abs(value) for value, std in self.targets.values()])

    @property
    def std_dof(self):
        return {"deflection": np.inf}

    def with_model(self, model):
        return replace(self, model=model)

    def evaluate(self, values):
        stiffness, _, _ = self.model.matrices(values)
        force = sum(size * self.model.sensor_rows([sensor(name)])[0] for name, size in self.load.items())
        moved = self.model.sensor_rows([sensor(name) for name in self.targets]) @ spsolve(stiffness, force)
        return dict(zip(self.targets, (1e3 * moved).tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class DeflectionResidual:
    problem: DeflectionProblem

    fitted_factors: Mapping[tuple[str, str], int] = field(default_factory=dict)
    told_by_responses = True
    faults = ()

    @property
    def space(self):
        return self.problem.space

    @property
    def rows(self):
        return tuple(DeflectionRow("", "deflection", name) for name in self.problem.targets)

    @property
    def relative_std(self):
        return self.problem.relative_std

    @property
    def shared_errors(self):
        return np.zeros((len(self.rows), 0))

    @property
    def std_dof(self):
        return self.problem.std_dof

    @property
    def fingerprint(self):
        return digest_of("deflection residual", self.problem.fingerprint, list(self.problem.targets.items()))[:16]

    @property
    def std(self):
        return np.array([std for _, std in self.problem.targets.values()])

    @property
    def measured_values(self):
        return np.array([value for value, _ in self.problem.targets.values()])

    def within(self, space):
        return self

    def with_model(self, model, added=None):
        return replace(self, problem=self.problem.with_model(model))

    def solve(self, values):
        return self.problem.evaluate(values)

    def responses(self, solution):
        return dict(solution)

    def restored(self, responses):
        return dict(responses)

    def of(self, solution):
        return np.array([(value - solution[name]) / std for name, (value, std) in self.problem.targets.items()])

    def slope(self, values, names, at):
        return central_jacobian(lambda there: self.of(at(there)), self.space, values, names)

    def unpaired(self, solution):
        return frozenset()

    def frequencies(self, values, names, at):
        return (), np.zeros(0), np.zeros((0, len(names)))


@dataclass(frozen=True, eq=False)
class HeldOutDeflections:
    targets: Mapping[str, tuple[float, float]]

    def pair(self, problem):
        return DeflectionResidual(replace(problem, targets=self.targets))

    def unfitted(self, values):
        return {}


def sensor(name):
    return calib.Sensor(int(name[:-1]), name[-1])


# -- what would stand in calib/experiment/static.py -----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DeflectionTest(Test):
    """Deflections, mm, under a load, N, both by node and direction."""

    deflections: Mapping[str, tuple[float, float]]
    load: Mapping[str, float]
    held_out: tuple[str, ...] = ()
    name: str = UNNAMED
    condition: Mapping[str, float] = field(default_factory=dict)

    repeats = None
    assumed = disagreements = ()
    claimed = ""

    def __post_init__(self):
        require_named(self)

    @property
    def measured(self):
        return self.deflections

    @cached_property
    def used(self):
        return {name: value for name, value in self.deflections.items() if name not in self.held_out}

    @property
    def unseen(self):
        held_out = {name: self.deflections[name] for name in self.held_out}
        return {"held_out_deflections": HeldOutDeflections(held_out)} if held_out else {}

    def problem(self, model, base=None):
        if not isinstance(model, calib.StructuralModel):
            raise InputError("it has no matrices", place=f"model {model.name}", remedy="give a StructuralModel")
        return DeflectionProblem(model, self.used, self.load)

    def residual(self, problem):
        return DeflectionResidual(problem)

    def table(self):
        rows = [(name, name in self.held_out, *value) for name, value in self.deflections.items()]
        return pd.DataFrame(rows, columns=["response", "held_out", "value", "std"])


# -- and what it can then be used for ---------------------------------------------------------------------------------

N = 6
LOAD = 49.05
"""N, at the free end: every spring carries it."""
TRUE = {"low": 32.0, "high": 48.0}


def compliance(low, high, soft=1.0):
    """Deflection of every mass, mm, in closed form: the springs below it, 1 to 3 and 4 to 6, are in series."""
    springs = np.array([low, low, soft * low, high, high, high])
    return np.cumsum(LOAD / springs)


def chain():
    def spring(n):
        row = np.zeros(N)
        row[n - 1] = 1.0
        if n > 1:
            row[n - 2] = -1.0
        return np.outer(row, row)

    return calib.StructuralModel.from_matrices(
        stiffness={f"spring {n}": (spring(n), "low" if n <= N // 2 else "high") for n in range(1, N + 1)},
        mass=10.0 * np.eye(N),
        dofs=[(n, "x") for n in range(1, N + 1)],
        parameters=[
            calib.Parameter("low", 25.0, 10.0, 90.0, "kN/m"),
            calib.Parameter("high", 60.0, 10.0, 90.0, "kN/m"),
        ],
        name="chain",
    )


def measured(soft=1.0, **given):
    found = compliance(**TRUE, soft=soft)
    return DeflectionTest({f"{n}x": (found[n - 1], 0.01) for n in range(1, N + 1)}, {f"{N}x": LOAD}, **given)


def test_it_is_compared():
    found = calib.Problem(chain(), measured()).compare()
    np.testing.assert_allclose(found.table["model"], compliance(25.0, 60.0))
    np.testing.assert_allclose(found.table["measured"], compliance(**TRUE))


@pytest.mark.medium
def test_it_is_fitted_and_verified_on_what_is_held_out():
    fit = calib.Problem(chain(), measured(held_out=("6x",))).calibrate()
    assert fit.values == pytest.approx(TRUE, rel=1e-4)
    # Of d = F/low (1, 2, 3) and 3 F/low + F/high (1, 2) the standard deviations, in closed form.
    slope = np.array([[1, 0], [2, 0], [3, 0], [3, 1], [3, 2]]) * -LOAD / np.array(list(TRUE.values())) ** 2
    std = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope))) * 0.01
    np.testing.assert_allclose(fit.table["std"], std, rtol=1e-3)
    errors = fit.errors.set_index("group")
    assert errors.loc["held_out_deflections", "rows"] == 1 and errors.loc["held_out_deflections", "rms"] < 0.1
    assert errors.loc["fit", "rows"] == N - 1


@pytest.mark.medium
def test_it_is_sampled_searched_and_reported_on(tmp_path):
    problem = calib.Problem(chain(), measured(), ledger=tmp_path / "ledger.sqlite")
    assert set(problem.sensitivity(samples=64).selected) == {"low", "high"}
    fit = problem.search(cases=2, population=8, generations=6)
    assert fit.values == pytest.approx(TRUE, rel=1e-4)
    (page,) = fit.report(tmp_path / "page.html")
    cells = re.sub(r"(<[^>]*>|\s)+", " ", page.read_text("utf-8"))
    want, found = compliance(**TRUE)[-1], compliance(25.0, 60.0)[-1]
    assert f" 6x {want:.5f} {found:.5f} {100 * (found / want - 1):+.2f} " in cells


def test_what_its_model_lacks_is_found():
    found = calib.Problem(chain(), measured(soft=0.7, held_out=("6x",))).explain().explanation.explanation
    assert found.perturbation.names == ("stiffness of spring 3",)
    assert found.perturbation.fit.values["stiffness of spring 3"] == pytest.approx(-0.3, abs=0.005)


@pytest.mark.medium
def test_it_stands_beside_another_kind():
    values = calib.Problem(chain(), measured()).calibrate().values
    first = chain().modes(values, 1).natural_freq[0]
    both = [measured(name="pulled"), calib.ResponseTest({"freq_1": (first, 0.01)}, name="shaken")]
    fit = calib.Problem(chain(), both).calibrate()
    assert fit.values == pytest.approx(TRUE, rel=1e-4)
    assert set(fit.errors["test"]) == {"pulled", "shaken"}


def test_what_is_no_test_is_refused_by_the_names_of_the_kinds():
    with pytest.raises(InputError, match="ModalTest or ResponseTest or FRFTest"):
        calib.Problem(chain(), 3.0)


def test_it_is_no_test_of_modes_or_of_a_mesh():
    fit = calib.Problem(chain(), measured()).statistics_at({})
    assert fit.figures == ("parameters",)
    with pytest.raises(InputError, match="it has no modes"):
        fit.figure("mac")
    with pytest.raises(InputError, match="has no mesh"):
        fit.explain(finer=chain())
