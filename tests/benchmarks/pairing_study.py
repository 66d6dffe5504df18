"""How often EMAC, MAC and order pairing find the mode that really belongs to a measured one.

Not part of the test run. Usage, from the root of the repository:

    python tests/benchmarks/pairing_study.py FOLDER [--samples 200] [--sensors 5] [--steps 20]

prints two tables and writes the first one, ``pairing_study.csv``, into the folder.

The bogie at its nominal values plays the measured structure: eight modes at all its sensors. At random points of the
study's two parameter spaces the truth is known by following every mode along the straight line from the nominal values
to the point, in at least that many steps; one is halved until consecutive mass-weighted shapes agree (MAC above 0.9).
Actuators, whose places are integers, move along the line as a support whose stiffness fades from one place to the
other. Where a mode meets another one so closely that even the smallest step turns its shape, the line is ambiguous and
left out of the score. Modes may also exchange their characters slowly (veering), so that a mode ends more like the
beginning of another one than like its own; such lines are scored, and counted apart.

The lines are followed on a reduced basis; the end points, where modes are paired, are solved at full order, and the end
of every line must be one of the full model's modes there. With fewer sensors than there are, every point draws its own.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.linalg as la
import scipy.sparse.linalg as spla
from scipy.optimize import linear_sum_assignment
from threadpoolctl import threadpool_limits

from calib.correlation.modal.pairing import emac, in_window, pair_by_order, pair_by_shape
from calib.measurement.mac import mac
from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.energy import strain_energy_shares
from calib.structure.model import StructuralModel
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
METHODS = ("EMAC", "MAC", "order")
SOLVED = 14
"""Modes solved at an end point; the pairing is offered as many as the study says."""
HALVINGS = 8
AGREE = 0.9
"""Smallest MAC of a mode's shapes at two consecutive steps."""
FOUND = 0.98
"""Smallest MAC of a line's last shape with the full model's mode it ends at."""


# -- lines through parameter space -------------------------------------------------------------------------------------


class ReducedModel:
    """A structural model on a fixed basis, with supports that may stand at two places at once.

    Parameters
    ----------
    model : StructuralModel
    points : list of mapping
        Named values whose undamped modes span the basis, beside the static answers to every place of a support.
    """

    def __init__(self, model: StructuralModel, points: list[Mapping[str, float]]):
        self.space = model.space
        k, _, m = model.matrices(model.space.values)
        columns = [solve_modes(a, None, b, SOLVED).shapes for a, _, b in map(model.matrices, points)]
        factor = spla.splu(k.tocsc(), permc_spec="MMD_AT_PLUS_A")
        for term in model.stiffness.selected:
            columns += [factor.solve(b)[:, None] for b in term.vectors.values()]
        raw = np.column_stack(columns)
        raw /= np.sqrt(np.einsum("ij,ij->j", raw, m @ raw))
        weight, mix = la.eigh(raw.T @ (m @ raw))
        kept = weight > 1e-11 * weight[-1]
        self.basis = raw @ (mix[:, kept] / np.sqrt(weight[kept]))
        self.stiffness, self.damping, self.mass = (
            [(t.coefficient, self.basis.T @ (t.matrix @ self.basis)) for t in matrix.terms]
            for matrix in (model.stiffness, model.damping, model.mass)
        )
        self.supports = [(t, {key: self.basis.T @ b for key, b in t.vectors.items()}) for t in model.stiffness.selected]

    def line(self, start: Mapping[str, float], end: Mapping[str, float]) -> Line:
        """The straight line between two points given by named values."""
        return Line(self, self.space.si(self.space.complete(start)), self.space.si(self.space.complete(end)))


@dataclass(frozen=True)
class Line:
    """Matrices on the way from one point (t = 0) to another (t = 1), both in SI."""

    model: ReducedModel
    start: Mapping[str, float]
    end: Mapping[str, float]

    def modes(self, t: float, count: int = SOLVED) -> tuple[np.ndarray, np.ndarray]:
        """Complex shapes over the basis (n_basis, count) in ascending frequency, and the mass matrix."""
        values = {name: (1 - t) * self.start[name] + t * self.end[name] for name in self.start}
        k, c, m = (
            sum(coefficient(values) * matrix for coefficient, matrix in terms)
            for terms in (self.model.stiffness, self.model.damping, self.model.mass)
        )
        for term, vectors in self.model.supports:
            for share, at in ((1 - t, self.start), (t, self.end)):
                b = vectors[term.choice(at)]
                k = k + share * term.coefficient(values) * np.outer(b, b)
        square, real = la.eigh(k, m, subset_by_index=[0, 39])
        # State space over forty undamped modes.
        n = len(square)
        state = np.zeros((2 * n, 2 * n))
        state[:n, n:] = np.eye(n)
        state[n:, :n] = -np.diag(square)
        state[n:, n:] = -real.T @ c @ real
        roots, vectors = la.eig(state)
        swinging = np.flatnonzero(roots.imag > 1e-7 * np.abs(roots))
        order = swinging[np.argsort(np.abs(roots[swinging]))][:count]
        return real @ vectors[:n, order], m


def overlap(one: np.ndarray, other: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Mass-weighted MAC of every pair of columns."""
    cross = np.abs(one.conj().T @ (mass @ other)) ** 2
    size = [np.einsum("ij,ij->j", x.conj(), mass @ x).real for x in (one, other)]
    return cross / np.outer(*size)


@dataclass(frozen=True)
class Followed:
    """Modes at the end of a line.

    Attributes
    ----------
    shapes : ndarray (n_dof, n_modes), complex
    clear : bool
        Whether every mode could be followed.
    veered : bool
        Whether some mode ends more like the beginning of another one than like its own.
    smallest : float
        Smallest step that was needed.
    """

    shapes: np.ndarray
    clear: bool
    veered: bool
    smallest: float


def follow(line: Line, modes: np.ndarray, steps: int) -> Followed:
    """Follow some of the modes at the beginning of a line, given by their numbers, to its end."""
    first, _ = line.modes(0.0)
    shapes, clear = first[:, modes], True
    t, step, smallest = 0.0, 1 / steps, 1 / steps
    while t < 1 - 1e-12:
        step = min(step, 1 - t)
        found, mass = line.modes(t + step)
        likeness = overlap(shapes, found, mass)
        rows, columns = linear_sum_assignment(likeness, maximize=True)
        worst = float(likeness[rows, columns].min())
        if worst < AGREE and step > 1 / steps / 2**HALVINGS:
            step /= 2
            continue
        clear = clear and worst >= AGREE
        shapes, t, smallest = found[:, columns], t + step, min(smallest, step)
        step = min(2 * step, 1 / steps)
    likeness = overlap(first[:, modes], shapes, mass)
    veered = bool(np.any(likeness.argmax(axis=0) != np.arange(len(modes))))
    return Followed(line.model.basis @ shapes, clear, veered, smallest)


# -- scoring -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Measured:
    """The model at its nominal values, measured: its modes in the order of the study's measured ones."""

    names: tuple[str, ...]
    numbers: np.ndarray
    freq: np.ndarray
    shapes: np.ndarray
    freq_std: np.ndarray
    shape_std: np.ndarray

    @staticmethod
    def of(study: LoadedStudy) -> Measured:
        """Noise-free, with the standard deviation of the study's own measurement kept beside."""
        found = study.problem.compare(study.model.space.values)
        numbers, given = found.pairing.model_index, found.measured
        if np.any(numbers < 0):
            raise SystemExit("at the nominal values not every measured mode has a partner, so none can be named")
        shapes = found.sensor_shapes[:, numbers]
        shapes = shapes / shapes[np.abs(shapes).argmax(axis=0), np.arange(len(numbers))]
        freq = found.modes.natural_freq[numbers]
        std = freq * np.nan_to_num(given.freq_std / given.natural_freq)
        return Measured(given.names, numbers, freq, shapes, std, np.nan_to_num(given.shape_std))

    def noisy(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies and shapes with the measurement's standard deviation."""
        parts = rng.standard_normal((2, *self.shapes.shape)) * self.shape_std
        return self.freq + rng.standard_normal(len(self.freq)) * self.freq_std, self.shapes + parts[0] + 1j * parts[1]


def study_space(
    study: LoadedStudy, measured: Measured, reduced: ReducedModel, space: ParameterSpace, given: argparse.Namespace
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """One row for every sample, kind of measurement, method and mode; and one for every line."""
    rng = np.random.default_rng(given.seed)
    pairs, lines = [], []
    model, problem = study.model, study.problem
    for number, x in enumerate(sample(space, given.samples, given.seed).points):
        values = space.complete(x)
        followed = follow(reduced.line(model.space.values, values), measured.numbers, given.steps)
        modes = model.modes(values, SOLVED)
        k, _, m = model.matrices(values)
        likeness = overlap(followed.shapes, modes.shapes, m)
        truth = likeness.argmax(axis=1)
        found = likeness.max(axis=1).min() >= FOUND and len(set(truth.tolist())) == len(truth)
        moved = not np.array_equal(np.argsort(truth), np.argsort(measured.numbers))
        lines.append(
            (number, followed.clear and found, followed.veered, moved, followed.smallest, likeness.max(axis=1).min())
        )
        offered = slice(0, problem.mode_count)
        at_sensors, freq = problem.sensor_rows @ modes.shapes[:, offered], modes.natural_freq[offered]
        shares, _ = strain_energy_shares(k, modes.shapes[:, offered], model.clusters)
        rows = dict(zip(model.clusters, shares, strict=True))
        share = np.array([sum(rows[c] for c in problem.mode_clusters[name]) for name in measured.names])
        some = np.sort(rng.choice(len(at_sensors), given.sensors or len(at_sensors), replace=False))
        for kind, (freq_measured, shapes) in (
            ("none", (measured.freq, measured.shapes)),
            ("as measured", measured.noisy(rng)),
        ):
            likely = mac(shapes[some], at_sensors[some])
            options = {"threshold": problem.threshold, "candidates": in_window(freq, problem.freq_window)}
            for method, pairing in (
                ("EMAC", pair_by_shape(likely, emac(likely, share), measured.names, **options)),
                ("MAC", pair_by_shape(likely, likely, measured.names, **options)),
                ("order", pair_by_order(freq_measured, freq, measured.names, window=problem.freq_window)[0]),
            ):
                for i, mode in enumerate(measured.names):
                    chosen = pairing.model_index[i]
                    verdict = "unpaired" if chosen < 0 else "right" if chosen == truth[i] else "wrong"
                    pairs.append((number, kind, method, mode, verdict, pairing.margin[i]))
    return (
        pd.DataFrame(pairs, columns=["sample", "noise", "method", "mode", "verdict", "margin"]),
        pd.DataFrame(lines, columns=["sample", "clear", "veered", "order_changed", "smallest_step", "found"]),
    )


def table_of(pairs: pd.DataFrame, lines: pd.DataFrame) -> pd.DataFrame:
    """Shares of modes and of samples, over the lines that could be followed."""
    clear = set(lines.loc[lines["clear"], "sample"])
    calm = set(lines.loc[lines["clear"] & ~lines["veered"], "sample"])
    rows = []
    for (noise, method), part in pairs[pairs["sample"].isin(clear)].groupby(["noise", "method"], sort=False):
        whole = (part["verdict"] == "right").groupby(part["sample"]).all()
        shares = {v: float((part["verdict"] == v).mean()) for v in ("right", "wrong", "unpaired")}
        wrong = part.loc[(part["verdict"] == "wrong") & part["margin"].notna(), "margin"]
        rows.append(
            {
                "noise": noise, "method": method, **shares, "all_eight": float(whole.mean()),
                "all_eight_without_veering": float(whole[whole.index.isin(calm)].mean()),
                "wrong_with_margin_below_0.2": float((wrong < 0.2).mean()) if len(wrong) else np.nan,
            }
        )  # fmt: skip
    order = {m: k for k, m in enumerate(METHODS)}
    return (
        pd.DataFrame(rows)
        .sort_values("method", key=lambda s: s.map(order), kind="stable")
        .sort_values("noise", key=lambda s: s != "none", kind="stable")
    )


def by_mode(pairs: pd.DataFrame) -> pd.DataFrame:
    """Share of samples in which each mode is paired right, with a noise-free measurement."""
    pairs = pairs[(pairs["noise"] == "none") & pairs["clear"]]
    right = pairs.assign(right=pairs["verdict"] == "right")
    return right.pivot_table(index=["space", "method"], columns="mode", values="right", aggfunc="mean")


def main() -> None:
    """Read the command line, study both spaces, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--samples", type=int, default=200)
    parser.add_argument("--sensors", type=int, help="as many, drawn anew at every point [default: all]")
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--seed", type=int, default=77)
    given = parser.parse_args()
    began = time.perf_counter()
    study = LoadedStudy.load(ROOT / "studies/bogie")
    spaces = {"sensitivity": study.sensitivity_space, "search": study.search_space}
    spanning = [s.complete(x) for k, s in enumerate(spaces.values()) for x in sample(s, 30, given.seed + 1 + k).points]
    reduced, measured = ReducedModel(study.model, spanning), Measured.of(study)
    tables, all_pairs = [], []
    for name, space in spaces.items():
        pairs, lines = study_space(study, measured, reduced, space, given)
        clear = lines["clear"]
        print(
            f"{name} space: {given.samples} samples, {(~clear).mean():.1%} ambiguous, "
            f"{lines.loc[clear, 'veered'].mean():.1%} of the others with veering, "
            f"{lines.loc[clear, 'order_changed'].mean():.1%} in another order than at the nominal values; "
            f"smallest step {lines['smallest_step'].min():.4f}, "
            f"ends found with a MAC of {lines['found'].min():.5f} or more"
        )
        tables.append(table_of(pairs, lines).assign(space=name))
        all_pairs.append(pairs.assign(space=name).merge(lines[["sample", "clear"]], on="sample"))
    table = pd.concat(tables, ignore_index=True)
    table = table[["space", *(c for c in table.columns if c != "space")]]
    print(table.to_string(index=False, float_format=lambda v: f"{100 * v:.1f} %"))
    given.folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(given.folder / "pairing_study.csv", index=False, float_format="%.6g")
    print(by_mode(pd.concat(all_pairs, ignore_index=True)).to_string(float_format=lambda v: f"{100 * v:.0f} %"))
    print(f"{time.perf_counter() - began:.0f} s; {given.folder / 'pairing_study.csv'}")


if __name__ == "__main__":
    with threadpool_limits(1):  # small matrices are slower on several threads
        main()
