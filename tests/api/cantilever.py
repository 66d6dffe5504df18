"""A cantilever that bends in two planes, by Euler-Bernoulli elements: modes by numpy alone, and its matrices.

It stands on a rotational spring, carries a mass at its tip and a dashpot, and may have a prop along its length. The
measurement is synthetic: a mesh four times as fine, other parameters, noise and repeats.
"""

import numpy as np
import pandas as pd

import calib
from calib.structure.affine import Monomial, Term
from calib.structure.effects.extend import Addition

LENGTH, LINE, ELEMENTS, PROP_AT = 2.0, 6.0, 8, 0.5
PLACES = (0.25, 0.5, 0.75, 1.0)
"""Of the sensors, in parts of the length; nodes 2, 4, 6 and 8 of the coarse mesh."""
SENSORS = tuple(
    calib.Sensor(round(8 * at), direction, (LENGTH * at, 0.0, 0.0)) for at in PLACES for direction in ("y", "z")
)
ADOPTED = {"EI_y": 5000.0, "EI_z": 8000.0, "m_tip": 1.0, "k_root": 60.0, "c_tip": 4.0}
TRUE = {"EI_y": 5400.0, "EI_z": 7300.0, "m_tip": 1.3, "k_root": 45.0, "c_tip": 5.5}


def space(**values):
    v = {**ADOPTED, **values}
    return calib.ParameterSpace(
        [
            calib.Parameter("EI_y", v["EI_y"], 2000.0, 15000.0, "-"),
            calib.Parameter("EI_z", v["EI_z"], 2000.0, 15000.0, "-"),
            calib.Parameter("m_tip", v["m_tip"], 0.2, 4.0, "kg"),
            calib.Parameter("k_root", v["k_root"], 10.0, 300.0, "kNm/rad"),
            calib.Parameter("c_tip", v["c_tip"], 0.5, 20.0, "Ns/m"),
        ]
    )


class Beam:
    """Matrices over v, w and the two slopes of every node but the first, whose slopes alone are free.

    Unknowns are those of bending in y (deflection, slope of each node), then those of bending in z.
    """

    def __init__(self, elements):
        self.elements, h = elements, LENGTH / elements
        n = 2 * (elements + 1)
        bending, mass = np.zeros((n, n)), np.zeros((n, n))
        weight = LINE * h / 420
        k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                      [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) / h**3  # fmt: skip
        m = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                      [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]) * weight  # fmt: skip
        for e in range(elements):
            at = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
            bending[at] += k
            mass[at] += m
        self.bending, self.mass = bending[1:, 1:], mass[1:, 1:]
        self.n = n - 1

    def deflection(self, at):
        """Number of the deflection at a part of the length, in one plane."""
        return 2 * round(at * self.elements) - 1

    def both(self, y, z):
        return np.block([[y, np.zeros((self.n, self.n))], [np.zeros((self.n, self.n)), z]])

    def point(self, *numbers):
        out = np.zeros((self.n, self.n))
        out[numbers, numbers] = 1.0
        return out

    def matrices(self, v):
        """K, C, M; ``prop`` is a grounded spring in z, N/m."""
        tip, root = self.point(self.n - 2), self.point(0)
        prop = v.get("prop", 0.0) * self.point(self.deflection(PROP_AT))
        k_root = 1e3 * v["k_root"]
        stiffness = self.both(v["EI_z"] * self.bending + k_root * root, v["EI_y"] * self.bending + k_root * root + prop)
        mass = self.both(self.mass + v["m_tip"] * tip, self.mass + v["m_tip"] * tip)
        return stiffness, v["c_tip"] * self.both(tip, tip), mass

    def modes(self, v, count, sensors=SENSORS):
        """Frequencies, damping ratios and shapes at the sensors; nothing joins the planes, which are solved apart."""
        roots, shapes, n = [], [], self.n
        rows = [self.deflection(s.point[0] / LENGTH) + (0 if s.direction == "y" else n) for s in sensors]
        for plane in (slice(0, n), slice(n, 2 * n)):
            k, c, m = (matrix[plane, plane] for matrix in self.matrices(v))
            own, vectors = np.linalg.eig(
                np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
            )
            oscillating = own.imag > 0
            whole = np.zeros((2 * n, np.count_nonzero(oscillating)), dtype=complex)
            whole[plane] = vectors[:n, oscillating]
            roots.append(own[oscillating])
            shapes.append(whole[rows])
        roots, shapes = np.concatenate(roots), np.hstack(shapes)
        order = np.argsort(np.abs(roots))[:count]
        size = np.abs(roots[order])
        return size / (2 * np.pi), -roots[order].real / size, shapes[:, order]


BEAM = Beam(ELEMENTS)


def bends(v):
    """The model as a function, as in a user's own code."""
    freq, ratio, shapes = BEAM.modes(v, 14)
    return {"natural_freq": freq, "damping_ratio": ratio, "shapes": shapes}


def as_function(**values):
    return calib.ModalFunctionModel("cantilever", space(**values), bends, SENSORS, n_modes=14, damped=True)


def as_matrices(damped=True, **values):
    nothing = np.zeros((BEAM.n, BEAM.n))
    tip, root = BEAM.point(BEAM.n - 2), BEAM.point(0)
    rows = []
    for plane, (deflection, slope) in enumerate((("y", "rz"), ("z", "ry"))):
        for k in range(BEAM.n):
            node = (k + 1) // 2
            rows.append((node, (deflection, slope)[(k + 1) % 2], LENGTH * node / ELEMENTS, 0.0, 0.0))
        assert len(rows) == (plane + 1) * BEAM.n
    return calib.StructuralModel.from_matrices(
        stiffness={
            "EI_y": BEAM.both(nothing, BEAM.bending),
            "EI_z": BEAM.both(BEAM.bending, nothing),
            "k_root": BEAM.both(root, root),
        },
        mass={"beam": BEAM.both(BEAM.mass, BEAM.mass), "m_tip": BEAM.both(tip, tip)},
        damping={"c_tip": BEAM.both(tip, tip)} if damped else None,
        dofs=pd.DataFrame(rows, columns=["node", "direction", "x", "y", "z"]),
        parameters=space(**values) if damped else space(**values).without({"c_tip": 0.0}),
        name="cantilever",
    )


def measured(prop=0.0, n_modes=8, repeats=6, seed=3, sensors=SENSORS, **true):
    """Synthetic: a mesh four times as fine."""
    rng = np.random.default_rng(seed)
    freq, ratio, shapes = Beam(4 * ELEMENTS).modes({**TRUE, **true, "prop": prop}, n_modes, sensors)
    shapes = shapes / shapes[np.argmax(np.abs(shapes), axis=0), range(n_modes)]
    f = freq * (1 + 1e-3 * rng.standard_normal((repeats, n_modes)))
    z = ratio * (1 + 0.03 * rng.standard_normal((repeats, n_modes)))
    noise = rng.standard_normal((2, repeats, *shapes.shape)) * 0.02
    s = shapes + noise[0] + 1j * noise[1]
    part = np.sqrt(repeats)
    return calib.MeasuredModes(
        names=tuple(f"m{k + 1}" for k in range(n_modes)),
        natural_freq=f.mean(axis=0), damped_freq=(f * np.sqrt(1 - z**2)).mean(axis=0),
        freq_std=f.std(axis=0, ddof=1) / part, damping_ratio=z.mean(axis=0), damping_std=z.std(axis=0, ddof=1) / part,
        sensors=sensors, shapes=s.mean(axis=0),
        shape_std=np.sqrt((s.real.var(axis=0, ddof=1) + s.imag.var(axis=0, ddof=1)) / 2) / part,
        n_repeats=repeats, synthetic=True, source="synthetic cantilever",
    )  # fmt: skip


# -- what it may lack --------------------------------------------------------------------------------------------------


def _effect(name, unit, sd, upper, build):
    magnitude = calib.Parameter(name, 0.0, 0.0, upper, unit, prior_sd=sd)
    return calib.Effect(name, name, "it is left out", "whether it is there", magnitude, build)


def effects_of_function():
    """A prop half way and a further mass there, in both planes."""

    def with_mass(model):
        def bent(v):
            return Heavier(ELEMENTS).modes(v, 14)

        return bent

    return (
        _effect("prop", "N/m", 2e3, 4e4, lambda model: lambda v: bends(v)),
        _effect("m_mid", "kg", 0.5, 10.0, with_mass),
    )


class Heavier(Beam):
    """The beam with a mass half way."""

    def matrices(self, v):
        k, c, m = super().matrices(v)
        more = self.point(self.deflection(PROP_AT))
        return k, c, m + v["m_mid"] * self.both(more, more)


def effects_of_matrices():
    nothing, at = np.zeros((BEAM.n, BEAM.n)), BEAM.point(BEAM.deflection(PROP_AT))

    def term(name, matrix):
        import scipy.sparse as sp

        return (Term(name, sp.csr_array(matrix), Monomial(1.0, ((name, 1.0),))),)

    return (
        _effect("prop", "N/m", 2e3, 4e4, lambda model: Addition(stiffness=term("prop", BEAM.both(nothing, at)))),
        _effect("m_mid", "kg", 0.5, 10.0, lambda model: Addition(mass=term("m_mid", BEAM.both(at, at)))),
    )


# -- as a study --------------------------------------------------------------------------------------------------------

STUDY = """
title = "Synthetic cantilever"
model = "model.py:MODEL"
effects = "model.py:library"
selection = SELECTED
[measurement]
files = ["modes.csv"]
shapes = ["shapes.csv"]
sensors = "sensors.csv"
repeats = 6
std_of = "mean"
synthetic = true
[held_out]
modes = ["m8"]
[pairing]
mode_count = 14
[sensitivity]
samples = 80
[calibration]
method = "gauss-newton"
starts = 1
population = 8
generations = 2
cases = [{ name = "A1", seed = 1 }]
"""

FEW = ("EI_y", "m_tip")
"""Parameters that suffice where it matters only which points are evaluated."""

MODEL = """
from pathlib import Path

import cantilever

LOG = Path(LOG_PATH)


def counted(v):
    with LOG.open("a") as stream:
        stream.write(repr(sorted(v.items())) + "\\n")
    return cantilever.bends(v)


def function():
    model = cantilever.as_function()
    return cantilever.calib.ModalFunctionModel(
        model.name, model.space, counted, model.sensors, n_modes=model.n_modes, damped=True
    )


def matrices():
    return cantilever.as_matrices()


def library():
    return cantilever.EFFECTS()
"""


def write_study(folder, log, model="function", prop=0.0, selected=tuple(ADOPTED)):
    """A study of the cantilever in a folder, its model as a function or as matrices; calls are logged outside it.

    Parameters that are not selected have their true value.
    """
    from pathlib import Path

    folder.mkdir(parents=True)
    m = measured(prop=prop, **{name: value for name, value in ADOPTED.items() if name not in selected})
    (folder / "study.toml").write_text(STUDY.replace("MODEL", model).replace("SELECTED", repr(list(selected))))
    text = MODEL.replace("LOG_PATH", repr(str(log))).replace("EFFECTS", f"effects_of_{model}")
    (folder / "model.py").write_text(text)
    (folder / "cantilever.py").write_bytes(Path(__file__).read_bytes())
    rows = zip(m.names, m.natural_freq, m.freq_std, m.damping_ratio, m.damping_std, strict=True)
    modes = pd.DataFrame(rows, columns=["mode", "freq", "freq_std", "damping", "damping_std"]).assign(
        freq_kind="natural"
    )
    modes.to_csv(folder / "modes.csv", index=False)
    shapes = [
        (name, s.node, s.direction, m.shapes[i, k].real, m.shapes[i, k].imag, m.shape_std[i, k])
        for k, name in enumerate(m.names)
        for i, s in enumerate(m.sensors)
    ]
    columns = ["mode", "node", "direction", "re", "im", "std"]
    pd.DataFrame(shapes, columns=columns).to_csv(folder / "shapes.csv", index=False)
    places = pd.DataFrame([(s.node, *s.point) for s in m.sensors], columns=["node", "x", "y", "z"]).drop_duplicates()
    places.assign(on="").to_csv(folder / "sensors.csv", index=False)
    return folder
