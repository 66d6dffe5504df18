"""Nastran's .op2: two real exports, and files written here after those, of each byte order and word length."""

import struct
from pathlib import Path

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.imports.coordinates import read_coordinates
from calib.imports.fe_modes import read_fe_modes
from calib.imports.matrices import read_matrices
from calib.imports.op2 import read_op2

EXPORTS = Path(__file__).parent / "exports"
GRIDS = {1: (0.0, 0.0, 0.0), 5: (2.0, 0.0, 1.0), 9: (0.0, 3.0, 0.0)}
TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # columns: axes of system 7
FREQ = np.array([4.0, 9.0])
MOTION = {node: np.arange(12.0).reshape(6, 2) + node for node in GRIDS}
STIFF = np.diag(np.arange(1.0, 20.0)) + np.diag(np.full(18, -0.5), 1) + np.diag(np.full(18, -0.5), -1)


class Writer:
    """Writes records between their lengths, each logical record ended by a key below 0."""

    def __init__(self, order, word):
        self.order, self.word, self.out = order, word, b""

    def ints(self, *values):
        return np.array(values, f"{self.order}i{self.word}").tobytes()

    def reals(self, values):
        return np.asarray(values, f"{self.order}f{self.word}").tobytes()

    def text(self, text):
        return b"".join(text[k : k + 4].ljust(self.word).encode() for k in range(0, 8, 4))

    def raw(self, data):
        length = struct.pack(self.order + "i", len(data))
        self.out += length + data + length

    def record(self, number, *chunks):
        for data in chunks:
            self.raw(self.ints(len(data) // self.word))
            self.raw(data)
        self.raw(self.ints(-number))

    def block(self, name, records, kind=0, trailer=(101, 0, 0, 0, 0, 0, 0)):
        name = name.ljust(8)
        self.record(1, self.text(name))
        self.record(2, self.ints(*trailer))
        self.record(3, self.ints(0), self.text(name))
        for number, chunks in enumerate(records, start=4):
            self.record(number, self.ints(kind), *chunks)
        for last in (1, 0, 0):
            self.raw(self.ints(last))


def written(order="<", word=4, systems=True, nodes=GRIDS, modes=True, analysis=22):
    """A free structure of three nodes, of which 5 moves in system 7, and a scalar point."""
    w = Writer(order, word)
    w.record(1, w.ints(1, 2, 3), w.text("NASTRAN "), w.text("XXXXXXXX"))
    w.raw(w.ints(0))
    geometry = [[w.ints(2101, 21, 8, 7, 1, 2, 0) + w.reals([0, 0, 0, 0, 0, 1, 0, 1, 0])]] if systems else []
    w.block("GEOM1", [*geometry, [w.ints(65535, 65535, 65535)]])
    if nodes is GRIDS:
        rows = b"".join(w.ints(7 if n == 5 else 0) + w.reals(place) for n, place in nodes.items())
        w.block("BGPDT", [[rows + w.ints(-1) + w.reals([0, 0, 0])]])
    external = [*GRIDS, 700]
    pairs = [part for k, node in enumerate(external) for part in (node, k + 1)]
    rows = [part for k, node in enumerate(external) for part in (node, 10 * (6 * k + 1) + (1 if k < 3 else 2))]
    w.block("EQEXIN", [[w.ints(*pairs)], [w.ints(*rows)]])
    tables = []
    for j, freq in enumerate(FREQ):
        head = w.ints(analysis, 7, 0, 1, j + 1) + w.reals([(2 * np.pi * freq) ** 2]) + w.ints(0, 0, 1, 8)
        data = b"".join(w.ints(10 * n + 2, 1) + w.reals(MOTION[n][:, j]) for n in GRIDS)
        data += w.ints(7002, 2) + w.reals([99, 0, 0, 0, 0, 0])
        tables += [[head + w.ints(*[0] * 136)], [data[: 5 * w.word], data[5 * w.word :]]]  # data in two parts
    if modes:
        w.block("OUGV1", tables)
    for name, matrix in (("KGG", STIFF), ("MGG", np.eye(19))):
        columns = []
        for column in matrix.T:
            (at,) = np.nonzero(column)
            columns.append([w.ints(at[0] + 1) + column[at[0] : at[-1] + 1].astype(f"{order}f8").tobytes()])
        w.block(name, columns, kind=1, trailer=(101, 19, 19, 6, 2, 0, 0))
    w.raw(w.ints(0))
    return w.out


def test_modes_of_a_free_beam_are_rigid_first():
    freq, motions, points, _ = read_op2(EXPORTS / "beam.op2")
    assert not points and freq.size == 18 and np.abs(freq[:6]).max() < 1e-4
    assert freq[6:8] == pytest.approx([22.27346, 24.67419], rel=1e-6)  # as its table of eigenvalues says
    own = read_coordinates(EXPORTS / "beam.dat")
    assert set(own) == {node for node, _ in motions} and len(own) == 10
    rows, found = [], []
    for node, (x, y, z) in own.items():
        cross = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
        rows += [np.hstack([np.eye(3), cross]), np.hstack([np.zeros((3, 3)), np.eye(3)])]
        found += [[motions[node, d][:6] for d in range(6)]]
    rigid, found = np.vstack(rows), np.vstack(found)
    left = found - rigid @ np.linalg.lstsq(rigid, found, rcond=None)[0]
    assert np.abs(left).max() < 1e-5 * np.abs(found).max()


def test_a_superelement_has_its_fixed_modes_at_the_nodes_that_were_asked_for():
    found = read_fe_modes(EXPORTS / "truss.op2", length_unit="in")
    assert found.natural_freq == pytest.approx(np.sqrt([1483.1598, 1483.5415, 22047.34]) / (2 * np.pi), rel=1e-6)
    assert {s.node for s in found.sensors} == {4, 16}
    place = next(s.point for s in found.sensors if s.node == 4)
    assert place == pytest.approx((900 * 0.0254, 0.0, 300 * 0.0254), rel=1e-6)


FORMS = [("<", 4), (">", 4), ("<", 8), (">", 8)]


@pytest.mark.parametrize("form", FORMS)
def test_motions_are_turned_into_basic_axes(form, tmp_path):
    (path := tmp_path / "model.op2").write_bytes(written(*form))
    freq, motions, points, notes = read_op2(path)
    assert freq == pytest.approx(FREQ, rel=1e-6) and points == GRIDS and not notes
    assert {node for node, _ in motions} == set(GRIDS)
    for node in GRIDS:
        own = np.array([motions[node, d] for d in range(6)])
        turn = TURNED if node == 5 else np.eye(3)
        assert own == pytest.approx(np.vstack([turn @ MOTION[node][:3], turn @ MOTION[node][3:]]), abs=1e-5)


@pytest.mark.parametrize("form", FORMS)
def test_matrices_of_all_degrees_of_freedom_name_their_rows(form, tmp_path):
    (path := tmp_path / "model.op2").write_bytes(written(*form))
    found = read_matrices([path])
    assert found.matrices["mass"]["MGG"].toarray() == pytest.approx(np.eye(19))
    rows = found.dofs.dropna(subset=["node"])
    assert len(rows) == 18 and rows["node"].tolist()[::6] == list(GRIDS)
    assert found.matrices["stiffness"]["KGG"].toarray() == pytest.approx(STIFF)


def test_a_node_in_unknown_axes_is_left_out_and_told(tmp_path):
    (path := tmp_path / "model.op2").write_bytes(written(systems=False))
    _, motions, _, notes = read_op2(path)
    assert {node for node, _ in motions} == {1, 9} and "node" in notes[0] and "5" in notes[0]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x18\0\0\0" * 8, "no binary OUTPUT2"), (written()[:900], "cut off"), (written()[:-150], "cut off"),
        (written(modes=False), "no real modes"), (written(analysis=92), "no real modes"),
    ],
)  # fmt: skip
def test_files_without_modes_are_refused(data, words, tmp_path):
    (path := tmp_path / "model.op2").write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_fe_modes(path)


def test_results_without_matrices_are_refused():
    with pytest.raises(InputError, match="no square"):
        read_matrices([EXPORTS / "beam.op2"])
