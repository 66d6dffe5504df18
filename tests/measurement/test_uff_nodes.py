"""Nodes of universal files: coordinate systems, units of length, and motions turned into global axes."""

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.files.read import read_modes
from calib.measurement.files.read_frf import read_frfs

FREQ = np.arange(1.0, 11.0)


def block(kind, *lines):
    return "\n".join([f"{-1:6d}", f"{kind:6d}", *lines, f"{-1:6d}", ""])


def systems_2420(*given):
    """(label, type, axes one a row, origin) each."""
    lines = [f"{1:10d}", "part"]
    for label, kind, axes, origin in given:
        lines += [f"{label:10d}{kind:10d}{8:10d}", f"CS{label}"]
        lines += ["".join(f"{x:25.16E}" for x in row).replace("E", "D") for row in (*axes, origin)]
    return block(2420, *lines)


def systems_18(*given):
    """(label, type, reference, origin, point on x, point in xz) each."""
    lines = []
    for label, kind, reference, *points in given:
        flat = np.ravel(points)
        lines += ["".join(f"{n:10d}" for n in (label, kind, reference, 8, 1)), "SYS"]
        lines += ["".join(f"{x:13.5E}" for x in flat[:6]), "".join(f"{x:13.5E}" for x in flat[6:])]
    return block(18, *lines)


def nodes(kind, entries):
    """Label -> (definition system, displacement system, three coordinates)."""
    lines = []
    for node, (defined, moves, place) in entries.items():
        head, numbers = f"{node:10d}{defined:10d}{moves:10d}{1:10d}", [f"{x:13.5E}" for x in place]
        lines += [head + "".join(numbers)] if kind == 15 else [head, "".join(f"{x:25.16E}" for x in place)]
    return block(kind, *lines)


def shape(values, freq=10.0, number=1):
    """A normal mode: node -> three values."""
    lines = [*["NONE"] * 5, "".join(f"{n:10d}" for n in (1, 2, 2, 8, 2, 3))]
    lines += ["".join(f"{n:10d}" for n in (2, 4, 1, number)), "".join(f"{x:13.5E}" for x in (freq, 1.0, 0.01, 0.0))]
    for node, entry in values.items():
        lines += [f"{node:10d}", "".join(f"{x:13.5E}" for x in entry)]
    return block(55, *lines)


def function(node, direction, values, reference=(9, 3), numerator=12):
    head = (
        f"{4:5d}{1:10d}{0:5d}{0:10d} {'NONE':10}{node:10d}{direction:4d} {'NONE':10}{reference[0]:10d}{reference[1]:4d}"
    )
    lines = [*["NONE"] * 5, head, f"{6:10d}{len(values):10d}{1:10d}{FREQ[0]:13.5E}{1.0:13.5E}{0.0:13.5E}"]
    for code, label, unit in ((18, "Frequency", "Hz"), (numerator, "NONE", "NONE"), (13, "NONE", "NONE")):
        lines.append(f"{code:10d}{0:5d}{0:5d}{0:5d} {label:20} {unit:20}")
    lines.append(f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':20} {'NONE':20}")
    flat = np.column_stack([values.real, values.imag]).ravel()
    lines += ["".join(f"{x:20.12E}" for x in flat[k : k + 4]) for k in range(0, len(flat), 4)]
    return block(58, *lines)


def rotation(rng):
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def by_name(measured):
    return {sensor.name: values for sensor, values in zip(measured.sensors, measured.shapes, strict=True)}


def unit_vectors(kind, local):
    """Directions of a local system at its own Cartesian coordinates, by the textbook, one a row."""
    x, y, _ = local
    flat, far = np.hypot(x, y), np.linalg.norm(local)
    around = np.array([-y, x, 0]) / flat
    if kind == 1:
        return np.array([[x / flat, y / flat, 0], around, [0, 0, 1]])
    return np.array([local / far, np.cross(around, local / far), around]) if kind == 2 else np.eye(3)


@pytest.mark.parametrize("kind", [0, 1, 2])
@pytest.mark.parametrize("dataset", [15, 2411])
def test_shapes_in_local_systems_come_back_in_global_axes(tmp_path, kind, dataset):
    rng = np.random.default_rng(kind)
    axes, origin = rotation(rng), np.array([0.5, -1.0, 2.0])
    places = {n: rng.normal(size=3) for n in (1, 2, 3)}
    true = {n: rng.normal(size=3) for n in places}
    turned = {n: unit_vectors(kind, axes @ (places[n] - origin)) @ axes for n in places}
    path = tmp_path / "m.unv"
    text = systems_2420((7, kind, axes, origin)) + nodes(dataset, {n: (0, 7, p) for n, p in places.items()})
    path.write_text(text + shape({n: turned[n] @ true[n] for n in places}))
    found = read_modes(path)
    scale = max(np.abs(v).max() for v in true.values())
    signed = by_name(found)
    sign = np.sign(signed["1x"][0].real * true[1][0])
    for n, entry in true.items():
        got = np.array([signed[f"{n}{d}"][0] for d in "xyz"])
        np.testing.assert_allclose(sign * scale * got.real, entry, atol=3e-5)
    for sensor in found.sensors:
        np.testing.assert_allclose(sensor.point, places[sensor.node], atol=1e-5)
    assert any("7" in note and "global axes" in note for note in found.notes)


def test_places_in_cylindrical_and_spherical_systems(tmp_path):
    path = tmp_path / "m.unv"
    given = systems_2420((4, 1, np.eye(3), (1.0, 0, 0)), (5, 2, np.eye(3), (0, 0, 1.0)))
    given += nodes(15, {1: (4, 0, (2.0, 90.0, 3.0)), 2: (5, 0, (2.0, 90.0, 180.0)), 3: (5, 0, (2.0, 0.0, 0.0))})
    path.write_text(given + shape({n: (0.0, 1.0, 0.0) for n in (1, 2, 3)}))
    points = {sensor.node: sensor.point for sensor in read_modes(path).sensors}
    for node, place in {1: (1, 2, 3), 2: (-2, 0, 1), 3: (0, 0, 3)}.items():
        np.testing.assert_allclose(points[node], place, atol=1e-5)


def test_a_system_that_refers_to_another_one_defined_behind_it(tmp_path):
    """Dataset 18: both turn by 90 degrees about z, so that the inner x is the global -x."""
    path = tmp_path / "m.unv"
    inner = (3, 0, 2, (1.0, 0, 0), (1.0, 1.0, 0), (1.0, 0, 1.0))
    outer = (2, 0, 0, (0.0, 0, 0), (0.0, 1.0, 0), (0.0, 0, 1.0))
    path.write_text(systems_18(inner, outer) + nodes(15, {1: (3, 3, (1.0, 0, 0)), 2: (0, 0, (0.0, 0, 0))})
                    + shape({1: (0.5, 0, 0), 2: (1.0, 0, 0)}))  # fmt: skip
    found = read_modes(path)
    assert {s.name for s in found.sensors} == {"1x", "2x"}
    assert by_name(found)["1x"][0] == pytest.approx(-0.5, abs=1e-5)
    np.testing.assert_allclose(next(s.point for s in found.sensors if s.node == 1), (-1.0, 1.0, 0.0), atol=1e-5)


@pytest.mark.parametrize(
    ("systems", "entries", "values", "words"),
    [
        ("", {1: (0, 5, (0.0, 0, 0))}, {1: (1.0, 0, 0)}, "node 1 moves in coordinate system 5"),
        ("", {1: (5, 0, (0.0, 0, 0))}, {1: (1.0, 0, 0)}, "node 1 is placed in coordinate system 5"),
        (systems_2420((5, 1, np.eye(3), (0, 0, 0))), {1: (0, 5, (0.0, 0, 2.0))}, {1: (1.0, 0, 0)}, "on the axis"),
        (systems_2420((5, 1, np.eye(3), (0, 0, 0))), {1: (0, 5, (1.0, 1.0, 0))}, {1: (1.0, 0, 0)}, "needs y"),
        (systems_2420((5, 3, np.eye(3), (0, 0, 0))), {1: (0, 5, (1.0, 1.0, 0))}, {1: (1.0, 0, 0)}, "type 3"),
        (systems_2420((5, 0, 2 * np.eye(3), (0, 0, 0))), {1: (0, 5, (1.0, 1.0, 0))}, {1: (1.0, 0, 0)}, "units"),
        (systems_18((2, 0, 3, *np.eye(3)), (3, 0, 2, *np.eye(3))), {1: (0, 0, (0, 0, 0))}, {1: (1, 0, 0)}, "refers to"),
        (systems_18((2, 0, 0, *np.ones((3, 3)))), {1: (0, 0, (0, 0, 0))}, {1: (1, 0, 0)}, "on a line"),
    ],
)
def test_what_cannot_be_turned_and_is_used_is_refused(tmp_path, systems, entries, values, words):
    path = tmp_path / "m.unv"
    path.write_text(systems + nodes(15, entries) + shape(values))
    with pytest.raises(InputError, match=words) as caught:
        read_modes(path)
    assert "m.unv" in str(caught.value)


def test_an_undefined_system_of_a_node_that_was_not_measured_refuses_nothing(tmp_path):
    path = tmp_path / "m.unv"
    path.write_text(nodes(15, {1: (0, 0, (0.0, 0, 0)), 2: (0, 5, (1.0, 0, 0))}) + shape({1: (1.0, 0, 0)}))
    assert [s.name for s in read_modes(path).sensors] == ["1x"]


def test_responses_and_forces_of_functions_are_turned(tmp_path):
    rng = np.random.default_rng(8)
    axes = rotation(rng)
    true = rng.normal(size=(3, 3, len(FREQ))) + 1j * rng.normal(size=(3, 3, len(FREQ)))  # of node 1 under node 9
    local = np.einsum("ai,bj,ijf->abf", axes, axes, true)
    text = systems_2420((7, 0, axes, (0, 0, 0))) + nodes(15, {1: (0, 7, (0.0, 0, 0)), 9: (0, 7, (1.0, 0, 0))})
    text += "".join(function(1, a + 1, local[a, b], (9, b + 1)) for a in range(3) for b in range(3))
    path = tmp_path / "f.unv"
    path.write_text(text)
    found = read_frfs(path)
    assert [s.name for s in found.responses] == ["1x", "1y", "1z"]
    np.testing.assert_allclose(np.moveaxis(found.values, 0, 2), true, atol=1e-9)
    path.write_text(text.replace(f"{7:10d}{0:10d}{8:10d}", f"{7:10d}{1:10d}{8:10d}").replace(
        f"{9:10d}   3", f"{9:10d}   2"))  # fmt: skip
    with pytest.raises(InputError, match=r"f\.unv"):
        read_frfs(path)


def test_nodes_in_double_precision_of_the_older_kind(tmp_path):
    path = tmp_path / "m.unv"
    path.write_text(nodes(781, {1: (0, 0, (0.25, 0, 1.5))}) + shape({1: (1.0, 0, 0)}))
    assert read_modes(path).sensors[0].point == (0.25, 0.0, 1.5)


def test_a_unit_of_length_may_be_stated_where_the_file_has_none(tmp_path):
    path = tmp_path / "m.unv"
    text = nodes(15, {1: (0, 0, (500.0, 0, 0)), 2: (0, 0, (0.0, 0, 0))}) + shape({1: (1.0, 0, 0), 2: (0.5, 0, 0)})
    path.write_text(text)
    plain, found = read_modes(path), read_modes(path, length_unit="mm")
    assert (plain.sensors[0].point, found.sensors[0].point) == ((500.0, 0, 0), (0.5, 0, 0))
    assert any("length_unit" in note for note in plain.notes) and not any("164" in note for note in found.notes)
    metres = block(164, f"{1:10d}{'SI':20}{2:10d}", "".join(f"{x:25.16E}" for x in (1.0, 1.0, 1.0)), f"{273.15:25.16E}")
    path.write_text(metres + text)
    with pytest.raises(InputError, match="not the stated unit"):
        read_modes(path, length_unit="mm")
    with pytest.raises(InputError, match="furlong"):
        read_modes(path, length_unit="furlong")
