"""A linear or mildly nonlinear model with Gaussian noise: closed forms exist and simulation is cheap."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from calib.errors.errors import EvaluationError
from calib.missing.decision import decide
from calib.missing.explanation import Explanation
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit
from calib.missing.rules import RULES
from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from tests.missing.verdict_cases import dressed, every_verdict


@dataclass(frozen=True)
class Row:
    """Label of one value of the data."""

    mode: str
    kind: str
    sensor: str = ""


@dataclass(frozen=True)
class Bump:
    """Signature with a nuisance parameter, largest in the modes whose place is near it, as that of a hung mass."""

    direction: np.ndarray
    place: np.ndarray
    nuisance: str
    width: float = 0.8

    def at(self, values: Mapping[str, float]) -> np.ndarray:
        return self.direction * np.exp(-0.5 * ((self.place - values[self.nuisance]) / self.width) ** 2)

    def slope(self, values: Mapping[str, float]) -> np.ndarray:
        return self.at(values) * (self.place - values[self.nuisance]) / self.width**2


@dataclass(frozen=True, eq=False)
class ToyProblem:
    """The toy with some effects."""

    toy: Toy
    space: ParameterSpace

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        self.toy.count[0] += 1
        if self.toy.fails(values):
            raise EvaluationError("it cannot be solved there")
        return (self.toy.data - self.toy.answer(values)) / self.toy.sd

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        columns = [-self.toy.slope(values, name) / self.toy.sd for name in names]
        return np.column_stack(columns) if columns else np.zeros((len(self.toy.data), 0))


@dataclass(frozen=True, eq=False)
class Toy:
    """Hypotheses about ``y = L + curvature L^2`` with ``L`` the sum of columns times parameters and magnitudes.

    ``columns`` holds one column for a parameter, effect or perturbation, or one for each place of an integer parameter;
    ``bumps`` the signatures of effects with a nuisance parameter; ``sd`` is the stated standard deviation, the true one
    is 1.
    """

    rows: tuple[Row, ...]
    base: ParameterSpace
    columns: Mapping[str, np.ndarray]
    bumps: Mapping[str, Bump]
    effects: tuple[Effect, ...]
    perturbations: tuple[Effect, ...]
    data: np.ndarray
    sd: np.ndarray
    curvature: float = 0.0
    fitted_factors: Mapping[tuple[str, str], int] = field(default_factory=dict)
    std_dof: Mapping[str, float] = field(default_factory=dict)
    fails: Callable[[Mapping[str, float]], bool] = lambda values: False
    faults: tuple[Effect, ...] = ()
    shared: tuple[np.ndarray, ...] = ()
    count: list[int] = field(default_factory=lambda: [0])

    @property
    def evaluations(self) -> int:
        return self.count[0]

    @property
    def shared_errors(self) -> np.ndarray:
        return np.array(self.shared).reshape(len(self.shared), len(self.rows)).T

    def fit_problem(self, names: tuple[str, ...]) -> ToyProblem:
        known = {e.name: e for e in (*self.effects, *self.perturbations, *self.faults)}
        more = tuple(p for n in names for p in known[n].parameters)
        return ToyProblem(self, ParameterSpace(self.base.parameters + more, self.base.constraints))

    def granting(self, faults: tuple[str, ...]) -> Toy:
        more = tuple(p for e in self.faults if e.name in faults for p in e.parameters)
        base = ParameterSpace(self.base.parameters + more, self.base.constraints)
        return replace(self, base=base, faults=tuple(e for e in self.faults if e.name not in faults), count=self.count)

    def unpaired(self, names: tuple[str, ...], values: Mapping[str, float]) -> frozenset[str]:
        return frozenset()

    def linear_start(self, names: tuple[str, ...], values: Mapping[str, float]) -> None:
        return None

    def _straight(self, values: Mapping[str, float]) -> np.ndarray:
        total = np.zeros(len(self.rows))
        for name, column in self.columns.items():
            if column.ndim == 2:
                total = total + column[:, round(values[name])]
            elif value := values.get(name, 0.0):  # most effects and perturbations have none
                total = total + column * value
        for name, bump in self.bumps.items():
            if values.get(name, 0.0):
                total = total + bump.at(values) * values[name]
        return total

    def answer(self, values: Mapping[str, float]) -> np.ndarray:
        straight = self._straight(values)
        return straight + self.curvature * straight**2

    def slope(self, values: Mapping[str, float], name: str) -> np.ndarray:
        inner = 1 + 2 * self.curvature * self._straight(values)
        for effect, bump in self.bumps.items():
            if name == effect:
                return inner * bump.at(values)
            if name == bump.nuisance:
                return inner * bump.slope(values) * values.get(effect, 0.0)
        return inner * self.columns[name]

    def drawn(self, rng: np.random.Generator, truth: Mapping[str, float] | None = None, noise: float = 1.0) -> Toy:
        """The toy with simulated data; parameters without a given truth are drawn from their prior."""
        values = {p.name: p.value if p.integer else rng.normal(p.value, p.prior_width) for p in self.base.parameters}
        exact = self.answer({**values, **(truth or {})})
        return replace(self, data=exact + noise * rng.standard_normal(len(self.rows)), count=[0])

    def explained(self, truth: Mapping[str, float], draws: int, seed: int = 1, noise: float = 1.0) -> list[Explanation]:
        """Explanations of simulated data sets, drawn one after the other from one generator."""
        rng = np.random.default_rng(seed)
        return [decide(self.drawn(rng, truth, noise)) for _ in range(draws)]

    def correlated(self, name: str, of: str, share: float, seed: int = 1) -> Toy:
        """The toy with a column of unchanged length that correlates with another one by ``share``."""
        other = np.random.default_rng(seed).standard_normal(len(self.rows))
        one = self.columns[of]
        other -= one * (one @ other) / (one @ one)
        column = share * one + np.sqrt(1 - share**2) * np.linalg.norm(one) * other / np.linalg.norm(other)
        return replace(self, columns={**self.columns, name: column})

    def calibrated(self, *names: str, start: Mapping[str, float] | None = None, whole: int = 0) -> LinearisedFit:
        fit_problem = self.fit_problem(names)
        return least_squares_fit(fit_problem, names, {**fit_problem.space.values, **(start or {})}, whole)


def labels(modes: int, sensors: int, kinds: Sequence[str]) -> tuple[Row, ...]:
    """A frequency, a damping ratio and the sensors of a shape for every mode, or scalar responses."""
    if not modes:
        return tuple(Row("", "response", f"y{k}") for k in range(sensors))
    out = []
    for k in range(modes):
        out += [Row(f"M{k}", kind) for kind in kinds if kind != "shape"]
        out += [Row(f"M{k}", "shape", f"S{s}") for s in range(sensors) if "shape" in kinds]
    return tuple(out)


def effect(name: str, size: float = 1.0, signed: bool = False, **more: object) -> Effect:
    """An effect whose plausible magnitude is ``size``."""
    lower = -50.0 * size if signed else 0.0
    magnitude = Parameter(name, 0.0, lower, 50.0 * size, prior_sd=size)
    return Effect(name, name, "lacks it", "look for it", magnitude, lambda model: None, **more)  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def make_effect() -> Callable[..., Effect]:
    return effect


@pytest.fixture(scope="session")
def toy() -> Callable[..., Toy]:
    """Parameters P0.., effects E0.. and local perturbations A0.. of random directions, one unit of the given size.

    Parameters act on all modes, effects and perturbations mostly on two. Without local perturbations no effect would be
    named: one that acts on all modes takes their place.
    """

    def make(
        seed: int = 0,
        parameters: int = 4,
        effects: int = 5,
        perturbations: int = 8,
        modes: int = 8,
        sensors: int = 10,
        kinds: Sequence[str] = ("frequency", "damping", "shape"),
        signed: Sequence[str] = (),
        size: float = 8.0,
        prior: float = 1.0,
        reach: float = 3.0,
        bump: bool = False,
        places: int = 0,
        curvature: float = 0.0,
    ) -> Toy:
        rng = np.random.default_rng(seed)
        rows = labels(modes, sensors, kinds)
        n = len(rows)

        def column(length: float, local: bool = True) -> np.ndarray:
            v = rng.standard_normal(n)
            if modes and local:
                touched = {f"M{k}" for k in rng.choice(modes, 2, replace=False)}
                v *= [1.0 if row.mode in touched else 0.1 for row in rows]
            return length * v / np.linalg.norm(v)

        own = [Parameter(f"P{k}", 0.0, -10 * prior, 10 * prior, prior_sd=prior) for k in range(parameters)]
        columns = {p.name: column(reach / prior * (1 + k), local=False) for k, p in enumerate(own)}
        if places:
            own.append(Parameter("place", 0, 0, places - 1, integer=True))
            columns["place"] = np.column_stack([column(size) for _ in range(places)])
        named = [effect(f"E{k}", signed=f"E{k}" in signed) for k in range(effects)]
        local = [effect(f"A{k}", signed=True) for k in range(perturbations)]
        columns |= {e.name: column(size) for e in (*named, *local)}
        bumps = {}
        if bump:
            grid = tuple({"hung": 1.0, "at": float(q)} for q in range(modes))
            middle = (modes - 1) / 2
            nuisance = Parameter("at", middle, -1.0, float(modes), "Hz", prior_sd=middle)
            named.append(effect("hung", nuisance=(nuisance,), grid=grid))
            place = np.array([int(row.mode[1:]) for row in rows], dtype=float)
            bumps["hung"] = Bump(column(2 * size, local=False), place, "at")
        if not local:
            local = [effect("bland", signed=True)]
            columns["bland"] = size * np.random.default_rng([seed, 1]).standard_normal(n) / np.sqrt(n)
        return Toy(
            rows=rows,
            base=ParameterSpace(tuple(own)),
            columns=columns,
            bumps=bumps,
            effects=tuple(named),
            perturbations=tuple(local),
            data=np.zeros(n),
            sd=np.ones(n),
            curvature=curvature,
        )

    return make


@pytest.fixture(scope="session")
def faulty(toy: Callable[..., Toy]) -> Callable[..., Toy]:
    """A toy whose measurement may have the faults F0.. of random local directions."""

    def make(number: int = 6, kind: str = "gain", **more: int) -> Toy:
        made = toy(effects=4, perturbations=6, **more)
        rng = np.random.default_rng(7)
        modes = np.array([row.mode for row in made.rows])
        columns, faults = dict[str, np.ndarray](), list[Effect]()
        for k in range(number):
            column = rng.standard_normal(len(made.rows)) * np.where(np.isin(modes, [f"M{k}", f"M{k + 1}"]), 1.0, 0.1)
            columns[f"F{k}"] = 8.0 * column / np.linalg.norm(column)
            one = effect(f"F{k}", signed=True)
            look = replace(one, look_for="Check its mounting.")
            object.__setattr__(look, "of_measurement", True)
            object.__setattr__(look, "kind", kind)
            faults.append(look)
        return dressed(replace(made, columns={**made.columns, **columns}, faults=tuple(faults)))

    return make


@pytest.fixture(scope="session")
def cases(toy: Callable[..., Toy]) -> dict[str, Explanation]:
    """Explanations of every verdict."""
    return every_verdict(toy)


@pytest.fixture
def fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the samples behind a p-value: enough for a level of 1 %; sampling takes longest over toys."""
    monkeypatch.setattr("calib.missing.score.RULES", replace(RULES, samples=RULES.samples // 4))
