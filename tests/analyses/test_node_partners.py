"""A test whose node numbers and places are its own, compared with a model by the nearest nodes: folder and memory."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.errors.errors import InputError
from calib.report.html.study_results import StudyResults
from calib.report.html.write import sections

_MODEL = """
import numpy as np
import pandas as pd

import calib


def chain(grid=0.5):
    n = 5
    dofs = pd.DataFrame([(k + 1, "x", grid * k, 0.0, 0.0) for k in range(n)], columns=["node", "direction", *"xyz"])
    links = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    k = calib.Parameter("k", 10.0, 5.0, 20.0, "kN/m")
    return calib.StructuralModel.from_matrices({"k": links}, np.eye(n), dofs=dofs, parameters=[k], name="chain")
"""
_STUDY = """
title = "A chain by distance"
model = "model.py:chain"
[measurement]
files = ["modes.csv"]
shapes = ["shapes.csv"]
sensors = "sensors.csv"
"""
_NODES = (31, 1, 2, 44)  # those of the model at 0, 0.5, 1.5 and 2 m are 1, 2, 4 and 5
_PLACES = ((0.004, 0.0, 0.0), (0.5, 0.03, 0.0), (1.5, 0.0, 0.0), (2.0, 0.0, 0.2))


@pytest.fixture
def study(tmp_path):
    """A folder whose measured shapes are those of the model at its nodes 1, 2, 4 and 5."""
    folder = tmp_path / "chain"
    folder.mkdir()
    (folder / "model.py").write_text(_MODEL)
    (folder / "study.toml").write_text(_STUDY)
    space: dict = {}
    exec(_MODEL, space)
    modes = space["chain"]().modes({}, 3)
    freq = [f"m{k + 1},{f},natural" for k, f in enumerate(modes.natural_freq)]
    (folder / "modes.csv").write_text("\n".join(["mode,freq,freq_kind", *freq]))
    shapes = [
        f"m{m + 1},{node},x,{modes.shapes[row, m].real},0"
        for m in range(3) for node, row in zip(_NODES, (0, 1, 3, 4), strict=True)
    ]  # fmt: skip
    (folder / "shapes.csv").write_text("\n".join(["mode,node,direction,re,im", *shapes]))
    _write(folder, _PLACES)
    return folder


def _write(folder, places):
    rows = [f"{node},{x},{y},{z}" for node, (x, y, z) in zip(_NODES, places, strict=True)]
    (folder / "sensors.csv").write_text("\n".join(["node,x,y,z", *rows]))


def _limit(folder, limit):
    (folder / "study.toml").write_text(_STUDY + f"node_limit = {limit}\n")


@pytest.mark.slow
def test_modes_are_compared_at_the_nearest_nodes_and_the_table_is_written(study, tmp_path):
    loaded = calib.Study.load(study, tmp_path / "results", progress=False)
    compared = loaded.compare()
    assert compared.table["mac"].to_numpy() == pytest.approx(1.0)  # node 1 of the test is node 2 of the model
    table = pd.read_csv(tmp_path / "results/chain/node_partners.csv").set_index("node")
    assert table["partner"].to_dict() == {1: 2, 2: 4, 31: 1, 44: 5}
    assert table["distance"].to_dict() == pytest.approx({1: 0.03, 2: 0.0, 31: 0.004, 44: 0.2})
    assert table["limit"].to_numpy() == pytest.approx(0.25, rel=1e-4)
    page = StudyResults(tmp_path / "results/chain", "A chain by distance", False)
    (body,) = (str(one.body) for one in sections(page) if "Measured nodes on the model" in str(one.body))
    rows = [
        re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", row)
        for row in body.partition("Measured nodes on the model")[2].split("<tr>")
    ]
    assert ["44", "5", "200", "250"] in [row[:4] for row in rows]
    (answer,) = compared.by_test.values()
    (words,) = (words for words in answer.hints if "200 mm" in words)
    assert "node 44" in words
    assert any("4 measured nodes" in words and "node 44" in words for words in answer.sentences)


@pytest.mark.medium
def test_both_doors_refuse_beyond_the_limit_that_is_stated(study, tmp_path, capsys):
    _limit(study, 0.1)
    assert cli.execute(["compare", str(study), "--results", str(tmp_path / "r")]) == 2
    said = capsys.readouterr().err
    assert "node 44 by 200 mm from node 5 (limit 100 mm)" in said
    assert "sensors.csv, line 5" in said
    below = said.splitlines()
    assert [line.split()[0] for line in below if line.endswith(("mm", "limit"))] == ["44", "1", "31", "2"]
    modes = calib.read_modes(study / "modes.csv", shapes=study / "shapes.csv", sensors=study / "sensors.csv")
    space: dict = {}
    exec(_MODEL, space)
    model = space["chain"]()
    with pytest.raises(InputError, match="node 44 by 200 mm from node 5"):
        calib.Problem(model, calib.ModalTest(modes, node_limit=0.1)).compare()
    found = calib.Problem(model, calib.ModalTest(modes, node_limit=0.21)).compare()
    assert found.table["mac"].to_numpy() == pytest.approx(1.0)
    with pytest.raises(InputError, match="node_limit"):
        calib.ModalTest(modes, node_limit=-0.1)
    _limit(study, 0.21)
    assert cli.execute(["compare", str(study), "--results", str(tmp_path / "r")]) == 0


def test_a_model_in_millimetres_is_refused_though_each_distance_is_within_its_limit(study, tmp_path, capsys):
    text = (study / "study.toml").read_text()
    (study / "study.toml").write_text(
        text.replace('model.py:chain"', 'model.py:chain"\nmodel_options = { grid = 500.0 }')
    )
    assert cli.execute(["compare", str(study), "--results", str(tmp_path / "r")]) == 2
    assert "places of the model in mm" in capsys.readouterr().err


def test_frfs_find_their_nodes_alike():
    space: dict = {}
    exec(_MODEL, space)
    model = space["chain"]()
    freq = np.linspace(1.0, 10.0, 5)
    places = (calib.Sensor(7, "x", (0.5, 0.01, 0.0)), calib.Sensor(8, "x", (1.5, 0.0, 0.0)))
    from calib.measurement.frf import MeasuredFRFs

    own = (replace(places[0], node=2), replace(places[1], node=4))
    values = np.ones((5, 2, 1), dtype=complex)
    frfs = MeasuredFRFs(freq, places, places[:1], "receptance", values, 0.1 * np.abs(values))
    same = MeasuredFRFs(freq, own, own[:1], "receptance", values, 0.1 * np.abs(values))
    one, other = (calib.Problem(model, calib.FRFTest(data)).compare() for data in (frfs, same))
    assert one.table["error"].to_numpy() == pytest.approx(other.table["error"].to_numpy())
    (answer,) = one.by_test.values()
    assert answer.partners.of == {7: 2, 8: 4}
    with pytest.raises(InputError, match="node 7 by 10 mm from node 2"):
        calib.Problem(model, calib.FRFTest(frfs, node_limit=0.005)).compare()
