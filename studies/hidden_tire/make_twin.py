"""Synthetic test of one tire that lacks nothing, an effect of the library, or something else.

    python studies/hidden_tire/make_twin.py effect TRUTH.json

The tire is inflated to four pressures and pressed on flat ground. It is not the fitted model: its mesh of 61 x 40 cells
has five times the cells, its profile is another spline, through 41 points, and the effect is built into it otherwise
than in the library (``remodelled.py``). True parameters are normal about their nominal values with half their prior
standard deviations; a seed draws the effect and its magnitude, 0.7 to 1.5 times the plausible one. Seeds are tried in
turn; the first one is taken whose effect is visible: the change that it makes to the measured responses, which the
fitted parameters cannot absorb, is 8 to 20 standard deviations long, the claimed accuracy included, and at least one
load changes by 3 %. No result of a search enters the choice.

Five repeats: one of them scatters by 1 % of a load, 2 % of a growth and 0.4 % of a frequency.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.structure import slope_entry
from calib.study.loading import module_of
from calib.study.study_text import read_settings
from models.tire.effects import tire_effects
from models.tire.model import parameters, tire_of
from models.tire.profile import Profile
from models.tire.responses import KPA, Rig

HERE = Path(__file__).resolve().parent
remodelled = module_of(HERE / "remodelled.py")
study = module_of(HERE / "model.py")

Responses = dict[float, dict[str, float]]
"""By pressure, kPa, and name."""
Claims = Mapping[str, str]
"""Claimed accuracy by kind, such as ``3 %``."""

MESH = (61, 40)
POINTS = 41
REPEATS = 5
UNITS = {"load": "N", "growth": "mm", "freq": "Hz"}
SCATTER = {"load": 0.01, "growth": 0.02, "freq": 0.004}
"""Of one repeat, relative, by kind."""
MEASURED = (
    *("growth_crown", "growth_width"), *(f"load_{d:g}" for d in study.DEFLECTIONS),
    *(f"freq_{order}" for order in study.ORDERS),
)  # fmt: skip
SPREAD, INSIDE = 0.5, 0.9
MAGNITUDES, VISIBLE = (0.7, 1.5), (8.0, 20.0)
LEAST_LOAD_CHANGE = 0.03
HARDLY_SEEN, NOT_BUILT = "uncoupled", "dead_pressure"
"""Effects that are not drawn: one would not be visible, the other is no construction of a tire."""
FIRST_SEED = {"nothing": 1001, "effect": 1, "outside": 2001}
SIZES = {"apex": (3.0, 8.0), "one_sidewall": (0.15, 0.35), "wandering_cords": (2.0, 5.0)}
"""Of the designs in no library: mm, share, degrees."""


@dataclass(frozen=True)
class Truth:
    """What no analysis may know.

    Attributes
    ----------
    parameters : mapping from str to float
    designs : mapping from str to float
    """

    parameters: Mapping[str, float]
    designs: Mapping[str, float]

    def tire(self) -> remodelled.BuiltTire:
        """The tire as it is built."""
        plain = tire_of(self.parameters)
        s = np.linspace(0.0, plain.profile.length, POINTS)
        profile = Profile.from_points(plain.profile.r(s), plain.profile.z(s))
        return remodelled.BuiltTire(
            profile, plain.plies, plain.crown_angle, plain.n_plies, plain.ply_thickness, density=plain.density,
            designs=self.designs,
        )  # fmt: skip


def draw(rng: np.random.Generator, kind: str, hidden: str = "") -> Truth:
    """True values, and a design from the library (``effect``), from outside (``outside``), or none (``nothing``)."""
    values = {
        p.name: p.value if p.distribution == "fixed" else _about(p.value, p.prior_width, p.lower, p.upper, rng)
        for p in parameters()
    }
    library = {e.name: e for e in tire_effects()}
    designs: dict[str, float] = {}
    if kind == "effect":
        drawn = [name for name in library if name not in (HARDLY_SEEN, NOT_BUILT)]
        effect = library[hidden or str(rng.choice(drawn))]
        size = effect.plausible * rng.uniform(*MAGNITUDES)
        designs[effect.name] = float(min(size, INSIDE * effect.magnitude.upper))
        designs |= {q.name: _about(q.value, q.prior_width, q.lower, q.upper, rng) for q in effect.nuisance}
    elif kind == "outside":
        name = hidden or str(rng.choice(remodelled.OUTSIDE))
        designs[name] = float(rng.uniform(*SIZES[name]))
    return Truth(values, designs)


def _about(value: float, width: float, lower: float, upper: float, rng: np.random.Generator) -> float:
    return float(np.clip(value + SPREAD * width * rng.standard_normal(), lower, upper))


def exact(truth: Truth, pressures: Sequence[float], mesh: tuple[int, int] = MESH) -> Responses:
    """Noise-free responses by pressure, kPa."""
    rig, tire = Rig(*mesh, study.DEFLECTIONS, (), study.ORDERS), truth.tire()
    out: Responses = {}
    for pressure in pressures:
        found = rig.responses(rig.solve(tire, pressure * KPA))
        out[pressure] = {name: found[name] for name in MEASURED}
    return out


def repeats(exact: Mapping[str, float], rng: np.random.Generator) -> np.ndarray:
    """Measured values of one pressure, (n_repeats, n_responses)."""
    scatter = np.array([SCATTER[name.split("_")[0]] for name in exact])
    return np.array(list(exact.values())) * (1 + scatter * rng.standard_normal((REPEATS, len(exact))))


def bare(truth: Truth) -> Truth:
    """The same tire without its designs."""
    return replace(truth, designs={})


def visible(
    truth: Truth, built: Responses, plain: Responses, used: Mapping[float, Sequence[str]], claimed: Claims
) -> float:
    """Length of the change by the designs in standard deviations, all fitted parameters projected out.

    The change is that of the twin; the directions that parameters take are the fitted model's.

    Parameters
    ----------
    truth : Truth
    built, plain : mapping
        Noise-free responses by pressure, with and without the designs.
    used : mapping from pressure to names
        Responses that a fit uses.
    claimed : mapping from kind to share
        Claimed accuracy, such as ``{"load": "3 %"}``.
    """
    model = study.tire()
    width = {p.name: p.prior_width for p in model.space.free}
    rows, change = [], []
    for pressure, names in used.items():
        at = model.function({**truth.parameters, "pressure": pressure})
        std = np.array([at[name] * standard_deviation(name, claimed) for name in names])
        change.append(np.array([built[pressure][n] - plain[pressure][n] for n in names]) / std)
        slope = np.array([[at[slope_entry(name, p)] * w for p, w in width.items()] for name in names])
        rows.append(slope / std[:, None])
    wide = np.vstack([*rows, np.eye(len(width))])  # the prior counts as data
    direction = np.concatenate([*change, np.zeros(len(width))])
    basis = np.linalg.qr(wide)[0]
    return float(np.linalg.norm(direction - basis @ (basis.T @ direction)))


def largest_load_change(built: Responses, plain: Responses) -> float:
    """Of all loads, relative."""
    loads = [(p, n) for p, own in plain.items() for n in own if n.startswith("load")]
    return max(abs(built[p][n] / plain[p][n] - 1) for p, n in loads)


def standard_deviation(name: str, claimed: Claims) -> float:
    """Of a mean, relative: repeatability and claimed accuracy."""
    kind = name.split("_")[0]
    return float(np.hypot(SCATTER[kind] / np.sqrt(REPEATS), float(claimed[kind].rstrip("%")) / 100))


def write(folder: Path, measured: Mapping[float, np.ndarray]) -> None:
    """One table for each pressure: repeats in rows."""
    folder.mkdir(parents=True, exist_ok=True)
    for pressure, table in measured.items():
        head = [
            f"# SYNTHETIC test of a tire at {pressure:g} kPa, made by make_twin.py: {REPEATS} repeats.",
            "# growth by inflation in mm, load at a deflection of so many mm in N, frequency of hoop order n in Hz",
            "repeat,response,value,unit",
        ]
        rows = [
            f"{k},{name},{value:.6g},{UNITS[name.split('_')[0]]}"
            for k, one in enumerate(table, 1)
            for name, value in zip(MEASURED, one, strict=True)
        ]
        (folder / f"{pressure:g}_kPa.csv").write_text("\n".join(head + rows) + "\n", encoding="utf-8")


def hidden_effects(truth: Truth) -> list[str]:
    """Names of the designs, without nuisances."""
    nuisances = {q.name for e in tire_effects() for q in e.nuisance}
    return [name for name in truth.designs if name not in nuisances]


def main() -> None:
    """Draw a tire whose effect is visible, measure it, write repeats and truth."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("kind", choices=tuple(FIRST_SEED))
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--into", type=Path, default=HERE / "measured", help="folder of the tables")
    given = arguments.parse_args()
    tests = read_settings(HERE / "study.toml").tests
    used = {test.set["pressure"]: [n for n in MEASURED if n not in test.held_out.responses] for test in tests}
    for seed in range(FIRST_SEED[given.kind], FIRST_SEED[given.kind] + 100):
        rng = np.random.default_rng(seed)
        truth = draw(rng, given.kind)
        found = exact(truth, list(used))
        seen = moved = 0.0
        if truth.designs:
            plain = exact(bare(truth), list(used))
            seen, moved = visible(truth, found, plain, used, tests[0].accuracy), largest_load_change(found, plain)
        print(f"seed {seed}: {hidden_effects(truth) or 'nothing'}, visible {seen:.1f}, loads {moved:.1%}", flush=True)
        if not truth.designs or (VISIBLE[0] <= seen <= VISIBLE[1] and moved >= LEAST_LOAD_CHANGE):
            break
    write(given.into, {p: repeats(one, rng) for p, one in found.items()})
    content = {
        "seed": seed, "effects": hidden_effects(truth), "magnitudes": dict(truth.designs), "visible": seen,
        "parameters": dict(truth.parameters), "responses": {f"{p:g}": one for p, one in found.items()},
    }  # fmt: skip
    given.truth.parent.mkdir(parents=True, exist_ok=True)
    given.truth.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
