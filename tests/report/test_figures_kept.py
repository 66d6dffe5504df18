"""Pictures that show what they would show again are not drawn again."""

import pytest

from calib.report import figures as module
from calib.report.figures import Figures


@pytest.fixture
def folder(tmp_path, before, modes, convergence):
    for name, table in {"comparison_before": before, "modes": modes, "convergence": convergence}.items():
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    Figures(tmp_path, "Mast", True).save()
    return tmp_path


@pytest.fixture
def drawn(folder, monkeypatch):
    """Names of the pictures that saving draws, for given arguments of `Figures` and `Figures.save`."""

    def save(title="Mast", synthetic=True, **more):
        made, content = [], module.content

        def noted(figure, name, *rest):
            made.append(name)
            return content(figure, name, *rest)

        with monkeypatch.context() as patch:
            patch.setattr(module, "content", noted)
            files = Figures(folder, title, synthetic).save(**more)
        assert all(file.is_file() for file in files)
        assert {file.stem for file in files} == set(Figures(folder, title, synthetic).plan)
        return set(made)

    return save


@pytest.mark.medium
def test_unchanged_tables_draw_nothing(folder, drawn):
    before = {file: file.read_bytes() for file in folder.glob("*.png")}
    assert len(before) >= 3 and drawn() == set()
    assert {file: file.read_bytes() for file in folder.glob("*.png")} == before


@pytest.mark.medium
def test_a_changed_table_draws_what_shows_it(folder, drawn, convergence):
    convergence.assign(best=convergence["best"] * 1.01).to_csv(folder / "convergence.csv", index=False)
    assert drawn() == {"convergence"}
    assert drawn() == set()


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    "change", [{"title": "Tower"}, {"synthetic": False}, {"width": "column"}, {"formats": ("png", "svg")}]
)
def test_another_heading_width_or_format_draws_all(folder, drawn, change):
    assert drawn(**change) == set(Figures(folder, "Mast", True).plan)


@pytest.mark.slow
def test_other_code_draws_all(folder, drawn, monkeypatch):
    monkeypatch.setattr(module, "_drawn_by", lambda: "a later version")
    assert drawn() == set(Figures(folder, "Mast", True).plan)


@pytest.mark.slow
def test_a_picture_that_is_gone_or_was_edited_is_drawn(folder, drawn):
    (folder / "convergence.png").unlink()
    assert drawn() == {"convergence"}
    with (folder / "convergence.png").open("ab") as file:
        file.write(b"edited")
    assert drawn() == {"convergence"}
    (folder / "convergence.png").write_bytes(b"no picture")
    assert drawn() == {"convergence"}


@pytest.mark.slow
def test_a_picture_too_wide_for_a_column_is_told_again_where_it_is_not_drawn_again(folder, drawn):
    figures = Figures(folder, "Mast", True)
    figures.save(width="column")
    assert set() < set(figures.too_wide) < set(figures.plan)
    assert drawn(width="column") == set()
    again = Figures(folder, "Mast", True)
    again.save(width="column")
    assert again.too_wide == figures.too_wide
    again.save()
    assert again.too_wide == ()
