"""Masses in a row as a model, and FRFs of it by hand: synthetic measurements of what the model has and may lack.

The functions are inverses of dynamic stiffness matrices that numpy alone makes, without a line of the model's code.
"""

import shutil

import numpy as np
import pandas as pd
import scipy.sparse as sp

import calib
from calib.measurement.frf_repeats import FRFRepeat, combine_frfs
from calib.measurement.modal import Sensor
from calib.structure.affine import Monomial, Term
from calib.structure.effects.extend import Addition

N = 4
FREQ = np.linspace(2.0, 40.0, 60)
TRUE = {"k": 1.2e4, "c": 12.0, "m": 2.3}
LINKS = 2e4
"""N/m of every spring but the lowest."""
RESPONSES, REFERENCES = (1, 3, 4), (1, 4)
GROUND_AT = 2
"""Mass that the hidden spring holds; no sensor is there."""
HIDDEN = 4e3
"""N/m of the hidden spring."""


def chain(stiff_links=False, **values):
    """The lowest spring, a damper and the last mass are parameters; with ``stiff_links`` the other springs too."""
    links = np.zeros((N, N, N))
    for i in range(N):
        b = np.eye(N)[i] - (np.eye(N)[i - 1] if i else 0)
        links[i] = np.outer(b, b)
    v = {"k": 1e4, "c": 8.0, "m": 2.0, "links": 1.0, **values}
    parameters = [
        calib.Parameter("k", v["k"], 5e3, 2e4, "N/m"),
        calib.Parameter("c", v["c"], 1.0, 50.0, "Ns/m"),
        calib.Parameter("m", v["m"], 1.0, 5.0, "kg"),
    ]
    if stiff_links:
        parameters.append(calib.Parameter("links", v["links"], 0.5, 2.0, "-"))
    return calib.StructuralModel.from_matrices(
        {"k": links[0], "links": LINKS * links[1:].sum(axis=0)},
        {"m": np.diag(np.eye(N)[-1]), "own": np.eye(N)},
        {"c": links[1], "dampers": 5.0 * links[2:].sum(axis=0)},
        dofs=pd.DataFrame({"node": range(1, N + 1), "direction": "x", "x": np.arange(N), "y": 0.0, "z": 0.0}),
        parameters=parameters,
        name="chain",
    )


def by_hand(values, ground=0.0, links=1.0):
    """K, C, M of the chain, in N/m, Ns/m and kg; ``ground`` is the hidden spring."""
    s = LINKS * links
    k = np.diag([values["k"] + s, 2 * s, 2 * s, s]) - s * (np.eye(N, k=1) + np.eye(N, k=-1))
    k[GROUND_AT - 1, GROUND_AT - 1] += ground
    above = np.array([values["c"], 5.0, 5.0])
    c = np.diag([above[0], above[0] + 5.0, 10.0, 5.0]) - np.diag(above, 1) - np.diag(above, -1)
    return k, c, np.diag([1.0, 1.0, 1.0, 1.0 + values["m"]])


def truth(values, freq=FREQ, responses=RESPONSES, references=REFERENCES, **changed):
    """Accelerances, (n_freq, n_responses, n_references); ``changed`` as of `by_hand`."""
    k, c, m = by_hand(values, **changed)
    whole = np.array([-(w**2) * np.linalg.inv(k + 1j * w * c - w**2 * m) for w in 2 * np.pi * freq])
    return whole[np.ix_(range(len(freq)), np.array(responses) - 1, np.array(references) - 1)]


def repeats_of(true, seed=None, repeats=4, share=0.01, floor=2e-3, responses=RESPONSES, references=REFERENCES):
    """Repeats of a test with noise in proportion to the FRF and a floor, one FRFRepeat each; no noise for no seed."""
    rng = np.random.default_rng(seed)
    found = []
    for n in range(repeats):
        std = 0.0 if seed is None else np.sqrt((share * np.abs(true)) ** 2 + floor**2)
        values = true + std * (rng.standard_normal(true.shape) + 1j * rng.standard_normal(true.shape))
        pairs = {
            ((r, "x"), (q, "x")): values[:, i, j]
            for i, r in enumerate(responses) for j, q in enumerate(references)
        }  # fmt: skip
        found.append(FRFRepeat(f"repeat {n}", FREQ, "accelerance", pairs))
    return found


def measured(
    seed=None, repeats=4, responses=RESPONSES, references=REFERENCES, values=TRUE, share=0.01, floor=2e-3, **changed
):
    """Mean of repeats of a test; ``share`` and ``floor`` as of `repeats_of`, ``changed`` as of `by_hand`."""
    true = truth(values, responses=responses, references=references, **changed)
    return combine_frfs(repeats_of(true, seed, repeats, share, floor, responses, references), synthetic=True)


def modes(seed, count=4, repeats=6, responses=RESPONSES, values=TRUE, **changed):
    """A modal test of the same chain: frequencies, damping ratios and shapes from the roots of its state matrix.

    ``changed`` as of `by_hand`.
    """
    k, c, m = by_hand(values, **changed)
    state = np.block([[np.zeros((N, N)), np.eye(N)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
    roots, vectors = np.linalg.eig(state)
    order = np.flatnonzero(roots.imag > 0)
    order = order[np.argsort(np.abs(roots[order]))][:count]
    size, shapes = np.abs(roots[order]), vectors[np.array(responses) - 1][:, order]
    shapes = shapes / shapes[np.argmax(np.abs(shapes), axis=0), range(count)]
    rng = np.random.default_rng(seed)
    f = size / (2 * np.pi) * (1 + 1e-3 * rng.standard_normal((repeats, count)))
    z = -roots[order].real / size * (1 + 0.03 * rng.standard_normal((repeats, count)))
    noise = 0.01 * rng.standard_normal((2, repeats, *shapes.shape))
    every = shapes + noise[0] + 1j * noise[1]
    part = np.sqrt(repeats)
    return calib.MeasuredModes(
        names=tuple(f"m{n + 1}" for n in range(count)),
        natural_freq=f.mean(axis=0), damped_freq=(f * np.sqrt(1 - z**2)).mean(axis=0),
        freq_std=f.std(axis=0, ddof=1) / part, damping_ratio=z.mean(axis=0), damping_std=z.std(axis=0, ddof=1) / part,
        sensors=tuple(Sensor(r, "x") for r in responses), shapes=every.mean(axis=0),
        shape_std=np.sqrt((every.real.var(axis=0, ddof=1) + every.imag.var(axis=0, ddof=1)) / 2) / part,
        n_repeats=repeats, synthetic=True, source="synthetic chain",
    )  # fmt: skip


def effects():
    """A spring from the second mass to the ground, and a further mass on the third."""

    def at(node):
        return np.diag(np.eye(N)[node - 1])

    def effect(name, unit, sd, upper, kind, node):
        term = (Term(name, sp.csr_array(at(node)), Monomial(1.0, ((name, 1.0),))),)
        magnitude = calib.Parameter(name, 0.0, 0.0, upper, unit, prior_sd=sd)
        return calib.Effect(
            name, name, "it is left out", "whether it is there", magnitude, lambda model: Addition(**{kind: term})
        )

    return (
        effect("ground_2", "N/m", 5e3, 1e5, "stiffness", GROUND_AT),
        effect("mass_3", "kg", 0.5, 5.0, "mass", 3),
    )


# -- as a study --------------------------------------------------------------------------------------------------------

STUDY = """
title = "Synthetic chain"
model = "model.py:chain"
effects = "model.py:effects"

[[tests]]
name = "shaker"
kind = "frf"
files = ["repeat_1.uff", "repeat_2.uff", "repeat_3.uff", "repeat_4.uff"]
sensors = "sensors.csv"
synthetic = true
held_out = { sensors = ["3x"], references = ["4x"], bands = [[20.0, 26.0]] }

[sensitivity]
samples = 80

[calibration]
method = "gauss-newton"
starts = 1
"""


def write_study(folder, seed=2, **changed):
    """A study of the chain in a folder, its measurement in universal files; ``changed`` as of `by_hand`."""
    import pyuff  # not the library's own writer, whose faults its reader might share

    folder.mkdir(parents=True)
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    shutil.copyfile(__file__, folder / "model.py")
    units = {"type": 164, "units_code": 1, "units_description": "SI", "temp_mode": 1, "length": 1.0, "force": 1.0}
    for k, repeat in enumerate(repeats_of(truth(TRUE, **changed), seed)):
        sets = [{**units, "temp": 1.0, "temp_offset": 273.15}]
        for ((response, _), (reference, _)), values in repeat.functions.items():
            sets.append({
                "type": 58, "func_type": 4, "rsp_node": response, "rsp_dir": 1, "ref_node": reference, "ref_dir": 1,
                "x": FREQ, "data": values, "abscissa_spacing": 0, "abscissa_spec_data_type": 18, "binary": 0,
                "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13,
            })  # fmt: skip
        pyuff.UFF(str(folder / f"repeat_{k + 1}.uff")).write_sets(sets, "overwrite")
    places = pd.DataFrame({"node": RESPONSES, "x": np.array(RESPONSES) - 1.0, "y": 0.0, "z": 0.0, "on": ""})
    places.to_csv(folder / "sensors.csv", index=False)
    return folder
