"""Matrices of a code as a model and as a study: checks at the door, the code's own modes, the command."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import eigh

import calib
from calib.command import cli
from calib.errors.errors import InputError

EXPORTS = Path(__file__).parents[1] / "imports" / "exports"


@pytest.fixture(scope="module")
def solid():
    return calib.import_matrices(EXPORTS / "solid.sti", units="mm-t-N", modes=EXPORTS / "solid_modes.dat")


def test_an_export_of_calculix_has_the_modes_that_calculix_printed(solid):
    beside = solid.modes.dropna()
    assert len(beside) == 6 and beside["freq_error"].abs().max() < 1e-6 and beside["mac"].min() > 0.99999
    assert not solid.warnings and any("code's own modes" in note for note in solid.notes)
    assert solid.model.n_dof == 42 and len(solid.model.labels) == 8


def test_a_row_that_is_named_twice_is_no_layer_of_a_solid(tmp_path):
    for suffix in ("sti", "mas", "inp"):
        shutil.copy(EXPORTS / f"solid.{suffix}", tmp_path)
    rows = (EXPORTS / "solid.dof").read_text().split()
    (tmp_path / "solid.dof").write_text("\n".join([rows[1], *rows[1:]]) + "\n")
    with pytest.raises(InputError, match=r"is named twice; write the .dof again: solid.inp has no shells"):
        calib.import_matrices(tmp_path / "solid.sti", units="mm-t-N")


def test_shells_that_became_solids_move_as_the_mean_of_their_layers():
    found = calib.import_matrices(EXPORTS / "shell.sti", units="mm-t-N", modes=EXPORTS / "shell_modes.frd")
    beside = found.modes.dropna()
    assert len(beside) == 4 and beside["freq_error"].abs().max() < 1e-6 and beside["mac"].min() > 0.9999
    steel = 7850 * 0.040 * 0.015 * 0.002
    assert any(f"{steel:.5g}, {steel:.5g}, {steel:.5g} kg" in note for note in found.notes)
    assert any("6 rigid-body motions" in note for note in found.notes)


def test_modes_of_another_model_are_told(tmp_path):
    other = tmp_path / "modes.csv"
    other.write_text("mode,freq,freq_kind\n1,1249.2,natural\n2,2450.4,natural\n")
    found = calib.import_matrices(EXPORTS / "solid.sti", units="mm-t-N", modes=other)
    assert any("at most 2" in words and "one model" in words for words in found.warnings)


def test_without_a_unit_system_the_mass_is_told_in_each():
    found = calib.import_matrices(EXPORTS / "solid.sti")
    (words,) = [note for note in found.notes if "Mass that moves" in note]
    assert "1.57e-05, 1.57e-05, 1.57e-05 kg" in words and "0.0157 kg in mm-t-N" in words


def test_a_negative_mass_and_an_asymmetric_stiffness_are_refused(tmp_path):
    k, m = np.array([[2.0, -1], [-1, 2]]), np.diag([1.0, 2.0])
    rows = [[1, 1], [2, 1]]
    for bad, words in (({"K": k, "M": -m}, "mass at row 1"), ({"K": k * [[1, 1.1], [1, 1]], "M": m}, "symmetric"),
                       ({"K": k * [[1, np.nan], [1, 1]], "M": m}, "nan"), ({"K": k, "M": m[:1, :1]}, "mass"),
                       ({"K": k, "M": m, "dofs": [[1, 1], [1, 1]]}, "twice"),
                       ({"K": k, "M": np.zeros((2, 2))}, "no mass|cannot be solved")):  # fmt: skip
        np.savez(tmp_path / "a.npz", **{"dofs": rows, **bad})
        with pytest.raises(InputError, match=words):
            calib.import_matrices(tmp_path / "a.npz")


@pytest.fixture
def measured(tmp_path):
    home = tmp_path / "measured"
    home.mkdir()
    (home / "modes.csv").write_text("mode,freq,freq_kind,freq_std\nA,1240,natural,3\nB,2460,natural,5\n")
    (home / "shapes.csv").write_text(
        "mode,node,direction,re,std\nA,901,z,1.0,0.01\nA,902,z,0.33,0.01\nA,901,y,0.0,0.01\n"
        "B,901,y,1.0,0.01\nB,902,z,0.0,0.01\nB,901,z,0.0,0.01\n"
    )
    (home / "places.csv").write_text("node,x,y,z\n901,0.06,0.0,0.0\n902,0.03,0.0,0.0\n")
    return home


@pytest.mark.medium
def test_the_command_writes_a_study_that_compares_at_once(measured, tmp_path, capsys, monkeypatch, undrawn):
    monkeypatch.chdir(tmp_path)
    for name in ("solid.sti", "solid.mas", "solid.dof", "solid.inp"):
        shutil.copy(EXPORTS / name, tmp_path)
    arguments = ["import", "solid.sti", "--units", "mm-t-N", "--to", "beam", "--measured", "measured/modes.csv",
                 "--shapes", "measured/shapes.csv", "--sensors", "measured/places.csv"]  # fmt: skip
    assert cli.execute(arguments) == 0
    said = capsys.readouterr().out
    assert "calib compare beam" in said and "1248.89" in said and "0.0157 kg" in said.replace("0.0157, 0.0157, ", "")
    found = calib.Study.load("beam", progress=False).compare().table
    assert found["mac"].min() > 0.99 and found["natural_freq_model"].tolist() == pytest.approx(
        [1248.89, 2450.42], rel=1e-5
    )
    assert cli.execute(arguments) == 2 and "not an empty folder" in capsys.readouterr().err
    wrong = ["m-kg-N" if one == "mm-t-N" else "wrong" if one == "beam" else one for one in arguments]
    assert cli.execute(wrong) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "will not compare: sensor 90" in said and "the model (--units of an import" in said
    assert (
        cli.execute(["numbers" if one == "wrong" else one for one in wrong[:-2]]) == 0
        and "No place of a measured" in capsys.readouterr().out
    )


def test_a_pattern_without_quotes_behind_an_option_is_told(tmp_path, capsys):
    for name in ("one.unv", "two.unv"):
        (tmp_path / name).write_text("    -1\n    -1\n")
    one, two = str(tmp_path / "one.unv"), str(tmp_path / "two.unv")
    for command in (
        ["import", one, "--measured", two, "--to", str(tmp_path / "study")],
        ["compare", one, "--measured", two],
    ):
        assert cli.execute(command) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert "one.unv" in said and "--measured" in said and "pattern in quotes" in said


def test_without_a_measurement_the_study_says_what_to_add(tmp_path, capsys):
    found = calib.import_matrices(EXPORTS / "solid.sti", units="mm-t-N", to=tmp_path / "beam")
    assert "study.toml" in found.next_steps[1] and found.study == tmp_path / "beam"
    assert cli.execute(["compare", str(tmp_path / "beam")]) == 2
    assert "measured" in capsys.readouterr().err


def test_parts_get_a_parameter_each(tmp_path):
    k = np.array([[1.0, -1], [-1, 1]])
    np.savez(tmp_path / "a.npz", K1=np.diag([1e4, 0]), **{"K-2": 1e4 * k}, M=np.diag([4.0, 2.0]), dofs=[[1, 1], [2, 1]])
    found = calib.import_matrices(tmp_path / "a.npz", to=tmp_path / "chain")
    assert [p.name for p in found.model.space] == ["K1", "K_2"]
    held = pd.read_csv(tmp_path / "chain" / "dofs.csv")
    assert held["node"].tolist() == [1, 2] and (tmp_path / "chain" / "lines.csv").exists()
    code = compile((tmp_path / "chain" / "model.py").read_text(), "model.py", "exec")
    space: dict = {"__file__": str(tmp_path / "chain" / "model.py"), "__name__": "model"}
    exec(code, space)
    again = space["imported"]()
    for values in ({}, {"K1": 0.7, "K_2": 1.3}):
        assert again.modes(values, 2).natural_freq == pytest.approx(found.model.modes(values, 2).natural_freq)


def test_element_sets_reach_the_study_with_their_share_of_the_energy(tmp_path):
    for suffix in ("sti", "mas", "dof"):
        shutil.copy(EXPORTS / f"solid.{suffix}", tmp_path)
    deck = (EXPORTS / "solid.inp").read_text()
    more = "*ELSET, ELSET=ROOT\n1\n*ELSET, ELSET=TIP\n2\n"
    (tmp_path / "solid.inp").write_text(deck.replace("*MATERIAL", more + "*MATERIAL", 1))
    found = calib.import_matrices(tmp_path / "solid.sti", units="mm-t-N", to=tmp_path / "beam")
    assert dict(found.read.sets) == {
        "BEAM": tuple(range(5, 13)), "ROOT": tuple(range(5, 9)), "TIP": tuple(range(5, 13))
    }  # fmt: skip
    assert found.modes["set"].tolist()[:2] == ["ROOT", "ROOT"] and found.modes["energy_share"].max() < 1.0
    space: dict = {"__file__": str(tmp_path / "beam" / "model.py"), "__name__": "model"}
    exec(compile((tmp_path / "beam" / "model.py").read_text(), "model.py", "exec"), space)
    again = space["imported"]()
    assert again.mesh.groups == found.model.mesh.groups and {"BEAM", "ROOT", "TIP"} <= set(again.clusters)


def free_bar(tmp_path, n=30, **changed):
    """Matrices of a bar of masses on springs, free; ``changed`` are other matrices."""
    stiffness = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    stiffness[0, 0] = stiffness[-1, -1] = 1e6
    np.savez(
        tmp_path / "bar.npz",
        **{"K": stiffness, "M": 2.0 * np.eye(n), "dofs": [[k + 1, 1] for k in range(n)], **changed},
    )
    return tmp_path / "bar.npz"


def test_a_stiffness_that_is_cut_off_is_refused(tmp_path):
    whole = calib.import_matrices(free_bar(tmp_path)).model.stiffness({"stiffness": 1.0}).toarray()
    whole[8:] = whole[:, 8:] = 0.0
    with pytest.raises(InputError, match=r"22 of 30 rows have mass and no stiffness, such as row 9 \(node 9, x\)"):
        calib.import_matrices(free_bar(tmp_path, K=whole))


def test_a_negative_stiffness_is_named(tmp_path):
    whole = calib.import_matrices(free_bar(tmp_path)).model.stiffness({"stiffness": 1.0}).toarray()
    with pytest.raises(InputError, match=r"the stiffness at row \d+ \(node \d+, x\) is -"):
        calib.import_matrices(free_bar(tmp_path, K=-whole))


def test_stiffness_and_mass_that_are_exchanged_are_refused(tmp_path):
    held = calib.import_matrices(free_bar(tmp_path)).model.stiffness({"stiffness": 1.0}).toarray()
    held[0, 0] *= 2
    right = calib.import_matrices(free_bar(tmp_path, K=held))
    assert not right.warnings
    for stiffness in ("M", "K"):  # exchanged, or the mass is the stiffness
        with pytest.raises(InputError, match=r"resist no translation.*--stiffness and --mass"):
            calib.import_matrices(free_bar(tmp_path, K=held), stiffness=stiffness, mass="K")
    assert any("No coordinates" in note and "--coordinates" in note for note in right.notes)


@pytest.mark.medium
def test_shapes_that_differ_where_frequencies_agree_do_not_accuse_the_matrices(tmp_path):
    listing = (EXPORTS / "solid_modes.dat").read_text().splitlines()
    for j, line in enumerate(listing):  # three nodes in exchanged directions, as if printed in local ones
        cells = line.split()
        if cells[:1] in (["12"], ["11"], ["10"]) and len(cells) == 4:
            listing[j] = f"{cells[0]:>10} {cells[3]:>13} {cells[1]:>13} {cells[2]:>13}"
    (own := tmp_path / "modes.dat").write_text("\n".join(listing) + "\n")
    found = calib.import_matrices(EXPORTS / "solid.sti", modes=own)
    assert len(found.warnings) == 1 and "matrices are right" in found.warnings[0]


def own_modes(home, k, m, rows, count, turn=0.0):
    """Tables of what a code computes of its matrices, in its own units; ``turn`` mixes modes of equal frequency."""
    squares, shapes = eigh(k, m)
    shapes[:, 1:-1:2], shapes[:, 2::2] = (
        np.cos(turn) * shapes[:, 1:-1:2] + np.sin(turn) * shapes[:, 2::2],
        np.cos(turn) * shapes[:, 2::2] - np.sin(turn) * shapes[:, 1:-1:2],
    )
    freq = np.sqrt(squares[:count]) / (2 * np.pi)
    names = "x y z rx ry rz".split()
    (home / "own.csv").write_text(
        "mode,freq,freq_kind\n" + "".join(f"{j + 1},{f!r},natural\n" for j, f in enumerate(map(float, freq)))
    )
    (home / "own_shapes.csv").write_text(
        "mode,node,direction,re\n"
        + "".join(f"{j + 1},{n},{names[d - 1]},{shapes[i, j]:.9g}\n" for j in range(count)
                  for i, (n, d) in enumerate(rows))
    )  # fmt: skip
    np.savez(home / "a.npz", K=k, M=m, dofs=rows)
    return calib.import_matrices(
        home / "a.npz", units="mm-t-N", modes=home / "own.csv", modes_shapes=home / "own_shapes.csv"
    )


def test_translations_of_the_code_are_in_its_unit_of_length_beside_rotations_in_rad(tmp_path):
    n, ei, mass = 6, 1e9, 1e-4  # a cantilever of beam elements of 100 mm, in N, mm, t
    k, m = np.zeros((2 * n + 2, 2 * n + 2)), np.diag(np.tile([mass, 0.2 * mass * 100**2], n + 1))
    lines = [12, 600, -12, 600], [600, 4e4, -600, 2e4], [-12, -600, 12, -600], [600, 2e4, -600, 4e4]
    element = ei / 100**3 * np.array(lines)
    for j in range(n):
        k[2 * j : 2 * j + 4, 2 * j : 2 * j + 4] += element
    rows = [[node, d] for node in range(1, n + 1) for d in (2, 6)]
    found = own_modes(tmp_path, k[2:, 2:], m[2:, 2:], rows, 6)
    assert not found.warnings and found.modes["mac"].min() > 0.9999


@pytest.mark.parametrize("count", [10, 11])
def test_a_pair_of_equal_modes_that_the_list_cuts_is_compared_as_one_motion(tmp_path, count):
    chain = 1e4 * (2 * np.eye(7) - np.eye(7, k=1) - np.eye(7, k=-1))
    k = np.zeros((15, 15))
    k[0, 0], k[1:8, 1:8], k[8:, 8:] = 10.0, chain, chain
    rows = [[99, 1], *([node, d] for d in (2, 3) for node in range(1, 8))]
    found = own_modes(tmp_path, k, 1e-3 * np.eye(15), rows, count, turn=0.7)
    assert not found.warnings and len(found.modes.dropna()) == 10 and found.modes["mac"].min() > 0.9999
