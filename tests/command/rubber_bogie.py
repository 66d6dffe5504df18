"""A study of the bogie of `studies/hidden_bogie` whose primary springs are rubber; the measurement is synthetic.

The twin is that of the blind studies (mesh three times finer, distributed masses, sensors off by up to 5 mm, the same
noise). Its primary springs have a dynamic stiffness ``K law(lambda)``; each eigenvalue is found as that of the matrices
at itself, in the span of undamped modes and static responses, without the states that effects of calib add.
"""

from pathlib import Path

import numpy as np
import scipy.linalg as la
import scipy.sparse.linalg as spla

from calib.structure.effects.attach import part_of
from calib.structure.modes import Modes
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
CORNERS = [f"primary springs {end} {side}" for end in ("front", "rear") for side in ("left", "right")]
BASIS, STEPS = 80, 60

STUDY = """
title = "Bogie with rubber in its primary suspension"
base = "{base}"
effects = "library.py:library"

[measurement]
files = [{files}]
sensors = "measured/sensors.csv"
synthetic = true
"""

LIBRARY = '''
"""Effects of the bogie, and rubber in its primary springs."""

from calib.structure.rubber import relaxing_rubber
from models.railway import bogie_effects

CORNERS = [f"primary springs {end} {side}" for end in ("front", "rear") for side in ("left", "right")]


def library():
    rubber = relaxing_rubber("primary_rubber", "the primary springs", CORNERS, corner=(1.0, 40.0), plausible=0.5)
    return (*bogie_effects(), rubber)
'''


class Rubber:
    """Modes of a bogie whose primary springs follow a law; sensors as on the bogie."""

    def __init__(self, model, law):
        self.model, self.law, self.sensor_rows = model, law, model.sensor_rows

    def modes(self, values, count):
        """The lowest modes."""
        model, si = self.model, self.model.space.si(self.model.space.complete(values))
        k, c, m = model.matrices(values)
        rubber = sum(p.matrix * p.coefficient(si) for p in (part_of(model, "stiffness", name) for name in CORNERS))
        _, basis = spla.eigsh(k.tocsc(), BASIS, m.tocsc(), sigma=-1e3, v0=np.ones(model.n_dof))
        factor = spla.splu((k + 1e3 * m).tocsc())
        loads = np.hstack([np.linalg.svd(a[:, np.unique(a.nonzero()[1])].toarray(), full_matrices=False)[0][:, :24]
                           for a in (rubber.tocsc(), c.tocsc())])  # fmt: skip
        basis = la.qr(np.hstack([basis, factor.solve(loads)]), mode="economic", pivoting=True)[0]
        k, c, m, rubber = (basis.T @ (a @ basis) for a in (k, c, m, rubber))
        weight = la.inv(la.cholesky(m + 1e-14 * np.trace(m) * np.eye(len(m))))
        k, c, m, rubber = (weight.T @ a @ weight for a in (k, c, m, rubber))
        basis = basis @ weight

        def solved(lam):
            state = np.block([[np.zeros_like(k), np.eye(len(k))], [-k - (self.law(lam) - 1) * rubber, -c]])
            return la.eig(state)

        found, shapes = [], []
        plain = solved(2j * np.pi * 8.0)[0]
        starts = plain[(plain.imag > 1e-3 * abs(plain)) & (abs(plain) > 1.0)]
        for lam in starts[np.argsort(abs(starts))][: count + 2]:
            for _ in range(STEPS):
                eigenvalues, vectors = solved(lam)
                near = int(np.argmin(abs(eigenvalues - lam)))
                before, lam = lam, eigenvalues[near]
                if abs(lam - before) < 1e-9 * abs(lam):
                    break
            if lam.imag > 1e-3 * abs(lam) and all(abs(lam - other) > 1e-6 * abs(lam) for other in found):
                found.append(lam)
                shapes.append(basis @ vectors[: len(k), near])
        order = np.argsort(np.abs(found))[:count]
        lam, shapes = np.array(found)[order], np.array(shapes).T[:, order]
        size = abs(lam)
        return Modes(size / (2 * np.pi), lam.imag / (2 * np.pi), -lam.real / size, shapes)


def write_study(folder, law, seed):
    """The study in a folder, and the true values of the parameters."""
    twin = module_of(ROOT / "studies/hidden_bogie/make_twin.py")
    specimen, rng = twin.specimen(), np.random.default_rng(seed)
    truth = specimen.draw(rng)
    names, modes, shapes = specimen.seen(Rubber(specimen.fine, law), 0, truth, rng)
    assert names == specimen.modes
    twin.blind.twin.write_measurement(
        folder / "measured", names, modes, shapes, specimen.layout, rng, "bogie test with rubber"
    )
    base = (ROOT / "studies/hidden_bogie").as_posix()
    files = ", ".join(f'"measured/repeat_{k}.uff"' for k in range(1, twin.blind.twin.REPEATS + 1))
    (folder / "library.py").write_text(LIBRARY, "utf-8")
    (folder / "study.toml").write_text(STUDY.format(base=base, files=files), "utf-8")
    return truth, modes
