"""Five masses in a chain as a function: from stiffness, mass and damping to the scalar responses of a modal test.

It is not a `StructuralModel`: it stands for any function of named numbers, such as an external solver.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib import Effect, EvaluationError, FunctionModel, Parameter, ParameterSpace
from models.function_effect import function_effect

MASSES = 5
STIFFNESS = 20e3
"""N/m of each spring."""
MASS = 2.0
"""kg."""
DAMPING = 8.0
"""Ns/m of the damper beside each spring."""
REFERENCE = (5, 2, 1, 4, 3)
"""Mass by whose displacement the shape of each mode is divided: the one that moves most when all springs are equal."""
HUNG_DAMPING = 0.01
"""Damping ratio of a hung mass on its spring."""


def five_mass_chain() -> FunctionModel:
    """Chain of five masses on the ground, a spring and a damper below each (spring 1 on the ground).

    Spring stiffnesses are factors of `STIFFNESS`, one factor scales all dampers; masses and single dampers are fixed at
    weighed and data-sheet values. Responses: see `chain_responses`.
    """
    numbers = range(1, MASSES + 1)
    springs = [
        Parameter(f"k{i}", 1.0, 0.6, 1.6, prior_sd=0.1, description=f"stiffness of spring {i} over {STIFFNESS:.0f} N/m")
        for i in numbers
    ]
    damping = Parameter("damping", 1.0, 0.3, 3.0, prior_sd=0.3, description="common factor of all dampers")
    masses = [
        Parameter(f"m{i}", MASS, 0.5 * MASS, 1.5 * MASS, "kg", "fixed", description=f"mass {i}, weighed")
        for i in numbers
    ]
    dampers = [
        Parameter(f"c{i}", DAMPING, 0.0, 3 * DAMPING, "Ns/m", "fixed", description=f"damper {i}, from its data sheet")
        for i in numbers
    ]
    return FunctionModel("five-mass chain", ParameterSpace((*springs, damping, *masses, *dampers)), chain_responses)


def chain_responses(values: Mapping[str, float]) -> dict[str, float]:
    """Five natural frequencies, damping ratios and shapes.

    Parameters
    ----------
    values : mapping
        Parameters of `five_mass_chain`, and any of those of `chain_effects` (0 when absent).

    Returns
    -------
    dict
        ``freq_<mode>`` in Hz, ``damping_<mode>`` as a ratio, and ``shape_<mode>_<mass>``, the displacement over that of
        the mode's `REFERENCE` mass, the part in phase with it.

    Raises
    ------
    EvaluationError
        When fewer than five modes oscillate.
    """
    get = values.get
    n = MASSES + (get("hung_mass_5", 0.0) > 0)
    stiffness, damping, mass = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    for i in range(1, MASSES + 1):
        k, c = STIFFNESS * values[f"k{i}"], values["damping"] * values[f"c{i}"]
        if i == 1:
            k /= 1 + k * 1e-6 * get("soft_foundation", 0.0)
        if i == 4:
            c *= 1 - get("weak_damper_4", 0.0)
        _connect(stiffness, k, i, i - 1)
        _connect(damping, c, i, i - 1)
        mass[i - 1, i - 1] = values[f"m{i}"]
    _connect(stiffness, get("ground_spring_3", 0.0), 3, 0)
    _connect(stiffness, get("cross_spring_2_4", 0.0), 2, 4)
    _connect(damping, get("ground_damper_5", 0.0), 5, 0)
    mass[1, 1] += get("extra_mass_2", 0.0)
    if n > MASSES:
        hung, omega = values["hung_mass_5"], 2 * np.pi * values["hung_freq"]
        mass[5, 5] = hung
        _connect(stiffness, hung * omega**2, 6, 5)
        _connect(damping, 2 * HUNG_DAMPING * hung * omega, 6, 5)
    return responses(*_modes(stiffness, damping, mass))


def responses(eigenvalues: np.ndarray, shapes: np.ndarray) -> dict[str, float]:
    """Named responses from eigenvalues (5,), rad/s, and complex shapes at the five masses (5, 5), modes as columns."""
    out = {f"freq_{j + 1}": float(abs(value)) / (2 * np.pi) for j, value in enumerate(eigenvalues)}
    out |= {f"damping_{j + 1}": float(-value.real / abs(value)) for j, value in enumerate(eigenvalues)}
    for j, reference in enumerate(REFERENCE):
        ratio = (shapes[:, j] / shapes[reference - 1, j]).real
        out |= {f"shape_{j + 1}_{i + 1}": float(ratio[i]) for i in range(MASSES) if i + 1 != reference}
    return out


def _connect(matrix: np.ndarray, size: float, a: int, b: int) -> None:
    """Add a spring or damper between two masses, counted from 1; 0 is the ground."""
    ends = [(a - 1, 1.0)] + ([(b - 1, -1.0)] if b else [])
    for i, s in ends:
        for j, t in ends:
            matrix[i, j] += size * s * t


def _modes(stiffness: np.ndarray, damping: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and shapes of the five modes of the chain, lowest first, without the mode of a hung mass."""
    n = len(mass)
    inverse = np.linalg.inv(mass)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    roots, vectors = np.linalg.eig(state)
    upper = np.flatnonzero(roots.imag > 0)
    upper = upper[np.argsort(np.abs(roots[upper]))]
    if len(upper) < n:
        raise EvaluationError(f"only {len(upper)} of {n} modes oscillate")
    shapes = vectors[:n, upper]
    if n > MASSES:
        energy = np.diag(mass)[:, None] * np.abs(shapes) ** 2
        own = int(np.argmax(energy[-1] / energy.sum(axis=0)))
        upper, shapes = np.delete(upper, own), np.delete(shapes, own, axis=1)
    return roots[upper], shapes[:MASSES]


# -- effects -----------------------------------------------------------------------------------------------------------


def chain_effects() -> tuple[Effect, ...]:
    """Effects that `five_mass_chain` leaves out; `chain_responses` reads their parameters itself.

    Plausible sizes are engineering estimates: 5 % of a spring or a mass, 10 % of the flexibility of spring 1, 30 % of a
    damper, a brake of a sixteenth of a damper.
    """
    return (
        function_effect(
            "ground_spring_3", "Mass 3 touches the ground", "a contact of mass 3 with the ground",
            "Only spring 1 stands on the ground.",
            "A cable, hose or guide between mass 3 and its surroundings.", 20e3, "N/m", 1e3,
        ),
        function_effect(
            "extra_mass_2", "Unweighed mass on mass 2", "an unweighed mass on mass 2", "Mass 2 is as weighed.",
            "Sensors, bolts or cables mounted after weighing.", 1.0, "kg", 0.1,
        ),
        function_effect(
            "cross_spring_2_4", "Masses 2 and 4 are connected", "a connection of masses 2 and 4",
            "Springs join neighbours only.",
            "A guide rod or cable past mass 3.", 20e3, "N/m", 1e3,
        ),
        function_effect(
            "hung_mass_5", "Something swings on mass 5", "something that swings on mass 5",
            "Everything on mass 5 moves with it.",
            "Anything loose or on a soft mount on mass 5.", 0.5, "kg", 0.1,
            nuisance=(
                Parameter("hung_freq", 9.0, 6.0, 12.0, "Hz", prior_sd=1.5, description="its natural frequency"),
            ),
            grid=[{"hung_mass_5": 0.05, "hung_freq": f} for f in (6.5, 7.5, 8.5, 9.5, 10.5, 11.5)],
        ),
        function_effect(
            "weak_damper_4", "Damper 4 has lost oil", "a loss of oil in damper 4", "All dampers are alike.",
            "Oil on damper 4.", 1.0, "-", 0.3,
        ),
        function_effect(
            "ground_damper_5", "Mass 5 is braked", "a brake on mass 5", "Dampers join neighbours only.",
            "Friction in a guide, or a plate that moves air.", 20.0, "Ns/m", 0.5,
        ),
        function_effect(
            "soft_foundation", "Compliance of the foundation", "the compliance of the foundation",
            "Spring 1 stands on rigid ground.", "Bolts of the base plate.", 100.0, "mm/kN", 5.0,
        ),
    )  # fmt: skip
