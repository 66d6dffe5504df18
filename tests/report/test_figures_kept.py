"""Pictures that show what they would show again are not drawn again."""

import pandas as pd
import pytest

from calib.report import figures as module
from calib.report import kept
from calib.report.figures import Figures
from calib.report.kept import KeptFigures
from calib.report.tables import CurrentFolder
from calib.results.results import Results


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


def test_a_folder_in_which_nothing_was_drawn_takes_results(tmp_path):
    """That of several tests holds no table after a comparison, which is told test by test."""
    KeptFigures(CurrentFolder(tmp_path, frozenset()), ()).note([])
    assert KeptFigures(CurrentFolder(tmp_path, frozenset()), ()).there == []
    Results.at(tmp_path.parent, tmp_path.name).write_table("verdicts", pd.DataFrame({"a": [1]}))


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
    monkeypatch.setattr(module, "drawn_by", lambda: "a later version")
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
def test_a_picture_too_wide_for_a_column_is_told_again_where_it_is_not_drawn_again(folder, drawn, monkeypatch):
    figures = Figures(folder, "Mast", True)
    legible = module.is_legible
    monkeypatch.setattr(module, "is_legible", lambda figure: legible(figure) and len(figure.axes) > 1)
    figures.save(width="column")
    assert set() < set(figures.too_wide) < set(figures.plan)
    assert drawn(width="column") == set()
    again = Figures(folder, "Mast", True)
    again.save(width="column")
    assert again.too_wide == figures.too_wide
    again.save()
    assert again.too_wide == ()


@pytest.fixture
def noted(tmp_path):
    """A folder with a table and pictures whose drawing was noted."""
    results = Results(tmp_path)
    results.write_json("record", {"when": 1})
    (tmp_path / "modes.csv").write_text("mode\n1BT\n")
    pictures = [results._write(f"{name}.png", name) for name in ("modes", "comparison")]
    now = KeptFigures(CurrentFolder(tmp_path, frozenset()), ("Mast", True))
    assert now.there is None
    now.begin()
    now.note(pictures)
    assert now.there == pictures
    return results


def test_a_folder_is_known_as_drawn_until_what_decides_its_pictures_changes(noted, monkeypatch):
    folder = noted.path

    def there(looks=("Mast", True), *stale):
        return KeptFigures(CurrentFolder(folder, frozenset(stale)), looks).there

    noted.write_json("record", {"when": 2})
    assert there() == [folder / "modes.png", folder / "comparison.png"]
    assert there(("Tower", True)) is there(("Mast", True), "modes.csv") is None
    with monkeypatch.context() as patch:
        patch.setattr(kept, "drawn_by", lambda: "a later version")
        assert there() is None
    table = (folder / "modes.csv").read_text()
    (folder / "modes.csv").write_text(table.replace("1", "2"))
    assert there() is None
    (folder / "modes.csv").write_text(table)
    assert there() is not None
    (folder / "errors.csv").write_text("group\n")
    assert there() is None


@pytest.mark.parametrize("damage", ["edited", "gone", "begun", "forgotten", "torn"])
def test_a_folder_whose_picture_or_note_is_not_as_written_is_drawn(noted, damage):
    now = KeptFigures(CurrentFolder(noted.path, frozenset()), ("Mast", True))
    if damage == "edited":
        (noted.path / "modes.png").write_text("edited")
    elif damage == "gone":
        (noted.path / "modes.png").unlink()
    elif damage == "begun":
        now.begin()
    elif damage == "forgotten":
        now.forget()
    else:
        (noted.path / "figures.sha256").write_text("")
    assert now.there is None


def test_tables_that_change_while_they_are_drawn_are_drawn_again(noted):
    now = KeptFigures(CurrentFolder(noted.path, frozenset()), ("Mast", True))
    now.begin()
    (noted.path / "modes.csv").write_text("mode\n2BT\n")
    now.note([noted.path / "modes.png"])
    assert KeptFigures(now.folder, now.looks).there is None


def test_pictures_of_other_tables_are_outdated_whatever_they_look_like(noted):
    folder = noted.path
    noted._write("anthill.png", "asked for by name")

    def outdated(looks=("Mast", True)):
        found = KeptFigures(CurrentFolder(folder, frozenset()), looks).outdated
        return None if found is None else {path.name for path in found}

    assert outdated() is outdated(("Tower", True)) is None
    (folder / "modes.csv").write_text("mode\n2BT\n")
    (folder / "mine.png").write_bytes(b"of the user")
    assert outdated() == {"modes.png", "comparison.png"}
    KeptFigures(CurrentFolder(folder, frozenset()), ()).begin()  # nobody knows what an interrupted drawing has left
    assert outdated() == {"modes.png", "comparison.png", "anthill.png"}
    KeptFigures(CurrentFolder(folder, frozenset()), ()).forget()
    assert outdated() is None
