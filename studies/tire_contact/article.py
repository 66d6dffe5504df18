"""A tire pressed on flat ground in 38 steps, after Bozdog and Olson (2005): mesh, displacements, patch, loads, time.

    python studies/tire_contact/article.py         # tables and figures in results/tire_contact_article

The article's text states no number that could be computed anew: profile, plies, pressure and the table of loads are
lost. What is shown is a generic bias tire (assumed) and the article's story. Its "464 elements" are most likely 1464,
from 61 x 24 cells: the text lost the digits 0, 1, 2 and 5 in places, and three unknowns at each of 1464 nodes are the
"439." equations that it mentions, at 464 they would be 1392. Both are run, 464 as 29 x 16.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.sparse.linalg import splu

from calib.study.loading import module_of
from models.tire import Tire, base_tire
from models.tire.contact import Ground, Pressed
from models.tire.load_curve import LoadCurve, RotationWarning, load_curve
from models.tire.patch import bulge, patch_length, patch_width

HERE = Path(__file__).resolve().parent

MESHES = ((29, 16), (61, 24))
"""464 and 1464 cells."""
STEPS, DEEPEST = 38, 25e-3
"""Of the article, and the last deflection, m, chosen here."""
PRESSURES = (1e5, 2e5, 3e5)
"""Pa; the first figures show the second."""
SHOWN_STEPS = (10, 20, 30, 38)
RIBS = 0.22
"""Part of the meridian on both sides of the crown in the figure of the patch."""
MM, KPA = 1e3, 1e-3


def timed(tire: Tire, mesh: tuple[int, int], pressure: float = PRESSURES[1]) -> tuple[LoadCurve, pd.DataFrame]:
    """The load curve and one row a step: deflection, load, patch, Newton steps, processor seconds."""
    ground = tire.on_ground(pressure, *mesh)
    begun, rows, curve = time.process_time(), [], LoadCurve(())
    deflections = np.linspace(0.0, DEEPEST, STEPS + 1)[1:]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RotationWarning)
        curve = load_curve(ground, deflections).complete()
    spent = time.process_time() - begun
    for number, step in enumerate(curve.steps, 1):
        rows.append({
            "cells": mesh[0] * mesh[1], "pressure": pressure * KPA, "step": number,
            "deflection": step.deflection * MM, "load": step.load,
            "loaded_radius": step.loaded_radius * MM, "patch_length": patch_length(step) * MM,
            "patch_width": patch_width(step) * MM, "bulge": bulge(step) * MM,
            "largest_pressure": step.largest_pressure * KPA, "rotation": step.largest_rotation,
            "iterations": step.iterations, "seconds": spent / STEPS,
        })  # fmt: skip
    return curve, pd.DataFrame(rows)


def displacements(step: Pressed) -> pd.DataFrame:
    """Displacements since inflation, mm: along the meridian below the axle, and along the crown around the hoop."""
    over, profile = cover(step), step.ground.inflated.wall.grid.profile
    crown = over["along"] == over["along"].iloc[int(np.argmax(profile.r(over["along"].to_numpy() / MM)))]
    section = over[over["around"] == 0.0].assign(place=lambda own: own["along"], along="meridian")
    hoop = over[crown].assign(place=lambda own: own["around"], along="hoop")
    return pd.concat([section, hoop], ignore_index=True)[["along", "place", "u", "v", "w"]]


def cover(step: Pressed) -> pd.DataFrame:
    """Displacements of all nodes since inflation, mm, by place along the section (mm) and around (degrees)."""
    inflated, grid = step.ground.inflated, step.ground.inflated.wall.grid
    u, v, w = (a - b for a, b in zip(grid.fields(step.displacement), grid.fields(inflated.displacement), strict=True))
    u_node = (np.vstack([np.zeros(grid.n_hoop), u]) + np.vstack([u, np.zeros(grid.n_hoop)])) / 2
    v_node = (v + np.roll(v, 1, axis=1)) / 2
    angle = np.degrees(np.where(grid.theta_node > np.pi, grid.theta_node - 2 * np.pi, grid.theta_node))
    along, around = np.meshgrid(grid.s_node * MM, angle, indexing="ij")
    table = pd.DataFrame({"along": along.ravel(), "around": around.ravel()})
    for name, field in (("u", u_node), ("v", v_node), ("w", w)):
        table[name] = (field * MM).ravel()
    return table.sort_values(["along", "around"], ignore_index=True)


def sections(curve: LoadCurve) -> pd.DataFrame:
    """Cross-sections below the axle, mm: axial position and height below the axle, by state."""
    ground = curve.steps[0].ground
    inflated = ground.inflated
    grid, wall = inflated.wall.grid, inflated.wall
    s = grid.s_node

    def at(state: str, q: np.ndarray, level: float) -> pd.DataFrame:
        out, across = ((rows @ q).reshape(-1, grid.n_hoop)[:, 0] for rows in (wall.height, wall.axial))
        return pd.DataFrame({
            "state": state, "axial": (grid.profile.z(s) + across) * MM,
            "height": (grid.profile.r(s) + out) * MM, "ground": level * MM,
        })  # fmt: skip

    steps = [curve.steps[number - 1] for number in SHOWN_STEPS]
    return pd.concat([
        at("as built", np.zeros(grid.n_dof), np.nan), at("inflated", inflated.displacement, np.nan),
        *(at(f"step {n}", step.displacement, step.loaded_radius) for n, step in zip(SHOWN_STEPS, steps, strict=True)),
    ], ignore_index=True)  # fmt: skip


def patch(step: Pressed) -> pd.DataFrame:
    """Contact pressure of the nodes below, kPa, by place along the crown and across it, mm."""
    ground = step.ground
    grid = ground.inflated.wall.grid
    ring, hoop = ground.nodes // grid.n_hoop, ground.nodes % grid.n_hoop
    angle = np.where(grid.theta_node > np.pi, grid.theta_node - 2 * np.pi, grid.theta_node)[hoop]
    across = grid.s_node[ring] - grid.profile.length / 2
    near = np.abs(across) <= RIBS * grid.profile.length
    table = pd.DataFrame({
        "along": ground.inflated.radius * angle * MM, "across": across * MM, "pressure": step.pressure * KPA,
    })  # fmt: skip
    return table[near & (np.abs(angle) < np.radians(40))].sort_values(["across", "along"], ignore_index=True)


def surface(step: Pressed) -> pd.DataFrame:
    """All nodes of the deformed wall, m, and how far each moved outward since inflation, mm."""
    inflated = step.ground.inflated
    wall, grid = inflated.wall, inflated.wall.grid
    shape = grid.n_meridian + 1, grid.n_hoop
    rows = (wall.height, wall.axial, wall.around)
    height, across, around = ((one @ step.displacement).reshape(shape) for one in rows)
    theta = np.broadcast_to(grid.theta_node[None, :], shape)
    radius = grid.profile.r(grid.s_node)[:, None] + height
    outward = grid.fields(step.displacement)[2] - grid.fields(inflated.displacement)[2]
    ring, hoop = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    return pd.DataFrame({
        "ring": ring.ravel(), "hoop": hoop.ravel(), "angle": theta.ravel(),
        "x": (radius * np.sin(theta) + around * np.cos(theta)).ravel(),
        "y": (grid.profile.z(grid.s_node)[:, None] + across).ravel(),
        "z": (-radius * np.cos(theta) + around * np.sin(theta)).ravel(),
        "moved": outward.ravel() * MM, "ground": -step.loaded_radius,
    })  # fmt: skip


def reference(ground: Ground) -> dict[str, float]:
    """Processor seconds of one factorisation of the tangent, by SuperLU and as a band; the best of three."""
    band = ground.inflated.stiffness
    whole = band.matrix().tocsc()

    def best(work) -> float:
        spent = []
        for _ in range(3):
            begun = time.process_time()
            work()
            spent.append(time.process_time() - begun)
        return min(spent)

    return {"sparse_factor": best(lambda: splu(whole)), "band_factor": best(band.factor)}


def tables() -> dict[str, pd.DataFrame]:
    """All tables by name."""
    tire = base_tire()
    curves, rows, times = {}, [], []
    for mesh in MESHES:
        for pressure in PRESSURES if mesh == MESHES[-1] else PRESSURES[1:2]:
            curve, table = timed(tire, mesh, pressure)
            curves[mesh, pressure] = curve
            rows.append(table)
            if pressure == PRESSURES[1]:
                times.append({
                    "cells": mesh[0] * mesh[1], "unknowns": curve.steps[0].displacement.size,
                    "newton_steps": int(table["iterations"].sum()), "seconds": float(table["seconds"].sum()),
                    "seconds_a_step": float(table["seconds"].mean()), **reference(curve.steps[0].ground),
                })  # fmt: skip
    shown = curves[MESHES[-1], PRESSURES[1]]
    last = shown.last
    return {
        "loads": pd.concat(rows, ignore_index=True),
        "times": pd.DataFrame(times),
        "displacements": displacements(last),
        "cover": cover(last),
        "sections": sections(shown),
        "patch": patch(last),
        "patch_coarse": patch(curves[MESHES[0], PRESSURES[1]].last),
        "surface": surface(last),
    }


def main() -> None:
    """Write all tables and figures; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--into", type=Path, default=Path("results/tire_contact_article"), help="folder of results")
    given = arguments.parse_args()
    given.into.mkdir(parents=True, exist_ok=True)
    for name, table in tables().items():
        table.to_csv(given.into / f"{name}.csv", index=False)
    for path in module_of(HERE / "article_figures.py").SET.save_all(given.into):
        print(path)


if __name__ == "__main__":
    main()
