"""Synthetic measurement of the five-mass chain, with one effect that the study's model lacks.

    python studies/five_mass_chain/make_twin.py TRUTH.json

The twin differs from the fitted model (no inverse crime): its springs have mass and are ten pieces each, so that it has
fifty masses. Each of the nominal masses 1 to 5 includes half of the adjacent springs. Stiffnesses, damping, the effect
and its magnitude are drawn by a seed and written to TRUTH.json, which nothing under ``calib``, ``models`` or
``studies`` reads. Any effect but the soft foundation may be drawn; that one is collinear with a soft spring 1.

The noise of the ten repeats is independent for each response, with a standard deviation of their mean of 0.2 % of the
frequency, 5 % of the damping ratio and 0.01 of the shape; the standard deviations in the table are estimated from the
repeats, pooled over the responses of each kind.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from models.five_mass_chain import DAMPING, HUNG_DAMPING, MASS, MASSES, STIFFNESS, chain_effects, responses

HERE = Path(__file__).resolve().parent
PIECES = 10
SPRING_MASS = 0.002
REPEATS = 10
STD_FREQ, STD_DAMPING, STD_SHAPE = 0.002, 0.05, 0.01
INVISIBLE = ("soft_foundation",)
MAGNITUDE = (1.0, 3.0)
"""Range of the magnitude, over its plausible size."""


def draw(rng: np.random.Generator, hidden: str | None = None) -> dict[str, float]:
    """True values: springs to 5 %, damping to 15 % (standard deviations), one effect (``hidden``; empty for none)."""
    truth = {f"k{i}": float(1 + 0.05 * rng.standard_normal()) for i in range(1, MASSES + 1)}
    truth["damping"] = float(np.exp(0.15 * rng.standard_normal()))
    library = {e.name: e for e in chain_effects() if e.name not in INVISIBLE}
    if hidden is None:
        hidden = str(rng.choice(list(library)))
    if hidden:
        truth[hidden] = float(library[hidden].plausible * rng.uniform(*MAGNITUDE))
        truth |= {q.name: float(q.value + 0.5 * q.prior_width * rng.uniform(-1, 1)) for q in library[hidden].nuisance}
    return truth


def twin_responses(truth: Mapping[str, float]) -> dict[str, float]:
    """Noise-free responses of the twin."""
    get = truth.get
    size = MASSES * PIECES + 1
    stiffness, damping, mass = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))

    def join(matrix: np.ndarray, value: float, a: int, b: int) -> None:
        matrix[np.ix_([a, b], [a, b])] += value * np.array([[1, -1], [-1, 1]])

    def load(value: float, node: int) -> None:
        mass[node, node] += value

    main = [PIECES * i for i in range(MASSES + 1)]
    for i in range(1, MASSES + 1):
        k, c = STIFFNESS * truth[f"k{i}"], DAMPING * truth["damping"]
        if i == 4:
            c *= 1 - get("weak_damper_4", 0.0)
        for piece in range(main[i - 1], main[i]):
            join(stiffness, PIECES * k, piece, piece + 1)
            join(damping, PIECES * c, piece, piece + 1)
            load(SPRING_MASS / PIECES / 2, piece)
            load(SPRING_MASS / PIECES / 2, piece + 1)
        load(MASS - SPRING_MASS * (1.0 if i < MASSES else 0.5), main[i])
    join(stiffness, get("ground_spring_3", 0.0), main[3], 0)
    join(stiffness, get("cross_spring_2_4", 0.0), main[2], main[4])
    join(damping, get("ground_damper_5", 0.0), main[5], 0)
    load(get("extra_mass_2", 0.0), main[2])
    if hung := get("hung_mass_5", 0.0):
        omega = 2 * np.pi * truth["hung_freq"]
        stiffness, damping, mass = (np.pad(matrix, (0, 1)) for matrix in (stiffness, damping, mass))
        join(stiffness, hung * omega**2, size, main[5])
        join(damping, 2 * HUNG_DAMPING * hung * omega, size, main[5])
        mass[size, size] = hung
    return responses(*_five_modes(stiffness[1:, 1:], damping[1:, 1:], np.diag(mass)[1:], main[1:]))


def _five_modes(
    stiffness: np.ndarray, damping: np.ndarray, mass: np.ndarray, main: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and shapes of the lowest five modes in which the chain has more energy than the hung mass."""
    n = len(mass)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / mass[:, None], -damping / mass[:, None]]])
    eigenvalues, vectors = np.linalg.eig(state)
    upper = np.flatnonzero(eigenvalues.imag > 0)
    upper = upper[np.argsort(np.abs(eigenvalues[upper]))]
    at = np.array(main) - 1
    energy = mass[:, None] * np.abs(vectors[:n, upper]) ** 2
    chain = upper[energy[: MASSES * PIECES].sum(axis=0) > 0.5 * energy.sum(axis=0)][:MASSES]
    return eigenvalues[chain], vectors[:n][np.ix_(at, chain)]


def measure(exact: Mapping[str, float], rng: np.random.Generator) -> dict[str, tuple[float, float]]:
    """Mean over the repeats of every response and its standard deviation, pooled over the responses of each kind."""
    names, values = list(exact), np.array(list(exact.values()))
    kinds = np.array([name.split("_")[0] for name in names])
    unit = np.where(kinds == "shape", 1.0, np.abs(values))
    std = np.select([kinds == "freq", kinds == "damping"], [STD_FREQ, STD_DAMPING], STD_SHAPE)
    repeats = values + unit * std * np.sqrt(REPEATS) * rng.standard_normal((REPEATS, len(names)))
    mean = repeats.mean(axis=0)
    unit = np.where(kinds == "shape", 1.0, np.abs(mean))
    spread = np.var(repeats / unit, axis=0, ddof=1) / REPEATS
    pooled = np.sqrt([spread[kinds == kind].mean() for kind in kinds]) * unit
    return {name: (float(m), float(s)) for name, m, s in zip(names, mean, pooled, strict=True)}


def main() -> None:
    """Draw true values, measure the twin, write truth and responses."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--seed", type=int, default=3, help="of the draw (default 3)")
    arguments.add_argument("--into", type=Path, default=HERE / "measured.csv", help="table of the responses")
    given = arguments.parse_args()
    rng = np.random.default_rng(given.seed)
    truth = draw(rng)
    exact = twin_responses(truth)
    rows = [f"{name},{value:.6g},{std:.3g}" for name, (value, std) in measure(exact, rng).items()]
    head = [
        "# SYNTHETIC measurement of a chain of five masses, made by make_twin.py: means over ten repeats.",
        "# freq in Hz, damping as a ratio, shape over the mode's reference mass; std of the mean, pooled by kind.",
        "response,value,std",
    ]
    given.into.write_text("\n".join(head + rows) + "\n", encoding="utf-8")
    own = [name for e in chain_effects() for name in e.names if name in truth]
    content = {
        "seed": given.seed,
        "effect": own[0],
        "magnitude": {name: truth[name] for name in own},
        "parameters": {name: value for name, value in truth.items() if name not in own},
        "responses": exact,
    }
    given.truth.parent.mkdir(parents=True, exist_ok=True)
    given.truth.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
