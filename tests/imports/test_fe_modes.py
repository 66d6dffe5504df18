"""Computed modes from files of finite-element codes, and their comparison with measured ones.

The files are written here after the codes' own descriptions of their formats; each holds a beam with known modes.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.api.fe_comparison import DRAWN, model_of_modes
from calib.command import cli
from calib.errors.errors import InputError
from calib.imports.fe_modes import read_fe_modes
from calib.measurement.files.uff import write_uff
from calib.measurement.modal import Sensor

X = np.linspace(0.0, 1.0, 6)
NUMBER = np.arange(1, 4)
FREQ = 10.0 * NUMBER**2
SHAPES = np.sin(np.pi * np.outer(X, NUMBER)) + 0.1
ALONG = 1e-3 * np.cos(np.outer(X, NUMBER))


def frd():
    out = ["    1C", "    1UUSER", f"    2C{len(X):30d}{'':37}1"]
    out += [f" -1{k + 1:10d}{1e3 * x:12.5E}{0.0:12.5E}{-4.0:12.5E}" for k, x in enumerate(X)] + [" -3"]
    for j, freq in enumerate(FREQ):
        out.append(f"  100CL{101 + j:5d}{freq:12.5E}{len(X):12d}{'':20}{2:2d}{j + 1:5d}MODAL     {1:2d}")
        out += [
            " -4  DISP        4    1",
            " -5  D1          1    2    1    0",
            " -5  ALL         1    2    0    0    1ALL",
        ]
        out += [f" -1{k + 1:10d}{ALONG[k, j]:12.5E}{0.0:12.5E}{SHAPES[k, j]:12.5E}" for k in range(len(X))] + [" -3"]
        out += [" -4  STRESS      6    1", f" -1{1:10d}{9.0:12.5E}{9.0:12.5E}{9.0:12.5E}", " -3"]
    return "\n".join([*out, " 9999"]) + "\n"


def f06():
    out = ["1    BEAM", "                   R E A L   E I G E N V A L U E S", ""]
    for j, freq in enumerate(FREQ):
        for page in (slice(0, 3), slice(3, None)):  # a table goes on behind a page break
            out += ["1    BEAM                    NOVEMBER  28, 2026  MSC.NASTRAN   PAGE    12", "0",
                    f"      EIGENVALUE = {(2 * np.pi * freq) ** 2:13.6E}",
                    f"          CYCLES = {freq:13.6E}         R E A L   E I G E N V E C T O R   N O . {j + 1:10d}", " ",
                    "      POINT ID.   TYPE          T1             T2             T3             R1             R2"
                    "             R3"]  # fmt: skip
            for k in range(len(X))[page]:
                values = (ALONG[k, j], 0.0, SHAPES[k, j], 0.0, -1e-12, 0.0)
                out.append(f"{k + 1:14d}      G   " + "".join(f"{v:15.6E}" for v in values))
        out.append(f"{900001:14d}      S   {1.0:15.6E}")
    return "\n".join(out) + "\n"


def abaqus():
    out = ["                              E I G E N V A L U E    O U T P U T", "",
           " MODE NO      EIGENVALUE              FREQUENCY         GENERALIZED MASS   COMPOSITE MODAL DAMPING",
           "                             (RAD/TIME)   (CYCLES/TIME)", ""]  # fmt: skip
    out += [f"{j + 1:8d} {(2 * np.pi * f) ** 2:12.5G} {2 * np.pi * f:12.5G} {f:12.5G} {1.0:12.5G} {0.0:12.4F}"
            for j, f in enumerate(FREQ)]  # fmt: skip
    out += [
        "",
        "                   M E M O R Y   E S T I M A T E",
        "     1          2.55E+07               18       40",
    ]
    for j in range(len(FREQ)):
        out += ["", f"                    E I G E N V A L U E    N U M B E R{j + 1:6d}", "",
                "   THE FOLLOWING TABLE IS PRINTED FOR ALL NODES", "",
                "       NODE FOOT-  U1             U2             U3",
                "            NOTE", ""]  # fmt: skip
        out += [f"{k + 1:11d}      {ALONG[k, j]:14.6E} {0.0:14.6E} {SHAPES[k, j]:14.6E}" for k in range(len(X))]
        out += ["", " MAXIMUM            9.0000  9.0000   9.0000", " AT NODE                  2          2        2"]
    return "\n".join(out) + "\n"


def calculix():
    out = ["", "     E I G E N V A L U E   O U T P U T", "", " MODE NO    EIGENVALUE                       FREQUENCY",
           "                                     REAL PART            IMAGINARY PART",
           "                           (RAD/TIME)      (CYCLES/TIME   (RAD/TIME)", ""]  # fmt: skip
    out += [f"{j + 1:7d} {(2 * np.pi * f) ** 2:14.7E} {2 * np.pi * f:14.7E} {f:14.7E} {0.0:14.7E}"
            for j, f in enumerate(FREQ)]  # fmt: skip
    for j in range(len(FREQ)):
        out += ["", f"                    E I G E N V A L U E    N U M B E R {j + 1:5d}", "",
                f" displacements (vx,vy,vz) for set NALL and time  {0.0:14.7E}", ""]  # fmt: skip
        out += [f"{k + 1:10d} {ALONG[k, j]:13.6E} {0.0:13.6E} {SHAPES[k, j]:13.6E}" for k in range(len(X))]
    return "\n".join(out) + "\n"


def ansys():
    out = []
    for j, freq in enumerate(FREQ):
        out += [" PRINT U    NODAL SOLUTION PER NODE", "", "  ***** POST1 NODAL DEGREE OF FREEDOM LISTING *****", "",
                f"  LOAD STEP=     1  SUBSTEP= {j + 1:5d}", f"   FREQ= {freq:10.5g}     LOAD CASE=   0", "",
                "  THE FOLLOWING DEGREE OF FREEDOM RESULTS ARE IN THE GLOBAL COORDINATE SYSTEM", "",
                "    NODE       UX           UY           UZ           USUM"]  # fmt: skip
        # numbers touch where they are negative, and exponents have three digits
        out += [f"{k + 1:8d} " + "".join(f"{fortran(v):>13}" for v in (ALONG[k, j], -0.5, SHAPES[k, j], 1.0))
                for k in range(len(X))]  # fmt: skip
        out += ["", " MAXIMUM ABSOLUTE VALUES", " NODE          3            2            1", " VALUE   9.0  9.0  9.0"]
    return "\n".join(out) + "\n"


def fil():
    """Places in mm, displacements with a column for the rotation about y, which is inactive in other directions."""
    records = [[1921, "6.14-1  ", "28-Nov-2"], *([1901, k + 1, 1e3 * x, 0.0, -4.0] for k, x in enumerate(X)),
               [1902, 1, 2, 3, 0, 4, 0]]  # fmt: skip
    for j, freq in enumerate(FREQ):
        records.append([1980, j + 1, (2 * np.pi * freq) ** 2, 1.0, 0.0])
        records += [[101, k + 1, ALONG[k, j], 0.0, SHAPES[k, j], 0.003 * k] for k in range(len(X))]
    text = "".join("*" + "".join(item(one) for one in [len(own) + 1, *own]) for own in records)
    return "\n".join(text[k : k + 80] for k in range(0, len(text), 80)) + "\n"


def item(value):
    if isinstance(value, str):
        return f"A{value:8}"
    if isinstance(value, float):
        return "D" + f"{value:22.15E}".replace("E", "D")
    return f"I{len(str(value)):2d}{value}"


def fortran(value):
    digits, power = f"{value:.4E}".split("E")
    return f"{float(digits) / 10:.5f}E{int(power) + 1:+04d}"


FILES = {"beam.frd": frd, "beam.f06": f06, "beam.dat": abaqus, "ccx.dat": calculix, "modes.txt": ansys, "beam.fil": fil}


@pytest.fixture(params=FILES)
def file(request, tmp_path):
    path = tmp_path / request.param
    path.write_text(FILES[request.param]())
    return path


def test_frequencies_and_shapes_are_read_as_they_were_written(file):
    found = read_fe_modes(file)
    assert found.natural_freq == pytest.approx(FREQ, rel=1e-4)
    z = np.array([k for k, s in enumerate(found.sensors) if s.direction == "z"])
    assert [found.sensors[k].node for k in z] == list(range(1, 7))
    largest = np.abs(SHAPES).max(axis=0)
    ansys_scale = np.maximum(largest, 0.5) if file.name == "modes.txt" else largest
    assert found.shapes[z].real == pytest.approx(SHAPES / ansys_scale, abs=5e-5)
    x = [k for k, s in enumerate(found.sensors) if s.direction == "x"]
    assert found.shapes[x].real == pytest.approx(ALONG / ansys_scale, abs=5e-5)


@pytest.fixture
def places(tmp_path):
    path = tmp_path / "nodes.inp"
    lines = [f"{k + 1}, {1e3 * x:.3f}, 0., -4." for k, x in enumerate(X)]
    path.write_text("*HEADING\n** a comment\n*NODE, NSET=NALL\n" + "\n".join(lines) + "\n*NODE FILE\nU\n1, 2, 3\n")
    return path


def measured(noise=0.0):
    rng = np.random.default_rng(1)
    seen = [1, 2, 4]
    shapes = -SHAPES[seen, :2] + noise * rng.standard_normal((3, 2))
    sensors = [calib.Sensor(70 + k, "z", (float(X[at]), 0.0, 0.001)) for k, at in enumerate(seen)]
    return calib.modes(1.02 * FREQ[:2], shapes, sensors=sensors, freq_std=0.1)


def test_modes_are_compared_by_the_places_of_nodes_whatever_their_numbers(file, places):
    given = {} if file.suffix == ".frd" else {"coordinates": places}
    found = calib.compare_modes(file, measured(), length_unit="mm", **given)
    assert found.table["mac"].tolist() == pytest.approx([1.0, 1.0], abs=1e-6)
    assert found.table["model_mode"].tolist() == [1, 2]
    assert found.table["freq_error"].tolist() == pytest.approx([1 / 1.02 - 1] * 2, abs=1e-4)
    assert any("by distance" in note for note in found.sentences)


def test_without_coordinates_numbers_count(tmp_path):
    (path := tmp_path / "beam.f06").write_text(f06())
    own = calib.modes(FREQ[:2], SHAPES[[1, 2, 4], :2], sensors=["2z", "3z", "5z"])
    assert calib.compare_modes(path, own).table["mac"].tolist() == pytest.approx([1.0, 1.0], abs=1e-6)
    with pytest.raises(InputError, match="number"):
        calib.compare_modes(path, calib.modes(FREQ[:2], SHAPES[[1, 2], :2], sensors=["91z", "92z"]))


def test_numbers_that_are_other_places_are_told_where_nothing_is_paired(tmp_path, places):
    (path := tmp_path / "beam.f06").write_text(f06())
    test = measured()
    other = np.linalg.svd(SHAPES[:5])[0][:, 3:]  # orthogonal to the modes at the nodes of these numbers
    unplaced = calib.modes(FREQ[:2], other, sensors=[f"{k + 1}z" for k in range(5)], freq_std=0.1)
    for given, sides in (({}, "measured nodes and nodes of the model"), ({"coordinates": places}, "measured nodes")):
        found = calib.compare_modes(path, unplaced, **given)
        assert any(f"since {sides} have no places" in words and "--sensors" in words for words in found.sentences)
        assert "places of the nodes" in found.lines["Next"] and "No mode is paired" in found.lines["How sure"]
    assert "since" not in " ".join(calib.compare_modes(path, test, coordinates=places, length_unit="mm").sentences)
    own = calib.modes(FREQ[:2], SHAPES[[1, 2, 4], :2], sensors=["2z", "3z", "5z"])
    with pytest.raises(InputError, match=r"length_unit \(mm\) is that of computed nodes"):
        calib.compare_modes(calib.modes(FREQ, SHAPES, sensors=[f"{k + 1}z" for k in range(6)]), own, length_unit="mm")


def test_of_a_large_model_some_nodes_are_drawn_and_all_measured_ones_compared():
    at = np.linspace(0.0, 1.0, 2001)
    shapes = np.sin(np.pi * np.outer(at, NUMBER)) + 0.1
    fe = calib.modes(FREQ, shapes, sensors=[calib.Sensor(k, "z", (x, 0.0, 0.0)) for k, x in enumerate(at)])
    seen = [77, 401, 1199, 1600]
    own = calib.modes(FREQ[:2], shapes[seen, :2], sensors=[calib.Sensor(k, "z", (at[k], 0.0, 0.0)) for k in seen])
    model, _ = model_of_modes(fe, own)
    assert len(seen) < len(model.sensors) <= DRAWN + len(seen)
    assert calib.compare_modes(fe, own).table["mac"].tolist() == pytest.approx([1.0, 1.0])


def test_a_wrong_unit_of_length_is_named(tmp_path):
    (path := tmp_path / "beam.frd").write_text(frd())
    with pytest.raises(InputError, match="mm"):
        calib.compare_modes(path, measured())


def test_frequencies_alone_are_paired_by_their_order():
    found = calib.compare_modes(calib.modes(FREQ), calib.modes(1.02 * FREQ[:2], freq_std=0.001 * FREQ[:2]))
    assert found.table["model_mode"].tolist() == [1, 2]
    assert "no parameters" in found.lines["Next"]


def test_rigid_modes_are_left_out_and_told(tmp_path):
    rigid = abaqus().replace(f"{FREQ[0]:12.5G} {1.0:12.5G}", f"{1e-6:12.5G} {1.0:12.5G}", 1)
    (path := tmp_path / "free.dat").write_text(rigid)
    found = read_fe_modes(path)
    assert found.names == ("2", "3") and any("rigid" in note for note in found.notes)


def test_complex_modes_keep_their_phases():
    turned = SHAPES[:, :2] * np.exp(0.6j)
    sensors = [f"{k + 1}z" for k in range(len(X))]
    fe = calib.modes(FREQ[:2], turned, sensors=sensors, damping=[0.01, 0.02])
    found = calib.compare_modes(fe, calib.modes(FREQ[:2], SHAPES[:, :2], sensors=sensors))
    assert found.table["mac"].tolist() == pytest.approx([1.0, 1.0])
    skewed = SHAPES[:, :2] * np.exp(1j * np.linspace(0, 3, len(X)))[:, None]
    other = calib.compare_modes(calib.modes(FREQ[:2], skewed, sensors=sensors), calib.modes(FREQ[:2], SHAPES[:, :2],
                                sensors=sensors))  # fmt: skip
    assert (other.table["mac"] < 0.97).all()


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.rst", "", "PRNSOL,U"),
        ("a.f06", "nothing here\n", "no modes"), ("a.frd", "    1C\n 9999\n", "no displacements"),
        ("a.fil", "\0binary", "ASCII"), ("a.fil", fil()[:2000] + "\n", "cut off"),
        ("a.fil", fil().replace("\n", "").replace("I 3101", "I 3107"), "no displacements"),
        ("a.frd", frd().replace("MODAL", "     "), "none of modes"),
        ("a.frd", frd()[:600] + "\n -1         2 1.0E+0x\n", "cannot be read"),
    ],
)  # fmt: skip
def test_files_without_modes_are_refused(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_fe_modes(tmp_path / name)


def test_a_measured_node_without_a_place_and_a_motion_that_is_not_computed_are_named(tmp_path):
    (path := tmp_path / "beam.frd").write_text(frd())
    at = [Sensor(k, "z", (float(X[k - 1]), 0.0, -4e-3)) for k in (1, 3, 5)]
    for wrong, words in ((Sensor(33, "z"), "node 33 has no place"), (Sensor(1, "ry", at[0].point), "node 1 along ry")):
        test = calib.modes(FREQ, np.eye(4, 3) + 0.1, sensors=[*at, wrong])
        with pytest.raises(InputError, match=words):
            calib.compare_modes(path, test, length_unit="mm")


def test_fewer_computed_than_measured_modes_are_refused():
    with pytest.raises(InputError, match="1 modes are computed, and 2"):
        calib.compare_modes(calib.modes(FREQ[:1]), calib.modes(FREQ[:2]))


@pytest.mark.medium
def test_the_command_needs_no_study(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "beam.frd").write_text(frd())
    (tmp_path / "modes.csv").write_text("mode,freq,freq_kind\nB1,10.2,natural\n")
    shapes = [f"B1,{k + 1},z,{SHAPES[k, 0]:.4f}" for k in (1, 2, 4)]
    (tmp_path / "shapes.csv").write_text("mode,node,direction,re\n" + "\n".join(shapes) + "\n")
    told = ["compare", "--modes", "beam.frd", "--measured", "modes.csv", "--shapes", "shapes.csv"]
    assert cli.execute(told) == 0
    told_first = capsys.readouterr().out
    assert "1 of 1 measured modes are paired" in told_first and "replaces" not in told_first
    assert "model %" not in told_first  # of damping, which neither side has
    assert cli.execute(told) == 0 and "replaces an earlier comparison" in capsys.readouterr().out
    assert (tmp_path / "compared" / "report.html").stat().st_size > 10_000
    assert (tmp_path / "compared" / "mac.csv").is_file()
    for wrong in (["compare"], ["compare", "--modes", "beam.frd"], ["compare", "study", *told[1:]]):
        assert cli.execute(wrong) == 2


def test_edges_over_nodes_that_are_not_drawn_join_those_that_are():
    count = 2 * DRAWN + 500
    sensors = [Sensor(k + 1, "z", (float(k), 0.0, 0.0)) for k in range(count)]
    modes = calib.modes([10.0], np.linspace(1.0, 2.0, count)[:, None], sensors=sensors)
    at = [Sensor(7, "z", (10.0, 0.0, 0.0)), Sensor(8, "z", (90.0, 0.0, 0.0))]
    test = calib.modes([10.0], [[1.0], [2.0]], sensors=at)
    model = model_of_modes(modes, test, lines=[(k, k + 1) for k in range(1, count)])[0]
    ends = np.sort(model.mesh.points[model.mesh.lines, 0], axis=1)
    drawn = np.sort(model.mesh.points[:, 0])
    chain = np.stack([drawn[:-1], drawn[1:]], axis=1)
    assert len(drawn) <= DRAWN + 2 and np.allclose(ends[np.argsort(ends[:, 0])], chain)


def test_shapes_of_other_directions_and_listings_without_a_title(tmp_path):
    (path := tmp_path / "modes.txt").write_text(ansys().replace(" PRINT U    NODAL SOLUTION PER NODE\n", ""))
    assert read_fe_modes(path).natural_freq == pytest.approx(FREQ, rel=1e-4)
    path.write_text(ansys().replace("IN THE GLOBAL COORDINATE SYSTEM", "IN COORDINATE SYSTEM     11  "))
    with pytest.raises(InputError, match=r"in coordinate system +11; .*RSYS,0"):
        read_fe_modes(path)


@pytest.mark.slow
def test_shapes_of_a_table_of_computed_modes_have_an_option(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, sign in (("fe", 1.0), ("test", -3.0)):
        rows = [f"{j + 1},{f},natural" for j, f in enumerate(FREQ)]
        (tmp_path / f"{name}.csv").write_text("mode,freq,freq_kind\n" + "\n".join(rows) + "\n")
        rows = [f"{j + 1},{k + 1},z,{sign * SHAPES[k, j]:.6f}" for j in range(3) for k in range(6)]
        (tmp_path / f"{name}_shapes.csv").write_text("mode,node,direction,re\n" + "\n".join(rows) + "\n")
    line = ["compare", "--modes", "fe.csv", "--measured", "test.csv", "--shapes", "test_shapes.csv"]
    assert cli.execute(line) == 2 and "fe.csv" in capsys.readouterr().err
    assert cli.execute([*line, "--modes-shapes", "fe_shapes.csv"]) == 0
    said = capsys.readouterr().out
    assert said.count("1.000") >= 3 and "by their numbers" in said
    (tmp_path / "taken").write_text("")
    assert cli.execute([*line, "--modes-shapes", "fe_shapes.csv", "--into", "taken"]) == 2
    assert "--into" in capsys.readouterr().err


def test_the_unit_of_measured_places_has_an_option_of_its_own(tmp_path, places):
    (path := tmp_path / "beam.f06").write_text(f06())
    test = measured()
    in_mm = [replace(s, point=tuple(1e3 * x for x in s.point)) for s in test.sensors]
    write_uff(tmp_path / "bare.uff", names=test.names, natural_freq=test.natural_freq, damping_ratio=np.full(2, 0.01),
              sensors=in_mm, shapes=test.shapes)  # fmt: skip
    text = (tmp_path / "bare.uff").read_text()
    bare = re.sub(r" {4}-1\n +164 *\n.*? {4}-1\n", "", text, flags=re.DOTALL)
    assert len(bare) < len(text)
    (tmp_path / "bare.uff").write_text(bare)
    with pytest.raises(InputError, match=r"measured places in mm.*--measured-length-unit"):
        calib.compare_modes(path, tmp_path / "bare.uff", coordinates=places, length_unit="mm")
    found = calib.compare_modes(
        path, tmp_path / "bare.uff", coordinates=places, length_unit="mm", measured_length_unit="mm"
    )
    assert found.table["mac"].min() > 0.99
    (tmp_path / "modes.csv").write_text("mode,freq,freq_kind\nB1,10.2,natural\n")
    with pytest.raises(InputError, match="that of universal files"):
        calib.compare_modes(path, tmp_path / "modes.csv", measured_length_unit="mm")


@pytest.mark.medium
def test_a_larger_limit_of_the_distance_holds_and_warnings_have_the_numbers_of_the_code():
    sensors = [calib.Sensor(50 + k, "z", (float(x), 0.0, 0.0)) for k, x in enumerate(X)]
    computed = calib.modes(FREQ, SHAPES, sensors=sensors)
    places = [calib.Sensor(k, "z", (float(x) + 0.1, 0.2, 0.0)) for k, x in enumerate(X)]
    test = calib.modes(FREQ, SHAPES, sensors=places)
    with pytest.raises(InputError, match="--node-limit"):
        calib.compare_modes(computed, test)
    found = calib.compare_modes(computed, test, node_limit=0.25)
    assert len(found.table) == 3
    told = [words for words in found.sentences if "as near" in words]
    assert told and "nodes 50 and 51" in told[0] and len(told) == 1
    page = found.answer_of("test").then
    assert found.lines["Next"] == page and "no parameters" in page


@pytest.mark.parametrize("factor", [-1.0, 1e-3, 37.0, 1j])
def test_normalisation_sign_and_phase_of_shapes_do_not_matter(factor):
    """Shapes normalised by mass, by the largest entry, of either sign and of any phase give one MAC."""
    masses = np.array([2.0, 1.0, 3.0, 1.0, 2.0, 1.0])
    by_mass = SHAPES / np.sqrt(masses @ SHAPES**2)
    names = [f"{k + 1}z" for k in range(6)]
    found = calib.compare_modes(
        calib.modes(FREQ, by_mass, sensors=names), calib.modes(FREQ, factor * SHAPES, sensors=names)
    )
    assert found.table["mac"].to_numpy() == pytest.approx(1.0, abs=1e-12)


def test_a_travelling_wave_is_itself_in_any_phase_and_not_the_one_that_runs_back():
    angle = 2 * np.pi * np.arange(12) / 12
    names = [f"{k + 1}z" for k in range(12)]
    wave = np.exp(1j * angle)[:, None]
    computed = calib.modes([10.0], wave, sensors=names)
    for factor, own, mac in ((1j, wave, 1.0), (1.0, wave.conj(), 0.0)):
        test = calib.ModalTest(calib.modes([10.0], factor * own, sensors=names))
        (found,) = calib.compare_modes(computed, test).by_test.values()
        assert found.comparison.mac[0, 0] == pytest.approx(mac, abs=1e-9)
