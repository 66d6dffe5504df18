"""Figures that two processes draw are those of one."""

import os
import time
from concurrent.futures import ProcessPoolExecutor

import pytest

from calib.errors import InputError
from calib.front import second_process
from calib.front.second_process import in_two_processes
from calib.report.figures import Asked, Figures


def asked(*page):
    return lambda: Asked(page, formats=("png",), width="page")


@pytest.fixture
def folder(tmp_path, monkeypatch, before, after, comac, modes, convergence):
    monkeypatch.setattr(second_process, "ENOUGH", 2)
    tables = {
        "comparison_before": before, "comparison_after": after, "comac_after": comac, "modes": modes,
        "convergence": convergence,
    }  # fmt: skip
    for name, table in tables.items():
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    return tmp_path


def drawn(figures, shown):
    elements = [figures.svg(name) for name in shown]
    files = figures.save()
    return elements, {file.name: file.read_bytes() for file in files}


@pytest.mark.slow  # a process of its own imports Matplotlib
def test_the_figures_are_those_of_one_process(folder, monkeypatch):
    shown = list(Figures(folder, "Mast", True).plan)[:2]
    expected = drawn(Figures(folder, "Mast", True), shown)
    figures, own = Figures(folder, "Mast", True), []
    last = folder / f"{list(figures.plan)[-1]}.png"
    last.unlink()
    made = figures.made
    monkeypatch.setattr(figures, "made", lambda name, asked: own.append(name) or made(name, asked))
    with in_two_processes(figures, asked(*shown), 2):
        begin = time.monotonic()
        while not last.exists():  # the second process begins there
            assert time.monotonic() - begin < 60
            time.sleep(0.05)
        found = drawn(figures, shown)
    assert found == expected and len(found[1]) > 3
    assert 0 < len(own) < len(figures.plan)


@pytest.mark.slow  # a process of its own imports Matplotlib
def test_when_the_second_process_dies_the_first_draws_all(folder, monkeypatch):
    class Dying(ProcessPoolExecutor):
        def submit(self, *given):
            return super().submit(os._exit, 3)

    monkeypatch.setattr(second_process, "ProcessPoolExecutor", Dying)
    figures = Figures(folder, "Mast", True)
    with in_two_processes(figures, asked(*figures.plan), 2):
        found = drawn(figures, figures.plan)
    assert found == drawn(Figures(folder, "Mast", True), figures.plan)


def test_a_damaged_table_is_refused_in_two_processes_too(folder):
    (folder / "comparison_after.csv").write_text("mode,freq\nx,y\n")
    figures = Figures(folder, "Mast", True)
    with pytest.raises(InputError, match="comparison_after"), in_two_processes(figures, asked(*figures.plan), 2):
        figures.save()


def test_few_figures_or_one_core_need_no_second_process(folder, monkeypatch):
    monkeypatch.setattr(second_process, "ProcessPoolExecutor", None)
    figures = Figures(folder, "Mast", True)
    with in_two_processes(figures, asked(*figures.plan), 1):
        assert figures._help is None
    monkeypatch.setattr(second_process, "ENOUGH", 100)
    with in_two_processes(figures, asked(*figures.plan), 2):
        assert figures._help is None
