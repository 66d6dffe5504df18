"""Modes that an added effect brings, on a row of masses that carries suspended ones."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as la

from calib.hypotheses import own_modes as of
from calib.hypotheses.own_modes import own_modes, own_modes_sentence
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.effects.attach import hung_masses, maxwell_branches
from calib.structure.effects.extend import extend
from calib.structure.model import StructuralModel

MASSES = np.array([10.0, 12.0, 9.0])
SPRINGS = np.array([2e5, 3e5, 1.5e5])


def row_of_masses():
    """Three masses in a row, the first on the ground: 5.8, 21 and 35 Hz or so."""
    k = np.diag(SPRINGS + np.append(SPRINGS[1:], 0.0)) - np.diag(SPRINGS[1:], 1) - np.diag(SPRINGS[1:], -1)
    return StructuralModel.from_matrices(k, np.diag(MASSES), dofs=[(n, "x") for n in (1, 2, 3)])


def unit(name, at):
    """A mass hung on one of the masses."""
    motion, freq = np.eye(3)[at], f"{name}_freq"
    return Effect(
        name, "Suspended unit", "all is rigid", "a unit", Parameter(name, 0.0, 0.0, 9.0, "kg", prior_sd=1.0),
        lambda model: hung_masses([np.pad(motion, (0, model.n_dof - 3))], name, freq, 0.0),
        nuisance=(Parameter(freq, 12.0, 1.0, 90.0, "Hz"),), grid=({name: 1.0, freq: 12.0},),
    )  # fmt: skip


def branch():
    """A spring with a damper in series from the first mass to the ground; its degree of freedom has no mass."""
    return Effect(
        "branch", "Maxwell element", "nothing", "it", Parameter("branch", 0.0, 0.0, 1e7, "N/m", prior_sd=1e5),
        lambda model: maxwell_branches([np.eye(3)[0]], "branch", "corner"),
        nuisance=(Parameter("corner", 10.0, 0.1, 900.0, "Hz"),), grid=({"branch": 1e5, "corner": 10.0},),
    )  # fmt: skip


def found(model, values, pairs=()):
    """What a comparison with measured modes M1, M2, ... holds, that pair with these model modes (from 1)."""
    index = np.array(pairs, dtype=int) - 1
    return SimpleNamespace(
        model=model, values=values, modes=model.modes(values, model.n_dof),
        measured=SimpleNamespace(names=[f"M{k + 1}" for k in range(len(index))]),
        pairing=SimpleNamespace(model_index=index, paired=np.flatnonzero(index >= 0)),
    )  # fmt: skip


def test_a_light_unit_between_modes_brings_one_mode_near_its_own_frequency():
    base, effect = row_of_masses(), unit("brake", 1)
    model = extend(base, [effect])
    table = own_modes(base, [effect], found(model, {"brake": 0.01, "brake_freq": 12.0}))
    (row,) = table.to_dict("records")
    assert row["effect"] == "brake" and row["natural_freq"] == pytest.approx(12.0, rel=0.01) and row["share"] > 0.98
    freq = model.modes({"brake": 0.01, "brake_freq": 12.0}, 4).natural_freq
    assert freq[row["model_mode"] - 1] == row["natural_freq"]
    told = own_modes_sentence(table)
    assert "brake" in told and "12 Hz" in told and f"{100 * row['share']:.0f} %" in told


def test_the_shares_of_a_unit_add_up_to_one(monkeypatch):
    monkeypatch.setattr(of, "RULES", replace(of.RULES, own_mode=-math.inf))
    base, effects = row_of_masses(), [unit("brake", 1), unit("lamp", 2)]
    values = {"brake": 3.0, "brake_freq": 20.0, "lamp": 2.0, "lamp_freq": 33.0}
    table = own_modes(base, effects, found(extend(base, effects), values))
    assert len(table) == 10 and (table.groupby("effect")["share"].sum() - 1).abs().max() < 1e-9


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_of_two_units_each_has_its_own_mode(order):
    units = [unit("brake", 1), unit("lamp", 2)]
    base, effects = row_of_masses(), [units[k] for k in order]
    values = {"brake": 0.02, "brake_freq": 10.0, "lamp": 0.02, "lamp_freq": 60.0}
    table = own_modes(base, effects, found(extend(base, effects), values)).set_index("effect")
    assert dict(table["natural_freq"].round()) == {"brake": 10.0, "lamp": 60.0}
    assert own_modes_sentence(table.reset_index()).count("adds a mode") == 2


def test_a_mode_that_a_measured_mode_pairs_with_is_not_told():
    base, effect = row_of_masses(), unit("brake", 1)
    model, values = extend(base, [effect]), {"brake": 0.01, "brake_freq": 12.0}
    number = int(own_modes(base, [effect], found(model, values))["model_mode"].iloc[0])
    others = [n for n in range(1, 5) if n != number]
    beside = own_modes(base, [effect], found(model, values, others))
    assert beside["paired"].tolist() == [""] and own_modes_sentence(beside)
    paired = own_modes(base, [effect], found(model, values, [0, number]))
    assert paired["paired"].tolist() == ["M2"] and own_modes_sentence(paired) == ""


def test_the_share_is_that_of_the_kinetic_energy_of_the_motion_relative_to_the_carrier():
    """Against the same structure with the unit's own motion as a degree of freedom."""
    base, effect, mass, freq = row_of_masses(), unit("brake", 1), 3.0, 12.0
    (row,) = own_modes(base, [effect], found(extend(base, [effect]), {"brake": mass, "brake_freq": freq})).to_dict(
        "records"
    )
    stiffness = np.zeros((4, 4))
    stiffness[:3, :3] = base.matrices({})[0].toarray()
    across = np.array([0.0, -1.0, 0.0, 1.0])
    stiffness += (2 * np.pi * freq) ** 2 * mass * np.outer(across, across)
    squares, shapes = la.eigh(stiffness, np.diag([*MASSES, mass]))
    shares = mass * (across @ shapes) * shapes[3]  # shapes are mass-normalised
    assert np.argmax(shares) == row["model_mode"] - 1 and row["share"] == pytest.approx(shares.max(), rel=1e-9)
    assert row["natural_freq"] == pytest.approx(np.sqrt(squares[np.argmax(shares)]) / 2 / np.pi, rel=1e-9)


def test_what_has_no_mass_brings_no_mode():
    base, effect = row_of_masses(), branch()
    model = extend(base, [effect])
    assert model.n_dof == base.n_dof + 1
    assert own_modes(base, [effect], found(model, {"branch": 3e6, "corner": 200.0})).empty


def test_models_without_matrices_have_none():
    function = SimpleNamespace(reducible=None)
    assert own_modes(function, [unit("brake", 1)], SimpleNamespace(model=function)).empty
