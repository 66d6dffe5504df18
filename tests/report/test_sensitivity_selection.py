import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from calib.errors.errors import InputError
from calib.report.figures import Figures
from calib.report.sensitivity import MEASURES, draw_selection


@pytest.fixture
def selection() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "parameter": ["K_primary", "m_centre", "position", "E_wood", "K_contact"],
            "max_spearman": [0.6, -0.7, 0.05, 0.02, 0.5],
            "spearman_response": ["f", "f", "f", "f", "f"],
            "spearman_floor": 0.16,
            "max_partial": [0.9, 0.1, -0.1, 0.03, 0.8],
            "partial_floor": 0.17,
            "max_variance_share": [0.5, 0.05, 0.6, np.nan, 0.4],
            "variance_share_floor": [0.1, 0.12, 0.14, np.nan, 0.1],
            "measured": [True, False, True, False, True],
            "forced": [True, True, True, False, False],
            "selected": [True, True, True, False, False],
            "why": "words",
        }
    )


@pytest.fixture
def inputs() -> pd.DataFrame:
    names = ["m_centre", "m_ends", "m_bar"]
    cells = [[1.0, 0.05, -0.87], [0.05, 1.0, -0.27], [-0.87, -0.27, 1.0]]
    table = pd.DataFrame(cells, columns=names)
    table.insert(0, "parameter", names)
    return table


def test_bars_have_the_absolute_values_and_are_hollow_below_the_floor(selection):
    ax = draw_selection(selection)
    for container, (measure, (_, colour)) in zip(ax.containers, MEASURES.items(), strict=True):
        size, floor = selection[f"max_{measure}"].abs(), selection[f"{measure}_floor"]
        np.testing.assert_allclose([bar.get_width() for bar in container], size)
        filled = [to_hex(bar.get_facecolor()) == colour.lower() for bar in container]
        assert filled == (size >= floor).tolist()
    marks = [segments for c in ax.collections for segments in c.get_segments()]
    drawn = np.array([segment[0][0] for segment in marks])
    expected = np.concatenate([selection[f"{m}_floor"].to_numpy(dtype=float) for m in MEASURES])
    np.testing.assert_allclose(drawn, expected[np.isfinite(expected)])


def test_the_selection_stands_beside_each_parameter(selection):
    ax = draw_selection(selection)
    words = {round(t.get_position()[1]): t.get_text() for t in ax.texts}
    assert words == {0: "selected", 1: "kept by the study", 2: "selected", 3: "–", 4: "left out by the study"}
    assert [t.get_text() for t in ax.get_yticklabels()] == list(selection["parameter"])
    assert ax.get_ylim()[0] > ax.get_ylim()[1]  # first parameter on top


@pytest.mark.medium
def test_each_figure_is_drawn_when_its_table_is_there(tmp_path, unrendered, sensitivity, inputs, selection):
    sensitivity.to_csv(tmp_path / "partial.csv", index=False)
    assert [p.name for p in Figures(tmp_path, "Bogie", True).save()] == ["partial.png"]
    sensitivity.to_csv(tmp_path / "variance_share.csv", index=False)
    inputs.to_csv(tmp_path / "input_correlation.csv", index=False)
    selection.to_csv(tmp_path / "selection.csv", index=False)
    written = Figures(tmp_path, "Bogie", True).save()
    assert [p.stem for p in written] == ["partial", "variance_share", "input_correlation", "selection"]
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in written)


def test_a_damaged_table_is_named(tmp_path, inputs, selection):
    inputs.iloc[::-1].to_csv(tmp_path / "input_correlation.csv", index=False)
    with pytest.raises(InputError, match="same parameters"):
        Figures(tmp_path, "Bogie", True).save()
    (tmp_path / "input_correlation.csv").unlink()
    selection.drop(columns="partial_floor").to_csv(tmp_path / "selection.csv", index=False)
    with pytest.raises(InputError, match="'partial_floor' is missing"):
        Figures(tmp_path, "Bogie", True).save()
