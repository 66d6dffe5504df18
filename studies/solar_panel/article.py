"""The example of Li and Hong (2012), computed anew: reduction, both iterations, noise, and cost.

    python studies/solar_panel/article.py          # tables and figures in results/solar_panel_article

The experiment is the article's own: the measured structure is the same mesh with other Young's moduli, so that nothing
but noise separates it from the model. It tests the iteration, not a calibration of a real structure. Geometry,
densities and Poisson's ratios of the array are lost; frequencies near which the functions are taken, weights of the
equations and seeds are not in the article either. They are chosen here, once: 2 % above each resonance, weights that
whiten multiplicative noise, seeds from 0 on. The results depend on these choices (`offsets`).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.linalg as la
import scipy.sparse as sp

from calib import EvaluationError, StructuralModel
from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import Change, CmcfSettings, InitialModel, MeasuredReceptance, Reduce
from calib.structure.reduction.static_reduction import reduction_levels, static_reduction
from calib.study.loading import module_of
from models.solar_panel import GROUPS, MASTERS, solar_panel

HERE = Path(__file__).resolve().parent

FACTORS = (1.2, 1.2, 1.3, 1.3, 1.5, 1.5)
"""Young's moduli of the experiment over those of the model, in the order of `GROUPS`."""
ASYMMETRIC = (1.2, 1.1, 1.3, 1.05, 1.5, 1.25)
"""Others, which move the array out of its symmetry; the article has none."""
LEVEL = 4
"""Of the reduction, counted from Guyan's, which is 0."""
ORDERS, MEASURED, REPORTED = 8, 4, 6
"""Model and measured frequencies in the equations, and frequencies that the article compares."""
STEPS = 15
NOISE_FRF, NOISE_FREQ = 0.05, 0.03
OFFSET = 0.02
OTHER_OFFSETS = (-0.05,)
SEEDS = 40
ITERATIONS = ("proposed", "traditional", "traditional_total")
SETTLED = (0.1, 0.5)
"""Distance of all frequency errors from their values after the last step within which a run counts as settled, %."""
LINES = np.arange(0.05, 70.0, 0.05)
"""Hz, of the functions that are drawn."""
PAIR = (0, 11)
"""H(1, 12): first and last master, nodes 1 and 30."""


@dataclass(frozen=True, eq=False)
class Example:
    """The array as the model to update.

    Attributes
    ----------
    array : StructuralModel
    """

    array: StructuralModel

    @cached_property
    def masters(self) -> np.ndarray:
        """Deflections of the article's nodes among the degrees of freedom, (12,)."""
        at = {(int(node) + 1, int(d)): k for k, (node, d) in enumerate(zip(*self._labels, strict=True))}
        return np.array([at[node, 2] for node in MASTERS])

    @property
    def _labels(self) -> tuple[np.ndarray, np.ndarray]:
        return self.array.dofs.node, self.array.dofs.direction

    @cached_property
    def model(self) -> InitialModel:
        """Its matrices, their changes and its reduction."""
        k, _, m = self.array.matrices({})
        own = [self.array.matrix_derivatives({}, g)[0] * self.array.space[g].value for g in GROUPS]
        changes = tuple(Change(g, "stiffness", sp.csc_array(part)) for g, part in zip(GROUPS, own, strict=True))
        return InitialModel(k, m, changes, self.masters, partial(_transformation, self.masters))

    def stiffness(self, factors: Sequence[float]) -> np.ndarray:
        """Stiffness matrix with factors on the Young's moduli, (90, 90)."""
        each = zip(factors, self.model.changes, strict=True)
        return np.asarray((self.model.stiffness + sum((f - 1) * change.matrix for f, change in each)).toarray())

    def freq(self, factors: Sequence[float], count: int = ORDERS) -> np.ndarray:
        """Natural frequencies, Hz."""
        squares = la.eigh(self.stiffness(factors), self.model.mass.toarray(), eigvals_only=True)
        return np.asarray(np.sqrt(squares[:count]) / (2 * np.pi))

    def receptance(self, factors: Sequence[float], freq: Iterable[float]) -> np.ndarray:
        """Receptance between all masters, (n_freq, 12, 12), m/N."""
        k, m = self.stiffness(factors), self.model.mass.toarray()
        forces = np.eye(len(k))[:, self.masters]
        return np.array([la.solve(k - (2 * np.pi * f) ** 2 * m, forces)[self.masters] for f in freq])

    def measured(self, factors: Sequence[float], offset: float) -> MeasuredReceptance:
        """What a test without noise gives beside its first resonances."""
        freq = self.freq(factors, MEASURED) * (1 + offset)
        return MeasuredReceptance(freq, self.receptance(factors, freq), np.arange(len(self.masters)))

    def noisy(
        self, true: MeasuredReceptance, seed: int, frf: float = NOISE_FRF, freq: float = NOISE_FREQ
    ) -> MeasuredReceptance:
        """With the article's noise: uniform within a share of each function value and of each frequency."""
        rng = np.random.default_rng(seed)
        receptance = true.receptance * (1 + frf * rng.uniform(-1, 1, true.receptance.shape))
        freq = true.freq * (1 + freq * rng.uniform(-1, 1, len(true.freq)))
        return MeasuredReceptance(freq, receptance, true.references)

    def errors(self, factors: Sequence[float]) -> np.ndarray:
        """Frequency errors against the experiment, %, (8,)."""
        return np.asarray(100 * (self.freq(factors) / self.freq(FACTORS) - 1))


@dataclass
class Counted:
    """A reduction that counts its calls."""

    reduce: Reduce
    calls: int = 0

    def __call__(self, stiffness: sp.csc_array, mass: sp.csc_array) -> np.ndarray:
        """As the reduction itself."""
        self.calls += 1
        return self.reduce(stiffness, mass)


def _transformation(masters: np.ndarray, stiffness: sp.csc_array, mass: sp.csc_array) -> np.ndarray:
    return static_reduction(stiffness, mass, masters, LEVEL).transformation


def reduction(example: Example) -> pd.DataFrame:
    """Table 1: frequencies of the reduced model by level; error in %."""
    k, m = example.model.stiffness, example.model.mass
    true = example.freq(np.ones(len(GROUPS)))
    rows = []
    for level, reduced in enumerate(islice(reduction_levels(k, m, example.masters), LEVEL + 1)):
        for order, (own, full) in enumerate(zip(reduced.natural_freq, true, strict=False), start=1):
            rows.append({"level": level, "order": order, "freq": full, "error": 100 * (own / full - 1)})
    return pd.DataFrame(rows)


def noise_free(example: Example) -> pd.DataFrame:
    """Largest error of a factor after each step without noise, by truth and iteration."""
    rows = []
    for truth, factors in (("symmetric", FACTORS), ("asymmetric", ASYMMETRIC)):
        measured = example.measured(factors, OFFSET)
        for iteration in ITERATIONS:
            found = cmcf(example.model, measured, _settings(iteration, OFFSET))
            for step, changes in enumerate(found.changes):
                error = float(np.abs(1 + changes - factors).max())
                rows.append({"truth": truth, "iteration": iteration, "step": step, "error": error})
    return pd.DataFrame(rows)


def _settings(iteration: str, offset: float) -> CmcfSettings:
    """All steps, as in the article."""
    return CmcfSettings(orders=ORDERS, offset=offset, iteration=iteration, steps=STEPS, tolerance=0.0)


def runs(example: Example, seeds: int, offset: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Runs with noise: one row a seed and iteration, and the frequency errors after each of its steps."""
    runs, steps = [], []
    true = example.measured(FACTORS, offset)
    for seed in range(seeds):
        measured = example.noisy(true, seed)
        for iteration in ITERATIONS:
            counted, begun = Counted(example.model.reduce), time.process_time()
            row = {"offset": offset, "iteration": iteration, "seed": seed, "error": ""}
            try:
                found = cmcf(replace(example.model, reduce=counted), measured, _settings(iteration, offset))
            except EvaluationError as failed:
                runs.append(row | {"error": str(failed)})
                continue
            row |= {"processor_ms": 1e3 * (time.process_time() - begun)}
            row |= {"builds": found.builds, "reductions": counted.calls}
            errors = np.array([example.errors(1 + changes) for changes in found.changes])
            compared = errors[:, :REPORTED]
            row |= {"first": np.abs(compared[1]).max(), "largest": np.abs(compared[-1]).max()}
            row |= {f"settled_{size:g}": settled(compared[1:], size) for size in SETTLED}
            runs.append(row | dict(zip(GROUPS, 1 + found.changes[-1], strict=True)))
            steps += [
                {"iteration": iteration, "seed": seed, "step": step, "order": order, "error": error}
                for step, each in enumerate(errors) for order, error in enumerate(each, start=1)
            ]  # fmt: skip
    return pd.DataFrame(runs), pd.DataFrame(steps)


def settled(errors: np.ndarray, size: float) -> int:
    """The first step from which on every error, (n_steps, n_orders) in %, stays within a size of its last value."""
    far = np.flatnonzero(np.any(np.abs(errors - errors[-1]) > size, axis=1))
    return 1 if not len(far) else int(far[-1]) + 2


def convergence(steps: pd.DataFrame) -> pd.DataFrame:
    """Figure 2: median and largest frequency error over the seeds after each step, %."""
    size = steps.assign(error=steps["error"].abs()).groupby(["iteration", "order", "step"])["error"]
    return size.agg(median="median", worst="max").reset_index()


def frequencies(converged: pd.DataFrame) -> pd.DataFrame:
    """Table 2: frequency errors before and after, %, by order and iteration."""
    last = converged[converged["step"] == STEPS].set_index(["iteration", "order"])
    before = converged[(converged["step"] == 0) & (converged["iteration"] == ITERATIONS[0])]
    out = before[["order"]].assign(before=before["median"]).set_index("order")
    for iteration in ITERATIONS:
        for column in ("median", "worst"):
            out[f"{iteration}_{column}"] = last.loc[iteration, column]
    return out.reset_index()


def factors(runs: pd.DataFrame) -> pd.DataFrame:
    """Factors of the Young's moduli over the seeds."""
    rows = []
    for iteration, own in runs.groupby("iteration", sort=False):
        for group, true in zip(GROUPS, FACTORS, strict=True):
            found = own[group].dropna()
            rows.append({
                "iteration": iteration, "parameter": group, "true": true, "mean": found.mean(), "std": found.std(),
                "median": found.median(), "lowest": found.min(), "highest": found.max(),
            })  # fmt: skip
    return pd.DataFrame(rows)


def cost(runs: pd.DataFrame) -> pd.DataFrame:
    """Table 3: builds of the equations, reductions, and processor time of a run over that of the proposed iteration."""
    done = runs[runs["error"] == ""].groupby("iteration", sort=False)
    counts = {name: (name, "max") for name in ("builds", "reductions")}
    out = done.agg(**counts, processor_ms=("processor_ms", "median")).reset_index()
    out["ratio"] = out["processor_ms"] / out["processor_ms"].iloc[0]
    return out


def offsets(runs: pd.DataFrame) -> pd.DataFrame:
    """How the comparison depends on where the functions are taken; errors in %."""
    rows = []
    for (offset, iteration), own in runs.groupby(["offset", "iteration"], sort=False):
        done = own[own["error"] == ""]
        row = {"offset": offset, "iteration": iteration, "runs": len(own), "failed": len(own) - len(done)}
        row |= {"first": done["first"].median(), "median": done["largest"].median(), "worst": done["largest"].max()}
        rows.append(row | {f"settled_{size:g}": done[f"settled_{size:g}"].median() for size in SETTLED})
    return pd.DataFrame(rows)


def sources(example: Example, seeds: int) -> pd.DataFrame:
    """Largest frequency error of the proposed iteration under either noise alone, %: median and worst of the seeds."""
    rows, true = [], example.measured(FACTORS, OFFSET)
    for frf, freq in ((NOISE_FRF, 0.0), (0.0, NOISE_FREQ)):
        found = [
            cmcf(example.model, example.noisy(true, s, frf, freq), _settings("proposed", OFFSET)) for s in range(seeds)
        ]
        largest = [np.abs(example.errors(1 + one.changes[-1])[:REPORTED]).max() for one in found]
        rows.append({"frf": frf, "freq": freq, "median": np.median(largest), "worst": max(largest)})
    return pd.DataFrame(rows)


def functions(example: Example, runs: pd.DataFrame) -> pd.DataFrame:
    """Figures 3 and 4: modulus of H(1, 12), m/N, before and after, for each iteration at its median seed."""
    wanted = {"experiment": FACTORS, "before": np.ones(len(GROUPS))}
    for iteration in ITERATIONS[:2]:
        ranked = runs[(runs["iteration"] == iteration) & (runs["error"] == "")].sort_values("largest")
        if len(ranked):
            wanted[iteration] = ranked[list(GROUPS)].iloc[len(ranked) // 2].to_numpy(dtype=float)
    found = {name: np.abs(example.receptance(given, LINES)[:, *PAIR]) for name, given in wanted.items()}
    return pd.DataFrame({"freq": LINES, **found})


def tables(seeds: int = SEEDS) -> dict[str, pd.DataFrame]:
    """All tables by name."""
    example = Example(solar_panel())
    here, steps = runs(example, seeds, OFFSET)
    every = pd.concat([here, *(runs(example, seeds, offset)[0] for offset in OTHER_OFFSETS)])
    converged = convergence(steps)
    return {
        "reduction": reduction(example),
        "noise_free": noise_free(example),
        "runs": every,
        "convergence": converged,
        "frequencies": frequencies(converged),
        "factors": factors(here),
        "cost": cost(here),
        "offsets": offsets(every),
        "sources": sources(example, seeds),
        "functions": functions(example, here),
    }


def main() -> None:
    """Write all tables and figures; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--into", type=Path, default=Path("results/solar_panel_article"), help="folder of results")
    arguments.add_argument("--seeds", type=int, default=SEEDS, help=f"draws of the noise (default {SEEDS})")
    given = arguments.parse_args()
    given.into.mkdir(parents=True, exist_ok=True)
    for name, table in tables(given.seeds).items():
        table.to_csv(given.into / f"{name}.csv", index=False)
    for path in module_of(HERE / "article_figures.py").SET.save_all(given.into):
        print(path)


if __name__ == "__main__":
    main()
