"""A repeat that disagrees is named where model and measurement are compared."""

import numpy as np
import pandas as pd
import pytest

from calib.correlation.scatter import scatter_of
from calib.example import write_example
from calib.questions.compare import compare
from calib.questions.record import check_repeats
from calib.results import Results
from calib.study import Study


@pytest.fixture
def example(tmp_path):
    """The example with five repeats in its tables; the sensor 3x is turned round in the second of them."""
    folder = tmp_path / "mast"
    write_example(folder)
    rng = np.random.default_rng(1)
    modes, shapes = (pd.read_csv(folder / name, comment="#") for name in ("modes.csv", "shapes.csv"))
    many_modes, many_shapes = [], []
    for k in range(1, 6):
        freq = modes["freq"] * (1 + 0.003 * rng.normal(size=len(modes)))
        many_modes.append(modes.assign(freq=freq, repeat=k).drop(columns=["freq_std", "damping_std"]))
        re = shapes["re"] + 0.01 * rng.normal(size=len(shapes))
        turned = (shapes["node"] == 3) & (shapes["direction"] == "x") & (k == 2)
        many_shapes.append(shapes.assign(re=re.where(~turned, -re), repeat=k).drop(columns=["std"]))
    pd.concat(many_modes).to_csv(folder / "modes.csv", index=False)
    pd.concat(many_shapes).to_csv(folder / "shapes.csv", index=False)
    return folder


def pooling(folder, kind):
    file = folder / "study.toml"
    text = file.read_text()
    assert "[withheld]" in text
    file.write_text(text.replace("[withheld]", f'pooling = "{kind}"\n\n[withheld]', 1))


def test_a_turned_channel_in_one_repeat(example, tmp_path):
    study = Study.load(example)
    results = Results.at(tmp_path / "results", study.name)
    compare(study, results)
    table = pd.read_csv(results.path / "repeat_disagreements.csv")
    assert table[["kind", "sensor", "left_out"]].to_numpy().tolist() == [["sensor", "3x", True]]
    assert "repeat 2" in table.loc[0, "repeat"]
    assert table.loc[0, "value"] == pytest.approx(-1, abs=0.1)
    assert len(check_repeats(study)) == 1
    measured = pd.read_csv(results.path / "measured.csv")
    assert measured["repeats"].tolist() == [5] * 4
    pooling(example, "plain")
    plain = Study.load(example)
    assert [d.left_out for d in plain.disagreements] == [False]
    swollen, clean = (scatter_of(s.measured).shape.mean() for s in (plain, study))
    assert swollen > 3 * clean
    assert plain.measured.fingerprint != study.measured.fingerprint
