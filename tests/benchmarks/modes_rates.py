"""How often `calib modes` finds modes, invents some, and holds the true damping, over 70 simulated tests.

A bar of two planes, fixed at both ends, is measured in seven families of tests: light damping, close pairs, 5 %
damping, zoomed lines, drift between functions, a roving accelerometer whose mass loads the bar where it stands, and
wide bands, in which some modes are weak since the force is near their nodes. Functions are inverses of dynamic
stiffness matrices, true modes eigenvalues of state matrices; no line that identifies is used.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import beta, t

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_repeats import FRFRepeat, combine_frfs
from calib.measurement.mac import mac
from calib.modal_analysis.identify import modes_from_frfs

FAMILIES = ("light", "pairs", "heavy", "zoom", "drift", "roving", "wide")
RUNS = 10
MASSES = 14
"""Of each plane of the bar."""
STATIONS = (1, 3, 4, 6, 8, 11)
"""Masses that carry a sensor, along both axes, which lie between the planes."""
LOUD = 5.0
"""Least height of a counted mode over the noise, root mean squares over the functions."""
ALIKE = 0.9
"""Least MAC of an identified mode with the true one."""


@dataclass(frozen=True)
class Case:
    """What one simulated test is like.

    ``first`` and ``last`` are the modes of each plane at the ends of the band, ``split`` the relative distance of the
    planes' frequencies, ``moved`` the relative standard deviation of the stiffness between functions, ``carried`` the
    sensor's mass over that of the bar, ``hits`` the repeats, ``noise`` a share of the functions' root mean square and
    ``force`` the station, by its place in `STATIONS`, of the force or of the first of two.
    """

    family: str
    seed: int
    damping: float
    split: float
    noise: float
    first: int = 1
    last: int = 3
    lines: float = 4.0
    references: int = 1
    hits: int = 1
    moved: float = 0.0
    carried: float = 0.0
    force: int = 0


def case_of(family: str, seed: int) -> Case:
    """A case of a family, drawn by its number."""
    rng = np.random.default_rng([FAMILIES.index(family), seed])
    noise, damping = float(10 ** rng.uniform(-2.7, -2.0)), float(rng.uniform(0.004, 0.012))
    hits = 3 if seed % 5 == 4 else 1
    if family == "light":
        return Case(family, seed, float(rng.uniform(0.001, 0.003)), 0.22, noise, 2, 3, hits=hits)
    if family == "pairs":
        apart = float(rng.uniform(1.0, 3.0)) * 2 * damping
        return Case(family, seed, damping, apart, noise, 1, 3, 6.0, references=1 + seed % 2, hits=hits)
    if family == "heavy":
        return Case(family, seed, float(rng.uniform(0.04, 0.06)), 0.22, noise, 1, 4, 12.0, 1 + seed % 2, hits)
    if family == "zoom":
        first = int(rng.integers(3, 8))
        return Case(family, seed, damping / 2, 0.04, 0.01, first, first + int(rng.integers(0, 2)), 3.5)
    if family == "drift":
        return Case(family, seed, damping / 2, 0.22, noise, 1, 3, hits=3 * (seed % 2) + 1,
                    moved=float(10 ** rng.uniform(-4.7, -3.5)))  # fmt: skip
    if family == "wide":
        # stations 4 and 9 of 14 stand near a third and two thirds of the length, where modes 3 and 6 have nodes
        return Case(family, seed, damping, float(rng.uniform(0.04, 0.12)), noise / 2, 1, int(rng.integers(6, 9)), 5.0,
                    hits=hits, force=2 + seed % 2)  # fmt: skip
    return Case(family, seed, damping, 0.22, noise, 1, 3, carried=float(10 ** rng.uniform(-3.5, -2.3)))


@dataclass(frozen=True, eq=False)
class Bar:
    """Matrices of the bar of a case, two planes one after the other; SI."""

    k: np.ndarray
    c: np.ndarray
    m: np.ndarray

    @classmethod
    def of(cls, case: Case) -> Bar:
        """Springs between masses and to both ends, uneven by 10 %; dampers beside them and to ground, by 30 %."""
        rng = np.random.default_rng([99, FAMILIES.index(case.family), case.seed])
        stretch = np.diff(np.vstack([np.zeros(MASSES), np.eye(MASSES), np.zeros(MASSES)]), axis=0)
        mass = rng.uniform(0.9, 1.1, MASSES) / MASSES
        scale = (2 * np.pi * 50.0 / np.pi * (MASSES + 1)) ** 2 / MASSES  # about 50 Hz, 100 Hz, ...
        springs = rng.uniform(0.9, 1.1, MASSES + 1)
        k, c = np.zeros((2 * MASSES, 2 * MASSES)), np.zeros((2 * MASSES, 2 * MASSES))
        middle = 2 * np.pi * 50.0 * 0.5 * (case.first + case.last)
        for plane, grown in ((0, 1.0), (1, (1 + case.split) ** 2)):
            here = slice(plane * MASSES, (plane + 1) * MASSES)
            own = scale * grown * stretch.T @ (springs[:, None] * stretch)
            k[here, here] = own
            uneven = scale * grown * stretch.T @ ((springs * rng.uniform(0.7, 1.3, len(springs)))[:, None] * stretch)
            c[here, here] = case.damping * (uneven / middle + middle * np.diag(mass * rng.uniform(0.7, 1.3, MASSES)))
        coupling = 0.2 * min(case.split, 0.02) * scale * (np.pi / (MASSES + 1)) ** 2
        k[:MASSES, MASSES:] += coupling * np.diag(rng.uniform(0, 1, MASSES))
        return cls(np.triu(k) + np.triu(k, 1).T, c, np.diag(np.tile(mass, 2)))

    def loaded(self, stiffer: float = 0.0, at: int | None = None, mass: float = 0.0) -> Bar:
        """The bar with another stiffness and a mass at a station."""
        m = self.m.copy()
        if at is not None:
            for row in (at, at + MASSES):
                m[row, row] += mass
        return Bar(self.k * (1 + stiffer), self.c, m)

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Poles, rad/s, ascending, and shapes at all masses."""
        n = len(self.k)
        state = np.block([
            [np.zeros((n, n)), np.eye(n)],
            [-np.linalg.solve(self.m, self.k), -np.linalg.solve(self.m, self.c)],
        ])  # fmt: skip
        found, vectors = np.linalg.eig(state)
        order = np.flatnonzero(found.imag > 0)
        order = order[np.argsort(np.abs(found[order]))]
        return found[order], vectors[:n, order]

    def receptances(self, freq: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(n_freq, n_dof, n_right)."""
        omega = (2 * np.pi * freq)[:, None, None]
        return np.linalg.solve(self.k + 1j * omega * self.c - omega**2 * self.m, right[None])


def sensor_rows() -> np.ndarray:
    """Rows of the measured motions: at each station along two axes 30 degrees from the planes."""
    rows, cos, sin = [], np.cos(np.pi / 6), np.sin(np.pi / 6)
    for station in STATIONS:
        for along, across in ((cos, sin), (-sin, cos)):
            row = np.zeros(2 * MASSES)
            row[station], row[station + MASSES] = along, across
            rows.append(row)
    return np.array(rows)


@dataclass(frozen=True, eq=False)
class Simulated:
    """Repeats of a test, true poles and shapes at the sensors, which of them are counted, and their scatter."""

    repeats: tuple[FRFRepeat, ...]
    poles: np.ndarray
    shapes: np.ndarray
    counted: np.ndarray


def simulated(case: Case) -> Simulated:
    """Functions of a case with its noise, drift and load."""
    rng = np.random.default_rng([7, FAMILIES.index(case.family), case.seed])
    bar, rows = Bar.of(case), sensor_rows()
    poles, shapes = bar.modes()
    size = np.abs(poles) / (2 * np.pi)
    low, high = size[2 * case.first - 2], size[2 * case.last - 1]
    margin = min(0.3 * 50.0, max(0.5 * (high - low), 8 * case.damping * high))
    widths = -2 * poles.real / (2 * np.pi)
    spacing = widths[(size >= low) & (size <= high)].min() / case.lines
    band = max(low - margin, 0.3 * low), high + margin
    n = max(int((band[1] - band[0]) / spacing) + 1, 60)
    freq = np.linspace(*band, n)
    forces = [2 * case.force, 7][: case.references]
    places = rows[forces]
    accelerance = -((2 * np.pi * freq) ** 2)[:, None, None]
    carried = case.carried * float(np.trace(bar.m)) / 2
    repeats = []
    for hit in range(case.hits):
        values = np.zeros((n, len(rows), case.references), complex)
        if case.moved or carried:
            for i, row in enumerate(rows):
                own = bar.loaded(case.moved * rng.standard_normal(), STATIONS[i // 2], carried)
                values[:, i] = np.einsum("d,fdr->fr", row, own.receptances(freq, places.T))
        else:
            values = np.einsum("sd,fdr->fsr", rows, bar.receptances(freq, places.T))
        values = values * accelerance
        rms = float(np.sqrt(np.mean(np.abs(values) ** 2)))
        values = values + case.noise * rms * (
            rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
        )
        pairs = {
            ((STATIONS[i // 2], "yz"[i % 2]), (STATIONS[k // 2], "yz"[k % 2])): values[:, i, j]
            for i in range(len(rows)) for j, k in enumerate(forces)
        }  # fmt: skip
        repeats.append(FRFRepeat(f"hit {hit + 1}", freq, "accelerance", pairs))
    if carried:
        # all functions are loaded: the mode that they hold is the mean of those under the load at each station
        poles = np.mean([bar.loaded(0.0, at, carried).modes()[0] for at in STATIONS], axis=0)
    truth = rows @ shapes
    scale = np.array([phi @ (2 * s * bar.m + bar.c) @ phi for s, phi in zip(poles, shapes.T, strict=True)])
    residues = truth[:, None, :] * (places @ shapes)[None] / scale
    heights = np.sqrt(np.mean(np.abs(residues) ** 2, axis=(0, 1))) * np.abs(poles) ** 2 / -poles.real
    inside = (size > band[0] + widths) & (size < band[1] - widths) & (widths / (freq[1] - freq[0]) >= 3)
    loud = heights > LOUD * case.noise * rms * np.sqrt(2 / case.hits)
    return Simulated(tuple(repeats), poles, truth, inside & loud)


def outcome(case: Case) -> dict[str, object]:
    """Counts of one test: modes counted, found, false, and damping ratios in their 95 % interval."""
    made = simulated(case)
    mean = combine_frfs(made.repeats, synthetic=True)
    each: list[MeasuredFRFs] = [combine_frfs([one], synthetic=True) for one in made.repeats] if case.hits > 1 else []
    out: dict[str, object] = {
        "family": case.family, "seed": case.seed, "counted": int(made.counted.sum()), "found": 0, "false": 0, "held": 0,
        "kept": 0, "lost": "", "invented": "", "beyond": "",
    }  # fmt: skip
    size, ratio = np.abs(made.poles) / (2 * np.pi), -made.poles.real / np.abs(made.poles)
    try:
        found = modes_from_frfs(mean, each).modes
    except InputError as fault:
        return {**out, "lost": str(fault)}
    agreement = mac(found.shapes, made.shapes)
    moved = 3 * max(case.moved, case.carried)
    near = np.abs(found.natural_freq[:, None] - size) <= size * (ratio + moved)
    likely = (agreement >= ALIKE) & near
    partners: dict[int, int] = {}
    for k in np.argsort(-agreement.max(axis=1)):
        free = [m for m in np.flatnonzero(likely[k]) if m not in partners.values()]
        if free:
            partners[int(k)] = max(free, key=lambda m: agreement[k, m])
    limit = t.ppf(0.975, case.hits - 1) if case.hits > 1 else t.ppf(0.975, 1e9)
    off = {k: (found.damping_ratio[k] - ratio[m]) / found.damping_std[k] for k, m in partners.items()}
    lost = [m for m in np.flatnonzero(made.counted) if m not in partners.values()]
    return {
        **out, "kept": found.n_modes, "found": int(made.counted.sum()) - len(lost),
        "false": found.n_modes - len(partners), "matched": len(partners),
        "held": sum(abs(value) <= limit for value in off.values()),
        "lost": ", ".join(f"{size[m]:.2f} Hz" for m in lost),
        "invented": ", ".join(f"{f:.2f} Hz" for k, f in enumerate(found.natural_freq) if k not in partners),
        "beyond": ", ".join(f"{found.natural_freq[k]:.2f} Hz {v:+.1f}" for k, v in off.items() if abs(v) > limit),
    }  # fmt: skip


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """Sums by family and of all, with the share's one-sided 95 % bound (Clopper and Pearson 1934)."""
    rows = [(name, table[table["family"] == name]) for name in FAMILIES] + [("all", table)]
    return pd.DataFrame([row for name, own in rows for row in _shares(name, own)])


def _shares(name: str, own: pd.DataFrame) -> Iterator[dict[str, object]]:
    for what, hits, of, upper in (
        ("found", "found", "counted", False), ("false", "false", "kept", True),
        ("damping held", "held", "matched", False),
    ):  # fmt: skip
        x, n = int(own[hits].sum()), int(own[of].sum())
        if not n:
            continue
        bound = (
            (beta.ppf(0.95, x + 1, n - x) if x < n else 1.0) if upper else (beta.ppf(0.05, x, n - x + 1) if x else 0.0)
        )
        yield {"family": name, "tests": len(own), "what": what, "count": x, "of": n, "bound": round(float(bound), 3)}


def main() -> None:
    """Run all cases, or those of one family, and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=FAMILIES)
    parser.add_argument("--runs", type=int, default=RUNS, help="tests of each family")
    parser.add_argument("--write", type=Path, help="table of the counts, CSV")
    chosen = parser.parse_args()
    rows = []
    for family in chosen.families:
        for seed in range(chosen.runs):
            rows.append(outcome(case_of(family, seed)))
            print({k: v for k, v in rows[-1].items() if v != ""}, flush=True)
    table = counts(pd.DataFrame(rows).fillna(0))
    print(table.to_string(index=False))
    if chosen.write is not None:
        table.to_csv(chosen.write, index=False)


if __name__ == "__main__":
    main()
