"""Figures that several processes make are those of one."""

import sys

import pytest

from calib.api.figures_made import make_all
from calib.errors.errors import InputError
from calib.execution.stage import silent
from calib.execution.tasks import shared_by
from calib.execution.team import Team
from calib.report.figures import FigureRequest, Figures


def asked(*page):
    return FigureRequest(page, formats=("png", "pdf", "svg"), width="page")


@pytest.fixture
def folder(tmp_path, before, after, comac, modes, convergence):
    tables = {
        "comparison_before": before, "comparison_after": after, "comac_after": comac, "modes": modes,
        "convergence": convergence,
    }  # fmt: skip
    for name, table in tables.items():
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    return tmp_path


def drawn(figures, shown):
    elements = [figures.svg(name) for name in shown]
    files = figures.save(asked().formats)
    return elements, {file.name: file.read_bytes() for file in files if file.suffix != ".pdf"}, {f.name for f in files}


@pytest.fixture
def shown(folder):
    return list(Figures(folder, "Mast", True).plan)[:2]


@pytest.mark.slow
def test_what_is_made_before_is_what_is_drawn_on_demand(folder, shown):
    expected = drawn(Figures(folder, "Mast", True), shown)
    for file in folder.glob("*.png"):
        file.unlink()
    figures, told = Figures(folder, "Mast", True), []
    figures.take(lambda: make_all(figures, asked(*shown), lambda *given: told.append(given)))
    assert not told
    elements = [figures.svg(name) for name in shown]
    assert not list(folder.glob("*.png"))  # nothing is written before all are made
    assert [done for _, done, _ in told] == list(range(len(figures.plan)))
    figures._content = None  # nothing is drawn twice
    assert elements == expected[0] and drawn(figures, shown) == expected and len(expected[2]) > 9


@pytest.mark.slow  # a process of its own imports Matplotlib
def test_they_are_the_same_whoever_makes_them(folder, shown, tmp_path_factory, monkeypatch):
    home = tmp_path_factory.mktemp("tasks")
    (home / "figure_tasks.py").write_text(
        "import os, time\n\n\ndef who(_, item):\n    time.sleep(0.05)\n    return os.getpid()\n"
    )
    monkeypatch.syspath_prepend(home)
    import figure_tasks

    expected, own, figures = drawn(Figures(folder, "Mast", True), shown), [], Figures(folder, "Mast", True)
    with Team(2) as team, shared_by(team):
        while len(set(team(figure_tasks.who, None, range(12)))) == 1:
            pass
        for _ in range(20):  # on a busy machine this process may be through before the other has begun
            own.clear()
            known = make_all(figures, asked(*shown), lambda *given: own.append(given))
            if len(own) < len(figures.plan):
                break
    figures.take(lambda: known)
    assert drawn(figures, shown) == expected
    assert 0 < len(own) < len(figures.plan)
    del sys.modules["figure_tasks"]


def test_a_damaged_table_is_refused(folder):
    (folder / "comparison_after.csv").write_text("mode,freq\nx,y\n")
    with pytest.raises(InputError, match="comparison_after"):
        make_all(Figures(folder, "Mast", True), asked(), silent)
