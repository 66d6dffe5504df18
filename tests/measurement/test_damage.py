"""Damaged files give modes or one sentence that names the file; nothing else, and nothing on the screen."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib.errors.errors import InputError
from calib.measurement.files.read import read_modes
from calib.measurement.files.uff import write_uff
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor

THOROUGH = settings(
    max_examples=250, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
QUICK = settings(parent=THOROUGH, max_examples=60)
MODES = b"mode,freq,freq_kind,freq_std,damping,damping_std\n# test 3\na,8,damped,0.4,0.06,0.01\nb,12.5,natural,,,\n"
SHAPES = b"mode,node,direction,re,im,std\na,1,y,2,0,0.2\na,2,-y,1,0,0.1\nb,1,y,-1,0,\nb,2,5,1,1,\n"
PLACES = b"node,x,y,z,on\n1,0,0,0.5,frame\n2,1,0,0.5,\n"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of good universal files: translations, and translations with rotations."""
    rng = np.random.default_rng(0)
    out = []
    for directions in (("y", "z"), DIRECTIONS):
        sensors = [Sensor(n, d, (float(n), 0.0, 0.5)) for n in (1, 2, 3) for d in directions]
        shapes = rng.normal(size=(len(sensors), 2)) + 1j * rng.normal(size=(len(sensors), 2))
        path = tmp_path_factory.mktemp("good") / "good.uff"
        write_uff(
            path,
            names=("a", "b"),
            natural_freq=np.array([8.0, 12.0]),
            damping_ratio=np.array([0.02, 0.01]),
            sensors=sensors,
            shapes=shapes,
        )
        out.append(path.read_bytes())
    return out


@st.composite
def damages(draw):
    """One to three damages, each as (kind, place between 0 and 1, byte)."""
    kind = st.sampled_from(["cut", "flip", "delete line", "double line", "insert", "blank"])
    return draw(st.lists(st.tuples(kind, st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=3))


def damaged(data, todo):
    for kind, where, byte in todo:
        at = int(where * max(len(data) - 1, 0))
        lines = data.splitlines(keepends=True)
        line = int(where * max(len(lines) - 1, 0))
        if kind == "cut":
            data = data[:at]
        elif kind == "flip":
            data = data[:at] + bytes([byte]) + data[at + 1 :]
        elif kind == "insert":
            data = data[:at] + bytes([byte]) + data[at:]
        elif kind == "delete line":
            data = b"".join(lines[:line] + lines[line + 1 :])
        elif kind == "double line":
            data = b"".join(lines[: line + 1] + lines[line:])
        else:
            data = b"".join([*lines[:line], b"\n", *lines[line + 1 :]])
    return data


def check(capfd, names, *arguments, **options):
    try:
        found = read_modes(*arguments, **options)
    except InputError as err:
        assert any(name in str(err) for name in names)
        assert "\n" not in str(err)
    else:
        assert isinstance(found, MeasuredModes)
        assert not np.isinf(found.shapes).any() and not np.isinf(found.shape_std).any()
        assert np.nanmax(np.abs(found.shapes), initial=0.0) <= 1 + 1e-12
        assert np.all((found.damped_freq > 0) & (found.damped_freq <= found.natural_freq))
    assert capfd.readouterr() == ("", "")


def check_universal_files(whole, tmp_path, capfd, todo, which, together):
    path, good = tmp_path / "damaged.uff", tmp_path / "good.uff"
    path.write_bytes(damaged(whole[which], todo))
    good.write_bytes(whole[which])
    check(capfd, ["damaged.uff"], [good, path] if together else [path])


DAMAGED_FILES = given(todo=damages(), which=st.integers(0, 1), together=st.booleans())


@pytest.mark.medium
@QUICK
@DAMAGED_FILES
def test_damaged_universal_files(whole, tmp_path, capfd, todo, which, together):
    check_universal_files(whole, tmp_path, capfd, todo, which, together)


@pytest.mark.slow
@THOROUGH
@DAMAGED_FILES
def test_many_damaged_universal_files(whole, tmp_path, capfd, todo, which, together):
    check_universal_files(whole, tmp_path, capfd, todo, which, together)


@QUICK
@given(data=st.binary(max_size=400), closed=st.booleans())
def test_random_bytes(tmp_path, capfd, data, closed):
    path = tmp_path / "damaged.unv"
    path.write_bytes(b"    -1\n    55\n" + data + b"\n    -1\n" if closed else data)
    check(capfd, ["damaged.unv"], [path])
    table = tmp_path / "damaged.csv"
    table.write_bytes(b"mode,freq,freq_kind\n" + data if closed else data)
    check(capfd, ["damaged.csv"], [table])


def check_tables(tmp_path, capfd, todo, which):
    tables = [MODES, SHAPES, PLACES]
    tables[which] = damaged(tables[which], todo)
    paths = [tmp_path / name for name in ("modes.csv", "shapes.csv", "places.csv")]
    for path, table in zip(paths, tables, strict=True):
        path.write_bytes(table)
    check(capfd, [p.name for p in paths], [paths[0]], shapes=[paths[1]], sensors=paths[2])


DAMAGED_TABLES = given(todo=damages(), which=st.integers(0, 2))


@pytest.mark.medium
@QUICK
@DAMAGED_TABLES
def test_damaged_tables(tmp_path, capfd, todo, which):
    check_tables(tmp_path, capfd, todo, which)


@pytest.mark.slow
@THOROUGH
@DAMAGED_TABLES
def test_many_damaged_tables(tmp_path, capfd, todo, which):
    check_tables(tmp_path, capfd, todo, which)
