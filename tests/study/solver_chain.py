"""A solver of a chain of two masses: a script that is its own deck, and writes modes and matrices."""

import sys

import numpy as np

import calib
from calib.study.solver import solver_model

SCRIPT = """import math, sys
k, m, t = {{ k }}, {{ m }}, {{ t }}
open({{ log }}, "a").write(f"{k!r} {m!r} {t!r} {{ matrices }}\\n")
{{ more }}
spring, base = k * 1e3, 200.0 * t**3 + 50.0 / t
a, b, c = spring + base, -spring, spring
heavy = m * t
if {{ matrices }}:
    for name, rows in (("K.mtx", [[a, b], [b, c]]), ("M.mtx", [[heavy, 0.0], [0.0, m]])):
        lines = [f"{i + 1} {j + 1} {rows[i][j]!r}" for i in range(2) for j in range(2) if rows[i][j]]
        head = f"%%MatrixMarket matrix coordinate real general\\n2 2 {len(lines)}\\n"
        open(name, "w").write(head + "\\n".join(lines) + "\\n")
    open("dofs.csv", "w").write("node,direction\\n1,z\\n2,z\\n")
    sys.exit()
trace, det = a / heavy + c / m, (a * c - b * b) / (heavy * m)
squares = [(trace + sign * math.sqrt(trace**2 - 4 * det)) / 2 for sign in (-1, 1)]
modes = [f"{n},{math.sqrt(x) / (2 * math.pi)!r},natural," for n, x in enumerate(squares, start=1)]
open("modes.csv", "w").write("mode,freq,freq_kind,freq_std\\n" + "\\n".join(modes) + "\\n")
shapes = [f"{n},1,z,1.0\\n{n},2,z,{(a - x * heavy) / spring!r}" for n, x in enumerate(squares, start=1)]
open("shapes.csv", "w").write("mode,node,direction,re\\n" + "\\n".join(shapes) + "\\n")
"""
COMMAND = [sys.executable, "-I", "-S", "solve.py"]
PARAMETERS = (
    calib.Parameter("k", 2.0, 1.0, 3.0, "kN/m"),
    calib.Parameter("m", 1.5, 1.0, 2.0, "kg"),
    calib.Parameter("t", 1.0, 0.7, 1.4),
)
TRUE = {"k": 2.3, "m": 1.3, "t": 1.0}


def template(folder, more=""):
    """The template of the solver in a folder, with more of its own; its runs are logged there."""
    text = SCRIPT.replace("{{ log }}", repr(str(folder / "log"))).replace("{{ more }}", more)
    (folder / "solve.py.j2").write_text(text, encoding="utf-8")
    return folder / "solve.py.j2"


def runs(folder):
    """Lines of its log, one a run."""
    return (folder / "log").read_text().splitlines() if (folder / "log").exists() else []


def solver(folder, more="", **options):
    """The solver as a model."""
    given = {
        "template": template(folder, more), "modes": "modes.csv", "shapes": "shapes.csv", "sensors": ["1z", "2z"],
        "n_modes": 2, "parameters": PARAMETERS, "folder": folder,
    }  # fmt: skip
    return solver_model(COMMAND, **{**given, **options})


def exact(values):
    """Frequencies (Hz) and shapes of the chain."""
    spring, base = 1e3 * values["k"], 200.0 * values["t"] ** 3 + 50.0 / values["t"]
    stiffness = np.array([[spring + base, -spring], [-spring, spring]])
    squares, shapes = np.linalg.eig(stiffness / np.array([[values["m"] * values["t"]], [values["m"]]]))
    order = np.argsort(squares)
    return np.sqrt(squares[order]) / (2 * np.pi), shapes[:, order]


STUDY = f"""title = "chain"
[model]
command = "{COMMAND[0]} -I -S solve.py"
template = "solve.py.j2"
modes = "modes.csv"
shapes = "shapes.csv"
matrices = ["K.mtx", "M.mtx", "dofs.csv"]
n_modes = 2
[model.parameters]
k = {{ value = 2.0, limits = [1.0, 3.0], unit = "kN/m" }}
m = {{ value = 1.5, limits = [1.0, 2.0], unit = "kg" }}
t = {{ value = 1.0, limits = [0.7, 1.4], powers = [-1, 1, 2, 3] }}
[parameters.t]
fixed = true
[measurement]
files = ["measured.csv"]
shapes = ["measured_shapes.csv"]
synthetic = true
[calibration]
method = "gauss-newton"
starts = 2
"""


def study(folder, more="", text=STUDY):
    """A study of the solver, measured at `TRUE`."""
    folder.mkdir(parents=True, exist_ok=True)
    template(folder, more)
    freq, shapes = (one.tolist() for one in exact(TRUE))
    lines = [f"B{j + 1},{freq[j]!r},natural,{1e-4 * freq[j]!r}" for j in range(2)]
    (folder / "measured.csv").write_text("mode,freq,freq_kind,freq_std\n" + "\n".join(lines) + "\n")
    rows = [f"B{j + 1},{i + 1},z,{shapes[i][j]!r},0.001" for j in range(2) for i in range(2)]
    (folder / "measured_shapes.csv").write_text("mode,node,direction,re,std\n" + "\n".join(rows) + "\n")
    (folder / "study.toml").write_text(text)
    return folder
