"""Two small studies with libraries of effects, and changes to their files."""

import os
from pathlib import Path

import pytest

from calib.errors.errors import InputError
from calib.study.study import LoadedStudy

RIG = Path(__file__).resolve().parents[2] / "studies/four_storey_rig"

RIG_EFFECTS = """\
import math
import scipy.sparse as sp
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial, Term, parameter
from calib.structure.effects.extend import Addition

def at(n, entries):
    rows, columns, values = zip(*((i, j, v) for (i, j), v in entries.items()))
    return sp.csr_array((values, (rows, columns)), shape=(n, n))

def more_mass(model):
    return Addition(mass=(Term("more", at(4, {(3, 3): 1.0}), parameter("top_mass")),))

def hung(model):
    # Relative motion of the hung mass times the root of its mass: regular at no mass.
    mass = (
        Term("carried", at(5, {(3, 3): 1.0}), parameter("hung_mass")),
        Term("coupling", at(5, {(3, 4): 1.0, (4, 3): 1.0}), Monomial(1.0, (("hung_mass", 0.5),))),
        Term("own", at(5, {(4, 4): 1.0})),
    )
    spring = Term("spring", at(5, {(4, 4): (2 * math.pi) ** 2}), Monomial(1.0, (("hung_freq", 2.0),)))
    return Addition(stiffness=(spring,), mass=mass, n_added=1)

def library():
    return (
        Effect("top_mass", "mass on top", "Top weighed without cables.", "Cables.",
               Parameter("top_mass", 0.0, 0.0, 0.1, "kg", prior_sd=0.02), more_mass),
        Effect("hung_mass", "hung mass", "Nothing hangs.", "Something that swings.",
               Parameter("hung_mass", 1e-9, 1e-9, 0.1, "kg", prior_sd=0.02), hung,
               nuisance=(Parameter("hung_freq", 30.0, 10.0, 90.0, "Hz"),),
               grid=({"hung_mass": 0.01, "hung_freq": 20.0}, {"hung_mass": 0.01, "hung_freq": 60.0})),
    )
"""

SUMS = """\
from calib.problem.effect import Effect
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

def sums(v):
    return {"s": v["a"] + v["b"], "p": v["a"] - v["b"] + 7.0 * v.get("known", 0.0)}

def build():
    return FunctionModel("sums", ParameterSpace((Parameter("a", 1.0, 0.0, 3.0), Parameter("b", 1.0, 0.0, 3.0))), sums)
"""

SUMS_EFFECTS = """\
from calib.problem.effect import Effect
from calib.problem.space import Parameter

def bent(model):
    def bend(v):
        base = model.function(v)
        return base | {"s": base["s"] + 10.0 * v["bend"] * v["a"]}
    return bend

def size(name):
    return Parameter(name, 0.0, -1.0, 1.0, prior_sd=0.5)

def library():
    return (
        Effect("bend", "bend", "It is straight.", "A bend.", size("bend"), bent),
        Effect("known", "known", "It is left out.", "A lot.", size("known"), lambda model: None),
    )
"""


def with_keys(folder: Path, *lines: str) -> Path:
    """Top-level keys in front of all others."""
    file = folder / "study.toml"
    file.write_text("\n".join(lines) + "\n" + file.read_text("utf-8"), "utf-8")
    return folder


def changed(folder: Path, old: str, new: str, name: str = "study.toml") -> Path:
    """One change to a file whose length may stay the same: its time must not, or Python takes the compiled one."""
    file = folder / name
    text = file.read_text("utf-8")
    assert old in text, old
    later = file.stat().st_mtime + 2
    file.write_text(text.replace(old, new, 1), "utf-8")
    os.utime(file, (later, later))
    return folder


def complaint(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        LoadedStudy.load(folder)
    return str(caught.value)


def names(effects):
    return tuple(effect.name for effect in effects)
