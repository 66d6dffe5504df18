"""A study with two tests of one frame, empty and loaded, and one with a bench beside it; synthetic measurements."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

MODEL = """
import numpy as np
import pandas as pd
import calib
from calib.structure.affine import Monomial
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition

N, MASS, STIFF = 6, 2000.0, 4e6


def frame():
    k = np.diag([2.0] * (N - 1) + [1.0]) - np.diag([1.0] * (N - 1), 1) - np.diag([1.0] * (N - 1), -1)
    load = np.zeros((N, N))
    load[-1, -1] = 1.0
    dofs = pd.DataFrame({"node": range(1, N + 1), "direction": "x", "x": 0.0, "y": 0.0})
    dofs["z"] = 3.0 * dofs["node"]
    space = [
        calib.Parameter("k", STIFF, 0.5 * STIFF, 2 * STIFF, "N/m", prior_sd=0.2 * STIFF),
        calib.Parameter("load", 0.0, 0.0, 5000.0, "kg"),
    ]
    return calib.StructuralModel.from_matrices(
        {"k": k}, {"own": MASS * np.eye(N), "load": load}, dofs=dofs, parameters=space, name="frame"
    )


def grounded(floor):
    name = f"contact_{floor}"

    def build(model):
        row = np.zeros(model.n_dof)
        row[floor - 1] = 1.0
        return Addition(stiffness=(outer_term(name, [row], Monomial(1.0, ((name, 1.0),))),))

    size = calib.Parameter(name, 0.0, 0.0, 5e6, "N/m", prior_sd=5e5)
    return calib.Effect(name, name, "The frame stands free.", "A contact with the neighbour.", size, build)


def library():
    return tuple(grounded(floor) for floor in (1, 3, 5))


def bench():
    space = calib.ParameterSpace((calib.Parameter("k", STIFF, 0.5 * STIFF, 2 * STIFF, "N/m", prior_sd=0.2 * STIFF),))
    return calib.FunctionModel("bench", space, lambda v: {"deflection": 1e6 / v["k"]})
"""

STUDY = """
title = "A frame, empty and loaded"
model = "model.py:frame"
effects = "model.py:library"
selection = ["k"]

[[tests]]
name = "empty"
set = { load = 0.0 }
files = ["empty.csv"]
shapes = ["empty_shapes.csv"]
sensors = "sensors.csv"
synthetic = true

[[tests]]
name = "loaded"
set = { load = 1500.0 }
files = ["loaded.csv"]
shapes = ["loaded_shapes.csv"]
sensors = "sensors.csv"
synthetic = true
held_out = { modes = ["M5"], sensors = ["2x"] }

[sensitivity]
samples = 40

[calibration]
starts = 2
cases = [{ name = "C1", seed = 1 }, { name = "C2", seed = 2 }]
"""

N, MASS, STIFF, GROUND = 6, 2000.0, 4e6, 4e5


def modes(load, factor=1.06):
    k = np.diag([2.0] * (N - 1) + [1.0]) - np.diag([1.0] * (N - 1), 1) - np.diag([1.0] * (N - 1), -1)
    k = factor * STIFF * k
    k[2, 2] += GROUND
    squares, shapes = eigh(k, np.diag([MASS] * (N - 1) + [MASS + load]))
    return np.sqrt(squares) / (2 * np.pi), shapes / np.abs(shapes).max(axis=0)


def write_test(folder, name, load, seed, factor=1.06):
    """Six repeats of all modes at all floors."""
    rng = np.random.default_rng(seed)
    freq, seen = modes(load, factor)
    poles, shapes = ["mode,freq,freq_kind,repeat"], ["mode,node,direction,re,repeat"]
    for repeat in range(6):
        for k in range(N):
            poles.append(f"M{k + 1},{freq[k] * (1 + 0.002 * rng.standard_normal()):.9g},natural,r{repeat}")
            for j in range(N):
                shapes.append(f"M{k + 1},{j + 1},x,{seen[j, k] + 0.01 * rng.standard_normal():.9g},r{repeat}")
    (folder / f"{name}.csv").write_text("\n".join(poles) + "\n")
    (folder / f"{name}_shapes.csv").write_text("\n".join(shapes) + "\n")


def write_study(folder, text=STUDY):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.py").write_text(MODEL)
    (folder / "study.toml").write_text(text)
    rows = [f"{j + 1},0,0,{3.0 * (j + 1)}" for j in range(N)]
    (folder / "sensors.csv").write_text("\n".join(["node,x,y,z", *rows]) + "\n")
    write_test(folder, "empty", 0.0, 1)
    write_test(folder, "loaded", 1500.0, 2)
    (folder / "bench.csv").write_text(f"response,value,std\ndeflection,{1e6 / (1.06 * STIFF):.9g},0.0002\n")
    return folder


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """The study, never changed, with a whole run by the command, and the folders that it drew and reported.

    The figures themselves take four times as long as all the rest and are left out, and so are the pages.
    """
    from calib.command import cli
    from calib.report.html.summary import page_summary
    from calib.report.html.write import Page

    root, drawn, reported = tmp_path_factory.mktemp("several"), [], []
    study = write_study(root / "frame")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "calib.report.figures.Figures.save", lambda figures, *given: drawn.append(figures.folder.folder.name) or []
        )

        def unwritten(results, *given):
            reported.append(results.folder.folder.name)
            return Page(results.folder / "report.html", page_summary(results))

        patch.setattr("calib.report.html.write.write_report", unwritten)
        assert cli.execute(["run", str(study), "--results", str(root / "results"), "--workers", "1"]) == 0
    return study, root / "results", drawn, reported


@pytest.fixture
def frame(run):
    """The study and its results."""
    return run[:2]


@pytest.fixture
def own(tmp_path):
    """A study of one's own."""
    return write_study(tmp_path / "frame")


def told(path: Path):
    return json.loads(path.read_text())
