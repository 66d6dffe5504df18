"""Waits of a user that any commit can be asked for: commands, imports, modes at full order, models of matrices.

    PYTHONPATH=CHECKOUT python tests/benchmarks/waits.py GROUP

The last line is a JSON object, as that of `measures.py`. Only the front door and the commands of calib are used, with
studies, models and oracles of the checkout, so that a commit of other rooms and keys can stand beside the present one.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # a user's Python keeps what it has compiled

import contextlib
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.sparse as sp
from child import report
from stopwatch import Spent, median, spent

Taken = dict[str, Spent | float | str]
REPEATS = 3
MODES, SHIFT = 40, -1.0
"""Of one solution by eigsh, the unit in which explanations of matrix models are told; and its shift, (rad/s)^2."""


def main() -> None:
    """Take the measures of one group."""
    groups: dict[str, Callable[[], Taken]] = {
        "imports": of_imports, "compare": of_compare, "explain": of_explain, "spearman": of_spearman,
        "plate": of_plate, "wide": lambda: of_explanation(58, (5, 2)), "parts": lambda: of_explanation(25, (10, 10)),
        "modes": of_modes,
    }  # fmt: skip
    report(**groups[sys.argv[1]]())


def of_imports() -> Taken:
    """What stands before the first line of a user's script."""
    words = [sys.executable, "-c", "import calib; calib.Problem"]
    subprocess.run(words, check=True)  # compiles what is not compiled yet
    return {"seconds": median([spent(lambda: subprocess.run(words, check=True)) for _ in range(2 * REPEATS)])}


def of_compare() -> Taken:
    """``calib compare studies/bogie`` first, and again with nothing changed; each to its answer and to its end."""
    with tempfile.TemporaryDirectory() as home:
        command("compare", "bogie", f"{home}/before", home)  # compiles, and trains the basis
        answer, first = command("compare", "bogie", f"{home}/results", home)
        answer_again, again = command("compare", "bogie", f"{home}/results", home)
    return {"answer": answer, "first": first, "answer_again": answer_again, "again": again}


def of_explain() -> Taken:
    """``calib explain studies/hidden_bogie`` with nothing kept, and with the bases of an earlier run."""
    with tempfile.TemporaryDirectory() as home:
        answer, first = command("explain", "hidden_bogie", f"{home}/results", home)
        answer_kept, kept = command("explain", "hidden_bogie", f"{home}/again", home)
    return {"answer": answer, "first": first, "answer_kept": answer_kept, "kept": kept}


def command(name: str, study: str, results: str, home: str) -> tuple[Spent, Spent]:
    """A command of the checkout on its own study, into a folder of results, with a cache in another.

    What passes until its answer is printed, and until it has ended: figures are drawn in between.
    """
    import calib

    words = [sys.executable, "-u", "-m", "calib", name, f"studies/{study}", "--results", results]
    root, kept = Path(calib.__file__).parents[1], {**os.environ, "CALIB_CACHE": f"{home}/cache"}
    answer = Spent(float("nan"), float("nan"))
    begun, used = time.perf_counter(), processor_of_children()
    with subprocess.Popen(
        words, cwd=root, env=kept, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True
    ) as running:
        assert running.stdout is not None
        for line in running.stdout:
            if line.startswith("Found:"):
                answer = Spent(time.perf_counter() - begun, processor_of_session(running.pid))
    if running.returncode:
        raise RuntimeError(f"{' '.join(words)} ended with {running.returncode}")
    return answer, Spent(time.perf_counter() - begun, processor_of_children() - used)


def processor_of_children() -> float:
    """Processor seconds of the processes that this one has waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def processor_of_session(leader: int) -> float:
    """Processor seconds so far of all processes of a session, from Linux' /proc; NaN elsewhere."""
    ticks = 0
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            fields = file.read_text().rpartition(")")[2].split()
            ticks += sum(map(int, fields[11:15])) if int(fields[3]) == leader else 0
    return ticks / os.sysconf("SC_CLK_TCK") if ticks else float("nan")


def of_spearman() -> Taken:
    """Rank correlations of 100 inputs with 300 responses of 500 samples."""
    from calib.sensitivity.spearman import spearman

    rng = np.random.default_rng(1)
    points = pd.DataFrame(rng.uniform(size=(500, 100))).rename(columns="x{}".format)
    responses = pd.DataFrame(rng.normal(size=(500, 300))).rename(columns="y{}".format)
    spearman(points.iloc[:, :2], responses.iloc[:, :2])
    return {"seconds": median([spent(lambda: spearman(points, responses)) for _ in range(REPEATS)])}


def of_modes() -> Taken:
    """Modes at full order: 40 undamped ones of the vehicle without seats, beside SciPy's eigsh, and 20 damped ones.

    Matrices are at hand, or assembled anew.
    """
    import calib

    sys.path[:0] = [f"{Path(calib.__file__).parents[1]}/{folder}" for folder in ("", "tests/oracles")]
    from simple_vehicle import simple_vehicle

    from models.railway import vehicle

    simple, whole = simple_vehicle(), vehicle()
    stiffness, mass = simple.matrices()
    values = dict(whole.space.values)
    name = next(iter(values))
    points = [values | {name: (1 + 0.01 * k) * values[name]} for k in range(1, REPEATS + 1)]
    turns: list[tuple[Spent, ...]] = []
    for point in points:  # in turn, so that a busy machine slows all alike
        tasks: list[Callable[[], object]] = [
            lambda: simple.modes(stiffness, mass, MODES),
            lambda: by_eigsh(stiffness, mass),
            lambda: simple.modes(*simple.matrices(), MODES),
            lambda: by_eigsh(*simple.matrices()),
            lambda point=point: whole.modes(point, MODES // 2),
        ]
        turns.append(tuple(spent(task) for task in tasks))
    own, eigsh, own_anew, eigsh_anew, damped = (median(some) for some in zip(*turns, strict=True))
    return {
        "own": own, "eigsh": eigsh, "own_anew": own_anew, "eigsh_anew": eigsh_anew, "damped": damped,
        "faster": Spent(*(eigsh[k] / own[k] for k in (0, 1))),
    }  # fmt: skip


def by_eigsh(stiffness: sp.csc_array, mass: sp.csc_array) -> np.ndarray:
    """As its manual has it: shift-invert, by a small negative shift since there may be rigid-body motions."""
    squares = sp.linalg.eigsh(sp.csc_matrix(stiffness), MODES, sp.csc_matrix(mass), sigma=SHIFT)[0]
    return np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)


def of_plate() -> Taken:
    """Calibration and explanation from Python: 4,800 degrees of freedom, 14 parts, one of them damped, 8 modes."""
    return of_explanation(40, (7, 2), damped=True, sensors=30, modes=8)


def of_explanation(
    side: int, zones: tuple[int, int], damped: bool = False, sensors: int = 40, modes: int = 10
) -> Taken:
    """Calibration and explanation of a grillage without a list of causes, nothing kept; over one solution by eigsh."""
    import scipy.stats  # noqa: F401  # its import is no part of a fit
    from grillage import grillage, measured

    import calib

    model = grillage(side, zones, damped)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["CALIB_CACHE"] = folder
        problem = calib.Problem(model, calib.ModalTest(measured(model, sensors, modes)))
        stiffness, mass = (sp.csc_matrix(matrix(model.space.values)) for matrix in (model.stiffness, model.mass))
        one = median([spent(lambda: sp.linalg.eigsh(stiffness, MODES, mass, sigma=SHIFT)) for _ in range(REPEATS)])
        fits: list = []
        fitted = spent(lambda: fits.append(problem.calibrate()))
        explained = spent(lambda: fits[0].explain())
    whole = Spent(*(fitted[k] + explained[k] for k in (0, 1)))
    return {
        "one": one, "calibrate": fitted, "explain": explained,
        "solutions": Spent(*(whole[k] / one[k] for k in (0, 1))),
    }  # fmt: skip


if __name__ == "__main__":
    main()
