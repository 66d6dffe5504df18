"""Undamped modes at full order, side by side: this solver, CalculiX and OpenSees on one vehicle or bogie.

    python tests/benchmarks/full_order.py [--model vehicle] [--modes 40] [--repeats 3] [--write FILE]

Ours is the factor and the solution with matrices at hand, since a search assembles once and then only adds up affine
terms; what that takes is told apart. The others read or build and assemble for every point anew; that is in their time,
and the part that can be told is stated. A code that is not installed is left out, with a word.

The vehicle is `simple_vehicle` of tests/oracles, the same nodes on all sides. What differs in CalculiX: solids made of
the shells and beams, with thickness, modulus and density that keep stiffness and mass; rectangles for all sections;
rigid arms are stiff beams; wheels have no rotary inertia. In OpenSees: its own shell element and lumped mass of walls.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from page import Page
from stopwatch import HEADER, Task, compared, in_turn, short, spent
from subject import ROOT, STUDIES, study_of, undamped

from calib.structure.eigenproblem.solve import solve_modes

sys.path.insert(0, str(ROOT / "tests/oracles"))

import calculix
import calculix_vehicle
import opensees_code
from opensees_vehicle import Twin
from simple_vehicle import SimpleVehicle, simple_vehicle
from test_opensees_rig import opensees_modes

Frequencies = dict[str, np.ndarray]
SYSTEMS = {"by default": None, "SuperLU": "SparseGEN", "UmfPack": "UmfPack"}
"""Linear solvers of OpenSees that are timed: the one it takes unasked, its fastest here, and that of the tests."""


def main() -> None:
    """Time and compare."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--model", choices=STUDIES, default="vehicle")
    arguments.add_argument("--modes", type=int, default=40)
    arguments.add_argument("--repeats", type=int, default=3)
    arguments.add_argument("--write", type=Path, help="append the tables to this file")
    given = arguments.parse_args()
    page, found = Page(given.write), {}
    page.begin(f"{given.modes} undamped modes of the {given.model} at full order")
    with tempfile.TemporaryDirectory() as folder:
        build = of_vehicle if given.model == "vehicle" else of_bogie
        tasks = build(page, given.modes, found, Path(folder))
        page.table(HEADER, compared(in_turn(tasks, [{}] * given.repeats)))
    own = next(iter(found.values()))
    rows = [(name, *(f"{f:.3f}" for f in freq[:12])) for name, freq in found.items()]
    page.say(f"Lowest frequencies in Hz; the highest of ours is {own[-1]:.2f}:")
    page.table(("", *map(str, range(1, len(rows[0])))), rows)


def of_vehicle(page: Page, modes: int, found: Frequencies, folder: Path) -> dict[str, Task]:
    """This solver, CalculiX and OpenSees on the vehicle without seats, and this solver on the whole one."""
    vehicle = simple_vehicle()
    assembled: list = []
    once = spent(lambda: assembled.append(vehicle.matrices()))
    stiffness, mass = assembled[0]
    study = study_of("vehicle")
    whole = undamped(study.model)
    k, _, m = whole.matrices({})
    added = spent(lambda: whole.matrices({}))
    page.say(
        f"{stiffness.shape[0]} degrees of freedom; assembly from elements {short(once.cpu)} s once, and "
        f"{short(1e3 * added.cpu)} ms at every further point (processor time)."
    )
    rotational = whole.dofs.direction >= 3
    tasks: dict[str, Task] = {
        "ours": keeping(found, "ours", lambda: vehicle.modes(stiffness, mass, modes).natural_freq),
        "ours, assembled anew": keeping(
            found, "ours, assembled anew", lambda: vehicle.modes(*vehicle.matrices(), modes).natural_freq
        ),
        "ours, with its 60 seats": keeping(
            found, "ours, with its 60 seats", lambda: solve_modes(k, None, m, modes, rotational).natural_freq
        ),
    }
    if calculix.COMMAND is None:
        page.say(f"CalculiX is left out: {calculix.MISSING}.")
    else:
        tasks |= _calculix(page, vehicle, modes, found, folder)
    if (code := _opensees(page)) is not None:
        for name, system in SYSTEMS.items():
            label = f"OpenSees, {name}"
            tasks[label] = keeping(found, label, lambda system=system: Twin(code, vehicle).solve(modes, system)[0])
        page.say(f"Building the model in OpenSees takes {short(spent(lambda: Twin(code, vehicle)).cpu)} s of that.")
    return tasks


def of_bogie(page: Page, modes: int, found: Frequencies, folder: Path) -> dict[str, Task]:
    """This solver and OpenSees on the bogie on its rig."""
    model = undamped(study_of("bogie").model)
    values = model.space.values
    tasks: dict[str, Task] = {"ours": keeping(found, "ours", lambda: model.modes(values, modes).natural_freq)}
    if (code := _opensees(page)) is not None:
        frame = model.locator.frame
        tasks["OpenSees"] = keeping(found, "OpenSees", lambda: opensees_modes(code, frame, values, modes)[0])
    return tasks


def keeping(found: Frequencies, name: str, solve: Callable[[], np.ndarray]) -> Task:
    """A task that leaves its frequencies."""

    def task(_: object) -> None:
        found[name] = solve()

    return task


def _calculix(page: Page, vehicle: SimpleVehicle, modes: int, found: Frequencies, folder: Path) -> dict[str, Task]:
    deck = calculix_vehicle.deck_of(vehicle)
    solving, least = deck.text(modes), deck.text(1)
    answer = calculix.run(solving, folder)
    page.say(
        f"CalculiX makes {answer.equations} equations of it; for a single mode, with reading and assembly, it takes "
        f"{short(spent(lambda: calculix.run(least, folder)).cpu)} s of processor time."
    )
    return {"CalculiX": keeping(found, "CalculiX", lambda: calculix.run(solving, folder).natural_freq)}


def _opensees(page: Page):
    try:
        return opensees_code.load()
    except ImportError as problem:
        page.say(f"OpenSees is left out: {problem}.")
        return None


if __name__ == "__main__":
    main()
